"""--every and --realtime: which frames of a recording are processed, and when."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import track_range as tr
from track_range.results.summary_shape import valid_summary

N_FRAMES = 12


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path, Path]:
    """A folder of images, the same without odd ones, and boxes of an object that approaches."""
    noise = np.random.default_rng(1).integers(0, 255, (60, 120, 3), np.uint8)
    whole, half = tmp_path / "whole", tmp_path / "half"
    for folder in (whole, half):
        folder.mkdir()
    rows = []
    for number in range(N_FRAMES):
        image = np.ascontiguousarray(np.roll(noise, number, axis=1)[:, :100])
        for folder in (whole, half)[: 2 - number % 2]:
            cv2.imwrite(str(folder / f"{number:06}.png"), image)
        height = 12 + 0.5 * number
        rows.append(
            f"{number} -1 Car -1 -1 -10 30 {35 - height} {30 + 1.3 * height} 35 -1 -1 -1 -1000 "
            "-1000 -1000 -10 0.9"
        )
    (tmp_path / "boxes.txt").write_text("\n".join(rows) + "\n")
    return whole, half, tmp_path / "boxes.txt"


def table(folder: Path, boxes: Path, **options: Any) -> tuple[list[int], dict[str, Any]]:
    run = tr.Run.mono(folder, detections=boxes, focal_px=100, ego_speed=36, **options)
    frames = [frame.index for frame in run]
    return frames, run.to_arrow().to_pydict()


def test_each_second_frame_is_a_recording_of_half_the_rate(
    folders: tuple[Path, Path, Path],
) -> None:
    whole, half, boxes = folders
    frames, rows = table(whole, boxes, every=2)
    assert frames == list(range(0, N_FRAMES, 2))
    expected = table(half, boxes, fps=5)[1]
    assert rows.keys() == expected.keys()
    assert np.isfinite(np.array(rows["closing_mps"], float)).any()
    for name, values in rows.items():
        assert values == expected[name], name


def test_rate_and_number_of_frames(folders: tuple[Path, Path, Path]) -> None:
    with pytest.raises(tr.errors.ConfigError, match="every"):
        tr.Run.mono(folders[0], every=0)
    recording = tr.open_recording(folders[0], focal_px=100, every=5)
    assert (recording.fps, recording.n_frames, [frame.index for frame in recording.frames]) == (
        2.0,
        3,
        [0, 5, 10],
    )
    recording.close()


def test_realtime_states_latency_and_drops(
    folders: tuple[Path, Path, Path], tmp_path: Path, cli: Callable[..., Any]
) -> None:
    options = (
        "--mono",
        folders[0],
        "--detections",
        folders[2],
        "--focal-px",
        100,
        "--no-overlay",
        "--lanes",
        "off",
    )
    out = tmp_path / "out"
    status, printed, complaint = cli(*options, "--realtime", "--folder-fps", 40, "--out", out)
    assert status == 0, complaint
    summary = json.loads((out / "summary.json").read_text())
    assert valid_summary(summary)[1] == []
    assert summary["frames"] + summary["frames_dropped"] == N_FRAMES
    assert (
        0
        < summary["latency_ms"]["p50"]
        <= summary["latency_ms"]["p95"]
        <= summary["latency_ms"]["max"]
    )
    assert "Latency" in printed
    assert not any("have no times" in note for note in summary["notes"])
    assert cli(*options, "--out", tmp_path / "plain")[0] == 0
    plain = json.loads((tmp_path / "plain/summary.json").read_text())
    assert not {"latency_ms", "frames_dropped"} & plain.keys()
    assert [
        "10 frames/s are assumed" in note for note in plain["notes"] if "have no times" in note
    ] == [True]


def test_latency_of_a_pipeline(folders: tuple[Path, Path, Path]) -> None:
    images = [
        np.asarray(cv2.imread(str(path)), np.uint8) for path in sorted(folders[0].iterdir())[:3]
    ]

    class Boxes:
        def detect(self, image: np.ndarray) -> tr.Detections:
            return tr.Detections.empty()

    def latencies(times_s: list[float]) -> dict[str, float]:
        with tr.Pipeline.mono(focal_px=100, detector=Boxes()) as pipeline:
            assert pipeline.latency_ms == {}
            for image, time_s in zip(images, times_s, strict=True):
                pipeline.step(image, time_s)
            return pipeline.latency_ms

    now_s = time.time()
    assert latencies([1.0, 2.0, 3.0])["p50"] > 0
    assert latencies([now_s - 5.0 + 0.1 * number for number in range(3)])["p50"] >= 4800


def test_milliseconds_are_no_seconds(folders: tuple[Path, Path, Path]) -> None:
    image = np.asarray(cv2.imread(str(min(folders[0].iterdir()))), np.uint8)

    class Boxes:
        def detect(self, image: np.ndarray) -> tr.Detections:
            return tr.Detections.empty()

    def is_noted(times_s: list[float]) -> bool:
        with tr.Pipeline.mono(focal_px=100, detector=Boxes()) as pipeline:
            for time_s in times_s:
                pipeline.step(image, time_s)
            return any("time_s" in note for note in pipeline.notes)

    assert is_noted([0.0, 100.0, 200.0, 300.0])
    assert not is_noted([0.0, 100.0, 200.0, 200.1])
    assert not is_noted([0.0, 0.1, 100.0, 100.1])
