"""Recordings that people own, each with what is right: times, order, track, pairs, or the sentence that
says what to give."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from track_range.recording.recording import Recording, open_recording
from track_range.recording.video.frame import VideoError

ASSUMED = "the images have no times; 25 frames/s are assumed"


@dataclass(frozen=True, kw_only=True)
class Case:
    """A recording of the shared folder, the options, and what a run should find."""

    name: str
    path: str
    options: dict[str, Any]
    n_frames: int
    step_s: float
    size_px: tuple[int, int] | None = None
    note: str | None = None  # words of a note; None = there is none


CASES = (
    Case(
        name="mjpeg_file_raw",
        path="drive.mjpeg",
        options={},
        n_frames=40,
        step_s=0.04,
        note=ASSUMED,
    ),
    Case(name="mjpeg_file_raw", path="drive.mjpeg", options={"fps": 10}, n_frames=40, step_s=0.1),
    Case(
        name="mjpeg_file_raw",
        path="drive.mjpeg",
        options={"folder_fps": 10},
        n_frames=40,
        step_s=0.1,
    ),
    Case(name="names_apolloscape", path="images", options={}, n_frames=16, step_s=0.033),
    Case(
        name="mkv_depth_track",
        path="k4a.mkv",
        options={},
        n_frames=10,
        step_s=0.1,
        size_px=(320, 180),
        note="depth or infrared by its name or grey values) is left out, track 0 is used",
    ),
)


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.name} {case.options}")
def test_recording(shared_data: Path, case: Case) -> None:
    path = shared_data / "cases" / case.name / case.path
    recording = open_recording(path, focal_px=180.0, **case.options)
    times_s = [frame.time_s for frame in recording.frames]
    assert len(times_s) == case.n_frames
    assert np.diff(times_s) == pytest.approx(case.step_s, abs=1e-4)
    assert case.size_px is None or recording.size_px == case.size_px
    notes = notes_of(recording)
    if case.note is None:
        assert notes == []
    else:
        assert any(case.note in note for note in notes), notes


def notes_of(recording: Recording) -> list[str]:
    """Notes on reading, without those on UTC and on the camera."""
    return [note for video in recording.videos for note in video.notes]


def test_playlist(shared_data: Path) -> None:
    with pytest.raises(VideoError, match=r"playlist\.m3u8: .*a playlist.*folder that contains"):
        open_recording(shared_data / "cases/hls_playlist/hls/playlist.m3u8", focal_px=180.0)
    folder = open_recording(shared_data / "cases/hls_playlist/hls", focal_px=180.0)
    assert len(list(folder.frames)) > 0


def test_chapters(shared_data: Path) -> None:
    recording = open_recording(shared_data / "cases/gopro_chapters/clips", focal_px=300.0)
    numbers = []
    for frame in recording.frames:  # the bright bar moves to the right with the time
        row = np.asarray(frame.left)[40].max(axis=-1).astype(float)
        numbers.append(int(np.argmax(np.convolve(row, np.ones(20), "valid"))))
    assert len(numbers) == 60
    assert numbers == sorted(numbers)
    starts_s = [part.start_s for part in recording.videos[0].parts]
    assert starts_s == pytest.approx([0.0, 2.0, 4.0])


def test_pair_of_clocks_with_other_origins(shared_data: Path) -> None:
    folder = shared_data / "cases/pair_ts_and_mp4"
    recording = open_recording(folder / "left.ts", folder / "right.mp4", rig=folder / "rig.yaml")
    assert recording.finding is not None
    assert recording.finding.fault == "fits"
    frames = list(recording.frames)
    assert len([frame for frame in frames if frame.right is not None]) == 35
    assert any("without a common origin: both are taken to start" in n for n in recording.notes)


@pytest.mark.parametrize("lag", [-14, 30])
def test_offset_of_clocks_from_images(
    shared_data: Path, tmp_path: Path, cut: Callable[..., Path], lag: int
) -> None:
    source = shared_data / "kitti_odometry/gray51"
    left = cut(source / "left.mp4", tmp_path / "left.mp4", first=max(0, -lag))
    right = cut(source / "right.mp4", tmp_path / "right.mp4", first=max(0, lag))
    recording = open_recording(left, right, rig=source / "calib.txt")
    pairs = [frame for frame in recording.frames if frame.right is not None]
    assert 0 <= 51 - abs(lag) - len(pairs) <= 1  # without the check of the first or last pair
    assert any(f"{lag / 10:+.2f} s are added to its times" in note for note in recording.notes)


def test_pair_of_two_drives(shared_data: Path) -> None:
    source = shared_data / "kitti_stereo"
    recording = open_recording(
        source / "0003/left.mp4", source / "0005/right.mp4", rig=source / "0003/calib.txt"
    )
    assert recording.rig is None
    assert recording.finding is not None
    assert recording.finding.fault == "refused"
    recording.close()


@pytest.fixture(scope="module")
def address(shared_data: Path) -> Callable[[str], Any]:
    """Starts a server of JPEGs at 10 per second: `address(mode)` gives (process, URL)."""

    def started(mode: str) -> tuple[subprocess.Popen[bytes], str]:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        script = shared_data / "cases/live_mjpeg_10/serve.py"
        server = subprocess.Popen(
            [sys.executable, script, str(port), "10", "20", mode],
            env={**os.environ, "DATA": str(shared_data)},
        )
        last_s = time.monotonic() + 30.0
        while time.monotonic() < last_s:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
            time.sleep(0.05)
        return server, f"http://127.0.0.1:{port}/video"

    return started


@pytest.mark.parametrize("mode", ["multipart", "raw"])
def test_times_of_a_live_stream_without_times(address: Callable[[str], Any], mode: str) -> None:
    server, url = address(mode)
    try:
        recording = open_recording(url, focal_px=721.5, duration_s=2.0)
        times_s = [frame.time_s for frame in recording.frames]
    finally:
        server.kill()
        server.wait()
    assert times_s[-1] == pytest.approx(2.0, abs=0.15)
    assert np.median(np.diff(times_s)) == pytest.approx(0.1, abs=0.02)
    assert recording.fps == pytest.approx(10.0, abs=2.0)


def test_snapshot(address: Callable[[str], Any]) -> None:
    server, url = address("snapshot")
    try:
        with pytest.raises(VideoError, match=r"single image \(a snapshot\)"):
            open_recording(url, focal_px=721.5)
    finally:
        server.kill()
        server.wait()
