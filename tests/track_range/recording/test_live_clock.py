"""Tests of the clock of live streams: increasing times of this machine's clock, without network
jitter."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.recording.sources.live.live_video import StreamClock


def test_timestamps_of_this_machines_clock() -> None:
    clock = StreamClock()
    assert [clock.time_s(stamp_s, stamp_s + 0.03) for stamp_s in (1000.0, 1000.1, 1000.2)] == [
        1000.0,
        1000.1,
        1000.2,
    ]
    assert clock.is_shared


def test_offset_is_that_of_the_shortest_delay() -> None:
    clock = StreamClock()
    # Sent at 5000 + stamp, arriving 80, 20 and 60 ms later.
    arrivals = [(1.0, 5001.08), (1.1, 5001.12), (1.2, 5001.26)]
    assert [clock.time_s(*arrival) for arrival in arrivals] == pytest.approx(
        [5001.08, 5001.12, 5001.22]
    )
    assert clock.is_shared is False


def test_frames_without_timestamps_get_arrival_times() -> None:
    clock = StreamClock()
    assert [clock.time_s(None, arrived_s) for arrived_s in (7.0, 7.4)] == [7.0, 7.4]


def test_repeated_and_backward_timestamps() -> None:
    clock = StreamClock()
    assert [clock.time_s(stamp_s, 5000.0) for stamp_s in (1.0, 1.0, 0.9, 1.1)][1:3] == [None, None]


def test_clock_drift_is_followed() -> None:
    """A clock slow by 0.1 % for an hour at 10 Hz: 3.6 s without correction."""
    clock = StreamClock()
    stamps_s = np.arange(36_000) * 0.1
    times_s = [clock.time_s(stamp_s, 9000.0 + 1.001 * stamp_s) for stamp_s in stamps_s.tolist()]
    assert times_s[-1] == pytest.approx(9000 + 1.001 * stamps_s[-1], abs=0.05)


@given(st.lists(st.tuples(st.one_of(st.none(), st.floats(0, 1e6)), st.floats(0, 1e6)), max_size=40))
@settings(deadline=None)
def test_times_increase_strictly(images: list[tuple[float | None, float]]) -> None:
    clock = StreamClock()
    times_s = [time_s for image in images if (time_s := clock.time_s(*image)) is not None]
    assert (np.diff(times_s) > 0).all()
