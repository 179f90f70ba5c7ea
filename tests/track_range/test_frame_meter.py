"""How fast a run goes and how late it is, by a clock that the test turns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.track_range.overlay_results import result
from track_range.run.throughput import FrameMeter


@dataclass
class Eye:
    first_time_s: float


def meter_of(times_s: list[float], frames: list[tuple[int, float]], live: Eye | None = None) -> FrameMeter:
    now = iter(times_s)
    meter = FrameMeter(live, now_s=lambda: next(now))
    results = [result([], index=index, time_s=time_s) for index, time_s in frames]
    for found in results:
        meter.add(found)
    return meter


def test_the_rate_is_that_of_the_last_two_seconds() -> None:
    meter = meter_of([0.0, 5.0, 5.5, 6.0, 6.5], [(number, 0.1 * number) for number in range(5)])
    assert meter.rate_hz == 2.0
    assert meter.captions() == ("2.0 fps",)
    assert meter.notes == ()


def test_one_frame_has_no_rate() -> None:
    meter = meter_of([3.0], [(0, 0.0)])
    assert np.isnan(meter.rate_hz)
    assert meter.captions() == ()
    assert FrameMeter().captions() == ()
    assert FrameMeter(Eye(0.0)).notes == ()


def test_a_live_run_says_how_late_it_is_and_what_it_left_out() -> None:
    """Images of 100.0, 100.1 and 100.4 s were ready at 100.2, 100.35 and 100.45 s; frames 5, 6 and 9."""
    meter = meter_of([100.2, 100.35, 100.45], [(5, 0.0), (6, 0.1), (9, 0.4)], Eye(100.0))
    assert meter.captions() == ("8.0 fps", "latency 50 ms", "2 dropped")
    assert meter.notes == ("Results came a median of 200 ms after the camera's images, 250 ms at most.",)
