"""Importing and running track-range change no setting of the process, which may be a notebook or a
ROS node."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

import track_range as tr
from tests.track_range.run.process_state import (
    assert_unchanged_by,
    process_state,
)
from track_range.simulation.drive import Drive

PROJECT = Path(__file__).resolve().parents[3]


@pytest.mark.parametrize("sgbm", [False, True])
def test_run(small_drive: Drive, sgbm: bool) -> None:
    before = process_state()
    run = tr.Run.stereo(small_drive.left, small_drive.right, rig=small_drive.rig, sgbm=sgbm)
    with run:
        assert process_state() == before
        assert_unchanged_by(run)
    assert process_state() == before


def test_run_with_files_and_an_early_end(small_drive: Drive, tmp_path: Path) -> None:
    before = process_state()
    for _ in tr.Run.mono(
        small_drive.left, focal_px=350, duration=0.6, out=tmp_path / "out", lanes="off"
    ):
        assert process_state() == before
        break
    assert (tmp_path / "out/summary.json").exists()
    assert process_state() == before


def test_pipeline(small_drive: Drive) -> None:
    before = process_state()
    recording = tr.open_recording(
        small_drive.left, small_drive.right, rig=small_drive.rig, align="off"
    )
    with closing(recording), tr.Pipeline.stereo(recording.rig, sgbm=False) as pipeline:
        assert_unchanged_by(
            pipeline.step(frame.left, frame.right[:, :], frame.time_s) for frame in recording.frames
        )
    assert process_state() == before


def test_runs_side_by_side(small_drive: Drive) -> None:
    before = process_state()
    options = {"focal_px": 350, "duration": 0.3, "detections": small_drive.detections}
    first, second = (iter(tr.Run.mono(small_drive.left, **options)) for _ in range(2))
    next(first), next(second)
    first.close()
    assert process_state() == before
    second.close()
    assert process_state() == before


def test_import_in_a_new_process() -> None:
    names = (
        "Run, Detector, Tracker, Overlay, StereoRanger, register_tracker, register_writer, evaluate"
    )
    code = f"""if True:
        import cv2, onnxruntime  # as another part of the program may have done
        from tests.track_range.run.process_state import process_state
        before = process_state()
        from track_range import {names}
        assert process_state() == before, (process_state(), before)
    """
    subprocess.run(
        [sys.executable, "-c", code],
        check=True,
        cwd=PROJECT,
        env={**os.environ, "PYTHONPATH": str(PROJECT)},
    )
