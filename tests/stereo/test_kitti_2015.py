"""Patch matcher and dense median on the labelled cars of KITTI's stereo pairs, against their true disparities.

The share of the objects' own depth in sigma was chosen on these pairs, so what is asserted of sigma only guards against
change; the drives of `test_end_to_end.py` are what it was not chosen on.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from stereo.patch_matcher import PatchMatcher
from stereo.sgbm import Sgbm, inner_half_median

Image = npt.NDArray[np.uint8]
FloatArray = npt.NDArray[np.float64]


def kitti_cars(folder: Path) -> Iterator[tuple[Image, Image, FloatArray, FloatArray]]:
    """Left, right, boxes (N, 4) and true disparities (N,) of each KITTI 2015 pair's labelled cars."""
    for path in sorted((folder / "image_2").glob("*.png")):
        left, right = (cv2.imread(str(folder / side / path.name)) for side in ("image_2", "image_3"))
        assert left is not None
        assert right is not None
        truth_px = cv2.imread(str(folder / "disp_occ_0" / path.name), cv2.IMREAD_UNCHANGED) / 256.0
        instance = cv2.imread(str(folder / "obj_map" / path.name), cv2.IMREAD_GRAYSCALE)
        cars = [car_truth(instance == number, truth_px) for number in np.unique(instance) if number > 0]
        found = [car for car in cars if car is not None]
        boxes = np.array([box for box, _ in found]).reshape(-1, 4)
        yield left, right, boxes, np.array([disparity for _, disparity in found])


def car_truth(mask: npt.NDArray[np.bool_], truth_px: FloatArray) -> tuple[FloatArray, float] | None:
    """Box and median true disparity of the inner half; None where too little of it is known."""
    rows, columns = np.nonzero(mask)
    box = np.array([columns.min() - 0.5, rows.min() - 0.5, columns.max() + 0.5, rows.max() + 0.5])
    known = mask & (truth_px > 0)
    quarter = (box[2:] - box[:2]) / 4
    (x1, y1), (x2, y2) = np.ceil(box[:2] + quarter).astype(int), np.floor(box[2:] - quarter).astype(int)
    inner = known[y1 : y2 + 1, x1 : x2 + 1]
    if known.sum() < 100 or inner.sum() < 20:
        return None
    return box, float(np.median(truth_px[y1 : y2 + 1, x1 : x2 + 1][inner]))


def test_cars_of_kitti_2015(shared_data: Path) -> None:
    patch, patch_sigma, dense, prior_error = [], [], [], []
    for left, right, boxes, truth_px in kitti_cars(shared_data / "kitti2015"):
        found, sigma = PatchMatcher().match(left, right, boxes, np.full(len(boxes), np.nan))
        again, _ = PatchMatcher().match(left, right, boxes, truth_px + 3.0)
        map_median, _ = inner_half_median(Sgbm().dense_disparity(left, right), boxes)
        patch.append(found - truth_px)
        patch_sigma.append(sigma)
        dense.append(map_median - truth_px)
        prior_error.append(again - found)
    patch_px, sigma_px, dense_px = (np.concatenate(each) for each in (patch, patch_sigma, dense))
    known = np.isfinite(patch_px)
    common = known & np.isfinite(dense_px)
    figures = {
        "cars": len(patch_px),
        "patch coverage": float(known.mean()),
        "sgbm coverage": float(np.isfinite(dense_px).mean()),
        "patch median abs error px": float(np.median(np.abs(patch_px[common]))),
        "sgbm median abs error px": float(np.median(np.abs(dense_px[common]))),
        "patch bias px": float(np.median(patch_px[common])),
        "patch share beyond 3 px": float((np.abs(patch_px[known]) > 3).mean()),
        "sgbm share beyond 3 px": float((np.abs(dense_px[np.isfinite(dense_px)]) > 3).mean()),
        "patch within 1 sigma": float((np.abs(patch_px) < sigma_px)[known].mean()),
    }
    assert figures["cars"] == 36, figures
    assert figures["patch coverage"] >= 0.9, figures
    assert figures["patch median abs error px"] <= figures["sgbm median abs error px"], figures
    assert 0.3 < figures["patch median abs error px"] < 0.6, figures  # KITTI's pairs read about 0.5 px low
    assert -0.6 < figures["patch bias px"] < -0.35, figures
    assert figures["patch share beyond 3 px"] == 0.0, figures
    assert 0.6 <= figures["patch within 1 sigma"] <= 0.76, figures
    assert np.abs(np.concatenate(prior_error)[known]).max() < 0.01
