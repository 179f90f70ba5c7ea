"""Options of recordings: one frozen type, with the names of the options of a run."""

from dataclasses import fields

import pytest

from track_range.recording.recording import open_recording
from track_range.recording.video.options import RecordingKeywords, RecordingOptions
from track_range.run.options.settings import RunSettings

NAMES = {field.name for field in fields(RecordingOptions)}


def test_each_option_is_a_keyword():
    assert RecordingKeywords.__annotations__.keys() - NAMES == {"folder_fps"}
    assert RecordingKeywords.__annotations__.keys() > NAMES
    with pytest.raises(TypeError, match="focal"):
        open_recording("drive.mp4", focal=700.0)


def test_settings_of_a_run_hold_the_options_of_its_recording():
    assert NAMES - RunSettings.model_fields.keys() == {"has_checks"}
    given = {"focal_px": 700.0, "start_s": 2.5, "topics": ("/left", "/right"), "every": 3}
    options = RunSettings(stereo=("left.mcap", "right.mcap"), **given).recording
    assert options == RecordingOptions(**given)


@pytest.mark.parametrize(
    ("given", "layout"),
    [
        ({"mono": "drive.mp4"}, None),
        ({"stereo": ("left.mp4", "right.mp4")}, None),
        ({"stereo": "both.mp4"}, "auto"),
        ({"stereo": "both.mp4", "stereo_layout": "top-bottom"}, "top-bottom"),
    ],
)
def test_layout_of_one_recording_of_two_cameras(given, layout):
    assert RunSettings(**given).recording.stereo_layout == layout
