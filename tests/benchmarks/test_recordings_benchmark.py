"""The benchmark of recordings and calibrations: right kinds are right, and wrong ones are not."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.accuracy.ranging.recordings import (
    Plain,
    _attempt as attempt,
    _read as read,
    recordings,
)
from tests.support.recordings.calibration_files import PARALLEL, Calibration, foundation_stereo
from tests.support.recordings.recording_files import RECORDINGS, Pair, Recording, folders
from track_range.simulation.drive import Drive
from track_range.stereo.geometry.rig import StereoRig

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def cache(small_drive: Drive, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cache")
    shutil.copytree(small_drive.rig.parent, folder / "recordings_3")
    return folder


def test_right_kinds(cache: Path) -> None:
    figures = recordings("--only", "half side", "--cache", str(cache))
    assert figures["right"] == {"recordings": "1 of 1", "calibrations": "0 of 0"}
    row = figures["recordings"]["half side by side"]
    assert (row["frames"], row["measured"], row["time_error_ms"]) == (
        12,
        pytest.approx(1.0, abs=0.05),
        0.0,
    )
    assert 0.05 < row["distance_error_pct"] < 1.0


def test_shifted_images_of_the_right_camera_are_wrong(cache: Path, tmp_path: Path) -> None:
    def shifted(folder: Path, pair: Pair) -> object:
        return folders(
            folder,
            Pair(pair.left, [image[:, [*range(1, image.shape[1]), -1]] for image in pair.right]),
        )

    row = Plain(cache / "recordings_3").compared(Recording("shifted", shifted), tmp_path)  # type: ignore[arg-type]
    assert not row["right"]
    assert row["distance_error_pct"] > 3.0


def test_frames_that_are_left_out_are_wrong(cache: Path, tmp_path: Path) -> None:
    half = RECORDINGS[0]._replace(
        write=lambda folder, pair: folders(folder, Pair(pair.left[:6], pair.right[:6]))
    )
    row = Plain(cache / "recordings_3").compared(half, tmp_path)
    assert (row["right"], row["frames"], row["distance_error_pct"]) == (False, 6, 0.0)


def test_calibrations(tmp_path: Path) -> None:
    assert read(Calibration("true", foundation_stereo, PARALLEL), tmp_path)["right"]
    wrong = Calibration(
        "2 % wider",
        lambda folder, rig: foundation_stereo(folder, StereoRig.rectified(rig.left, 0.1224)),
        PARALLEL,
    )
    row = read(wrong, tmp_path)
    assert not row["right"]
    assert row["baseline_m"] == pytest.approx(0.0024)
    assert row["distance_error_pct"] == pytest.approx(2.0, abs=1e-3)
    moved = replace(PARALLEL.left, cx_px=PARALLEL.left.cx_px + 1e-3)
    assert not read(
        Calibration(
            "moved",
            lambda folder, _: foundation_stereo(folder, StereoRig.rectified(moved, 0.12)),
            PARALLEL,
        ),
        tmp_path,
    )["right"]


def test_refusals_have_their_sentence() -> None:
    row = attempt(
        lambda folder: read(Calibration("none", lambda _, __: folder / "none.yaml"), folder)
    )
    assert not row["right"]
    assert "none.yaml" in row["said"]
