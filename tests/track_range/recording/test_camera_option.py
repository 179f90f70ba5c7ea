"""`--camera` of a run, in Python, in settings, in a pipeline, of `rig` and of a fleet: the cameras of a
calibration file of several."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import track_range as tr
from tests.support.command_line import Finished
from track_range.errors import RigError
from track_range.fleet.engine.plan import fleet_plan
from track_range.fleet.settings import FleetSettings
from track_range.run.options.precedence import settings_from
from track_range.run.options.settings_file import read_settings
from track_range.simulation.drive import Drive

EYE = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]


@pytest.fixture
def cameras(tmp_path: Path) -> Path:
    """Three cameras of images of 620x188, 0.5 m apart."""
    content = {
        f"cam_{n}": {
            "K": [[400 + 100 * n, 0, 309.5], [0, 400 + 100 * n, 93.5], [0, 0, 1]],
            "D": [0.0] * 5,
            "image_size": [620, 188],
            "R": EYE,
            "T": [-0.5 * n, 0, 0],
        }
        for n in range(3)
    }
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps(content))
    return path


def test_recordings(small_drive: Drive, cameras: Path) -> None:
    for name, focal_px in (("cam_0", 400), ("cam_2", 600)):
        recording = tr.open_recording(small_drive.left, rig=cameras, camera=name)
        assert recording.calibration.camera.fx_px == focal_px
        recording.close()
    with pytest.raises(RigError, match=r"camera=.*cam_0, cam_1, cam_2"):
        tr.open_recording(small_drive.left, rig=cameras)
    with pytest.raises(RigError, match="LEFT,RIGHT"):
        tr.open_recording(small_drive.left, small_drive.right, rig=cameras, align="off")
    names = ("cam_0", "cam_2")
    pair = tr.open_recording(
        small_drive.left,
        small_drive.right,
        rig=cameras,
        camera=names,
        align="off",
        has_checks=False,
    )
    assert pair.rig is not None
    assert pair.rig.baseline_m == pytest.approx(1.0)
    pair.close()
    with pytest.raises(RigError, match="expected a calibration file with cameras"):
        tr.open_recording(small_drive.left, focal_px=500, camera="cam_1")
    with pytest.raises(RigError, match="expected a calibration file with cameras"):
        tr.open_recording(small_drive.left, rig=pair.rig, camera="cam_1")


def test_pipelines(cameras: Path) -> None:
    with tr.Pipeline.mono(rig=cameras, camera="cam_1", detections=None) as pipeline:
        assert pipeline is not None
    with pytest.raises(RigError, match="cam_0, cam_1, cam_2"):
        tr.Pipeline.mono(rig=cameras, camera="other")
    image = np.zeros((188, 620, 3), np.uint8)
    pipeline = tr.Pipeline.mono(focal_px=500, camera="cam_1", detections=None)
    with pipeline, pytest.raises(RigError, match="expected a calibration file with cameras"):
        pipeline.step(image, time_s=0.0)


def test_settings(tmp_path: Path, small_drive: Drive, cameras: Path) -> None:
    """The option in a file, of which a run's recording has the names."""
    (tmp_path / "settings.yaml").write_text(
        f"track_range_settings: 1\nrun:\n  mono: {small_drive.left}\n"
        f"  rig: {cameras}\n  camera: cam_2\n"
    )
    settings = settings_from(read_settings(tmp_path / "settings.yaml"))
    assert settings.recording.camera == ("cam_2",)
    assert settings_from({"stereo": ("a", "b"), "camera": "cam_0,cam_2"}).camera == (
        "cam_0",
        "cam_2",
    )


def test_commands(cli: Callable[..., Finished], tmp_path: Path, cameras: Path) -> None:
    status, _, stderr = cli("rig", "show", cameras)
    assert status == 1
    assert "cam_0, cam_1, cam_2" in stderr
    status, stdout, _ = cli("rig", "show", cameras, "--camera", "cam_1")
    assert status == 0
    assert "500.00" in stdout
    out = tmp_path / "pair.yaml"
    status, _, _ = cli("rig", "convert", cameras, out, "--camera", "cam_0,cam_1")
    assert status == 0
    assert tr.load_rig(out).baseline_m == pytest.approx(0.5)


def test_fleets(
    cli: Callable[..., Finished], tmp_path: Path, small_drive: Drive, cameras: Path
) -> None:
    """A fleet's --camera is that of clips without a calibration; --rig-camera is that of a run."""
    options = ("--rig", cameras, "--out", tmp_path / "out", "--dry-run")
    status, stdout, stderr = cli("fleet", "run", small_drive.left, *options)
    assert status == 3  # clips that cannot be processed
    assert "cam_0, cam_1, cam_2" in stdout + stderr
    status, stdout, _ = cli("fleet", "run", small_drive.left, *options, "--rig-camera", " cam_1")
    assert status == 0
    settings = FleetSettings(recordings=("clips",), out="out", rig_camera="cam_1")
    one, other = (fleet_plan(settings, {"camera": name}) for name in ("cam_1", "cam_2"))
    assert one.keys.settings != other.keys.settings
