"""The road classes, and the names of other class lists (COCO, KITTI, VOC) that map to them."""

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache

import numpy as np

from track_range.foundation.arrays import BoolArray, IntArray
from track_range.foundation.errors import UserError
from track_range.foundation.files.input_files import quoted

ROAD_CLASSES = (
    "person",
    "bicycle",
    "car",
    "motorcycle",
    "bus",
    "truck",
    "traffic light",
    "traffic sign",
)
"""Names of the road classes; the index in this tuple is the `class_id` of detections and tracks."""
STATIC_CLASSES = ("traffic light", "traffic sign")  # classes that are not road users

# fmt: off
_SYNONYMS = {
    "person": ("pedestrian", "ped", "people", "human", "walker", "man", "woman", "boy", "girl", "child", "children",
               "adult"),
    "bicycle": ("bike", "cycle", "push bike"),
    "car": ("vehicle", "automobile", "auto", "passenger car", "other vehicle", "land vehicle", "motor vehicle"),
    "motorcycle": ("motorbike", "motor", "motor bike", "motor cycle"),
    "bus": ("autobus",),
    "truck": ("lorry", "heavy truck"),
    "traffic light": ("trafficlight", "light", "traffic signal"),
    "traffic sign": ("trafficsign", "sign", "road sign"),
}
_KINDS = {
    "person": ("person sitting", "rider", "motorcyclist", "other person", "person on vehicle", "police officer"),
    "bicycle": ("cyclist", "bicyclist", "biker"),
    "car": ("van", "taxi", "cab", "suv", "sedan", "hatchback", "minivan", "pickup", "pickup truck", "police car",
            "limousine", "jeep", "ambulance", "vehicle.emergency.police",
            "emergency vehicle", "transporter", "regular vehicle", "mini van"),
    "motorcycle": ("scooter", "moped", "e bike"),
    "bus": ("minibus", "mini bus", "coach", "school bus", "bendy bus", "articulated bus", "double decker bus"),
    "truck": ("trailer", "caravan", "construction vehicle", "vehicle.construction", "semi", "fire truck", "tanker",
              "heavy vehicle", "large vehicle", "box truck", "dump truck", "garbage truck", "firetruck",
              "semi truck", "truck cab", "vehicular trailer"),
    "traffic sign": ("stop sign", "speed limit sign"),
}
# fmt: on
ROAD_CLASS_OF: Mapping[str, str] = {
    **{name: name for name in ROAD_CLASSES},
    **{
        name: road
        for table in (_SYNONYMS, _KINDS)
        for road, names in table.items()
        for name in names
    },
}
"""Road class by the names of COCO, VOC, KITTI, BDD100K, Cityscapes, VisDrone, UA-DETRAC, Open
Images, nuScenes and Waymo, as `class_key` writes them; other names are not road classes. The names
in `_KINDS` cover only a part of their class.

Used for detectors, label files and boxes of other libraries. `KITTI_IGNORED` excludes some names in
KITTI's ground truth.
"""

# names of many kinds of objects: they say nothing of a kind that is not known by its own name
_GENERAL = (
    "human",
    "vehicle",
    "other vehicle",
    "land vehicle",
    "motor vehicle",
    "auto",
    "motor",
    "light",
    "sign",
)
# words that change the size of a class, not the class
_SIZE_WORDS = frozenset("big small mid medium large heavy long short s m l xl".split())
# of regions that are not evaluated
_REGION_NAMES = (
    "dontcare",
    "dont care",
    "don't care",
    "ignore",
    "ignored",
    "ignored region",
    "ignore region",
)
# of a class that stands for no object
_BACKGROUND_NAMES = ("background", "bg", "n/a")

# by class_id: detectors confuse those of a group
SAME_OBJECT_GROUP: IntArray = np.array([0, 1, 2, 1, 2, 2, 3, 4])
# neither true nor false positives
KITTI_IGNORED = ("Van", "Tram", "Misc", "Person", "Person_sitting", "DontCare")

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
# ids that COCO's annotations do not use
_UNUSED_COCO_IDS = (0, 12, 26, 29, 30, 45, 66, 68, 69, 71, 83)
_COCO_NAME_OF_ID = dict(
    zip((i for i in range(91) if i not in _UNUSED_COCO_IDS), COCO_CLASSES, strict=True)
)
# by category id, "N/A" = unused
COCO_CATEGORIES = tuple(_COCO_NAME_OF_ID.get(i, "N/A") for i in range(91))

# Pascal VOC's 20 class names, in alphabetical order as networks trained on VOC use them
VOC_CLASSES = (
    "aeroplane", "bicycle", "bird", "boat", "bottle", "bus", "car", "cat", "chair", "cow", "diningtable", "dog",
    "horse", "motorbike", "person", "pottedplant", "sheep", "sofa", "train", "tvmonitor",
)  # fmt: skip
# of MOT16 and MOT20 by number (Milan et al., "MOT16", 2016, table 3); "" = the file has no classes
MOT_CLASSES = (
    "", "pedestrian", "person on vehicle", "car", "bicycle", "motorbike", "non motorized vehicle", "static person",
    "distractor", "occluder", "occluder on the ground", "occluder full", "reflection", "crowd",
)  # fmt: skip
VISDRONE_CLASSES = (
    "ignored region", "pedestrian", "people", "bicycle", "car", "van", "truck", "tricycle", "awning-tricycle", "bus",
    "motor", "others",
)  # Zhu et al., "Detection and tracking meet drones challenge", PAMI 2021, and its toolkit's readme  # fmt: skip
CLASS_LISTS: Mapping[str, tuple[str, ...]] = {
    "coco": COCO_CLASSES,
    "coco-ids": COCO_CATEGORIES,
    "voc": VOC_CLASSES,
    "mot": MOT_CLASSES,
    "visdrone": VISDRONE_CLASSES,
}
"""Lists of names by number, as `--names` takes them."""


