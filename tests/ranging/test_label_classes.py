import numpy as np
import pytest

from track_range.detection.classes import KITTI_IGNORED, ROAD_CLASS_OF
from track_range.ranging.size_models.size_model import SIZE_CLASSES
from track_range.ranging.truth.label_classes import (
    SIZE_CLASS_ORDER,
    not_counted_notes,
    size_class_of,
    size_classes_of,
)


def test_every_road_class_name_has_a_size_class():
    assert {size_class_of(name) for name in ROAD_CLASS_OF} == set(SIZE_CLASSES)
    assert sorted(SIZE_CLASS_ORDER) == sorted(SIZE_CLASSES)


@pytest.mark.parametrize(
    ("label_type", "size_class"),
    [
        ("Bus", "bus"),
        ("Motorcycle", "motorcycle"),
        ("Pickup", "car"),
        ("Bicycle", "bicycle"),
        ("Cyclist", "bicycle"),
        ("Construction_vehicle", "truck"),
        ("Van", "van"),
        ("Tram", ""),
    ],
)
def test_size_class_of_labels(label_type, size_class):
    assert size_class_of(label_type) == size_class
    assert size_classes_of([label_type]) == [size_class]


def test_types_that_kitti_ignores_have_no_class_but_vans():
    assert set(size_classes_of(list(KITTI_IGNORED))) == {"", "van"}
    assert size_class_of("Person") == "person"  # in files of other layouts


def test_types_without_a_counted_box_are_said():
    types = ["Car", "Car", "Bus", "Misc", "Misc", "DontCare", "Person_sitting"]
    is_counted = np.array([True, False, False, False, False, False, False])
    notes = not_counted_notes(types, is_counted, "none is visible")
    assert notes == (
        "Bus: 1 box is not counted: none is visible.",
        "Misc: 2 boxes are not counted: no road user with known sizes.",
        "Person_sitting: 1 box is not counted: people who sit have other sizes.",
    )
    assert not_counted_notes(types, np.ones(len(types), np.bool_), "") == ()
