from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.tracking.common_motion import CommonMotion
from track_range.tracking.deepsort import DeepSortSettings, DeepSortTracker
from track_range.tracking.motion import MotionNoise, initiate

NOISE = MotionNoise()
CAR, PERSON = ROAD_CLASSES.index("car"), ROAD_CLASSES.index("person")
PEOPLE = np.array([[100.0, 50.0, 140.0, 150.0], [400.0, 50.0, 440.0, 150.0]])
S = 2 * (0.05 * 100) ** 2  # variance of a new track's prediction and of a detected box, px^2


def shift(
    moves_px: np.ndarray, boxes: np.ndarray = PEOPLE, classes: tuple[int, int] = (PERSON, PERSON)
) -> np.ndarray:
    """The shift of boxes that moved by (N, 2), from predictions at rest, in the first frame."""
    n = len(boxes)
    detections = Detections.of(
        boxes + np.tile(moves_px, 2), np.full(n, 0.9), np.full(n, classes[1])
    )
    filters = initiate(boxes, NOISE)
    return CommonMotion().update(filters, np.full(n, classes[0]), detections, 0.0, NOISE)


def test_equal_moves_by_hand() -> None:
    # both tracks move by 8 px: C = 8^2 in the first frame, V = S / 2 = 25
    expected = 8 * 64 / (64 + 25)
    np.testing.assert_allclose(shift(np.array([[8.0, 0.0], [8.0, 0.0]])), [expected, 0.0])


def test_evidence_fades_by_half_in_its_half_life() -> None:
    motion, filters, class_id = CommonMotion(), initiate(PEOPLE, NOISE), np.full(2, PERSON)
    for time_s, move_px in ((0.0, 8.0), (math.log(2), 0.0), (2 * math.log(2), 0.0)):
        moved = Detections.of(PEOPLE + np.tile([move_px, 0.0], 2), [0.9, 0.9], class_id)
        motion.update(filters, class_id, moved, time_s, NOISE)
    # C = 64 / 4 = 16, above 0.4 V = 10: with the next move of 8 px at the same time
    moved = Detections.of(PEOPLE + np.tile([8.0, 0.0], 2), [0.9, 0.9], class_id)
    found = motion.update(filters, class_id, moved, 2 * math.log(2), NOISE)
    np.testing.assert_allclose(found, [8 * 16 / (16 + 25), 0.0])


@pytest.mark.parametrize(
    "moves", [[[0.0, 0.0], [0.0, 0.0]], [[4.0, -3.0], [-4.0, 3.0]], [[4.0, 0.0], [0.0, 4.0]]]
)
def test_tracks_that_move_differently_are_no_evidence(moves: list[list[float]]) -> None:
    assert shift(np.array(moves)).tolist() == [0.0, 0.0]


def test_boxes_of_other_classes_are_no_pairs() -> None:
    moves = np.full((2, 2), 8.0)
    assert shift(moves, classes=(PERSON, PERSON)).all()
    assert not shift(moves, classes=(CAR, PERSON)).any()


def test_one_object_has_no_common_motion() -> None:
    assert not shift(np.full((1, 2), 8.0), PEOPLE[:1]).any()


def test_a_wrong_pair_counts_less() -> None:
    boxes = np.concatenate([PEOPLE + np.tile([600.0 * k, 0.0], 2) for k in range(3)])
    moves = np.tile([4.0, 0.0], (6, 1))
    moves[0] = 20.0, 0.0  # their mean is 6.7
    motion, filters, class_id = CommonMotion(), initiate(boxes, NOISE), np.full(6, PERSON)
    moved = Detections.of(boxes + np.tile(moves, 2), np.full(6, 0.9), class_id)
    found = motion.update(filters, class_id, moved, 0.0, NOISE)
    product = (moves[:, 0].sum() ** 2 - (moves[:, 0] ** 2).sum()) / (36 - 6)
    shrinkage = product / (product + S / 6)
    assert 4.0 * 0.9 * shrinkage < found[0] < 5.7 * shrinkage


@given(st.lists(st.floats(-8, 8), min_size=4, max_size=4))
def test_shift_is_odd_and_no_longer_than_the_largest_move(moves: list[float]) -> None:
    moves_px = np.reshape(moves, (2, 2))
    found = shift(moves_px)
    np.testing.assert_allclose(shift(-moves_px), -found, atol=1e-12)
    assert (np.abs(found) <= np.abs(moves_px).max(axis=0) + 1e-12).all()


def test_many_tracks_count_in_part() -> None:
    boxes = np.concatenate([PEOPLE + np.tile([1000.0 * k, 0.0], 2) for k in range(500)])
    found = shift(np.tile([4.0, 0.0], (1000, 1)), boxes)
    assert 0 < found[0] < 4


def turned(n: int, *, hidden: range, swing_px: float) -> list[Detections]:
    """Six people who stand, seen by a camera that turns to and fro; the third is hidden for a
    while."""
    frames = []
    for k in range(n):
        left = 200.0 * np.arange(6) + 100 + swing_px * math.sin(0.4 * k)
        boxes = np.stack([left, np.full(6, 50.0), left + 40, np.full(6, 150.0)], axis=1)
        rows = [i for i in range(6) if not (i == 2 and k in hidden)]
        frames.append(
            Detections.of(boxes[rows], np.full(len(rows), 0.9), np.full(len(rows), PERSON))
        )
    return frames


@pytest.mark.parametrize("is_compensated", [True, False])
def test_lost_tracks_move_with_the_camera(is_compensated: bool) -> None:
    tracker = DeepSortTracker(DeepSortSettings(is_camera_motion_compensated=is_compensated))
    frames = turned(32, hidden=range(17, 25), swing_px=25.0)
    tracks = [tracker.update(boxes, 0.1 * k, None) for k, boxes in enumerate(frames)]
    is_found = 3 in tracks[-1].track_id
    assert is_found == is_compensated


def test_a_camera_that_stands_changes_nothing() -> None:
    frames = turned(20, hidden=range(4, 6), swing_px=0.0)
    ids = []
    for is_compensated in (True, False):
        tracker = DeepSortTracker(DeepSortSettings(is_camera_motion_compensated=is_compensated))
        ids.append(
            [tracker.update(f, 0.1 * k, None).xyxy_px.tolist() for k, f in enumerate(frames)]
        )
    assert ids[0] == ids[1]
