"""The road classes, and which names of other class lists (COCO, KITTI, VOC) mean them."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence

import numpy as np

from track_range.foundation.arrays import IntArray
from track_range.foundation.errors import UserError

ROAD_CLASSES = ("person", "bicycle", "car", "motorcycle", "bus", "truck", "traffic light", "traffic sign")
"""Index in this tuple = class_id everywhere downstream of a detector."""

ROAD_CLASS_OF = {
    **{name: name for name in ROAD_CLASSES},
    "stop sign": "traffic sign",
    "sign": "traffic sign",
    "trafficsign": "traffic sign",
    "trafficlight": "traffic light",
    "light": "traffic light",
    "pedestrian": "person",
    "cyclist": "bicycle",
    "motorbike": "motorcycle",
    "van": "car",
    "person_sitting": "person",
}
"""Names of COCO, VOC and KITTI (lower case) -> road class; what is not here is not a road class.

This is what a detector's word means; what KITTI's truth asks for is narrower (`KITTI_IGNORED`).
"""

SAME_OBJECT_GROUP: IntArray = np.array([0, 1, 2, 1, 2, 2, 3, 4])
"""(8,) by class_id: classes of one group are what detectors take for each other on one and the same object."""

KITTI_IGNORED = ("Van", "Tram", "Misc", "Person", "Person_sitting", "DontCare")
"""KITTI types that are neither right nor wrong to detect or track: neighbours of a class, or labelled in lumps."""

# fmt: off
COCO_CLASSES = (
    "person", "bicycle", "car", "motorcycle", "airplane", "bus", "train", "truck", "boat", "traffic light",
    "fire hydrant", "stop sign", "parking meter", "bench", "bird", "cat", "dog", "horse", "sheep", "cow",
    "elephant", "bear", "zebra", "giraffe", "backpack", "umbrella", "handbag", "tie", "suitcase", "frisbee", "skis",
    "snowboard", "sports ball", "kite", "baseball bat", "baseball glove", "skateboard", "surfboard",
    "tennis racket", "bottle", "wine glass", "cup", "fork", "knife", "spoon", "bowl", "banana", "apple", "sandwich",
    "orange", "broccoli", "carrot", "hot dog", "pizza", "donut", "cake", "chair", "couch", "potted plant", "bed",
    "dining table", "toilet", "tv", "laptop", "mouse", "remote", "keyboard", "cell phone", "microwave", "oven",
    "toaster", "sink", "refrigerator", "book", "clock", "vase", "scissors", "teddy bear", "hair drier",
    "toothbrush",
)
# fmt: on
"""COCO's 80 names in the order of every network trained on it."""

# fmt: off
VOC_CLASSES = (
    "aeroplane", "bicycle", "bird", "boat", "bottle", "bus", "car", "cat", "chair", "cow", "diningtable", "dog",
    "horse", "motorbike", "person", "pottedplant", "sheep", "sofa", "train", "tvmonitor",
)
# fmt: on
"""Pascal VOC's 20 names, in their order."""


class ClassNameError(UserError, ValueError):
    """A class name that is no road class; the message names the nearest one."""


def road_class_ids(names: Iterable[str]) -> IntArray:
    """Class ids, sorted, of names such as a user writes them: road classes or their synonyms.

    Raises:
        ClassNameError: a name is unknown.
    """
    found = set()
    for name in names:
        key = name.strip().lower()
        if key not in ROAD_CLASS_OF:
            near = difflib.get_close_matches(key, ROAD_CLASS_OF, n=1, cutoff=0.0)[0]
            raise ClassNameError(
                f"unknown class '{name.strip()}': did you mean '{ROAD_CLASS_OF[near]}'? "
                f"The classes are {', '.join(ROAD_CLASSES)}."
            )
        found.add(ROAD_CLASSES.index(ROAD_CLASS_OF[key]))
    return np.array(sorted(found), np.int64)


def road_class_of_each(names: Sequence[str]) -> IntArray:
    """(len(names),) road class id of each name of a foreign class list, -1 where it is no road class."""
    road = [ROAD_CLASS_OF.get(name.strip().lower()) for name in names]
    return np.array([-1 if name is None else ROAD_CLASSES.index(name) for name in road], np.int64)
