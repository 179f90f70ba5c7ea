import numpy as np
import pytest

from tests.track_range.recording.telemetry.telemetry_files import START_S, part
from track_range.recording.telemetry.tracks.track import TelemetryError, TelemetryTrack
from track_range.recording.telemetry.video_clock import on_video_clock


def track(first_s, *, n=21, clock="utc"):
    return TelemetryTrack(
        time_s=first_s + np.arange(float(n)),
        speed_mps=np.full(n, 10.0),
        source="a.gpx",
        clock=clock,
    )


def test_times_of_the_video():
    result, _ = on_video_clock(track(3.0, clock="video"), part(start_s=None))
    assert result.time_s[0] == 3.0


def test_difference_of_the_clocks():
    result, _ = on_video_clock(track(START_S - 600, n=2000), part())
    assert result.time_s[0] == -600
    assert result.clock == "video"
    assert result.notes == ()


@pytest.mark.parametrize("zone_h", [-7, 2, 5.5])
def test_time_zone_is_corrected_and_noted(zone_h):
    result, _ = on_video_clock(track(START_S + 1 - zone_h * 3600), part())
    assert result.time_s[0] == 1.0
    assert f"{zone_h:+g} h" in result.notes[0]


def test_no_time_zone_where_the_user_states_the_time():
    with pytest.raises(TelemetryError, match="give --start-utc as 2026-05-03 12:00:00"):
        on_video_clock(track(START_S + 7200), part(source="--start-utc"))


def test_local_time_of_the_video():
    result, _ = on_video_clock(
        track(START_S + 1), part(start_s=START_S + 7200, is_local=True, uncertainty_s=50400)
    )
    assert result.time_s[0] == 1.0


def test_header_that_states_the_end():
    result, _ = on_video_clock(track(START_S, n=21), part(start_s=START_S + 20, uncertainty_s=21.0))
    assert result.time_s[0] == 0.0


@pytest.mark.parametrize(
    ("given", "video", "word"),
    [
        (track(START_S + 86400 * 2), part(), "another day"),
        (track(START_S + 1234), part(), "another drive"),
        (track(START_S - 40_000, n=80_000), part(is_local=True), "--start-utc"),
        (track(START_S, n=500), part(start_s=None), "--start-utc"),
        (track(START_S - 9000, n=18_000, clock="local"), part(), "several time zones"),
    ],
)
def test_times_that_cannot_be_matched(given, video, word):
    with pytest.raises(TelemetryError, match=word):
        on_video_clock(given, video)


def test_equal_length_without_a_date():
    result, _ = on_video_clock(track(START_S + 5, n=22), part(start_s=None))
    assert result.time_s[0] == 0.0
    assert "as long as the telemetry" in result.notes[0]
