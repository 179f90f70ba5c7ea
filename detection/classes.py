"""The road classes, and the names of other class lists (COCO, KITTI, VOC) that map to them."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence

import numpy as np

from track_range.foundation.arrays import BoolArray, IntArray
from track_range.foundation.errors import UserError

ROAD_CLASSES = ("person", "bicycle", "car", "motorcycle", "bus", "truck", "traffic light", "traffic sign")
"""Names of the road classes; the index in this tuple is the `class_id` of detections and tracks."""

ROAD_CLASS_OF = {
    **{name: name for name in ROAD_CLASSES},
    "stop sign": "traffic sign",
    "sign": "traffic sign",
    "trafficsign": "traffic sign",
    "trafficlight": "traffic light",
    "light": "traffic light",
    "traffic_light": "traffic light",
    "traffic_sign": "traffic sign",
    "pedestrian": "person",
    "cyclist": "bicycle",
    "motorbike": "motorcycle",
    "van": "car",
    "person_sitting": "person",
}
"""Road class by the lower-case name that COCO, VOC or KITTI use; other names are not road classes.

For detectors' class names. For KITTI's ground truth, `KITTI_IGNORED` excludes some of these names.
"""

_KINDS = ("stop sign", "van", "cyclist", "person_sitting")  # names in `ROAD_CLASS_OF` for only part of their class
SAME_OBJECT_GROUP: IntArray = np.array([0, 1, 2, 1, 2, 2, 3, 4])  # by class_id: detectors confuse those of a group
KITTI_IGNORED = ("Van", "Tram", "Misc", "Person", "Person_sitting", "DontCare")  # neither true nor false positives

COCO_CLASSES = (  # COCO's 80 class names, in the order that networks trained on COCO use
    "person", "bicycle", "car", "motorcycle", "airplane", "bus", "train", "truck", "boat", "traffic light",
    "fire hydrant", "stop sign", "parking meter", "bench", "bird", "cat", "dog", "horse", "sheep", "cow",
    "elephant", "bear", "zebra", "giraffe", "backpack", "umbrella", "handbag", "tie", "suitcase", "frisbee", "skis",
    "snowboard", "sports ball", "kite", "baseball bat", "baseball glove", "skateboard", "surfboard",
    "tennis racket", "bottle", "wine glass", "cup", "fork", "knife", "spoon", "bowl", "banana", "apple", "sandwich",
    "orange", "broccoli", "carrot", "hot dog", "pizza", "donut", "cake", "chair", "couch", "potted plant", "bed",
    "dining table", "toilet", "tv", "laptop", "mouse", "remote", "keyboard", "cell phone", "microwave", "oven",
    "toaster", "sink", "refrigerator", "book", "clock", "vase", "scissors", "teddy bear", "hair drier",
    "toothbrush",
)  # fmt: skip
_UNUSED_COCO_IDS = (0, 12, 26, 29, 30, 45, 66, 68, 69, 71, 83)  # ids that COCO's annotations do not use
_COCO_NAME_OF_ID = dict(zip((i for i in range(91) if i not in _UNUSED_COCO_IDS), COCO_CLASSES, strict=True))
COCO_CATEGORIES = tuple(_COCO_NAME_OF_ID.get(i, "N/A") for i in range(91))  # by category id, "N/A" = unused

VOC_CLASSES = (  # Pascal VOC's 20 class names, in alphabetical order as networks trained on VOC use them
    "aeroplane", "bicycle", "bird", "boat", "bottle", "bus", "car", "cat", "chair", "cow", "diningtable", "dog",
    "horse", "motorbike", "person", "pottedplant", "sheep", "sofa", "train", "tvmonitor",
)  # fmt: skip


ROAD_CLASS_TABLE = ", ".join(f"{class_id} {name}" for class_id, name in enumerate(ROAD_CLASSES))  # for messages


class ClassNameError(UserError, ValueError):
    """Unknown class name; the message suggests the most similar road class."""


def road_class_id(name: str) -> int:
    """Class id of a road class or a synonym, in any case.

    Example:
        >>> import track_range as tr
        >>> tr.class_id("car"), tr.class_id("Pedestrian"), tr.ROAD_CLASSES[2]
        (2, 0, 'car')

    Raises ClassNameError: the name is unknown.
    """
    key = str(name).strip().lower()
    if key not in ROAD_CLASS_OF:
        near = difflib.get_close_matches(key, ROAD_CLASS_OF, n=1, cutoff=0.0)[0]
        raise ClassNameError(
            f"unknown class '{name}': did you mean '{ROAD_CLASS_OF[near]}'? The classes are {ROAD_CLASS_TABLE}."
        )
    return ROAD_CLASSES.index(ROAD_CLASS_OF[key])


def road_class_ids(names: Iterable[str]) -> IntArray:
    """Sorted class ids of names that a user typed, see `road_class_id`."""
    return np.array(sorted({road_class_id(name) for name in names}), np.int64)


def map_to_road_classes(names: Sequence[str]) -> IntArray:
    """(len(names),) road class id of each name of another class list; -1 for names that are not road classes."""
    road = [ROAD_CLASS_OF.get(name.strip().lower()) for name in names]
    return np.array([-1 if name is None else ROAD_CLASSES.index(name) for name in road], np.int64)


def fully_known(names: Sequence[str]) -> BoolArray:
    """(8,) road classes that a list of class names has as a whole, not only a kind of them such as stop signs."""
    road = map_to_road_classes([name for name in names if name.strip().lower() not in _KINDS])
    return np.isin(np.arange(len(ROAD_CLASSES)), road)


def class_counts(class_ids: IntArray) -> str:
    """Number of objects of each class in words, such as "2 car, 1 bus"; "none" for (0,) ids."""
    counts = [(np.count_nonzero(class_ids == i), name) for i, name in enumerate(ROAD_CLASSES)]
    return ", ".join(f"{count} {name}" for count, name in counts if count) or "none"


ROAD_OF_COCO = {80: map_to_road_classes(COCO_CLASSES), 91: map_to_road_classes(COCO_CATEGORIES)}
"""(80,) and (91,) road class of each of COCO's class numbers and category ids; -1 = not a road class."""
