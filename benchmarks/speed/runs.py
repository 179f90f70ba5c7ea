"""Time and memory of whole runs, each in a separate process, and of the start of the program."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.harness import PROGRAM, Figures, in_new_process, option, workload
from benchmarks.inputs.drives import DRIVE_OPTIONS, LoopedDrive, looped, ordinary_video
from benchmarks.inputs.emulated_network import time_ms
from benchmarks.inputs.run_inputs import RunInputs, run_ms
from track_range.detection.models.onnx_session import OnnxSession, Runtime
from track_range.detection.yolo.detector import DEFAULT_SIZE_PX
from track_range.detection.yolo.letterbox import rectangular_input_hw

COMMANDS = {
    "python -c pass": ("-c", "pass"),
    "import track_range": ("-c", "import track_range"),
    "track-range --help": ("-m", "track_range", "--help"),
    "track-range run --help": ("-m", "track_range", "run", "--help"),
}
"""What `startup` measures."""

SAMPLE_S = 0.25  # interval in s between samples of the memory


def times_s(arguments: Sequence[str]) -> tuple[float, float]:
    """Wall-clock and CPU time in s of a process of Python, which has to succeed."""
    start_s = time.perf_counter()
    process = subprocess.Popen([sys.executable, *arguments], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(arguments)}: status {process.returncode}")
    return time.perf_counter() - start_s, usage.ru_utime + usage.ru_stime


def pair_command(drive: LoopedDrive, options: Namespace, out: Path) -> tuple[str, ...]:
    """Arguments of Python for a run on a looped drive, without dense stereo."""
    pair = ("--stereo", str(drive.left), str(drive.right), "--rig", str(drive.rig))
    return (
        *PROGRAM[1:],
        *pair,
        "--detector",
        str(options.detector),
        "--out",
        str(out),
        "--no-sgbm",
    )


@workload(option("--runs", default=10, help="runs of each command"))
def startup(options: Namespace) -> Figures:
    """Median wall-clock and CPU time in s of each command in a new process; runs alternate between
    the commands.
    """
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in COMMANDS}
    for _ in range(options.runs):
        for name, arguments in COMMANDS.items():
            times[name].append(times_s(arguments))
    medians = {name: np.median(pairs, axis=0).tolist() for name, pairs in times.items()}
    return {
        name: {"wall_s": wall, "cpu_s": cpu, "n_runs": options.runs}
        for name, (wall, cpu) in medians.items()
    }


@workload(
    *DRIVE_OPTIONS,
    option("--frames", default=300, help="number of frames of the looped drive"),
    option("--rounds", default=3, help="number of rounds"),
    option("--network-ms", default=0.0, help="time of a network with stored boxes; 0 = detector"),
)
def pipeline(options: Namespace) -> Figures:
    """Wall time of whole runs relative to the detector's inference alone, both with one network
    thread, ms.
    """
    if options.network_ms:
        return _with_fast_network(options)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        drive = looped(options.drive, folder, n_frames=options.frames)
        video = ordinary_video(folder / "ordinary.mp4", n_frames=options.frames)
        one = (
            "--mono",
            str(video),
            "--focal-px",
            "1150",
            "--detector",
            str(options.detector),
            "--no-sgbm",
        )
        commands = {
            "pair": (*pair_command(drive, options, folder / "pair"), "--align", "off"),
            "ordinary": (*PROGRAM[1:], *one, "--out", str(folder / "ordinary")),
        }
        rounds = []
        for _ in range(options.rounds):
            alone_ms = _inference_alone_ms(
                options.detector, n_frames=options.frames, image_hw=drive.image_hw
            )
            figures = {"inference alone": alone_ms}
            for kind, command in commands.items():
                times_s((*command, "--threads", "1", "--device", "cpu"))
                summary = json.loads((folder / kind / "summary.json").read_text(encoding="utf-8"))
                run_ms = 1e3 * summary["wall_s"] / summary["frames"]
                figures |= {kind: run_ms, f"{kind}, ratio": run_ms / alone_ms}
            rounds.append(figures)
    median = {key: statistics.median(figures[key] for figures in rounds) for key in rounds[0]}
    return {"frames": options.frames, "median": median, "rounds": rounds}


def _with_fast_network(options: Namespace) -> Figures:
    """Wall time of runs with stored boxes and a network of the given time, with and without
    overlay, ms.
    """
    rounds: list[dict[str, dict[str, float]]] = []
    with tempfile.TemporaryDirectory() as name:
        inputs = RunInputs.written(
            Path(name), options.drive, options.detector, options.frames, options.network_ms
        )
        for _ in range(options.rounds):
            figures = {"network alone": {"processor_ms": time_ms(inputs.detector)}}
            for kind, settings in inputs.settings.items():
                for has_overlay in (True, False):
                    label = kind if has_overlay else f"{kind}, no overlay"
                    given = {**settings, "overlay": has_overlay}
                    figures[label] = in_new_process(run_ms, given, inputs.stored[kind])
            rounds.append(figures)
    median = {
        kind: {key: statistics.median(figures[kind][key] for figures in rounds) for key in of_kind}
        for kind, of_kind in rounds[0].items()
    }
    return {"frames": options.frames, "median": median, "rounds": rounds}


def _inference_alone_ms(detector: Path, *, n_frames: int, image_hw: tuple[int, int]) -> float:
    session = OnnxSession(detector, Runtime(device="cpu", n_threads=1))
    # input size of a run with a dynamic network
    free_hw = rectangular_input_hw(image_hw, size_px=DEFAULT_SIZE_PX)
    height, width = (
        fixed or free for fixed, free in zip(session.input_shape[2:], free_hw, strict=True)
    )
    network = session.bound((height, width))
    network.blob[:] = np.random.default_rng(0).random((1, 3, height, width), np.float32)
    network.run()
    start_s = time.perf_counter()
    for _ in range(n_frames):
        network.run()
    return 1e3 * (time.perf_counter() - start_s) / n_frames


@workload(
    *DRIVE_OPTIONS, option("--frames", default=2000, help="number of frames of the looped drive")
)
def memory(options: Namespace) -> Figures:
    """Resident memory of a run, MiB: medians by quarter, equal but the first if it does not grow,
    and the peak.
    """
    # a local import, since only this workload and `writers` require the extra `bench`
    import psutil

    samples: list[tuple[int, float]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        drive = looped(options.drive, folder, n_frames=options.frames)
        process = subprocess.Popen(
            [sys.executable, *pair_command(drive, options, folder / "out")],
            stdout=subprocess.DEVNULL,
        )
        resources = psutil.Process(process.pid)
        while process.poll() is None:
            time.sleep(SAMPLE_S)
            frame = _last_frame(folder / "out" / "tracks.csv")
            if frame is not None and process.poll() is None:
                samples.append((frame, resources.memory_info().rss / 2**20))
        if process.returncode:
            raise SystemExit(f"track-range failed with status {process.returncode}")
    n_frames = 1 + max(frame for frame, _ in samples)
    quarters = {
        f"quarter_{q + 1}_mib": statistics.median(
            mib for frame, mib in samples if 4 * frame // n_frames == q
        )
        for q in range(4)
    }
    return {"frames": options.frames, **quarters, "peak_mib": max(mib for _, mib in samples)}


def _last_frame(rows: Path) -> int | None:
    try:
        with rows.open("rb") as file:
            file.seek(max(0, rows.stat().st_size - 400))
            last = file.read().splitlines()[-1].split(b",")[0]
    except (OSError, IndexError):
        return None
    return int(last) if last.isdigit() else None
