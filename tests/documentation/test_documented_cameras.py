"""The commands of docs/how-to/camera-files.md with the files that these cameras and programs
write."""

from __future__ import annotations

import csv
import shlex
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests.documentation.documented_commands import PAGES, commands
from tests.support.command_line import run_command
from tests.support.recordings import calibration_files as files
from tests.support.recordings.recording_files import (
    Pair,
    Written,
    folders,
    one_file,
    timed_folders,
    videos,
)
from track_range.recording.sources.open_video import open_video
from track_range.simulation.drive import Drive
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.rig_formats.reading import load_rig

pytestmark = pytest.mark.slow
Record = Callable[[Path, Pair], Written]

CAMERAS: dict[str, tuple[Record, files.Write]] = {
    "track-range --stereo zed.mp4 --stereo-layout side-by-side --rig SN12345.conf": (
        partial(one_file, name="zed.mp4"), files.zed,
    ),
    "track-range --stereo left.mp4 right.mp4 --rig oak.json": (videos, files.oak),
    "track-range --stereo infra1.mp4 infra2.mp4 --rig rs.txt": (
        partial(videos, names=("infra1", "infra2")), files.realsense,
    ),
    "track-range --stereo drive.mp4 --stereo-layout side-by-side --rig rig.yaml": (
        partial(one_file, name="drive.mp4"), files.ours,
    ),
    "track-range --stereo left.mp4 right.mp4 --rig stereo.npz": (
        videos, partial(files.of_names, names=files.NAMES[4], file="stereo.npz"),
    ),
    "track-range --stereo mav0/cam0/data mav0/cam1/data --rig mav0/cam0/sensor.yaml": (
        partial(timed_folders, names=("mav0/cam0/data/{ns}.png", "mav0/cam1/data/{ns}.png"), times="data.csv",
                form="{ns},{ns}.png"),
        lambda folder, rig: files.euroc(
            folder, files.with_coefficients(rig, 4), files=("mav0/cam0/sensor.yaml", "mav0/cam1/sensor.yaml")
        ),
    ),
    "track-range --stereo image_2 image_3 --rig calib.txt": (
        partial(folders, names=("image_2/{n:06}.png", "image_3/{n:06}.png")), partial(files.kitti, form="P{n}: "),
    ),
}  # fmt: skip
"""By command: what writes the images, and the calibration."""


@pytest.fixture(scope="module")
def pair(small_drive: Drive) -> tuple[Pair, StereoRig]:
    """The drive in the middle of images of a ZED camera, whose pixels are those of the drive, and
    their rig."""
    rig, _ = load_rig(small_drive.rig, size_px=(620, 188))
    border = (94, 94), (26, 26), (0, 0)
    images = Pair(
        *(
            [np.pad(frame.image, border) for frame in open_video(path)]
            for path in (small_drive.left, small_drive.right)
        )
    )
    left = rig.left
    camera = replace(
        left, cx_px=left.cx_px + 26, cy_px=left.cy_px + 94, width_px=672, height_px=376
    )
    return images, files.with_coefficients(StereoRig.rectified(camera, rig.baseline_m), 5)


@pytest.mark.parametrize("line", CAMERAS)
def test_command_of_a_camera(tmp_path: Path, pair: tuple[Pair, StereoRig], line: str) -> None:
    record, calibrate = CAMERAS[line]
    record(tmp_path, pair[0])
    calibrate(tmp_path, pair[1])
    cheap = ["--out", "out", "--align", "off", "--no-sgbm", "--no-overlay", "--duration", "0.6"]
    done = run_command(*shlex.split(line)[1:], *cheap, folder=tmp_path)
    assert (done.status, done.stderr) == (0, "")
    with (tmp_path / "out/tracks.csv").open() as file:
        rows = list(csv.DictReader(file))
    distances_m = np.array(
        [[float(row["stereo_m"]), float(row["mono_m"])] for row in rows if row["stereo_m"]]
    )
    assert len(distances_m) > 5
    assert np.median(distances_m[:, 0] / distances_m[:, 1]) == pytest.approx(1.0, abs=0.2)


def test_commands_are_documented() -> None:
    assert set(CAMERAS) <= set(commands(PAGES["docs/how-to/camera-files.md"]))
