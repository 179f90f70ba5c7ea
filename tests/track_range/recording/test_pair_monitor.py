"""Tests of the check of a pair's first images: which frames are used, its messages and its end."""

import re

import numpy as np
import pytest

from tests.track_range.recording.road_pairs import HEIGHT_PX, RIG, WIDTH_PX, road
from track_range.recording.pairs.pair_monitor import MAX_CHECKED_PAIRS, PairMonitor
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import RigError


def frames(n, *, step_s=1.0, row_px=0, is_swapped=False):
    for number in range(n):
        left, right = road(-1), road(1, row_px)
        yield Frame(number, number * step_s, *((right, left) if is_swapped else (left, right)))


def blank(n):
    grey = np.zeros((HEIGHT_PX, WIDTH_PX), np.uint8)
    return [Frame(number, float(number), grey, grey) for number in range(n)]


def notes_of(frames, monitor, corrected_px=0.0):
    for frame in frames:
        monitor.add(frame)
    return monitor.notes(monitor.finding, corrected_px)


def test_good_pair_has_no_notes():
    monitor = PairMonitor(RIG)
    assert notes_of(frames(MAX_CHECKED_PAIRS), monitor) == ()
    assert monitor.finding.fault == "fits"
    assert monitor.has_equal_rows


def test_row_offset_is_reported_unless_corrected():
    monitor = PairMonitor(RIG)
    (note,) = notes_of(frames(MAX_CHECKED_PAIRS, row_px=5), monitor)
    row_px = float(re.search(r"vertical offset of \+([0-9.]+) px", note)[1])
    assert row_px == pytest.approx(5.0, abs=0.2)
    assert notes_of([], monitor, corrected_px=4.5) == ()


def test_swapped_pair_is_an_error_at_the_end_of_the_check():
    monitor = PairMonitor(RIG)
    assert notes_of(frames(MAX_CHECKED_PAIRS - 1, is_swapped=True), monitor) == ()
    with pytest.raises(RigError, match="swapped"):
        monitor.finish()


def test_a_frame_is_checked_if_it_is_due():
    monitor = PairMonitor(RIG)
    assert notes_of(frames(30, step_s=0.02), monitor) == ()
    assert monitor.finding is None
    # at 0, 0.1 and 0.28 s: without motion the interval doubles
    assert monitor._n_pairs == 3


def test_pairs_without_texture_are_reported():
    monitor = PairMonitor(RIG)
    (note,) = notes_of(blank(MAX_CHECKED_PAIRS), monitor)
    assert "too few" in note
    assert not monitor.has_equal_rows
    assert notes_of(frames(3, is_swapped=True), monitor) == (note,)  # the check has ended


def test_one_camera_is_not_checked():
    single = [Frame(n, float(n), np.zeros((9, 9), np.uint8), None) for n in range(20)]
    monitor = PairMonitor(RIG)
    assert notes_of(single, monitor) == ()
    assert monitor.finish() is None
