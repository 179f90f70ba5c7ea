"""Conversion of boxes from and to supervision's attributes."""

from types import SimpleNamespace

import numpy as np
import pytest

from track_range.detection.detections import Detections
from track_range.tracking.tracks import Tracks


def boxes(**changed):
    attributes = {
        "xyxy": np.array([[0, 0, 10, 20], [5, 5, 9, 9], [1, 2, 3, 4]], np.float32),
        "confidence": np.array([0.9, 0.8, 0.7], np.float32),
        "class_id": np.array([2, 63, 0]),  # COCO: car, laptop, person
        "tracker_id": np.array([7, 8, -1]),
        "data": {},
    }
    return SimpleNamespace(**{**attributes, **changed})


def test_road_users_of_coco_classes():
    detections = Detections.from_supervision(boxes())
    assert detections.class_id.tolist() == [2, 0]
    assert detections.score == pytest.approx([0.9, 0.7], abs=1e-6)
    assert detections.xyxy_px[0].tolist() == [-0.5, -0.5, 9.5, 19.5]  # corners to pixel centres


def test_names_come_from_data_or_argument():
    named = boxes(data={"class_name": np.array(["truck", "dog", "Pedestrian"])})
    assert Detections.from_supervision(named).class_id.tolist() == [5, 0]
    renamed = Detections.from_supervision(
        boxes(class_id=np.array([0, 1, 1])), class_names=["bus", "tree"]
    )
    assert renamed.class_id.tolist() == [4]


def test_tracks_leave_out_unconfirmed_identities():
    tracks = Tracks.from_supervision(boxes())
    assert tracks.track_id.tolist() == [7]
    assert tracks.observed.all()


def test_round_trip():
    tracks = Tracks(
        np.array([3, 9]),
        np.array([[1.5, 2.5, 30.25, 40.5], [0.0, 0.0, 5.0, 6.0]]),
        np.array([2, 6]),
        np.array([0.5, 0.25]),
        np.array([True, True]),
    )
    converted = tracks.to_supervision()
    assert len(converted) == 2
    restored = Tracks.from_supervision(converted)
    assert restored.xyxy_px.tolist() == tracks.xyxy_px.tolist()
    assert restored.track_id.tolist() == [3, 9]
    assert restored.class_id.tolist() == [2, 6]


@pytest.mark.parametrize(
    ("changed", "key_word"),
    [
        ({"confidence": np.array([0.5])}, "confidence"),
        ({"class_id": None}, "class_id"),
        ({"class_id": np.array([2, 99, 0])}, "99"),
        ({"data": {"class_name": ["car"]}}, "class_name"),
    ],
)
def test_invalid_attributes(changed, key_word):
    with pytest.raises(ValueError, match=key_word):
        Detections.from_supervision(boxes(**changed))


def test_tracks_need_identities():
    with pytest.raises(ValueError, match="tracker_id"):
        Tracks.from_supervision(boxes(tracker_id=None))
    with pytest.raises(ValueError, match="once"):
        Tracks.from_supervision(boxes(tracker_id=np.array([1, 1, 1])))
