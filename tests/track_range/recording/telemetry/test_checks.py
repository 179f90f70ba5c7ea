import numpy as np
import pytest

from tests.track_range.recording.telemetry.telemetry_files import (
    DEG_PER_M,
    LATITUDE,
    LONGITUDE,
    START_S,
)
from track_range.recording.telemetry.checks import usable
from track_range.recording.telemetry.tracks.positions import speed_from_positions
from track_range.recording.telemetry.tracks.track import TelemetryError, TelemetryTrack

N = 30


def track(speed_mps=10.0, *, clock="video", time_s=None, **columns):
    time_s = np.arange(float(N)) if time_s is None else np.asarray(time_s, float)
    values = {name: np.asarray(value, float) for name, value in columns.items()}
    speed = np.broadcast_to(np.asarray(speed_mps, float), time_s.shape).copy()
    return TelemetryTrack(time_s=time_s, speed_mps=speed, source="test", clock=clock, **values)


def test_good_track_is_unchanged():
    given = track(np.linspace(5, 20, N), utc_s=START_S + np.arange(N))
    assert usable(given).speed_mps.tolist() == given.speed_mps.tolist()


def test_missing_speeds_are_refused():
    with pytest.raises(ValueError, match="speed_mps"):
        TelemetryTrack(time_s=np.arange(3.0), speed_mps=np.empty(0), source="test", clock="video")


def test_samples_in_the_order_of_time_once():
    result = usable(track([1, np.nan, 2, 3], time_s=[2, 1, 1, 0]))
    assert result.time_s.tolist() == [0, 1, 2]
    assert result.speed_mps.tolist() == [3, 2, 1]


def test_single_wild_speed_is_omitted():
    speeds = np.full(N, 10.0)
    speeds[7] = 500
    assert np.flatnonzero(np.isnan(usable(track(speeds)).speed_mps)).tolist() == [7]


def jumping_clock():
    utc_s = START_S + np.arange(N)
    utc_s[4:] += 3 * 3600
    return utc_s


@pytest.mark.parametrize(
    ("given", "word"),
    [
        (track(np.nan), "fix"),
        (track([], time_s=[]), "fix"),
        (track(utc_s=jumping_clock()), "jumps by 3 h"),
        (track(clock="utc", time_s=jumping_clock()), "jumps by 3 h"),
        (track(clock="utc", time_s=START_S - np.arange(N) * 10.0), "back"),
        (track(latitude_deg=np.full(N, 200.0), longitude_deg=np.full(N, 9.0)), "Earth"),
        (
            track(
                latitude_deg=np.random.default_rng(0).uniform(-80, 80, N),
                longitude_deg=np.full(N, 9.0),
            ),
            "positions",
        ),
        (track(200.0), "432 km/h"),
        (track(np.where(np.arange(N) % 2, 60.0, 5.0)), "jump"),
    ],
)
def test_unusable_track(given, word):
    with pytest.raises(TelemetryError, match=word) as error:
        usable(given)
    assert "\n" not in str(error.value)


def at_mps(position_mps, speed_mps, *, decimals=9, **given):
    """A track to the north, with speeds of its positions and its own speeds."""
    lat = np.round(LATITUDE + np.arange(N) * position_mps * DEG_PER_M, decimals)
    return track(
        speed_mps, latitude_deg=lat, longitude_deg=np.full(N, round(LONGITUDE, decimals)), **given
    )


@pytest.mark.parametrize(("factor", "unit"), [(3.6, "km/h"), (2.23694, "mph"), (1.94384, "kn")])
def test_stated_unit_that_positions_contradict(factor, unit):
    result = usable(at_mps(15.0, 15.0 * factor))
    assert result.speed_mps == pytest.approx([15.0] * N, rel=1e-4)
    assert result.notes == (
        f"its speeds are in {unit} instead of m/s, as the positions show; they were converted.",
    )


