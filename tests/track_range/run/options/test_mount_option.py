"""The option --mount: texts, objects, and one height."""

import pytest

from track_range.foundation.errors import UsageError
from track_range.run.options.settings import PipelineOptions, RunSettings
from track_range.stereo.geometry.mounting import Mounting


@pytest.mark.parametrize(
    "mount",
    ["yaw=-58,pitch=2", ["yaw=-58", "pitch=2"], Mounting(yaw_deg=-58.0, pitch_deg=2.0)],
)
def test_ways_to_give_a_mounting(mount):
    options = PipelineOptions.of({"mount": mount})
    assert options.mounting == Mounting(yaw_deg=-58.0, pitch_deg=2.0)
    # as a settings file stores it
    assert PipelineOptions.of(options.model_dump()).mounting == options.mounting


def test_mounting_that_is_not_given():
    assert PipelineOptions().mounting is None


@pytest.mark.parametrize("mount", ["yaw=-580", "jaw=3", "yaw=left", "yaw=1,yaw=2", 3, ["yaw=1", 2]])
def test_unusable_mounting_names_the_option(mount):
    with pytest.raises(UsageError, match="--mount"):
        RunSettings.of({"mono": "a.mp4", "mount": mount})


def test_value_that_is_no_mounting():
    with pytest.raises(UsageError, match=r"expected a tr\.Mounting or texts .*, found 5"):
        PipelineOptions.of({"mount": 5})


def test_heights_that_differ_are_a_contradiction():
    with pytest.raises(UsageError, match=r"z=2.0 in --mount and 1.5 in --camera-height-m"):
        PipelineOptions.of({"mount": "z=2", "camera_height_m": 1.5})
    assert PipelineOptions.of({"mount": "z=1.5", "camera_height_m": 1.5}).mounting.z_m == 1.5
