"""Options of the runs of a fleet."""

import pytest

from tests.support.networks.depth_networks import write_depth, write_stereo
from track_range.detection.catalogue.lookup import find_model
from track_range.detection.models.onnx_session import ModelError
from track_range.fleet.engine.plan import fleet_plan
from track_range.fleet.settings import FleetSettings
from track_range.foundation.errors import UsageError

SETTINGS = FleetSettings(recordings=("x",), out="out")


@pytest.mark.parametrize("value", ["auto", "off", False, "1", "0", "72.5"])
def test_ego_speed_for_all_clips(value):
    fleet_plan(SETTINGS, {"ego_speed": value})


@pytest.mark.parametrize("value", ["speed.csv", "on", "", "nan", True])
def test_ego_speed_of_one_clip(value):
    with pytest.raises(UsageError, match="ego-speed"):
        fleet_plan(SETTINGS, {"ego_speed": value})


def test_the_content_of_a_network_and_its_settings_is_a_part_of_the_keys_of_tracks(tmp_path):
    model, given = tmp_path / "net.onnx", {"depth_model": str(tmp_path / "net.onnx")}
    write_depth(model, constant=9.0)
    plain, first = fleet_plan(SETTINGS, {}).keys, fleet_plan(SETTINGS, given).keys
    assert first.detections == plain.detections
    assert first.tracks != plain.tracks
    assert first == fleet_plan(SETTINGS, given).keys
    settings = model.with_suffix(".yaml")
    settings.write_text(f"{settings.read_text()}scale: 2.0\n")
    other = fleet_plan(SETTINGS, given).keys
    assert other.tracks not in (first.tracks, plain.tracks)
    write_depth(model, constant=8.0)
    assert fleet_plan(SETTINGS, given).keys.tracks not in (first.tracks, other.tracks)


def test_networks_that_no_clip_can_use_are_refused_before_the_run(tmp_path):
    (tmp_path / "text.onnx").write_text("no network")
    with pytest.raises(ModelError, match=r"text\.onnx"):
        fleet_plan(SETTINGS, {"depth_model": tmp_path / "text.onnx"})
    with pytest.raises(ModelError, match="--stereo-model"):
        fleet_plan(SETTINGS, {"depth_model": write_stereo(tmp_path / "stereo.onnx")})
    with pytest.raises(ModelError, match=r"found a detector; give it by --detector"):
        fleet_plan(SETTINGS, {"depth_model": find_model("road").path})
