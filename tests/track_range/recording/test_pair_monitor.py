"""Tests of the checks of pairs: swapped videos, vertical offset."""

from functools import cache

import cv2
import numpy as np
import pytest

from track_range.recording.pairs.pair_monitor import MAX_CHECKED_PAIRS, PairMonitor
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import RigError

SIZE_PX = (480, 260)


@cache
def texture():
    noise = np.random.default_rng(7).normal(size=(320, 700))
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


@cache
def wall(number, *, shift_px, row_px=0):
    """Image of a textured wall that the vehicle approaches."""
    scale = 1.05**number
    transform = np.array([[scale, 0, 250 - scale * 350 - shift_px], [0, scale, 130 - scale * 160 + row_px]])
    return cv2.warpAffine(texture(), transform, SIZE_PX)


def frames(n, *, shift_px=10, **more):
    for number in range(n):
        left = wall(number, shift_px=0)
        yield Frame(number, number / 10, left, wall(number, shift_px=shift_px, **more))


def notes_of(frames, *monitors):
    for frame in frames:
        for monitor in monitors:
            monitor.add(frame)
    return tuple(note for monitor in monitors for note in monitor.notes)


def test_good_pair_has_no_notes():
    assert notes_of(frames(24), PairMonitor()) == ()


def test_row_offset_is_reported_unless_corrected():
    monitor = PairMonitor()
    (note,) = notes_of(frames(3, row_px=5), monitor)
    assert "+5.0 px" in note
    monitor.corrected_px = 4.0
    assert monitor.notes == ()


def test_swapped_pair_is_an_error():
    with pytest.raises(RigError, match="swapped"):
        notes_of(frames(3, shift_px=-10), PairMonitor())


@pytest.mark.parametrize("n_conclusive", [1, 3])
def test_number_of_conclusive_pairs(n_conclusive):
    monitor = PairMonitor(n_conclusive=n_conclusive)
    notes_of(frames(n_conclusive), monitor)
    assert monitor.is_done
    assert len(monitor.row_offsets_px) == n_conclusive
    swapped = Frame(9, 0.9, wall(0, shift_px=0), wall(0, shift_px=-10))
    assert notes_of([swapped], monitor) == ()


def test_ten_pairs_are_checked():
    blank = [Frame(n, n / 10, np.zeros((260, 480), np.uint8), np.zeros((260, 480), np.uint8)) for n in range(10)]
    swapped = Frame(10, 1.0, wall(0, shift_px=0), wall(0, shift_px=-10))
    assert len(blank) == MAX_CHECKED_PAIRS
    (note,) = notes_of([*blank, swapped], PairMonitor())
    assert "too few" in note
    with pytest.raises(RigError):
        notes_of([*blank[:9], swapped], PairMonitor())


def test_each_frame_is_checked_once():
    monitor = PairMonitor()
    blank = Frame(3, 0.3, np.zeros((260, 480), np.uint8), np.zeros((260, 480), np.uint8))
    assert notes_of([blank] * 20, monitor) == ()
    assert not monitor.is_done


def test_pairs_without_common_points_are_reported():
    rng = np.random.default_rng(1)
    images = rng.integers(0, 255, (13, 2, 120, 160), np.uint8)
    pairs = (Frame(i, i / 10, left, right) for i, (left, right) in enumerate(images))
    (note,) = notes_of(pairs, PairMonitor())
    assert "too few" in note


def test_one_camera_is_not_checked():
    single = [Frame(n, n / 10, np.zeros((9, 9), np.uint8), None) for n in range(20)]
    assert notes_of(single, PairMonitor()) == ()
