"""Matches of detections with labels by COCO's protocol (pycocotools' COCOeval, 100 boxes per image
and class).

In each image and class, detections are matched greedily in order of decreasing score, each with the
unmatched label of the largest IoU; labels to ignore are matched only if no other label is left. A
detection matched with such a label is neither a true nor a false positive.

In a bin of sizes, labels outside the bin are ignored, and unmatched detections outside the bin are
neither true nor false positives. (Lin et al., "Microsoft COCO", ECCV 2014;
cocodataset.org/#detection-eval.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from track_range.detection.boxes import area_px2, fraction_inside, iou
from track_range.detection.detections import Detections
from track_range.detection.formats.image_labels.image_truth import ANY_CLASS, ImageTruth
from track_range.foundation.arrays import BoolArray, FloatArray

IOU_THRESHOLDS: FloatArray = np.linspace(0.5, 0.95, 10)  # of AP50-95, as in COCO
MAX_DETECTIONS = 100  # per image and class, as in COCO
SizeMeasure = Literal["area", "height"]  # area in square pixels or height in pixels, in the image


@dataclass(frozen=True, slots=True)
class SizeBin:
    """Range of sizes of boxes, low <= size < high, in square pixels of the image for areas, else in
    pixels.
    """

    name: str
    measure: SizeMeasure
    low: float
    high: float

    def contains(self, xyxy_px: FloatArray) -> BoolArray:
        """(N,) mask of the boxes (N, 4) with a size in the bin."""
        size = area_px2(xyxy_px) if self.measure == "area" else height_px(xyxy_px)
        return np.asarray((self.low <= size) & (size < self.high))


ANY_SIZE = SizeBin("all", "area", 0.0, np.inf)  # bin of all sizes


@dataclass(frozen=True, slots=True)
class ClassMatches:
    """The K detections of one class in order of decreasing score, and how they were matched at each
    IoU threshold.
    """

    score: FloatArray  # (K,) confidence
    is_hit: BoolArray  # (10, K) true positive: matched with a label
    # (10, K) not counted: matched with a label to ignore, or unmatched and outside the size bin
    is_void: BoolArray
    n_boxes: int  # number of labels, without those to ignore

    @classmethod
    def concatenate(cls, parts: Sequence[ClassMatches]) -> ClassMatches:
        """The matches of several images or classes as one, in order of decreasing score."""
        if not parts:
            no_matches = np.zeros((len(IOU_THRESHOLDS), 0), np.bool_)
            return cls(np.zeros(0), no_matches, no_matches, 0)
        score = np.concatenate([part.score for part in parts])
        order = np.argsort(-score, kind="stable")
        hits = np.concatenate([part.is_hit for part in parts], axis=1)[:, order]
        voids = np.concatenate([part.is_void for part in parts], axis=1)[:, order]
        return cls(score[order], hits, voids, sum(part.n_boxes for part in parts))


def match_class(
    detections: Sequence[Detections],
    truth: Sequence[ImageTruth],
    class_id: int,
    *,
    min_height_px: float = 0.0,
    bins: Sequence[SizeBin] = (ANY_SIZE,),
) -> list[ClassMatches]:
    """The matches of one class in the images in which it is labelled completely, for each bin.

    `min_height_px`: labels below this height are ignored, and so are unmatched detections below it
    (KITTI's rule). ValueError: `detections` and `truth` differ in length.
    """
    if len(detections) != len(truth):
        raise ValueError(
            f"detections: expected {len(truth)} images, as many as in truth, got {len(detections)}"
        )
    by_image = [
        _match_image(d, t, class_id, min_height_px=min_height_px, bins=bins)
        for d, t in zip(detections, truth, strict=True)
        if t.is_complete[class_id]
        and (class_id in d.class_id or class_id in t.class_id or ANY_CLASS in t.class_id)
    ]
    return [
        ClassMatches.concatenate([matches[i] for matches in by_image]) for i in range(len(bins))
    ]


def _match_image(
    detections: Detections,
    truth: ImageTruth,
    class_id: int,
    *,
    min_height_px: float,
    bins: Sequence[SizeBin],
) -> list[ClassMatches]:
    chosen = np.flatnonzero(detections.class_id == class_id)
    chosen = chosen[np.argsort(-detections.score[chosen], kind="stable")][:MAX_DETECTIONS]
    label_rows = np.flatnonzero((truth.class_id == class_id) | (truth.class_id == ANY_CLASS))
    boxes, labels = detections.xyxy_px[chosen], truth.xyxy_px[label_rows]
    is_region = truth.is_region[label_rows]
    overlap = np.where(is_region, fraction_inside(boxes, labels), iou(boxes, labels))
    matches = []
    for size_bin in bins:
        is_counted = size_bin.contains(labels) & (height_px(labels) >= min_height_px)
        is_ignored = truth.is_ignored[label_rows] | ~is_counted
        is_hit = np.zeros((len(IOU_THRESHOLDS), len(boxes)), np.bool_)
        is_void = np.zeros_like(is_hit)
        if len(labels):
            _match(
                overlap, is_ignored=is_ignored, is_region=is_region, is_hit=is_hit, is_void=is_void
            )
        is_void |= ~is_hit & ~(size_bin.contains(boxes) & (height_px(boxes) >= min_height_px))
        n_boxes = int(np.count_nonzero(~is_ignored))
        matches.append(ClassMatches(detections.score[chosen], is_hit, is_void, n_boxes))
    return matches


def height_px(xyxy_px: FloatArray) -> FloatArray:
    """(N,) heights of the boxes (N, 4)."""
    return np.asarray(xyxy_px[:, 3] - xyxy_px[:, 1])


def _match(
    overlap: FloatArray,
    *,
    is_ignored: BoolArray,
    is_region: BoolArray,
    is_hit: BoolArray,
    is_void: BoolArray,
) -> None:
    """Set `is_hit` and `is_void` (10, K) in place, from the overlaps (K, M) of detections (best
    first) and labels.

    A region (M,) can be matched more than once. Of equal overlaps the last label is matched, as in
    pycocotools.
    """
    is_enough = overlap[:, None, :] >= np.minimum(IOU_THRESHOLDS, 1 - 1e-10)[:, None]
    is_free = np.ones((len(IOU_THRESHOLDS), overlap.shape[1]), np.bool_)
    thresholds = np.arange(len(IOU_THRESHOLDS))
    last = overlap.shape[1] - 1
    for i in np.flatnonzero(is_enough.any(axis=(1, 2))):
        candidates = is_enough[i] & is_free
        valid = candidates & ~is_ignored
        hit = valid.any(axis=1)
        allowed = np.where(hit[:, None], valid, candidates)
        label = last - np.where(allowed, overlap[i], -1.0)[:, ::-1].argmax(axis=1)
        matched = allowed.any(axis=1)
        is_hit[:, i] = hit
        is_void[:, i] = matched & ~hit
        is_free[thresholds[matched], label[matched]] = is_region[label[matched]]
