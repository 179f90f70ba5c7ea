"""Frames looked at as they pass: what is told, and that they pass unchanged."""

import cv2
import numpy as np
import pytest

from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import RigError
from track_range.video.pair_monitor import MAX_CHECKED_PAIRS, PairWatch, checked_pair, order_checked

SIZE_PX = (480, 260)


def eye(number, *, shift_px, row_px=0, zoom=1.05):
    """A textured wall that the vehicle drives towards, as one eye sees it."""
    noise = np.random.default_rng(7).normal(size=(320, 700))
    wall = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    grown = zoom**number
    towards = np.array([[grown, 0, 250 - grown * 350 - shift_px], [0, grown, 130 - grown * 160 + row_px]])
    return cv2.warpAffine(wall, towards, SIZE_PX)


def frames(n, *, late=0, shift_px=10, **more):
    for number in range(n):
        left = eye(number, shift_px=0, zoom=more.get("zoom", 1.05))
        yield Frame(number, number / 10, left, eye(number - late, shift_px=shift_px, **more))


def notes_of(passing):
    watch = PairWatch()
    passed = [frame.index for frame in watch.watched(passing)]
    assert passed == list(range(len(passed)))
    return watch.notes


def test_nothing_is_told_of_a_good_pair():
    assert notes_of(frames(24)) == ()


@pytest.mark.parametrize(("late", "eye_name"), [(1, "right"), (-1, "left")])
def test_an_eye_that_is_a_frame_late_is_told_once(late, eye_name):
    (note,) = notes_of(frames(24, late=late))
    assert f"the {eye_name} video is a frame late" in note
    assert f"cut the first frame off the {eye_name} video" in note


def test_a_vehicle_that_stands_still_tells_nothing():
    assert notes_of(frames(24, late=1, zoom=1.0)) == ()


def test_rows_apart_are_told():
    (note,) = notes_of(frames(3, row_px=5))
    assert "+5.0 px apart" in note


def test_swapped_eyes_are_refused():
    with pytest.raises(RigError, match="left and right are swapped"):
        notes_of(frames(3, shift_px=-10))


def test_the_order_of_the_eyes_is_looked_at_until_it_is_known():
    assert [frame.index for frame in order_checked(frames(4))] == [0, 1, 2, 3]
    with pytest.raises(RigError, match="left and right are swapped"):
        list(order_checked(frames(3, shift_px=-10)))
    first, swapped = next(frames(1)), next(frames(1, shift_px=-10))
    assert list(order_checked([first, swapped])) == [first, swapped]
    blank = Frame(0, 0.0, np.zeros((260, 480), np.uint8), np.zeros((260, 480), np.uint8))
    assert len(list(order_checked([*[blank] * MAX_CHECKED_PAIRS, swapped]))) == MAX_CHECKED_PAIRS + 1
    with pytest.raises(RigError):
        list(order_checked([*[blank] * (MAX_CHECKED_PAIRS - 1), swapped]))


def test_pairs_that_share_nothing_are_told_after_ten():
    rng = np.random.default_rng(1)
    images = rng.integers(0, 255, (13, 2, 120, 160), np.uint8)
    (note,) = notes_of(Frame(i, i / 10, left, right) for i, (left, right) in enumerate(images))
    assert "share too few points" in note


def test_one_camera_is_not_checked():
    assert checked_pair(Frame(0, 0.0, np.zeros((9, 9), np.uint8), None)) is None
