"""Recall of the packaged detector on labelled images that are made darker, foggy, overexposed,
blurred, or covered by glare or drops.

The images are those of the validation part of a folder with a manifest.csv that have labels of people
(sets hod, dawn and coco of the road images), and KITTI's stereo pairs of 2015, whose cars have
distances. A road user of at least 6 % of the height of the image counts as found if a box with a
score of at least 0.25 of a class that detectors confuse with it has an IoU of 0.5. Every image has
sensor noise with a standard deviation of 2 grey levels, also in "day".
"""

from argparse import Namespace
from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from benchmarks.harness import Figures, option, workload
from track_range.detection.boxes import iou
from track_range.detection.catalogue.lookup import DEFAULT_MODEL, find_model
from track_range.detection.classes import (
    ROAD_CLASSES,
    SAME_OBJECT_GROUP,
    STATIC_CLASSES,
    road_class_id,
)
from track_range.detection.formats.image_labels.labelled_images import (
    of_split,
    read_image,
    read_labelled,
    read_manifest,
)
from track_range.detection.models.onnx_session import Runtime
from track_range.detection.yolo.detector import YoloDetector, YoloSettings
from track_range.foundation.arrays import FloatArray, Image, IntArray
from track_range.run.reports.visibility import look_of
from track_range.stereo.evaluation.kitti_2015 import LABELLED_CLASS, read_pairs

_NOISE, _AIR, _GLARE = 2.0, 200.0, 400.0  # grey levels: of a sensor, of fog, and of a light
_MIN_SCORE, _MIN_IOU, _MIN_HEIGHT = 0.25, 0.5, 0.06
_BANDS_M = (0.0, 20.0, 40.0, np.inf)
_SETS = ("hod", "dawn", "coco")
_IS_USER = np.array([name not in STATIC_CLASSES for name in ROAD_CLASSES])
Change = Callable[[FloatArray, np.random.Generator], FloatArray]
Labelled = tuple[Image, FloatArray, IntArray, FloatArray]


def _scaled(factor: float, image: FloatArray, rng: np.random.Generator) -> FloatArray:
    return image * factor


def _fog(share: float, image: FloatArray, rng: np.random.Generator) -> FloatArray:
    return image * share + _AIR * (1 - share)


