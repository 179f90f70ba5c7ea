"""Memory over 3,000 frames, and equal bytes from runs with different numbers of threads."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.inputs.drives import loop_video
from benchmarks.torture.cases import Case, problems
from benchmarks.torture.processes import Child, start
from benchmarks.torture.result_files import result_problems
from benchmarks.torture.seeds import FOCAL_PX, simulate

_N_LONG = 3000
"""Number of frames of the long run."""

_FIRST_SAMPLE = 1000
"""Frame at which the memory is compared with that at the end: buffers and caches are filled by then."""

_MAX_GROWTH_MIB = 8.0
"""Largest growth in MiB between the two: rows of the summary take 250 bytes, and the allocator some MiB."""

_TIME_LIMIT_S = 900.0
"""Time limit of a run, in seconds."""

_N_FRAMES = 20
"""Number of frames of the drive for determinism."""


def run_memory(folder: Path, seed: int, n_cases: int, n_jobs: int) -> Iterator[Case]:
    """Cases of runs of 3,000 small frames with recorded boxes: the growth of the resident memory."""
    for number in range(n_cases):
        place = folder / f"memory-{number}"
        drive = simulate(place / "drive", n_frames=40, options=("--seed", str(seed + number)))
        loop_video(drive / "left.mp4", place / "long.mp4", n_frames=_N_LONG)
        rows = [line.split(" ") for line in (drive / "detections.txt").read_text().splitlines()]
        with (place / "detections.txt").open("w", encoding="utf-8") as file:
            for first in range(0, _N_LONG, 40):
                file.writelines(" ".join([str(int(row[0]) + first), *row[1:]]) + "\n" for row in rows)
        command = (
            *("--mono", "long.mp4", "--focal-px", str(FOCAL_PX), "--detections", "detections.txt"),
            *("--lanes", "off", "--no-overlay", "--out", "out"),
        )
        child = start(command, place, time_limit_s=_TIME_LIMIT_S)
        first_mib, last_mib = _memory_at(child, place / "out/tracks.csv")
        end = child.wait()
        faults = list(problems(end)) + list(result_problems(place / "out"))
        if not first_mib or end.status:
            faults.append(f"no samples of the memory, or failed: {end.stderr[-200:]}")
        if last_mib - first_mib > _MAX_GROWTH_MIB:
            faults.append(f"memory grows from {first_mib:.0f} to {last_mib:.0f} MiB")
        print(f"Memory at frame {_FIRST_SAMPLE} and at the end: {first_mib:.1f} and {last_mib:.1f} MiB.")
        if not faults:
            shutil.rmtree(place)
        yield Case("memory", f"{_N_LONG} frames", f"run {number}", "accepted", tuple(faults), command, place, end)


def run_determinism(folder: Path, seed: int, n_cases: int, n_jobs: int) -> Iterator[Case]:
    """Cases of runs with the packaged detector on one and two threads, twice: the rows must be equal."""
    for number in range(n_cases):
        place = folder / f"equal-{number}"
        simulate(place / "drive", n_frames=_N_FRAMES, options=("--seed", str(seed + number)))
        contents: dict[str, tuple[bytes, ...]] = {}
        faults: list[str] = []
        for name, threads in (("a1", "1"), ("a2", "2"), ("b1", "1"), ("b2", "2")):
            command = (
                *("--stereo", "drive/left.mp4", "drive/right.mp4", "--rig", "drive/rig.yaml"),
                *("--no-overlay", "--threads", threads, "--out", name),
            )
            end = start(command, place, time_limit_s=_TIME_LIMIT_S).wait()
            faults += problems(end)
            if end.status:
                faults.append(f"run {name}: {end.stderr[-200:]}")
                break
            contents[name] = tuple((place / name / file).read_bytes() for file in ("tracks.csv", "mot.txt"))
        faults += [f"run {name} differs from run a1" for name, content in contents.items() if content != contents["a1"]]
        if not faults:
            shutil.rmtree(place)
        yield Case(
            "determinism", "--threads 1 and 2, twice", f"run {number}", "accepted", tuple(faults), command, place, end
        )


def _memory_at(child: Child, rows: Path) -> tuple[float, float]:
    """Resident memory in MiB after the first sample's frame, and the median of the last frames; 0 = not sampled."""
    first_mib, samples = 0.0, [0.0]
    while (frame := _last_frame(rows)) < _N_LONG - 100:
        time.sleep(0.05)
        if child.has_ended():
            break
        if frame >= _FIRST_SAMPLE:
            samples.append(child.resident_mib())
            first_mib = first_mib or samples[-1]
    return first_mib, sorted(samples[-10:])[len(samples[-10:]) // 2]


def _last_frame(rows: Path) -> int:
    """Number of the last frame in a file of rows; -1 = none."""
    try:
        with rows.open("rb") as file:
            file.seek(max(0, rows.stat().st_size - 600))
            complete = file.read().rpartition(b"\n")[0]
    except OSError:
        return -1
    text = complete.rpartition(b"\n")[2].split(b",")[0]
    return int(text) if text.isdigit() else -1
