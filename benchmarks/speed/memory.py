"""Memory of a long run: resident memory of the process over a real drive that is looped to 2,000 frames.

If memory does not depend on the length of the video, it is the same in the second and the last quarter. The peak
includes the summary and the report at the end, with 250 bytes per row of tracks.csv.
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
"""Interval in s between samples of the memory."""

_MIB = 2**20


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this workload."""
    add_drive_options(parser)
    parser.add_argument("--frames", type=int, default=2000, help="number of frames of the looped drive")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Medians of the resident memory in MiB by quarter of the frames; prints the table."""
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
    """(frame, MiB) samples while the command runs; the frame is that of the last row in the file `rows`."""
    import psutil  # a local import, since only this workload requires the extra `bench`

    samples = []
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    resources = psutil.Process(process.pid)
    while process.poll() is None:
        time.sleep(_SAMPLE_S)
        frame = _last_frame(rows)
        if frame is not None and process.poll() is None:
            samples.append((frame, resources.memory_info().rss / _MIB))
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
