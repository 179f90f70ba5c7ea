"""ImageTruth: the labels of one image, including labels to ignore in the evaluation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from track_range.detection.classes import ROAD_CLASSES, road_class_of
from track_range.detection.formats.video_labels.kitti import KittiLabels
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray, check_shape

ANY_CLASS = -1  # class_id of labels that are ignored for every class, such as KITTI's Misc
# (8,) for images with all road classes labelled
ALL_COMPLETE: BoolArray = np.ones(len(ROAD_CLASSES), np.bool_)
# ignored types, and similar evaluated classes
_KITTI_NEIGHBOUR = {"Van": "car", "Person_sitting": "person"}
# (8,) classes that it labels
_KITTI_COMPLETE: BoolArray = np.isin(ROAD_CLASSES, ("person", "bicycle", "car", "truck"))


@dataclass(frozen=True, slots=True)
class ImageTruth:
    """The M labels of one image.

    `is_region`: (M,) ignored region of many objects: any number of detections can match it, by
    their fraction inside the region instead of their IoU. `confidence`: (M,) float64 probability
    that there is such an object: 1 for labels, less for pseudo-labels.
    """

    xyxy_px: FloatArray  # (M, 4) float64, pixel centres at integers
    # (M,) int64 road class, or ANY_CLASS for labels that are ignored for every class
    class_id: IntArray
    # (M,) a detection matched with the label counts neither as true nor as false positive
    is_ignored: BoolArray
    is_region: BoolArray
    # (8,) by road class: all objects of the class are labelled; other classes are not evaluated
    is_complete: BoolArray
    confidence: FloatArray

    def __post_init__(self) -> None:
        n = len(self.class_id)
        for name in ("class_id", "is_ignored", "is_region", "confidence"):
            check_shape(name, getattr(self, name), (n,))
        check_shape("xyxy_px", self.xyxy_px, (n, 4))
        check_shape("is_complete", self.is_complete, (len(ROAD_CLASSES),))

    @classmethod
    def of(
        cls, xyxy_px: Any, class_id: Any, *, is_ignored: Any = False, is_region: Any = False
    ) -> ImageTruth:
        """Labels of an image in which all classes are labelled, from arrays or lists; see the
        attributes.
        """
        ids = np.asarray(class_id, np.int64).reshape(-1)
        regions, ignored = (
            np.full(len(ids), bool(flags))
            if np.ndim(flags) == 0
            else np.asarray(flags, np.bool_).reshape(-1)
            for flags in (is_region, is_ignored)
        )
        boxes = np.asarray(xyxy_px, np.float64).reshape(-1, 4)
        return cls(
            boxes,
            ids,
            ignored | regions | (ids == ANY_CLASS),
            regions,
            ALL_COMPLETE,
            np.ones(len(ids)),
        )


def truth_of_kitti(labels: KittiLabels) -> ImageTruth:
    """The truth of one image from its KITTI rows, for objects of any size, occlusion and
    truncation.

    Car, Pedestrian, Cyclist and Truck are evaluated; Van and Person_sitting are ignored for the
    similar class, Tram, Misc and other types for every class; DontCare is a region. The box of a
    Cyclist includes the rider, unlike the box of COCO's bicycle, so the score of a detector with
    COCO's classes is too low for this class.
    """
    types = [str(name) for name in labels.kitti_type]
    roads = [_KITTI_NEIGHBOUR.get(name) or road_class_of(name) for name in types]
    class_id = np.array(
        [ANY_CLASS if road is None else ROAD_CLASSES.index(road) for road in roads], np.int64
    )
    ignored = np.array([name in _KITTI_NEIGHBOUR for name in types], np.bool_)
    regions = np.array([name == "DontCare" for name in types], np.bool_)
    truth = ImageTruth.of(labels.xyxy_px, class_id, is_ignored=ignored, is_region=regions)
    return replace(truth, is_complete=_KITTI_COMPLETE)
