"""Notes on options that have no effect."""

import shutil
from contextlib import closing

import numpy as np
import pytest

from track_range.recording.recording import open_recording
from track_range.results.rows.rows import Rows
from track_range.run.options.settings import RunSettings
from track_range.run.reports.options import MissingPlaces, OptionsWithoutEffect


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


@pytest.mark.parametrize(
    ("write", "x_m", "files"),
    [
        (("csv", "openscenario", "osi-gt"), np.nan, "run.xosc and run_gt.osi: no road users"),
        (("osi",), np.nan, ""),
        (("osi-gt",), 3.0, ""),
    ],
)
def test_files_without_positions_in_the_map(write, x_m, files):
    rows = Rows({"world_x_m": np.array([np.nan, x_m])})
    notes = MissingPlaces(RunSettings(mono="drive.mp4", write=write), rows).notes()
    assert len(notes) == bool(files)
    assert files in " ".join(notes)
