"""Fusion of the boxes of several detectors (weighted boxes fusion).

The boxes of all detectors and views are visited in order of decreasing score s. A box without a cluster starts a new
one, which takes all free boxes of easily confused classes whose IoU with this box exceeds 0.55. A cluster C becomes

    box = (sum over i in C of s_i^2 b_i) / (sum over i in C of s_i^2)
    s_dc = min(1, 1/2 sum over i in C of s_i), for the boxes i of detector d and class c in both views

which is the mean score over the views, as non-maximum suppression leaves hardly more than one such box per view.

(Solovyev, Wang, Gabruseva, "Weighted boxes fusion", Image and Vision Computing 2021, with squared weights, clusters
around their best box, and one score per detector and class, which `calibration` combines, instead of a mean score.)
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from track_range.detection.boxes import iou
from track_range.detection.classes import ROAD_CLASSES, SAME_OBJECT_GROUP
from track_range.detection.training.ensemble.views import N_VIEWS, ViewBoxes
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray, check_shape

SAME_OBJECT_IOU = 0.55  # IoU above which boxes of easily confused classes are boxes of one object
MIN_CLUSTER_SCORE = 0.04  # minimum score of the best box of a cluster


@dataclass(frozen=True, slots=True)
class FusedBoxes:
    """The K fused boxes of D detectors in one image."""

    xyxy: FloatArray  # (K, 4) left, top, right, bottom as fractions of the image size
    score: FloatArray  # (K, D, 8) score s_dc by detector and road class; 0 = not detected

    def __post_init__(self) -> None:
        check_shape("xyxy", self.xyxy, (len(self.score), 4))
        check_shape("score", self.score, (None, None, len(ROAD_CLASSES)))


def fuse(boxes: Sequence[ViewBoxes]) -> FusedBoxes:
    """The fused boxes of one image, in order of their best score, from the boxes of each
    detector.
    """
    s, b, c = (
        np.concatenate([getattr(detected, key) for detected in boxes])
        for key in ("score", "xyxy", "class_id")
    )
    d = np.repeat(np.arange(len(boxes)), [len(detected.score) for detected in boxes])
    order = np.argsort(-s, kind="stable")
    s, b, c, d = s[order], b[order], c[order], d[order]
    is_same_object = (iou(b, b) > SAME_OBJECT_IOU) & (
        SAME_OBJECT_GROUP[c][:, None] == SAME_OBJECT_GROUP[c]
    )
    cluster = _clusters(is_same_object, n_seeds=int(np.count_nonzero(s >= MIN_CLUSTER_SCORE)))
    n_clusters = int(cluster.max(initial=-1)) + 1
    used = cluster >= 0
    s, b, c, d, cluster = s[used], b[used], c[used], d[used], cluster[used]

    weighted = np.zeros((n_clusters, 4))
    np.add.at(weighted, cluster, (s**2)[:, None] * b)
    s_dc = np.zeros((n_clusters, len(boxes), len(ROAD_CLASSES)))
    np.add.at(s_dc, (cluster, d, c), s / N_VIEWS)
    total = np.bincount(cluster, s**2, minlength=n_clusters)
    return FusedBoxes(weighted / total[:, None], np.minimum(s_dc, 1.0))


def _clusters(is_same_object: BoolArray, *, n_seeds: int) -> IntArray:
    """(N,) cluster of each box, in order of decreasing score, -1 = none; only the first `n_seeds`
    start clusters.
    """
    cluster: IntArray = np.full(len(is_same_object), -1, np.int64)
    n_clusters = 0
    for seed in range(n_seeds):
        if cluster[seed] < 0:
            cluster[is_same_object[seed] & (cluster < 0)] = n_clusters
            cluster[seed] = n_clusters  # its IoU with itself is 0 if it is empty
            n_clusters += 1
    return cluster
