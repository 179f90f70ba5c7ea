"""run.mf4: read back by asammdf and by mdfreader, slots, invalidation bits, and documented channels."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.documentation.documented_commands import PAGES
from tests.support.results.frame_results import changed
from tests.track_range.results.moving_frames import PERIOD_S, START_S, frame, info
from track_range.ranging.warning.safety import SafetyMeasures
from track_range.ranging.world.ego_path import EgoPose
from track_range.results.formats.adas import mdf_file
from track_range.results.formats.adas.mdf_file import channels_of, comment_of
from track_range.results.writers import OpenWriters
from track_range.stereo.geometry.mounting import Mounting
from track_range.stereo.odometry.ego_motion import EgoMotion

asammdf = pytest.importorskip("asammdf", reason="asammdf is not installed (extra adas)")

N_FRAMES = 7
SUMMARY = {"notes": ["The speed is < 3 m/s & not given."]}


def led(index):
    """Frame `index` with track 3 as the lead vehicle, 12 m away; it is absent in frame 2."""
    given = frame(index)
    if index == 2:
        return given
    pair = {"gap_m": 10.0, "headway_s": 1.0, "ttc_front_s": 5.0, "drac_mps2": 0.2}
    columns = {name: np.array([value, np.nan]) for name, value in pair.items()}
    safety = replace(SafetyMeasures.unknown(2), **columns, is_lead=np.array([True, False]))
    given = changed(given, safety=safety)
    return replace(given, ego=replace(given.ego, speed_sigma_mps=0.5, yaw_rad_s=0.1))


def written(folder, frames, **given):
    with OpenWriters(("mf4",), info(**given), folder) as writers:
        for each in frames:
            writers.write(each)
        writers.close(SUMMARY)
    return folder / "run.mf4"


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """A run whose frames are written in several blocks."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mdf_file, "_N_BUFFERED", 3)
        folder = tmp_path_factory.mktemp("run")
        return written(folder, map(led, range(N_FRAMES)), start_utc_s=START_S)


@pytest.fixture
def mdf(path):
    with asammdf.MDF(path) as opened:
        yield opened


def channel(mdf, name):
    """Samples of a channel, NaN or empty where they are invalid."""
    signal = mdf.get(name, ignore_invalidation_bits=True)
    samples = signal.samples
    if samples.dtype.kind == "S":
        return np.where(signal.invalidation_bits, b"", samples)
    return np.where(signal.invalidation_bits, np.nan, samples)


def test_slots_of_tracks(mdf):
    """A track has a slot while it lives; channels have names, units, comments and invalid samples."""
    nan = math.nan
    np.testing.assert_array_equal(channel(mdf, "obj_01_id"), [3, 3, nan, 3, 3, 3, 3])
    np.testing.assert_array_equal(channel(mdf, "obj_02_id"), [7] * N_FRAMES)
    np.testing.assert_array_equal(channel(mdf, "obj_01_distance"), [12, 12, nan, 12, 12, 12, 12])
    np.testing.assert_allclose(
        channel(mdf, "obj_01_age"), [0.0, 0.1, nan, 0.0, 0.1, 0.2, 0.3], atol=1e-6
    )
    assert channel(mdf, "obj_01_class").tolist()[:3] == [b"car", b"car", b""]
    assert np.isnan(channel(mdf, "obj_02_distance")).all()
    # warnings did not run: not "no warning"
    assert np.isnan(channel(mdf, "obj_01_warning")).all()
    assert (channel(mdf, "obj_02_state") == b"parked").all()
    signal = mdf.get("obj_01_closing_speed_sigma")
    assert (signal.unit, signal.comment) == ("m/s", "standard deviation of obj_01_closing_speed")
    np.testing.assert_allclose(signal.timestamps, PERIOD_S * np.array([0, 1, 3, 4, 5, 6]))
    assert (mdf.version, mdf.header.start_time.timestamp()) == ("4.11", START_S)
    assert "The speed is &lt; 3 m/s &amp; not given." in mdf.header.comment


