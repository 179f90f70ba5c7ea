"""ImageTruth: what is to be found in one image, and what is neither right nor wrong to find."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from track_range.detection.classes import ROAD_CLASS_OF, ROAD_CLASSES
from track_range.detection.formats.kitti import KittiLabels
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray, check_shape

ANY_CLASS = -1
"""The class_id of what may be taken for anything, such as KITTI's Misc."""

ALL_COMPLETE: BoolArray = np.ones(len(ROAD_CLASSES), np.bool_)

_KITTI_NEIGHBOUR = {"Van": "car", "Person_sitting": "person"}
"""Types that KITTI's own evaluation neither rewards nor punishes, and the class they are taken for."""

_KITTI_REGION = "DontCare"

_KITTI_COMPLETE: BoolArray = np.isin(ROAD_CLASSES, ("person", "bicycle", "car", "truck"))
"""KITTI labels no motorcycles, buses, lights or signs."""


@dataclass(frozen=True, slots=True)
class ImageTruth:
    """The labels of one image; M = 0 means that there is nothing to find.

    Attributes:
        xyxy_px: (M, 4) float64, pixel centres at whole numbers.
        class_id: (M,) int64 road class, or ANY_CLASS (such a one is ignored in every class).
        is_ignored: (M,) neither right nor wrong to find; met by IoU, once.
        is_region: (M,) ignored, an area of many objects: met by the share of a detection inside it, again and again.
        is_complete: (8,) by road class: every such object in the image is labelled; other classes are not counted.
    """

    xyxy_px: FloatArray
    class_id: IntArray
    is_ignored: BoolArray
    is_region: BoolArray
    is_complete: BoolArray

    def __post_init__(self) -> None:
        n = len(self.class_id)
        check_shape("xyxy_px", self.xyxy_px, (n, 4))
        check_shape("class_id", self.class_id, (n,))
        check_shape("is_ignored", self.is_ignored, (n,))
        check_shape("is_region", self.is_region, (n,))
        check_shape("is_complete", self.is_complete, (len(ROAD_CLASSES),))

    @classmethod
    def of(cls, xyxy_px: Any, class_id: Any, *, is_ignored: Any = None, is_region: Any = None) -> ImageTruth:
        """Labels of an image in which every class is labelled, from anything that numpy can read as such arrays."""
        ids = np.asarray(class_id, np.int64).reshape(-1)
        regions = np.zeros(len(ids), np.bool_) if is_region is None else np.asarray(is_region, np.bool_).reshape(-1)
        ignored = np.zeros(len(ids), np.bool_) if is_ignored is None else np.asarray(is_ignored, np.bool_).reshape(-1)
        boxes = np.asarray(xyxy_px, np.float64).reshape(-1, 4)
        return cls(boxes, ids, ignored | regions | (ids == ANY_CLASS), regions, ALL_COMPLETE)


def truth_of_kitti(labels: KittiLabels) -> ImageTruth:
    """One image's KITTI rows.

    Car, Pedestrian, Cyclist and Truck are to be found; Van and Person_sitting are ignored beside their neighbour class,
    Tram, Misc and what else there is beside every class; DontCare is a region. A Cyclist's box holds bicycle and rider,
    COCO's bicycle has none: a detector of COCO's classes looks worse on it than it is. Objects of any size, occlusion
    and truncation count.
    """
    types = [str(name) for name in labels.kitti_type]
    class_id = np.array([_kitti_class_id(name) for name in types], np.int64)
    ignored = np.array([name in _KITTI_NEIGHBOUR for name in types], np.bool_)
    regions = np.array([name == _KITTI_REGION for name in types], np.bool_)
    truth = ImageTruth.of(labels.xyxy_px, class_id, is_ignored=ignored, is_region=regions)
    return replace(truth, is_complete=_KITTI_COMPLETE)


def _kitti_class_id(name: str) -> int:
    road = _KITTI_NEIGHBOUR.get(name) or ROAD_CLASS_OF.get(name.lower())
    return ANY_CLASS if road is None else ROAD_CLASSES.index(road)
