"""Live page under load: time of a run without viewers, and of the same run with 200 slow readers of its stream."""

from __future__ import annotations

import os
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks.inputs.drives import add_drive_options, looped
from benchmarks.plain_tables import figure_text, plain_table


def add_options(parser: ArgumentParser) -> None:
    """Add the options of this workload."""
    add_drive_options(parser)
    parser.add_argument("--frames", type=int, default=150, help="number of frames of the looped drive (default: 150)")
    parser.add_argument("--readers", type=int, default=200, help="number of slow readers (default: 200)")
    parser.add_argument("--rounds", type=int, default=3, help="runs of each kind, in turn (default: 3)")


def measure(options: Namespace) -> dict[str, Any]:
    """Wall-clock and CPU time in seconds of the runs, and their median ratios round by round."""
    times: dict[str, list[tuple[float, float]]] = {"no viewer": [], "slow readers": []}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        drive = looped(options.drive, folder, n_frames=options.frames)
        command = [str(Path(sys.executable).with_name("track-range")), "--stereo", str(drive.left), str(drive.right)]
        command += ["--rig", str(drive.rig), "--detector", str(options.detector), "--no-sgbm", "--threads", "1"]
        command += ["--out", str(folder / "out")]
        for _ in range(options.rounds):
            times["no viewer"].append(_times_s(command))
            port = _free_port()
            with _slow_readers(port, options.readers):
                times["slow readers"].append(_times_s([*command, "--serve", str(port)]))
            print({kind: [round(time_s, 1) for time_s in measured[-1]] for kind, measured in times.items()}, flush=True)
    pairs = list(zip(times["no viewer"], times["slow readers"], strict=True))
    ratios = {
        kind: statistics.median(loaded[k] / alone[k] for alone, loaded in pairs)
        for k, kind in enumerate(("wall", "cpu"))
    }
    table = plain_table(f"Live page, {options.readers} slow readers, median", "run", "wall s", "CPU s")
    for kind, measured in times.items():
        wall_s, cpu_s = (statistics.median(column) for column in zip(*measured, strict=True))
        table.add_row(kind, figure_text(wall_s, digits=1), figure_text(cpu_s, digits=1))
    table.add_row("ratio", figure_text(ratios["wall"], digits=3), figure_text(ratios["cpu"], digits=3))
    Console().print(table)
    return {"times_s": times, "ratios": ratios}


@contextmanager
def _slow_readers(port: int, n_readers: int) -> Iterator[None]:
    process = subprocess.Popen([sys.executable, "-m", "benchmarks.speed.slow_readers", str(port), str(n_readers)])
    try:
        yield
    finally:
        process.kill()
        process.wait()


def _times_s(command: list[str]) -> tuple[float, float]:
    """Wall-clock and CPU time of one process, which has to succeed."""
    start_s = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)  # not the time of the readers
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"track-range failed with status {process.returncode}")
    return time.perf_counter() - start_s, usage.ru_utime + usage.ru_stime


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port: int = server.getsockname()[1]
        return port
