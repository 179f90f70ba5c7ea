"""Matchers by name, compared on exact pairs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.recordings.kitti_folder import write_set
from track_range.stereo.evaluation.box_matchers import MATCHER_NAMES, measure_pairs, open_matcher
from track_range.stereo.evaluation.kitti_2015 import read_pairs


def test_all_matchers_on_exact_pairs(tmp_path: Path) -> None:
    measured = measure_pairs(read_pairs(write_set(tmp_path)), MATCHER_NAMES)
    assert tuple(measured.columns) == MATCHER_NAMES
    objects = measured.objects
    assert objects.true_px.tolist() == [20.0, 30.0, 20.0, 30.0]
    assert objects.distance_m == pytest.approx([7.5, 5.0, 7.5, 5.0])
    assert objects.pair.tolist() == objects.group.tolist() == [0, 0, 1, 1]
    assert len(objects.cameras) == 2
    for name, column in measured.columns.items():
        assert np.abs(column.disparity_px - objects.true_px).max() < 0.15, name
        assert ((column.sigma_px > 0) & (column.sigma_px < 1)).all(), name
        assert measured.ms_per_frame[name] > 0
    assert len(measured.notes) == 1
    assert "has no image size; it is taken to be" in measured.notes[0]


def test_tracks_of_a_drive_are_groups(tmp_path: Path) -> None:
    frames = [
        replace(pair, track_id=np.array([7, 3]), notes=("a note on the rig",))
        for pair in read_pairs(write_set(tmp_path))
    ]
    measured = measure_pairs(frames, ["patch"])
    assert measured.objects.group.tolist() == [7, 3, 7, 3]
    assert measured.objects.pair.tolist() == [0, 0, 1, 1]
    assert np.abs(measured.columns["patch"].disparity_px - measured.objects.true_px).max() < 0.15
    assert measured.notes == ("a note on the rig",)


def test_no_pairs() -> None:
    measured = measure_pairs([], ["patch"])
    assert (len(measured.objects), measured.columns["patch"].disparity_px.shape) == (0, (0,))
    assert measured.ms_per_frame == {}


def test_unknown_matcher(tmp_path: Path) -> None:
    pair = next(read_pairs(write_set(tmp_path)))
    with pytest.raises(ValueError, match="pach"):
        open_matcher("pach", pair.rig)
