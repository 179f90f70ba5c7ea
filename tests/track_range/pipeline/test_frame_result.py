"""FrameResult: the objects of a frame, and the texts of results."""

import math

import numpy as np
import pytest

from tests.support.results.frame_results import frame_result
from track_range.ranging.measurement.ranges import Ranges
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

LEFT, RIGHT = np.zeros((80, 100, 3), np.uint8), np.zeros((80, 100), np.uint8)
NAN = math.nan


def result(*, ranges=None, right=RIGHT):
    """Three tracks: a car at 20 m, a person at 8 m, and a predicted truck."""
    ids, boxes = np.array([4, 7, 9]), np.arange(12.0).reshape(3, 4)
    fused = Ranges(ids, np.array([20.0, 8.0, NAN]), np.array([0.5, 0.2, NAN]))
    filtered = Ranges(ids, np.array([19.5, 8.1, 30.0]), np.array([0.4, 0.2, 3.0]))
    return frame_result(
        frame=Frame(12, 0.4, LEFT, right),
        tracks=Tracks(
            ids, boxes, np.array([2, 0, 5]), np.full(3, 0.9), np.array([True, True, False])
        ),
        ranges={"fused": fused, "fused_kf": filtered} if ranges is None else ranges,
        closing_mps=np.array([5.0, NAN, 1.0]),
        closing_sigma_mps=np.full(3, 0.1),
        ttc_s=np.array([4.0, NAN, NAN]),
        ttc_sigma_s=np.full(3, 0.1),
        xyz_m=np.array([[1.0, 0.5, 20.0], [0.0, 0.1, 8.0], [NAN, NAN, NAN]]),
    )


def test_objects_have_the_values_of_their_rows():
    frame = result()
    car, person, truck = frame.objects
    assert (car.id, car.class_name, car.xyxy_px, car.is_observed) == (
        4,
        "car",
        (0.0, 1.0, 2.0, 3.0),
        True,
    )
    assert (car.distance_m, car.sigma_m, car.closing_mps, car.ttc_s) == (20.0, 0.5, 5.0, 4.0)
    assert (car.filtered_m, car.filtered_sigma_m) == (19.5, 0.4)
    assert math.isnan(result(ranges={}).objects[0].filtered_m)
    assert car.position_m == (1.0, 0.5, car.distance_m)
    assert (person.class_name, truck.class_name) == ("person", "truck")
    assert math.isnan(truck.distance_m)
    assert (truck.is_observed, truck.closing_mps) == (False, 1.0)
    values = [
        car.distance_m,
        car.sigma_m,
        car.closing_mps,
        car.ttc_s,
        *car.xyxy_px,
        *car.position_m,
    ]
    assert {type(value) for value in values} == {float}
    assert (type(car.id), type(car.is_observed)) == (int, bool)


def test_objects_without_fused_distances():
    assert [math.isnan(t.distance_m) for t in result(ranges={}).objects] == [True] * 3


@pytest.mark.parametrize("right", [RIGHT, None])
def test_images_of_the_frame(right):
    frame = result(right=right)
    assert frame.left is LEFT
    assert frame.right is right


def test_results_are_shown_in_one_line():
    frame = result()
    assert (
        repr(frame) == "FrameResult(index=12, time_s=0.400, 3 objects, nearest person 7 at 8.0 m)"
    )
    assert repr(result(ranges={})) == "FrameResult(index=12, time_s=0.400, 3 objects)"
    assert repr(frame.frame) == "Frame(index=12, time_s=0.400, 100 x 80 px, two cameras)"
    assert (
        repr(result(right=None).frame) == "Frame(index=12, time_s=0.400, 100 x 80 px, one camera)"
    )
    assert repr(frame.tracks) == "Tracks(1 person, 1 car, 1 truck)"
    assert repr(frame.ranges["fused"]) == "Ranges(2 of 3 measured, 8.0 to 20.0 m)"
    assert repr(Ranges.unmeasured(np.array([1]))) == "Ranges(0 of 1 measured)"
