"""A tiny set in KITTI 2015's layout: noise shifted by whole pixels, so that disparities are
exact."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

HEIGHT_PX, WIDTH_PX = 120, 360
FOCAL_PX, BASELINE_M = 300.0, 0.5
BACKGROUND_PX = 4
Car = tuple[int, int, int, int, int]
CARS: tuple[Car, ...] = ((100, 30, 159, 69, 20), (220, 40, 299, 99, 30))
"""First column, first row, last column, last row, disparity: 7.5 m and 5 m away."""

CALIBRATION = (
    f"P2: {FOCAL_PX} 0 180 0 0 {FOCAL_PX} 60 0 0 0 1 0\n"
    f"P3: {FOCAL_PX} 0 180 {-FOCAL_PX * BASELINE_M} 0 {FOCAL_PX} 60 0 0 0 1 0\n"
)


def noise(seed: int, *, height_px: int = HEIGHT_PX, width_px: int = WIDTH_PX) -> np.ndarray:
    grey = np.random.default_rng(seed).normal(size=(height_px, width_px))
    return cv2.normalize(cv2.GaussianBlur(grey, (0, 0), 1.2), None, 0, 255, cv2.NORM_MINMAX).astype(
        np.uint8
    )


def write_pair(
    folder: Path, name: str, *, seed: int = 0, offset_px: int = 0, cars: Sequence[Car] = CARS
) -> None:
    """One pair; the true disparities of cars are `offset_px` larger than those of the images."""
    wall = noise(seed, width_px=WIDTH_PX + BACKGROUND_PX)
    left, right = wall[:, :WIDTH_PX].copy(), wall[:, BACKGROUND_PX:].copy()
    truth, instance = np.zeros((HEIGHT_PX, WIDTH_PX)), np.zeros((HEIGHT_PX, WIDTH_PX), np.uint8)
    for number, (x1, y1, x2, y2, disparity) in enumerate(cars, 1):
        body = noise(seed + 100 * number, height_px=y2 - y1 + 1, width_px=x2 - x1 + 1)
        left[y1 : y2 + 1, x1 : x2 + 1] = body
        right[y1 : y2 + 1, x1 - disparity : x2 + 1 - disparity] = body
        truth[y1 : y2 + 1, x1 : x2 + 1] = disparity + offset_px
        instance[y1 : y2 + 1, x1 : x2 + 1] = number
    for part, image in (
        ("image_2", left),
        ("image_3", right),
        ("disp_occ_0", (256 * truth).astype(np.uint16)),
        ("obj_map", instance),
    ):
        (folder / part).mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / part / f"{name}.png"), image)


def write_set(
    folder: Path, names: Sequence[str] = ("000000_10", "000001_10"), *, offset_px: int = 0
) -> Path:
    """A set of pairs with its calibration."""
    for number, name in enumerate(names):
        write_pair(folder, name, seed=number, offset_px=offset_px)
    (folder / "calib.txt").write_text(CALIBRATION)
    return folder
