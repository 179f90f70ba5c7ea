"""Anchors from a data set's own boxes: k-means++ on widths and heights, with 1 - IoU as the distance.

(Redmon & Farhadi, "YOLO9000", CVPR 2017, for the distance; Arthur & Vassilvitskii, "k-means++", SODA 2007, for the
start.)
"""

from __future__ import annotations

import numpy as np

from track_range.detection.models.metadata import Anchors
from track_range.foundation.arrays import FloatArray

_MAX_ROUNDS = 300
_N_STARTS = 5


def shape_iou(a_wh: FloatArray, b_wh: FloatArray) -> FloatArray:
    """(N, M) IoU of boxes of sizes (N, 2) and (M, 2) on one centre."""
    shared = np.minimum(a_wh[:, None], b_wh[None]).prod(axis=2)
    return np.asarray(shared / (a_wh.prod(axis=1)[:, None] + b_wh.prod(axis=1)[None] - shared))


def mean_best_iou(sizes_px: FloatArray, anchors_px: FloatArray) -> float:
    """How well anchors (K, 2) fit boxes (N, 2): the mean IoU of each box with its best anchor."""
    return float(shape_iou(sizes_px, anchors_px).max(axis=1).mean())


def kmeans_anchors(sizes_px: FloatArray, n_anchors: int, rng: np.random.Generator) -> FloatArray:
    """(K, 2) anchors, small to large, for boxes of (N, 2) width and height: the best of five starts.

    Raises:
        ValueError: fewer different boxes than anchors.
    """
    n_sizes = len(np.unique(sizes_px, axis=0))
    if n_sizes < n_anchors:
        raise ValueError(f"{n_anchors} anchors want as many boxes of different sizes; there are {n_sizes}.")
    found = [_kmeans(sizes_px, n_anchors, rng) for _ in range(_N_STARTS)]
    best = max(found, key=lambda anchors: mean_best_iou(sizes_px, anchors))
    return best[np.argsort(best.prod(axis=1))]


def by_head(anchors_px: FloatArray, n_heads: int) -> Anchors:
    """Anchors, small to large, shared out evenly to heads, finest grid first."""
    return tuple(tuple((float(w), float(h)) for w, h in head) for head in np.split(anchors_px, n_heads))


def as_text(anchors: Anchors) -> str:
    """As `--anchors` of the detector takes them: `10,14 23,27 / 81,82 135,169`."""
    return " / ".join(" ".join(f"{w:.4g},{h:.4g}" for w, h in head) for head in anchors)


def _kmeans(sizes_px: FloatArray, n_anchors: int, rng: np.random.Generator) -> FloatArray:
    """One run from one k-means++ start."""
    chosen = [int(rng.integers(len(sizes_px)))]
    while len(chosen) < n_anchors:
        squared = (1 - shape_iou(sizes_px, sizes_px[chosen]).max(axis=1)) ** 2
        chosen.append(int(rng.choice(len(sizes_px), p=squared / squared.sum())))
    anchors = sizes_px[chosen].astype(np.float64)
    nearest = np.full(len(sizes_px), -1)
    for _ in range(_MAX_ROUNDS):
        now = shape_iou(sizes_px, anchors).argmax(axis=1)
        if np.array_equal(now, nearest):
            break
        nearest = now
        for k in np.unique(nearest):
            anchors[k] = np.median(sizes_px[nearest == k], axis=0)
    return anchors
