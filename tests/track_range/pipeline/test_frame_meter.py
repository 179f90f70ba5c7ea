"""Rate and latency of a run, with a clock set by the test."""

from __future__ import annotations

import time
from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from tests.support.results.overlay_results import result
from track_range.pipeline.throughput import FrameMeter, PacedFrames, latency_ms
from track_range.stereo.geometry.frames import Frame


@dataclass
class Camera:
    first_time_s: float


def meter_of(
    times_s: list[float], frames: list[tuple[int, float]], live: Camera | None = None
) -> FrameMeter:
    now = iter(times_s)
    meter = FrameMeter(live, now_s=lambda: next(now))
    results = [result([], index=index, time_s=time_s) for index, time_s in frames]
    for frame in results:
        meter.add(frame)
    return meter


def test_rate_over_two_seconds() -> None:
    meter = meter_of([0.0, 5.0, 5.5, 6.0, 6.5], [(number, 0.1 * number) for number in range(5)])
    assert meter.rate_hz == 2.0
    assert meter.captions() == ("processed at 2.0 fps",)
    assert meter.notes() == ()


def test_one_frame_has_no_rate() -> None:
    meter = meter_of([3.0], [(0, 0.0)])
    assert np.isnan(meter.rate_hz)
    assert meter.captions() == ()
    assert FrameMeter().captions() == ()
    assert FrameMeter(Camera(0.0)).notes() == ()


def test_live_run_reports_latency_and_drops() -> None:
    """Frames 5, 6 and 9 of 100.0, 100.1 and 100.4 s; results at 100.2, 100.35 and 100.45 s."""
    meter = meter_of([100.2, 100.35, 100.45], [(5, 0.0), (6, 0.1), (9, 0.4)], Camera(100.0))
    assert meter.captions() == ("processed at 8.0 fps", "latency 50 ms", "2 dropped")
    (note,) = meter.notes()
    assert "200 ms" in note
    assert "250 ms" in note
    assert meter.summary() == {
        "latency_ms": {"p50": 200.0, "p95": 245.0, "max": 250.0},
        "frames_dropped": 2,
    }
    assert meter.status == "latency 200 ms, p95 245 ms, 2 dropped"


def test_frames_that_are_not_wanted_are_not_dropped() -> None:
    frames = [(0, 0.0), (3, 0.1), (9, 0.3)]
    meter = FrameMeter(Camera(0.0), every=3)
    for index, time_s in frames:
        meter.add(result([], index=index, time_s=time_s))
    assert meter.n_dropped == 1
    assert FrameMeter().summary() == {}
    assert latency_ms([]) == {}


def paced(n_frames: int, interval_s: float) -> PacedFrames:
    def frames() -> Generator[Frame, None, None]:
        for number in range(n_frames):
            yield result([], index=number, time_s=2.0 + number * interval_s).frame

    return PacedFrames(frames(), interval_s)


def test_no_frame_before_its_time() -> None:
    source = paced(5, 0.01)
    for frame in source:
        assert time.monotonic() - source.first_time_s >= frame.time_s - 1e-6


def test_frames_that_a_newer_one_replaced_are_dropped() -> None:
    source, seen = paced(30, 0.005), []
    for frame in source:
        seen.append(frame.index)
        if frame.index == 0:
            time.sleep(0.05)
    assert seen[0] == 0
    assert seen[1] >= 9
    assert source.n_dropped == 30 - len(seen)


def test_frames_that_are_always_late_are_not_all_dropped() -> None:
    """Decoding takes longer than the interval: one frame per second is passed on all the same."""
    source = paced(2, 1e-9)
    source.first_time_s = time.monotonic() - 100.0
    assert [frame.index for frame in source] == [0]


def test_a_stopped_wait_ends_the_frames() -> None:
    source = paced(2, 1000.0)
    frames = iter(source)
    next(frames)
    source.stop()
    assert list(frames) == []
