"""Rate and latency of a run, with a clock set by the test."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.track_range.views.overlay_results import result
from track_range.pipeline.throughput import FrameMeter


@dataclass
class Camera:
    first_time_s: float


def meter_of(times_s: list[float], frames: list[tuple[int, float]], live: Camera | None = None) -> FrameMeter:
    now = iter(times_s)
    meter = FrameMeter(live, now_s=lambda: next(now))
    results = [result([], index=index, time_s=time_s) for index, time_s in frames]
    for frame in results:
        meter.add(frame)
    return meter


def test_rate_over_two_seconds() -> None:
    meter = meter_of([0.0, 5.0, 5.5, 6.0, 6.5], [(number, 0.1 * number) for number in range(5)])
    assert meter.rate_hz == 2.0
    assert meter.captions() == ("2.0 fps",)
    assert meter.notes == ()


def test_one_frame_has_no_rate() -> None:
    meter = meter_of([3.0], [(0, 0.0)])
    assert np.isnan(meter.rate_hz)
    assert meter.captions() == ()
    assert FrameMeter().captions() == ()
    assert FrameMeter(Camera(0.0)).notes == ()


def test_live_run_reports_latency_and_drops() -> None:
    """Frames 5, 6 and 9 of 100.0, 100.1 and 100.4 s; results at 100.2, 100.35 and 100.45 s."""
    meter = meter_of([100.2, 100.35, 100.45], [(5, 0.0), (6, 0.1), (9, 0.4)], Camera(100.0))
    assert meter.captions() == ("8.0 fps", "latency 50 ms", "2 dropped")
    (note,) = meter.notes
    assert "200 ms" in note
    assert "250 ms" in note