# for messages
ROAD_CLASS_TABLE = ", ".join(f"{class_id} {name}" for class_id, name in enumerate(ROAD_CLASSES))


class ClassNameError(UserError, ValueError):
    """Unknown class name; the message suggests the most similar road class."""


def class_key(name: str) -> str:
    """A class name in the form of `ROAD_CLASS_OF`: lower case, spaces for hyphens and underscores,
    without TYPE_.
    """
    key = str(name).strip().lower().replace("--", ".")  # Mapillary writes object--vehicle--car
    return " ".join(re.sub(r"[_\-\s]+", " ", key).split()).removeprefix("type ")


def road_class_of(name: str) -> str | None:
    """The road class of a name in another class list; None if it is not a road class.

    In a name with dots, such as nuScenes' vehicle.bus.rigid, the last known part decides, but not a
    general one: vehicle.boat is no car. Plurals and sizes (big bus) do not matter.
    """
    key = class_key(name)
    last, *parents = reversed(key.split("."))
    without_size = " ".join(word for word in last.split() if word not in _SIZE_WORDS)
    exact = [*_singulars(key), *_singulars(last)]
    others = [form for form in (*_singulars(without_size), *parents) if form not in _GENERAL]
    return next((ROAD_CLASS_OF[form] for form in exact + others if form in ROAD_CLASS_OF), None)


def _singulars(name: str) -> tuple[str, ...]:
    """A name and what it may be the plural of."""
    return name, name.removesuffix("s"), name.removesuffix("es"), re.sub("ies$", "y", name)


@lru_cache(maxsize=1024)  # files repeat few names
def is_region_name(name: str) -> bool:
    """Whether a label marks a region that is not evaluated, such as DontCare."""
    return class_key(name).removesuffix("s") in _REGION_NAMES


def is_background_name(name: str) -> bool:
    """Whether a name in a list is that of the background, or of a number that is not used."""
    return class_key(name) in _BACKGROUND_NAMES


def road_class_id(name: str) -> int:
    """Class id of a road class or a synonym, in any case.

    Example:
        >>> import track_range as tr
        >>> tr.class_id("car"), tr.class_id("Pedestrian"), tr.ROAD_CLASSES[2]
        (2, 0, 'car')

    Raises ClassNameError: the name is unknown.
    """
    road_class = road_class_of(name)
    if road_class is None:
        key = class_key(name)
        near = difflib.get_close_matches(key, ROAD_CLASS_OF, n=1, cutoff=0.0)[0]
        raise ClassNameError(
            f"unknown class '{name}': did you mean '{ROAD_CLASS_OF[near]}'? The classes are {ROAD_CLASS_TABLE}."
        )
    return ROAD_CLASSES.index(road_class)


def road_class_ids(names: Iterable[str]) -> IntArray:
    """Sorted class ids of names that a user typed, see `road_class_id`."""
    return np.array(sorted({road_class_id(name) for name in names}), np.int64)


def map_to_road_classes(names: Sequence[str]) -> IntArray:
    """(len(names),) road class id of each name of another class list; -1 for names that are not
    road classes.
    """
    road = {name: road_class_of(name) for name in set(names)}  # files repeat few names
    ids = {
        name: -1 if road_class is None else ROAD_CLASSES.index(road_class)
        for name, road_class in road.items()
    }
    return np.array([ids[name] for name in names], np.int64)


def fully_known(names: Sequence[str]) -> BoolArray:
    """(8,) road classes that a list of class names covers as a whole; stop signs are only a part of
    their class.
    """
    kinds = {kind for names_of_class in _KINDS.values() for kind in names_of_class}
    road = map_to_road_classes([name for name in names if class_key(name) not in kinds])
    return np.isin(np.arange(len(ROAD_CLASSES)), road)


def class_counts(class_ids: IntArray) -> str:
    """Number of objects of each class in words, such as "2 car, 1 bus"; "none" for (0,) ids."""
    counts = [(np.count_nonzero(class_ids == i), name) for i, name in enumerate(ROAD_CLASSES)]
    return ", ".join(f"{count} {name}" for count, name in counts if count) or "none"


ROAD_OF_COCO = {80: map_to_road_classes(COCO_CLASSES), 91: map_to_road_classes(COCO_CATEGORIES)}
"""(80,) and (91,) road class of each of COCO's class numbers and category ids; -1 = not a road
class."""


_MAX_NAME = 100  # characters of a class name


def names_of(value: object) -> tuple[str, ...]:
    """Names from a list, or from a mapping of numbers from 0 to names, as in Ultralytics' files;
    else ValueError.
    """
    if isinstance(value, Mapping):
        try:
            numbers = {int(key): name for key, name in value.items()}
        except (ValueError, TypeError, OverflowError) as error:
            raise ValueError(
                f"expected names numbered from 0, got {quoted(list(value))}"
            ) from error
        if sorted(numbers) != list(range(len(numbers))):
            raise ValueError(
                f"expected names numbered from 0 without gaps, got {quoted(sorted(numbers))}"
            )
        value = [numbers[key] for key in sorted(numbers)]
    if not isinstance(value, Sequence) or isinstance(value, str | bytes) or not value:
        raise ValueError(
            f"expected a list of names, got {quoted(value)}; specify them with --names"
        )
    for name in value:
        if not isinstance(name, str | int | float) or len(str(name)) > _MAX_NAME:
            raise ValueError(
                f"expected names of at most {_MAX_NAME} characters, got {quoted(name)}"
            )
    return tuple(str(name) for name in value)
