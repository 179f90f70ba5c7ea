"""End-to-end runs on local live streams."""

from __future__ import annotations

import http.client
import itertools
import json
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
import yaml

from tests.support.recordings.live_servers import cameras
from track_range.results.formats.csv_file import read_tracks_csv
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.rig_formats.rig_yaml import save_rig

Cli = Callable[..., tuple[int, str, str]]
BOXES = "".join(f"{frame},-1,10,10,20,20,0.9,-1,-1,-1\n" for frame in range(1, 3000))
"""The same box in every frame."""

QUICK = ("--focal-px", "60", "--lanes", "off", "--tracker", "sort")


@pytest.fixture
def boxes(tmp_path: Path) -> Path:
    path = tmp_path / "det.txt"
    path.write_text(BOXES)
    return path


def n_frames_of(video: Path) -> int:
    with av.open(str(video)) as container:
        return sum(1 for _ in container.decode(video=0))


def summary_of(out: Path) -> dict:
    return json.loads((out / "summary.json").read_text())


def test_one_camera_for_a_while(boxes: Path, tmp_path: Path, cli: Cli) -> None:
    out = tmp_path / "out"
    with cameras(1) as (camera,):
        url = camera.url.replace("tcp://", "tcp://me:secret@")
        status, printed, errors = cli(
            "--mono", url, "--detections", boxes, *QUICK, "--duration", "0.5", "--out", out
        )
    assert (status, errors) == (0, "")
    summary = summary_of(out)
    assert summary["frames"] == n_frames_of(out / "overlay.mp4") > 0
    times_s = read_tracks_csv(out / "tracks.csv")["time_s"]
    assert times_s[0] >= 0
    assert times_s[-1] < 0.5
    assert summary["utc"]["source"] == "clock of this computer"
    assert "Latency" in printed
    assert "<h3>Settings</h3>" in (out / "report.html").read_text()
    assert all(
        b"secret" not in file.read_bytes() for file in out.iterdir() if file.suffix != ".mp4"
    )
    assert yaml.safe_load((out / "settings.yaml").read_text())["run"]["mono"] == camera.url


@pytest.mark.slow
def test_two_cameras_until_one_is_unplugged(boxes: Path, tmp_path: Path, cli: Cli) -> None:
    out = tmp_path / "out"
    with cameras(1) as (left,), cameras(1, 500, is_torn=True) as (right,):
        # without an alignment, whose first frames are read before the run begins
        pair = ("--stereo", left.url, right.url, "--align", "off")
        status, _, errors = cli(*pair, "--detections", boxes, *QUICK, "--no-sgbm", "--out", out)
    assert status == 1
    assert re.match(rf"track-range: {right.url}: .*lost after \d+ frames", errors)
    summary = summary_of(out)
    assert summary["frames"] == n_frames_of(out / "overlay.mp4") > 0
    frames = "1 frame" if summary["frames"] == 1 else f"{summary['frames']} frames"
    assert any(
        note.startswith(f"The run was stopped early, after {frames}: {right.url}")
        for note in summary["notes"]
    )
    assert any("arrival time" in note for note in summary["notes"])
    assert "<html" in (out / "report.html").read_text()


def test_live_stream_and_file_are_not_a_pair(
    film: Callable[..., Path], tmp_path: Path, cli: Cli
) -> None:
    film(tmp_path / "left.mp4", [0.0, 0.1])
    with cameras(1) as (camera,):
        status, _, errors = cli("--stereo", camera.url, tmp_path / "left.mp4", "--focal-px", "60")
    assert status == 1
    assert "live streams" in errors


