"""The size class of each type of label: one mapping for every reader of boxes with distances.

A type has the class that a detector would report (`road_class_of`), except vans, which are a size
class of their own. In labels of KITTI's layout, the types that its benchmark ignores have none. The
boxes of types without a size class are not counted, and a note says how many they are, and why.
"""

from collections.abc import Sequence

import numpy as np

from track_range.detection.classes import KITTI_IGNORED, class_key, road_class_of
from track_range.foundation.arrays import BoolArray
from track_range.foundation.files.input_files import counted, shortened
from track_range.ranging.size_models.size_model import SIZE_CLASSES

_FIRST = ("car", "van", "truck", "person", "bicycle")  # the classes of KITTI
SIZE_CLASS_ORDER = (*_FIRST, *(name for name in SIZE_CLASSES if name not in _FIRST))
"""The size classes in the order of tables."""

_IGNORED = frozenset(KITTI_IGNORED) - {"Van"}
_REGION = "DontCare"
_SITS = "people who sit have other sizes"
_REASONS = {"Person": _SITS, "Person_sitting": _SITS}


def size_class_of(label_type: str) -> str:
    """The size class of a label's type; "" = it is not a road class.

    Example:
        >>> [size_class_of(name) for name in ("Pedestrian", "Van", "Pickup", "Misc")]
        ['person', 'van', 'car', '']
    """
    key = class_key(label_type)
    return key if key == "van" else road_class_of(key) or ""  # vans have sizes of their own


def size_classes_of(kitti_types: Sequence[str]) -> list[str]:
    """The size class of each type of labels of KITTI's layout; "" = it is not counted."""
    known = {
        str(name): "" if name in _IGNORED else size_class_of(name) for name in set(kitti_types)
    }
    return [known[name] for name in kitti_types]


def not_counted_notes(
    kitti_types: Sequence[str], is_counted: BoolArray, unused: str
) -> tuple[str, ...]:
    """A sentence for each type of (N,) labels of which no box is counted, but regions.

    `unused` is the reason for a type that has a size class.
    """
    types = np.array(kitti_types, np.str_)
    notes = []
    for name in sorted(set(types.tolist()) - {*types[is_counted].tolist(), _REGION}):
        of_other = _REASONS.get(name, "no road user with known sizes")
        reason = unused if size_classes_of([name])[0] else of_other
        boxes = counted(int((types == name).sum()), "box is", "boxes are")
        notes.append(f"{shortened(name, 30)}: {boxes} not counted: {reason}.")
    return tuple(notes)
