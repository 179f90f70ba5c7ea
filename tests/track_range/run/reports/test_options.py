"""Notes on options that have no effect."""

import shutil
from contextlib import closing

import pytest

from track_range.recording.recording import open_recording
from track_range.run.options.settings import RunSettings
from track_range.run.reports.options import OptionsWithoutEffect


@pytest.mark.parametrize("has_rig", [True, False])
def test_known_distances_are_for_pairs_without_a_calibration(small_drive, tmp_path, has_rig):
    """Also before the focal length is estimated, as in pairs of live cameras."""
    pair = [
        shutil.copy(video, tmp_path / video.name) for video in (small_drive.left, small_drive.right)
    ]
    settings = RunSettings(stereo=pair, known_distance=("0,100,100,140,140,car=5",))
    with closing(open_recording(*pair, rig=small_drive.rig if has_rig else None)) as recording:
        assert recording.rig is not None
        assert recording.rig.is_assumed != has_rig
        notes = OptionsWithoutEffect(settings, recording, has_positions=False).notes()
    assert ["--known-distance" in note for note in notes] == [True] * has_rig
