"""Damaged files in folders of runs and of images: they are read without what is missing, or refused
in one sentence."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from tests.support.damaged_text import check_reading, damaged
from tests.support.results.events import event
from track_range.foundation.files.structured_text import yaml_text
from track_range.recording.sources.files.image_folder import ImageFolder
from track_range.results.events.files import events_text
from track_range.results.folder import read_run_folder
from track_range.results.rows.columns import column_names

SUMMARY = {
    "frames": 3,
    "wall_s": 1.5,
    "starts_s": 0.0,
    "notes": ["A note."],
    "tracks": {"n": 1},
    "focal_px": 700.0,
}
SETTINGS = {
    "track_range_settings": 1,
    "run": {"mono": "a.mp4", "focal_px": 700.0},
    "found": {"fps": 10.0},
}
ROW = ["0", "0.0", "3", "car", "0.9", "1", "10", "20", "30", "40"]
TIMES = "".join(f"2011-09-26 13:10:51.{number}00000000\n" for number in range(3))


def read_run(folder: Path) -> object:
    return read_run_folder(folder)


def read_images(folder: Path) -> object:
    images = ImageFolder(folder, fps=10.0)
    return images.first_time_s, images.notes


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of a run with one row, and of three images with times."""
    folder = tmp_path_factory.mktemp("files") / "run"
    folder.mkdir()
    (folder / "summary.json").write_text(json.dumps(SUMMARY))
    (folder / "settings.yaml").write_text(yaml_text(SETTINGS))
    names = list(column_names())
    row = [*ROW, *[""] * (len(names) - len(ROW))]
    (folder / "tracks.csv").write_text(f"{','.join(names)}\n{','.join(row)}\n")
    (folder / "events.csv").write_text(events_text([event(start_s=0.0, end_s=0.0)]))
    (folder / "timestamps.txt").write_text(TIMES)
    for number in range(3):
        cv2.imwrite(str(folder / f"{number:06d}.png"), np.full((48, 64, 3), 90, np.uint8))
    return folder


READERS: dict[str, Callable[[Path], object]] = {
    "summary.json": read_run,
    "settings.yaml": read_run,
    "tracks.csv": read_run,
    "events.csv": read_run,
    "timestamps.txt": read_images,
    "000000.png": read_images,
}


@pytest.mark.parametrize("name", READERS)
@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_damaged_file_in_a_folder(folder: Path, name: str, data: st.DataObject) -> None:
    copy = folder.with_name("copy")
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(folder, copy)
    (copy / name).write_bytes(data.draw(damaged((folder / name).read_bytes())))
    check_reading(READERS[name], copy)


@pytest.mark.parametrize("name", READERS)
def test_intact_folder(folder: Path, name: str) -> None:
    assert READERS[name](folder) is not None