def test_speeds_that_no_unit_explains():
    with pytest.raises(
        TelemetryError, match=r"8 m/s in the median, contradict its positions, which show 37 m/s"
    ):
        usable(at_mps(37.0, 8.0))
    # one position for a whole drive shows nothing
    assert usable(at_mps(0.0, 8.0)).speed_mps.max() == 8.0


def test_speedometer_that_is_fast():
    result = usable(at_mps(20.0, 21.6))
    assert (result.speed_mps.max(), result.speed_sigma_mps) == (21.6, pytest.approx(1.6, abs=0.1))
    assert "8% above" in result.notes[0]


@pytest.mark.parametrize(("decimals", "sigma_mps"), [(7, 0.5), (5, 0.68), (4, 1.04)])
def test_speed_of_rounded_positions(decimals, sigma_mps):
    rounded = at_mps(14.0, np.nan, decimals=decimals)
    derived = speed_from_positions(
        rounded.time_s, rounded.latitude_deg, rounded.longitude_deg, rounded.utc_s
    )
    assert derived.speed_sigma_mps == pytest.approx(sigma_mps, abs=0.03)
    error = derived.speed_mps - 14.0
    assert np.sqrt(np.mean(error**2)) < 1.2 * sigma_mps
    assert abs(error.mean()) < 0.2


def test_positions_that_are_repeated_until_the_next_fix():
    time_s = np.arange(0, 60, 0.1)
    speed_mps = np.where((time_s > 20) & (time_s < 35), 0.0, 14.0)
    lat = LATITUDE + DEG_PER_M * np.repeat(np.cumsum(speed_mps)[::10] * 0.1, 10)
    derived = speed_from_positions(time_s, lat, np.full(600, LONGITUDE), np.full(600, np.nan))
    moving = np.abs(derived.time_s - 27.5) > 8.6
    assert derived.speed_mps[moving] == pytest.approx(14.0, abs=0.01)
    assert derived.speed_mps[np.abs(derived.time_s - 27.5) < 5].max() == 0.0


def test_pause_is_no_jump():
    times_s = np.concatenate([START_S + np.arange(10), START_S + 4000 + np.arange(10)])
    assert len(usable(track(clock="utc", time_s=times_s))) == 20


def cold_start(n_void=4, n_fixed=12, stale_s=-3 * 3600):
    """A receiver that sets its clock when it gets its fix."""
    utc_s = (
        START_S
        + np.arange(n_void + n_fixed)
        + np.where(np.arange(n_void + n_fixed) < n_void, stale_s, 0)
    )
    speed_mps = np.where(np.arange(n_void + n_fixed) < n_void, np.nan, 10.0)
    return speed_mps, utc_s


@pytest.mark.parametrize("clock", ["video", "utc"])
@pytest.mark.parametrize("stale_s", [-3 * 3600, 3 * 3600, -1024 * 7 * 86400])
def test_cold_start(clock, stale_s):
    speed_mps, utc_s = cold_start(stale_s=stale_s)
    times_s = utc_s if clock == "utc" else np.arange(16.0)
    result = usable(track(speed_mps, clock=clock, time_s=times_s, utc_s=utc_s))
    assert len(result) == 12
    assert result.time_s[0] == times_s[4]
    assert "first 4 samples" in result.notes[0]


def test_default_date_of_a_receiver_with_a_fix():
    _, utc_s = cold_start(stale_s=946_684_800 - START_S)
    assert len(usable(track(time_s=np.arange(16.0), utc_s=utc_s))) == 12


@pytest.mark.parametrize("change", ["short", "jump", "losses"])
def test_cold_start_without_a_stable_fix(change):
    speed_mps, utc_s = cold_start(n_fixed=8 if change == "short" else 20)
    if change == "jump":
        utc_s[12:] += 3 * 3600
    if change == "losses":
        speed_mps[8:12] = np.nan
    with pytest.raises(TelemetryError, match="clock jumps by 3 h"):
        usable(track(speed_mps, time_s=np.arange(float(len(utc_s))), utc_s=utc_s))