def test_lead_and_ego(mdf):
    """Sigmas of the lead's headway, time to collision and deceleration, by hand."""
    lead = {name: channel(mdf, f"lead_{name}") for name in ("id", "gap", "gap_sigma", "class")}
    assert [lead["id"][0], lead["gap"][0], lead["class"][0]] == [3, 10, b"car"]
    assert math.isclose(lead["gap_sigma"][0], 0.4, rel_tol=1e-6)
    assert np.isnan(lead["id"][2])
    # gap 10 +- 0.4 m, closing speed 2 +- 0.5 m/s, ego speed 10 +- 0.5 m/s
    sigmas = {
        "headway": 1.0 * math.hypot(0.04, 0.05),
        "ttc": 5.0 * math.hypot(0.04, 0.25),
        "deceleration_required": 0.2 * math.hypot(0.04, 0.5),
    }
    for name, expected in sigmas.items():
        assert math.isclose(channel(mdf, f"lead_{name}_sigma")[0], expected, rel_tol=1e-5)
    assert channel(mdf, "ego_speed").tolist() == [10.0] * N_FRAMES
    np.testing.assert_allclose(channel(mdf, "ego_yaw_rate")[[0, 2]], [-0.1, math.nan])


def test_ego_of_a_camera_that_looks_aside(tmp_path):
    """Speed and heading are those of the vehicle, not those of the axis of the camera."""
    mounting = Mounting(yaw_deg=-60.0)
    right_mps, _, forward_mps = mounting.velocity_mps(10.0)
    ego = EgoMotion(forward_mps, 0.25, right_mps=right_mps, right_sigma_mps=0.25 * 3**0.5)
    given = changed(frame(0), ego=ego, ego_pose=EgoPose(0.0, 0.0, 0.1))
    with asammdf.MDF(written(tmp_path, [given], mounting=mounting)) as mdf:
        expected = {"speed": 10.0, "speed_sigma": 0.5, "heading": 0.1 + math.radians(60.0)}
        for name, value in expected.items():
            assert channel(mdf, f"ego_{name}") == pytest.approx(value)


def test_slots_are_empty_for_a_frame(tmp_path):
    """A new track takes the slot of another one only after a frame without it."""
    tracks = [frame(index) for index in range(6)]

    def only(given, track_id):
        ids = np.array([track_id, 7])
        return replace(given, tracks=replace(given.tracks, track_id=ids))

    frames = [only(tracks[i], 3 if i < 2 else 9) for i in (0, 1, 3, 4)]
    frames.append(only(tracks[5], 11))
    with asammdf.MDF(written(tmp_path, frames)) as mdf:
        nan = math.nan
        np.testing.assert_array_equal(channel(mdf, "obj_01_id"), [3, 3, nan, nan, 11])
        np.testing.assert_array_equal(channel(mdf, "obj_03_id"), [9, 9, nan])
        assert mdf.header.start_time.timestamp() == 0
        assert "not known" in mdf.header.comment


def test_discarded_frame_and_runs_without_frames(tmp_path):
    for n_frames in (0, 3):
        folder = tmp_path / str(n_frames)
        folder.mkdir()
        with OpenWriters(("mf4",), info(), folder) as writers:
            for index in range(n_frames):
                writers.write(led(index))
            writers.discard_last()
            writers.close(None)
        with asammdf.MDF(folder / "run.mf4") as mdf:
            n_left = max(n_frames - 1, 0)
            n_samples = [group.channel_group.cycles_nr for group in mdf.groups]
            assert n_samples == [n_left] * (4 if n_left else 0)


def test_other_readers(path):
    """mdfreader, which has nothing of asammdf, reads the same values, units and times."""
    mdfreader = pytest.importorskip("mdfreader", reason="mdfreader is not installed (extra dev)")
    read = mdfreader.Mdf(str(path))
    assert read.get_channel_data("obj_02_id").tolist() == [7] * N_FRAMES
    assert read.get_channel_data("obj_01_class")[0] == "car"
    assert read.get_channel_unit("lead_gap") == "m"
    np.testing.assert_allclose(read.get_channel_data("lead_gap")[:2], 10.0)
    master = read.get_channel_master("obj_01_id")
    np.testing.assert_allclose(read.get_channel_data(master), PERIOD_S * np.arange(N_FRAMES))


def table(channels):
    """Rows of the page, of which a sigma follows its value."""
    names = {channel.name for channel in channels}
    for one in channels:
        if one.name.endswith("_sigma"):
            assert one.name.removesuffix("_sigma") in names
            continue
        has_sigma = "yes" if f"{one.name}_sigma" in names else "no"
        yield f"| `{one.name}` | {one.unit or '-'} | {has_sigma} | {comment_of(one)} |"


def test_channels_are_documented():
    page = PAGES["docs/how-to/adas-formats.md"].partition("## MDF4")[2].partition("\n## ")[0]
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    groups = ("ego", "lead", "obj_NN")
    assert rows == [row for group in groups for row in table(channels_of(group))]
