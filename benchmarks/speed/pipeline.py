"""Wall time of whole runs relative to the detector's inference alone, both with one network thread.

Protocol: a near-lossless stereo drive looped to 300 frames, and an ordinary video of one camera (H.264, crf 23,
1280 x 720); alternating, several rounds of (a) the network alone on one prepared input, once per frame, and (b)
`track-range --threads 1 --no-sgbm` with overlay in a separate process, for each of the two. Its time is `wall_s`:
opening the videos and processing all frames, without the start of Python, the loading of the network, the summary and
the report. No alignment is estimated: the frames of the first seconds, which it reads, would be decoded before.
The figure is the median of the ratios of the rounds, since the speed of the machine varies.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.inputs.drives import add_drive_options, looped, ordinary_video
from track_range.detection.models.onnx_session import OnnxSession, Runtime
from track_range.detection.yolo.detector import DEFAULT_SIZE_PX
from track_range.detection.yolo.letterbox import rectangular_input_hw


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this workload."""
    add_drive_options(parser)
    parser.add_argument("--frames", type=int, default=300, help="number of frames of the looped drive")
    parser.add_argument("--rounds", type=int, default=3, help="number of rounds")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Run all rounds, print the table, and return its figures (milliseconds per frame)."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        drive = looped(options.drive, folder, n_frames=options.frames)
        video = ordinary_video(folder / "ordinary.mp4", n_frames=options.frames)
        inputs = {
            "pair": ["--stereo", str(drive.left), str(drive.right), "--rig", str(drive.rig), "--align", "off"],
            "ordinary": ["--mono", str(video), "--focal-px", "1150"],
        }
        rounds = [_round(inputs, drive.image_hw, options, folder / "out") for _ in range(options.rounds)]
    median = {key: statistics.median(r[key] for r in rounds) for key in rounds[0]}
    figures = {"frames": options.frames, "rounds": rounds, "median": median}
    _print(rounds, median)
    return figures


def _round(
    inputs: dict[str, list[str]], image_hw: tuple[int, int], options: argparse.Namespace, out: Path
) -> dict[str, float]:
    alone_ms = _inference_alone_ms(options.detector, n_frames=options.frames, image_hw=image_hw)
    figures = {"inference alone": alone_ms}
    for name, given in inputs.items():
        summary = _run([*given, "--detector", str(options.detector), "--out", str(out / name)])
        run_ms = 1e3 * summary["wall_s"] / summary["frames"]
        figures |= {name: run_ms, f"{name}, ratio": run_ms / alone_ms}
    return figures


def _inference_alone_ms(detector: Path, *, n_frames: int, image_hw: tuple[int, int]) -> float:
    session = OnnxSession(detector, Runtime(device="cpu", n_threads=1))
    free_hw = rectangular_input_hw(image_hw, size_px=DEFAULT_SIZE_PX)  # input size of a run with a dynamic network
    height, width = (fixed or free for fixed, free in zip(session.input_shape[2:], free_hw, strict=True))
    network = session.bound((height, width))
    network.blob[:] = np.random.default_rng(0).random((1, 3, height, width), np.float32)
    network.run()
    start_s = time.perf_counter()
    for _ in range(n_frames):
        network.run()
    return 1e3 * (time.perf_counter() - start_s) / n_frames


def _run(given: list[str]) -> dict[str, Any]:
    """The summary of a run with one network thread."""
    command = [str(Path(sys.executable).with_name("track-range")), *given, "--threads", "1"]
    subprocess.run([*command, "--no-sgbm", "--device", "cpu"], check=True, stdout=subprocess.DEVNULL)
    out = Path(given[given.index("--out") + 1])
    summary: dict[str, Any] = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    return summary


def _print(rounds: list[dict[str, float]], median: dict[str, float]) -> None:
    table = Table("ms per frame", *(f"round {i}" for i in range(1, len(rounds) + 1)), "median", title="pipeline")
    for key in median:
        table.add_row(key, *(f"{r[key]:.2f}" for r in rounds), f"{median[key]:.2f}")
    Console().print(table)
