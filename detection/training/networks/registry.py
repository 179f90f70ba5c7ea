"""The networks that can be trained, by name, with their default anchors, and anchors for the boxes
of a data set.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from track_range.detection.training.networks.network import DetectionNetwork
from track_range.detection.training.networks.road_net import RoadNet
from track_range.detection.training.networks.yolov4_tiny import (
    DEFAULT_ANCHORS_PX as YOLOV4_TINY_ANCHORS_PX,
    YoloV4Tiny,
)
from track_range.detection.training.networks.yolov5 import COCO_ANCHORS_PX, YoloV5
from track_range.detection.yolo.metadata import Anchors
from track_range.foundation.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class NetworkKind:
    """A network that can be trained."""

    family: str  # name for display
    make: Callable[..., DetectionNetwork]  # function that creates the network
    # default anchors of each head in input pixels; empty for a network without anchors
    anchors_px: Anchors = ()

    @property
    def n_heads(self) -> int:
        """Number of heads."""
        return len(self.anchors_px)

    @property
    def n_anchors(self) -> int:
        """Number of anchors of all heads."""
        return sum(len(head) for head in self.anchors_px)


NETWORKS: Mapping[str, NetworkKind] = {
    "road": NetworkKind("RoadNet", RoadNet),
    "yolov5n": NetworkKind("YOLOv5n", YoloV5, COCO_ANCHORS_PX),
    "yolov5s": NetworkKind("YOLOv5s", YoloV5, COCO_ANCHORS_PX),
    "yolov4-tiny": NetworkKind("YOLOv4-tiny", YoloV4Tiny, YOLOV4_TINY_ANCHORS_PX),
}


def make_network(
    name: str, n_classes: int, *, anchors_px: Anchors | None = None, has_cbam: bool = False
) -> DetectionNetwork:
    """A network with random weights; if it has anchors, these are `anchors_px` or its default
    anchors.
    """
    kind = NETWORKS[name]
    if not kind.anchors_px:
        return kind.make(name, n_classes, has_cbam=has_cbam)
    return kind.make(name, n_classes, anchors_px=anchors_px or kind.anchors_px, has_cbam=has_cbam)


_MAX_ROUNDS = 300
_N_STARTS = 5  # k-means runs, of which the best is used


def shape_iou(a_wh: FloatArray, b_wh: FloatArray) -> FloatArray:
    """(N, M) IoU of boxes of sizes (N, 2) and (M, 2) with the same centre."""
    intersection = np.minimum(a_wh[:, None], b_wh[None]).prod(axis=2)
    return np.asarray(
        intersection / (a_wh.prod(axis=1)[:, None] + b_wh.prod(axis=1)[None] - intersection)
    )


def mean_best_iou(sizes_px: FloatArray, anchors_px: FloatArray) -> float:
    """Mean IoU of box sizes (N, 2) with their best anchor of (K, 2)."""
    return float(shape_iou(sizes_px, anchors_px).max(axis=1).mean())


def kmeans_anchors(sizes_px: FloatArray, n_anchors: int, rng: np.random.Generator) -> FloatArray:
    """(K, 2) anchors sorted by area, for box sizes (N, 2): the best of five runs. ValueError for
    fewer sizes than K.

    k-means with the distance 1 - IoU (Redmon & Farhadi, "YOLO9000", CVPR 2017); the start is chosen
    as in k-means++ (Arthur & Vassilvitskii, SODA 2007).
    """
    n_sizes = len(np.unique(sizes_px, axis=0))
    if n_sizes < n_anchors:
        raise ValueError(
            f"expected at least {n_anchors} different box sizes for {n_anchors} "
            f"anchors, got {n_sizes}."
        )
    results = [_kmeans(sizes_px, n_anchors, rng) for _ in range(_N_STARTS)]
    best = max(results, key=lambda anchors: mean_best_iou(sizes_px, anchors))
    return best[np.argsort(best.prod(axis=1))]


def by_head(anchors_px: FloatArray, n_heads: int) -> Anchors:
    """Anchors (K, 2), sorted by area, divided equally among the heads, finest grid first."""
    return tuple(
        tuple((float(w), float(h)) for w, h in head) for head in np.split(anchors_px, n_heads)
    )


def as_text(anchors: Anchors) -> str:
    """Anchors in the format of `--anchors`: `10,14 23,27 / 81,82 135,169`."""
    return " / ".join(" ".join(f"{w:.4g},{h:.4g}" for w, h in head) for head in anchors)


def _kmeans(sizes_px: FloatArray, n_anchors: int, rng: np.random.Generator) -> FloatArray:
    chosen = [int(rng.integers(len(sizes_px)))]
    while len(chosen) < n_anchors:
        squared = (1 - shape_iou(sizes_px, sizes_px[chosen]).max(axis=1)) ** 2
        chosen.append(int(rng.choice(len(sizes_px), p=squared / squared.sum())))
    anchors = sizes_px[chosen].astype(np.float64)
    nearest = np.full(len(sizes_px), -1)
    for _ in range(_MAX_ROUNDS):
        updated = shape_iou(sizes_px, anchors).argmax(axis=1)
        if np.array_equal(updated, nearest):
            break
        nearest = updated
        for k in np.unique(nearest):
            anchors[k] = np.median(sizes_px[nearest == k], axis=0)
    return anchors
