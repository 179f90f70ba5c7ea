"""Importing and running track-range change no setting of the process, which may be a notebook or a
ROS node."""

from __future__ import annotations

import gc
import logging
import os
import signal
import subprocess
import sys
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path
from typing import Any

import cv2
import pytest

import track_range as tr
from track_range.simulation.drive import Drive

PROJECT = Path(__file__).resolve().parents[3]


def process_state() -> dict[str, Any]:
    """Settings that hold for the whole process."""
    return {
        "thread switching interval": sys.getswitchinterval(),
        "OpenCV's threads": cv2.getNumThreads(),
        "OpenCV's optimizations": cv2.useOptimized(),
        "garbage collection": (
            gc.isenabled(),
            gc.get_threshold(),
            gc.get_freeze_count(),
            list(gc.callbacks),
        ),
        "niceness": os.getpriority(os.PRIO_PROCESS, os.getpid()),
        "folders of modules": list(sys.path),
        "log handlers": list(logging.getLogger().handlers),
        "log level": (logging.getLogger().level, logging.root.manager.disable),
        "signal handlers": [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)],
        "output": (sys.stdout, sys.stderr),
    }


def niceness_of_threads() -> set[int]:
    """Niceness of each thread of this process, also those of libraries (Linux only)."""
    folder = Path("/proc/self/task")
    return (
        {os.getpriority(os.PRIO_PROCESS, int(task.name)) for task in folder.iterdir()}
        if folder.is_dir()
        else set()
    )


def assert_unchanged_by(results: Iterable[Any]) -> None:
    """Check that the settings of the process are the same before, inside the loop of, and after an
    iteration."""
    before, threads_before = process_state(), niceness_of_threads()
    n_results = 0
    for _ in results:
        n_results += 1
        assert process_state() == before
    assert n_results > 0
    assert process_state() == before
    assert niceness_of_threads() <= threads_before


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
        "Run, Detector, Tracker, Overlay, StereoRanger, register_tracker, register_writer, "
        "evaluate_stereo"
    )
    code = f"""if True:
        import cv2, onnxruntime  # as another part of the program may have done
        from tests.track_range.run.test_process_state import process_state
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
