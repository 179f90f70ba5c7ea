"""Memory of a long run: a real drive looped to 2,000 frames, the process's resident memory over time.

A run whose memory does not depend on the video's length is as large in its last quarter as in its second. The peak is
told too: the summary and the report at the end read tracks.csv back, 250 bytes of numbers per row.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.inputs.drives import add_drive_options, looped

_SAMPLE_S = 0.25
_MIB = 2**20


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this workload."""
    add_drive_options(parser)
    parser.add_argument("--frames", type=int, default=2000)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Run it, print the table, and return medians in MiB by quarter of the frames."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        drive = looped(options.drive, folder, n_frames=options.frames)
        command = [str(Path(sys.executable).with_name("track-range")), "--stereo", str(drive.left), str(drive.right)]
        command += ["--rig", str(drive.rig), "--detector", str(options.detector), "--out", str(folder / "out")]
        samples = _sampled([*command, "--no-sgbm"], folder / "out" / "tracks.csv")
    n_frames = max(frame for frame, _ in samples)
    peak_mib = max(mib for _, mib in samples)
    quarters = {
        f"quarter_{q + 1}_mib": statistics.median(m for f, m in samples if q <= 4 * f / (n_frames + 1) < q + 1)
        for q in range(4)
    }
    table = Table(
        "resident memory, MiB", *(f"quarter {q}" for q in range(1, 5)), "peak", title=f"memory, {options.frames} frames"
    )
    table.add_row("median", *(f"{value:.0f}" for value in quarters.values()), f"{peak_mib:.0f}")
    Console().print(table)
    return {"frames": options.frames, **quarters, "peak_mib": peak_mib}


def _sampled(command: list[str], rows: Path) -> list[tuple[int, float]]:
    """(frame, MiB) samples while the command runs; the frame is read from the last row that it wrote."""
    import psutil  # of the extra `bench`, which the other workloads do without

    samples = []
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    watched = psutil.Process(process.pid)
    while process.poll() is None:
        time.sleep(_SAMPLE_S)
        frame = _last_frame(rows)
        if frame is not None and process.poll() is None:
            samples.append((frame, watched.memory_info().rss / _MIB))
    if process.returncode:
        raise SystemExit(f"track-range failed with status {process.returncode}")
    return samples


def _last_frame(rows: Path) -> int | None:
    try:
        with rows.open("rb") as file:
            file.seek(max(0, rows.stat().st_size - 400))
            last = file.read().splitlines()[-1].split(b",")[0]
    except (OSError, IndexError):
        return None
    return int(last) if last.isdigit() else None
