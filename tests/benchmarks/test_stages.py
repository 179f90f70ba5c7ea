"""Tests of the times and calls of stages: the drive that they are measured on, and the counts."""

import sys

import numpy as np
import pytest

from benchmarks.inputs.dense_traffic import DenseTraffic, one_camera
from benchmarks.speed.processor_time import functions_at
from benchmarks.speed.stage_counts import ARRAYS, CALLS, StageProbe
from benchmarks.speed.stages import N_COUNTED, N_FIRST, WITHIN, stage_figures


@pytest.mark.parametrize("n_users", [1, 6, 50])
def test_all_road_users_stay_in_view(n_users):
    drive = DenseTraffic.of(n_users)
    for frame in drive.blank_frames(100):
        assert len(drive.detections(frame)) == n_users


ARRAY = np.ones(3)


def worked(array, values):
    """Two operators and a call on arrays, a call of C, and two of Python's own numbers."""
    total = values[0] + values[1]
    return np.maximum(array * array, array[1:2]), abs(total)


def counted(n_frames=10):
    probe = StageProbe()
    for index in range(40 + n_frames):
        with probe.frame(counts=index >= 40), probe.stage("outer"), probe.stage("inner"):
            worked(ARRAY, [1.0, 2.0])
    return probe.figures(n_frames)


def test_calls_and_operations_of_arrays_are_counted_by_stage():
    rows = counted()
    assert rows["inner"][ARRAYS] == 3
    assert rows["inner"][CALLS] >= 2
    assert rows["outer"][ARRAYS] == 0
    assert rows["sum"][ARRAYS] == 3


def test_functions_of_numpy_are_restored():
    before = np.maximum, np.where, np.linalg.norm
    counted()
    assert (np.maximum, np.where, np.linalg.norm) == before


def test_a_trace_function_counts_for_nothing_and_is_active_again():
    def trace(*_):
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        rows = counted()
        assert sys.gettrace() is trace
    finally:
        sys.settrace(before)
    assert rows["inner"][ARRAYS] == 3


def test_time_of_a_stage_within_another_one_counts_once():
    probe = StageProbe()
    with probe.frame(), probe.stage("outer"), probe.stage("inner"):
        sum(range(1_000_000))
    (times_s,) = probe.times_s
    assert times_s["inner"] > 10 * times_s["outer"]


@pytest.mark.parametrize("path", [path for paths in WITHIN.values() for path in paths])
def test_functions_that_are_stages_exist(path):
    assert all(callable(function) for _, function in functions_at(path))


@pytest.mark.slow
@pytest.mark.parametrize("is_pair", [False, True])
def test_every_stage_of_a_frame_has_figures(is_pair):
    wrapped = [pair for paths in WITHIN.values() for path in paths for pair in functions_at(path)]
    drive = DenseTraffic.of(6)
    frames = list(drive.blank_frames(N_FIRST + 10 + N_COUNTED))
    frames = frames if is_pair else [one_camera(frame) for frame in frames]
    rows = stage_figures(drive, frames, has_images=False)
    expected = {"track", "lanes", "mono", "fuse", "filter", "alarm", "writers", "overlay", "sum"}
    assert expected | ({"stereo", "odometry, pair"} if is_pair else set()) <= set(rows)
    assert all(row["ms"] >= 0 and row[CALLS] >= 0 for row in rows.values())
    assert rows["sum"]["ms"] == pytest.approx(
        sum(row["ms"] for name, row in rows.items() if name != "sum")
    )
    assert all(getattr(owner, function.__name__) is function for owner, function in wrapped)