@pytest.mark.slow
def test_ctrl_c_ends_a_live_run(boxes: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with cameras(1) as (camera,):
        options = (
            "--mono",
            camera.url,
            "--detections",
            boxes,
            *QUICK,
            "--serve",
            "0",
            "--out",
            out,
        )
        command = [sys.executable, "-m", "track_range", *map(str, options)]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        with subprocess.Popen(command, **pipes, text=True) as running:
            assert running.stdout is not None
            lines = iter(running.stdout.readline, "")
            address = next(
                match for line in lines if (match := re.search(r"http://127.0.0.1:(\d+)/", line))
            )
            viewer = http.client.HTTPConnection("127.0.0.1", int(address[1]), timeout=30)
            viewer.request("GET", "/stream.mjpg")
            with viewer.getresponse() as pictures:
                parts = (
                    line for line in iter(pictures.readline, b"") if line.strip() == b"--picture"
                )
                # so at least one frame is finished
                assert len(list(itertools.islice(parts, 3))) == 3
            viewer.close()
            running.send_signal(signal.SIGINT)
            _, errors = running.communicate(timeout=60)
    assert running.returncode == 1
    assert errors.startswith("track-range: stopped")
    assert summary_of(out)["frames"] == n_frames_of(out / "overlay.mp4") > 0


def test_port_in_use_ends_the_run_at_once(boxes: Path, tmp_path: Path, cli: Cli) -> None:
    with cameras(1) as (camera,):
        port = camera.url.rpartition(":")[2]
        options = (
            "--mono",
            "left.mp4",
            "--focal-px",
            "60",
            "--serve",
            port,
            "--out",
            tmp_path / "out",
        )
        status, _, errors = cli(*options)
    assert status == 1
    assert re.match(rf"track-range: --serve 127.0.0.1:{port}: .*in use", errors)
    assert not (tmp_path / "out").exists()


def test_invalid_port_is_a_usage_error(cli: Cli) -> None:
    status, _, errors = cli("--mono", "left.mp4", "--focal-px", "60", "--serve", "loud")
    assert status == 2
    assert "--serve" in errors


def test_no_such_camera(cli: Cli) -> None:
    status, _, errors = cli("--mono", "987", "--focal-px", "60")
    assert status == 1
    assert errors.startswith("track-range: /dev/video987: ")
    assert "camera" in errors


def test_overlay_with_disparities(
    film: Callable[..., Path], boxes: Path, tmp_path: Path, cli: Cli
) -> None:
    noise = np.random.default_rng(4).integers(0, 255, (96, 200, 3), np.uint8)
    texture = cv2.resize(noise[::4, ::4], (200, 96))
    save_rig(
        StereoRig.rectified(PinholeCamera(150.0, 150.0, 95.5, 47.5, 192, 96), 0.5),
        tmp_path / "rig.yaml",
    )
    views = {"left": texture[:, :192], "right": texture[:, 8:]}
    films = [
        film(tmp_path / f"{name}.mp4", [0.0, 0.1, 0.2], images=[view] * 3)
        for name, view in views.items()
    ]
    pair = (
        "--stereo",
        *films,
        "--detections",
        boxes,
        "--lanes",
        "off",
        "--align",
        "off",
        "--out",
        tmp_path / "out",
    )
    status, _, errors = cli(*pair, "--overlay-disparity")
    assert (status, errors) == (0, "")
    with av.open(str(tmp_path / "out" / "overlay.mp4")) as container:
        picture = next(container.decode(video=0)).to_ndarray(format="bgr24")
    assert picture.shape == (192, 192, 3)
    assert np.ptp(picture[96:180, 64:180].astype(int), axis=2).mean() > 60  # in colours
    status, _, errors = cli(*pair, "--overlay-disparity", "--no-sgbm")
    assert status == 2
    assert "--overlay-disparity" in errors


def test_overlay_disparity_needs_a_rig(
    film: Callable[..., Path], boxes: Path, tmp_path: Path, cli: Cli
) -> None:
    films = [film(tmp_path / f"{name}.mp4", [0.0, 0.1, 0.2]) for name in ("left", "right")]
    options = (
        "--detections",
        boxes,
        "--lanes",
        "off",
        "--overlay-disparity",
        "--out",
        tmp_path / "out",
    )
    status, printed, errors = cli("--stereo", *films, *options)
    assert (status, errors) == (0, "")
    assert "needs a rig" in " ".join(printed.split())
    with av.open(str(tmp_path / "out" / "overlay.mp4")) as container:
        assert next(container.decode(video=0)).height == 48