def _blurred(sigma: float, image: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Gaussian blur with `sigma` in thousandths of the width."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma * image.shape[1] / 1000))


def _glare(radius: float, image: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A light with its halo, `radius` in widths of the image, in the middle third."""
    height, width = image.shape[:2]
    x, y = width * rng.uniform(0.33, 0.67), height * rng.uniform(0.2, 0.5)
    rows, columns = np.mgrid[:height, :width]
    halo = np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * (radius * width) ** 2))
    return np.asarray(image + _GLARE * halo[..., None])


def _drops(share: float, image: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Blurred discs that cover a share of the image."""
    height, width = image.shape[:2]
    cover = np.zeros((height, width))
    while cover.mean() < share:
        centre = int(rng.integers(width)), int(rng.integers(height))
        cv2.circle(cover, centre, int(width * rng.uniform(0.02, 0.06)), 1.0, -1)
    edge = cv2.GaussianBlur(cover, (0, 0), 0.003 * width)[..., None]
    return np.asarray(image * (1 - edge) + cv2.GaussianBlur(image, (0, 0), 0.02 * width) * edge)


CHANGES: dict[str, Change] = {
    "day": partial(_scaled, 1.0),
    **{f"dark {100 * f:.0f} %": partial(_scaled, f) for f in (0.5, 0.4, 0.3, 0.2, 0.15, 0.08)},
    **{f"overexposed x{f:g}": partial(_scaled, f) for f in (1.5, 2.0, 3.0)},
    **{f"fog {100 * f:.0f} %": partial(_fog, f) for f in (0.5, 0.3, 0.2, 0.1)},
    **{f"glare {f:g}": partial(_glare, f) for f in (0.1, 0.3)},
    **{f"blur {f:g}": partial(_blurred, f) for f in (1.5, 3.0, 5.0, 8.0)},
    **{f"drops {100 * f:.0f} %": partial(_drops, f) for f in (0.2, 0.4)},
}


@workload(
    option("--images", type=Path, help="folder with images/, labels/ and manifest.csv"),
    option("--pairs", type=Path, help="folder of KITTI's stereo pairs of 2015"),
    option("--most", default=400, help="largest number of images of the folder"),
)
def visibility(options: Namespace) -> Figures:
    """Recall, false boxes and the look of the images by what was done to them."""
    network = YoloDetector(
        find_model(DEFAULT_MODEL).path,
        YoloSettings(min_score=_MIN_SCORE),
        runtime=Runtime(n_threads=1),
    )
    figures: Figures = {}
    if options.images:
        figures["road"] = _measured(network, list(_of_folder(options.images, options.most)), ())
    if options.pairs:
        figures["kitti"] = _measured(network, list(_of_pairs(options.pairs)), _BANDS_M)
    return figures


def _of_folder(folder: Path, most: int) -> Iterator[Labelled]:
    manifest = read_manifest(folder / "manifest.csv")
    images = [
        one
        for one in of_split(
            read_labelled(folder / "images", folder / "labels", "yolo", names=ROAD_CLASSES),
            manifest,
            "val",
        )
        if one.path.name.startswith(_SETS)
    ]
    for one in images[:: max(1, -(-len(images) // most))]:
        image = read_image(one.path)
        truth = one.truth_in(image)
        height = (truth.xyxy_px[:, 3] - truth.xyxy_px[:, 1]) / image.shape[0]
        counts = (height >= _MIN_HEIGHT) & ~truth.is_ignored & _IS_USER[truth.class_id]
        yield image, truth.xyxy_px[counts], truth.class_id[counts], height[counts]


def _of_pairs(folder: Path) -> Iterator[Labelled]:
    for pair in read_pairs(folder):
        cars = np.full(len(pair.xyxy_px), road_class_id(LABELLED_CLASS))
        distance_m = pair.rig.left.fx_px * pair.rig.baseline_m / pair.true_px
        yield pair.left, pair.xyxy_px, cars, distance_m


def _measured(
    network: YoloDetector, images: list[Labelled], bands: tuple[float, ...]
) -> dict[str, Figures]:
    return {name: _figures(network, images, change, bands) for name, change in CHANGES.items()}


def _figures(
    network: YoloDetector, images: list[Labelled], change: Change, bands: tuple[float, ...]
) -> Figures:
    rng = np.random.default_rng(0)
    looks, found, sizes, n_false = [], [], [], 0
    for image, boxes, classes, size in images:
        changed = change(image.astype(np.float64), rng) + rng.normal(0.0, _NOISE, image.shape)
        shown = np.clip(np.rint(changed), 0, 255).astype(np.uint8)
        detected = network.detect(shown)
        is_same = SAME_OBJECT_GROUP[classes][:, None] == SAME_OBJECT_GROUP[detected.class_id]
        is_hit = (iou(boxes, detected.xyxy_px) >= _MIN_IOU) & is_same
        looks.append(look_of(shown))
        found.append(is_hit.any(axis=1))
        sizes.append(size)
        n_false += int((~is_hit.any(axis=0)).sum())
    hits, size = np.concatenate(found), np.concatenate(sizes)
    by_band = {
        f"recall_{low:g}_{high:g}_pct": 100 * float(hits[(size >= low) & (size < high)].mean())
        for low, high in pairwise(bands)
    }
    return {
        "n": len(hits),
        "recall_pct": 100 * float(hits.mean()),
        **by_band,
        "false_per_image": n_false / len(images),
        **{
            name: float(np.nanmedian([getattr(look, name) for look in looks]))
            for name in ("brightness", "contrast", "sharpness")
        },
    }
