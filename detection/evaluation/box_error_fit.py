"""Measurement of the systematic errors of a detector's boxes on labelled images (`detection.box_errors`).

    e = log(size of the box / size of the label)    of width and height, for the matches of a class
    m = median of e over all matches, s = its standard error from the medians of blocks of successive images
    mean  = g m,   g = c^2 / (c^2 + s^2)            d: deviation of a drive from the mean over drives
    sigma = sqrt(g s^2 + d^2)                       c^2 + d^2: variance of an unknown detector

Blocks are used because an object is in many images of a video. No set of images shows d; its value was measured with
the detectors of `UNKNOWN_DETECTOR`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from track_range.detection.box_errors import UNKNOWN_DETECTOR, BoxError
from track_range.detection.boxes import area_px2, intersection_px2, iou
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.formats.image_labels.image_truth import ImageTruth
from track_range.foundation.arrays import FloatArray

MIN_MATCHES = 20  # smallest number of matches of a class
# of labels, as in KITTI's evaluation; errors of smaller ones are noise of a pixel
MIN_HEIGHT_PX = 25.0
MIN_SCORE = 0.3  # of detections: those that start tracks
# of matches; distance from the image border within which a label counts as cut
_MIN_IOU, _BORDER_PX = 0.5, 2.0
# largest fraction of a label inside one that ends lower in the image, which is nearer
_MAX_COVERED = 0.1
_N_BLOCKS = 10  # of successive images
_DRIVE_SIGMA = 0.04  # d: standard deviation between KITTI 0003, 0005 and 2015 for 7 detectors
# d for drawn labels, which end at the tyres, not at the bumper as projections of 3-D boxes do
_DRAWN_SIGMA = 0.045


@dataclass(slots=True)
class BoxErrorSamples:
    """Matches of detections with labels, collected image by image."""

    n_images: int = 0
    # (K, 4) image, class, errors of log height and log width
    _rows: list[FloatArray] = field(default_factory=list)

    def add(self, image_hw: tuple[int, int], detections: Detections, truth: ImageTruth) -> None:
        """Add the matches of one image: complete, unoccluded and high labels, with boxes of their
        class.
        """
        (height_px, width_px), labels, boxes = image_hw, truth.xyxy_px, detections.xyxy_px
        covered_px2 = intersection_px2(labels, labels) * (labels[:, 3] > labels[:, 3:])
        is_used = ~truth.is_ignored & (labels[:, 3] - labels[:, 1] >= MIN_HEIGHT_PX)
        is_used &= covered_px2.max(axis=1, initial=0.0) <= _MAX_COVERED * area_px2(labels)
        is_used &= (labels[:, :2] >= _BORDER_PX).all(axis=1)
        is_used &= (labels[:, 2] <= width_px - 1 - _BORDER_PX) & (
            labels[:, 3] <= height_px - 1 - _BORDER_PX
        )
        overlap = iou(boxes, labels)
        overlap *= (detections.score >= MIN_SCORE)[:, None] & (
            detections.class_id[:, None] == truth.class_id
        )
        if overlap.size:
            # detections of one class hardly overlap, by non-maximum suppression
            best = overlap.argmax(axis=0)
            label = np.flatnonzero(is_used & (overlap.max(axis=0) >= _MIN_IOU))
            box, true = boxes[best[label]], labels[label]
            error = np.log((box[:, 2:] - box[:, :2]) / (true[:, 2:] - true[:, :2]))[:, ::-1]
            index = np.full(len(label), self.n_images)
            self._rows.append(np.column_stack([index, truth.class_id[label], error]))
        self.n_images += 1

    def fit(self, *, is_drawn: bool) -> Mapping[str, tuple[BoxError, int]]:
        """Errors and number of matches of the classes with at least `MIN_MATCHES` matches.

        `is_drawn`: the labels are drawn around what is visible, and not projections of 3-D boxes.
        """
        rows = np.concatenate([np.zeros((0, 4)), *self._rows])
        drive_sigma = _DRAWN_SIGMA if is_drawn else _DRIVE_SIGMA
        fits = {}
        for class_id, name in enumerate(ROAD_CLASSES):
            index, _, *errors = rows[rows[:, 1] == class_id].T
            if len(index) < MIN_MATCHES:
                continue
            block = (index * _N_BLOCKS // self.n_images).astype(np.int64)
            numbers = []
            for error, unknown_sigma in zip(errors, UNKNOWN_DETECTOR[name][1::2], strict=True):
                medians = [np.median(error[block == k]) for k in np.unique(block)]
                prior_variance = unknown_sigma**2 - drive_sigma**2
                variance = (
                    np.var(medians, ddof=1) / len(medians) if len(medians) > 1 else prior_variance
                )
                gain = prior_variance / (prior_variance + variance)
                sigma = np.sqrt(gain * variance + drive_sigma**2)
                numbers += [round(float(value), 3) for value in (gain * np.median(error), sigma)]
            fits[name] = BoxError(*numbers), len(index)
        return fits
