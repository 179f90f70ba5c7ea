"""Start-up time: `track-range --help`, `track-range run --help` and `import track_range`, each in a new process."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from argparse import ArgumentParser, Namespace
from typing import Any

from rich.console import Console

from benchmarks.plain_tables import figure_text, plain_table

COMMANDS = {
    "python -c pass": ("-c", "pass"),
    "import track_range": ("-c", "import track_range"),
    "track-range --help": ("-m", "track_range", "--help"),
    "track-range run --help": ("-m", "track_range", "run", "--help"),
}


def add_options(parser: ArgumentParser) -> None:
    """Add the options of this workload."""
    parser.add_argument("--runs", type=int, default=10, help="runs of each command (default: 10)")


def measure(options: Namespace) -> dict[str, Any]:
    """Median wall-clock and CPU time in seconds of each command, over runs that alternate between the commands."""
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in COMMANDS}
    for _ in range(options.runs):
        for name, arguments in COMMANDS.items():
            times[name].append(_times_s(arguments))
    figures = {
        name: {
            "wall_s": statistics.median(wall for wall, _ in pairs),
            "cpu_s": statistics.median(cpu for _, cpu in pairs),
            "n_runs": len(pairs),
        }
        for name, pairs in times.items()
    }
    table = plain_table("Start-up time, median", "command", "wall s", "CPU s")
    for name, row in figures.items():
        table.add_row(name, figure_text(row["wall_s"], digits=3), figure_text(row["cpu_s"], digits=3))
    Console().print(table)
    return figures


def _times_s(arguments: tuple[str, ...]) -> tuple[float, float]:
    """Wall-clock and CPU time of one process."""
    cpu_s = _children_cpu_s()
    start_s = time.perf_counter()
    subprocess.run([sys.executable, *arguments], stdout=subprocess.DEVNULL, check=True)
    return time.perf_counter() - start_s, _children_cpu_s() - cpu_s


def _children_cpu_s() -> float:
    times = os.times()
    return times.children_user + times.children_system
