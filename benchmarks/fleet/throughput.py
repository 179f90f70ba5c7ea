"""Fleet: throughput, overhead and memory of its workers, control path with a stub, and the cost of
1,000 hours.
"""

from __future__ import annotations

import csv
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from argparse import Namespace
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from benchmarks.fleet import costs
from benchmarks.harness import PROGRAM, ROOT, Figures, option, workload
from benchmarks.inputs.drives import DRIVE_OPTIONS, LoopedDrive, looped
from track_range.fleet.output.state import read_state
from track_range.fleet.storage.location import Location

# parts by default; `gpu` is another one
PARTS = ("throughput", "cores", "mono", "memory", "driver")
_POLL_S = 0.5  # time between two looks at fleet.json for processes to pin, s


@workload(
    *DRIVE_OPTIONS,
    option("--only", default=PARTS, choices=(*PARTS, "gpu"), help="parts"),
    option("--clips", default=12, help="clips of the throughput"),
    option("--frames", default=96, help="frames of each of them"),
    option("--memory-clips", default=100, help="clips of the memory"),
    option("--rows", default=100_000, help="rows of the manifest"),
    option("--gpu-workers", default=4, help="workers that share the GPU"),
    option("--docs", type=Path, metavar="FILE.md", help="page whose tables of costs are replaced"),
)
def fleet(options: Namespace) -> Figures:
    parts = {
        "throughput": _throughput,
        "cores": _cores,
        "mono": _mono,
        "memory": _memory,
        "driver": _driver,
        "gpu": _gpu,
    }
    figures: Figures = {}
    for name in options.only:
        with tempfile.TemporaryDirectory() as folder:
            figures[name] = parts[name](options, Path(folder))
    inputs = costs.measured(list(figures.values()))
    if options.docs is not None:
        known = costs.inputs_in(options.docs.read_text(encoding="utf-8"))
        costs.replace_tables(options.docs, {**known, **inputs})
    elif costs.is_complete(inputs):
        print(costs.cost_tables(inputs))
    return figures


@dataclass(frozen=True, slots=True)
class _FleetRun:
    """Start and duration of a run of a fleet, and its records in the order of their ends, `end_s`;
    Unix times.
    """

    start_s: float
    wall_s: float
    rows: Sequence[Figures]

    def frames_per_s(self, n_workers: int) -> float:
        """Rate between the first end of all workers and the last of all, in which each of them was
        busy.
        """
        first, last = n_workers - 1, len(self.rows) - n_workers
        n_frames = sum(row["frames"] for row in self.rows[first + 1 : last + 1])
        return float(n_frames / (self.rows[last]["end_s"] - self.rows[first]["end_s"]))


def _throughput(options: Namespace, folder: Path) -> Figures:
    drive = looped(options.drive, folder, n_frames=options.frames)
    manifest = _manifest(folder, drive, options.clips)
    arguments = ["--detector", str(options.detector), "--no-sgbm"]
    one = _run_fleet(manifest, folder / "one", 1, arguments, pinned_core=0)
    two = _run_fleet(manifest, folder / "two", 2, arguments)
    start_s = time.perf_counter()
    for i in range(options.clips):  # ordinary runs, each in its own process with all cores
        subprocess.run(
            _run_command(drive, folder / "loop" / str(i), arguments),
            check=True,
            stdout=subprocess.DEVNULL,
        )
    loop_s = time.perf_counter() - start_s
    n_frames = sum(row["frames"] for row in one.rows)
    one_fps, two_fps = one.frames_per_s(1), two.frames_per_s(2)
    warm = one.rows[1:]
    between_ends_s = (one.rows[-1]["end_s"] - one.rows[0]["end_s"]) / len(warm)
    run_s = statistics.mean(row["wall_s"] - row["overhead_s"] for row in warm)
    return {
        "clips": options.clips,
        "frames": n_frames,
        "one_pinned_fps": one_fps,
        "two_fps": two_fps,
        "two_to_one": two_fps / one_fps,
        "loop_fps": n_frames / loop_s,
        "two_to_loop": two_fps / (n_frames / loop_s),
        "one_wall_s": one.wall_s,
        "two_wall_s": two.wall_s,
        "loop_wall_s": loop_s,
        "stereo_ms": 1000 * run_s * len(warm) / sum(row["frames"] for row in warm),
        "overhead_s": between_ends_s - run_s,
        "start_s": one.rows[0]["end_s"] - one.rows[0]["wall_s"] - one.start_s,
        "stereo_mb_per_s": _mb_per_s([drive.left, drive.right], one.rows[0]["seconds"]),
    }


def _cores(options: Namespace, folder: Path) -> Figures:
    """Rate of runs without a fleet on both cores, relative to one core; cores share caches, memory
    and clock.
    """
    drive = looped(options.drive, folder, n_frames=options.frames)
    arguments = ["--detector", str(options.detector), "--no-sgbm", "--threads", "1"]
    one_s: list[float] = []
    two_s: list[float] = []
    for i in range(max(3, options.clips // 4)):  # alternating, since the speed of machines changes
        for cores, durations_s in (((0,), one_s), ((0, 1), two_s)):
            start_s = time.perf_counter()
            runs = [
                subprocess.Popen(
                    _run_command(drive, folder / f"{i}-{len(cores)}-{core}", arguments),
                    stdout=subprocess.DEVNULL,
                    preexec_fn=partial(os.sched_setaffinity, 0, {core}),
                )
                for core in cores
            ]
            statuses = [run.wait() for run in runs]
            if any(statuses):
                raise RuntimeError("a run failed; its message is above.")
            durations_s.append(time.perf_counter() - start_s)
    return {
        "runs": len(one_s),
        "two_to_one": 2 * statistics.median(one_s) / statistics.median(two_s),
    }


def _mono(options: Namespace, folder: Path) -> Figures:
    drive = looped(options.drive, folder, n_frames=options.frames)
    manifest = _manifest(folder, drive, max(3, options.clips // 3), is_mono=True)
    run = _run_fleet(
        manifest, folder / "out", 1, ["--detector", str(options.detector)], pinned_core=0
    )
    warm = run.rows[1:]
    run_s = sum(row["wall_s"] - row["overhead_s"] for row in warm)
    return {
        "mono_ms": 1000 * run_s / sum(row["frames"] for row in warm),
        "mono_mb_per_s": _mb_per_s([drive.left], run.rows[0]["seconds"]),
    }


def _gpu(options: Namespace, folder: Path) -> Figures:
    drive = looped(options.drive, folder, n_frames=options.frames)
    n_workers = options.gpu_workers
    manifest = _manifest(folder, drive, max(options.clips, 3 * n_workers), is_mono=True)
    arguments = [
        "--detector",
        str(options.detector),
        "--device",
        "cuda",
        "--gpus-per-worker",
        f"{1 / n_workers:.4f}",
    ]
    run = _run_fleet(manifest, folder / "out", n_workers, arguments)
    return {"gpu_workers": n_workers, "gpu_mono_ms": 1000 / run.frames_per_s(n_workers)}


def _memory(options: Namespace, folder: Path) -> Figures:
    drive = looped(options.drive, folder, n_frames=16)
    manifest = _manifest(folder, drive, options.memory_clips)
    run = _run_fleet(
        manifest, folder / "out", 1, ["--detector", str(options.detector), "--no-sgbm"]
    )
    peaks_mb = [row["peak_memory_mb"] for row in run.rows]
    size = len(peaks_mb) // 4
    quarters = {
        f"quarter_{q + 1}_mb": statistics.median(peaks_mb[q * size : (q + 1) * size])
        for q in range(4)
    }
    return {"clips": len(peaks_mb), **quarters, "max_mb": max(peaks_mb)}


def _driver(options: Namespace, folder: Path) -> Figures:
    video = folder / "clip.mp4"
    video.write_bytes(b"not a video")
    manifest = folder / "clips.csv"
    with manifest.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("clip", "left", "vehicle"))
        writer.writerows((f"clip-{i:06}", video.name, f"van-{i % 40}") for i in range(options.rows))
    command = [sys.executable, "-m", "benchmarks.fleet.stub", str(manifest), str(folder / "out")]
    runs = []
    for _ in range(2):
        done = subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True)
        runs.append(json.loads(done.stdout.splitlines()[-1]))
    first, second = runs
    return {
        **first,
        "driver_clips_per_s": (first["clips"] - 1) / first["work_s"],
        "second_wall_s": second["wall_s"],
        "second_skipped": second["skipped"],
        "second_peak_mb": second["driver_peak_mb"],
    }


def _manifest(folder: Path, drive: LoopedDrive, n_clips: int, *, is_mono: bool = False) -> Path:
    """Manifest of a drive under several names (hard links)."""
    path = folder / "clips.csv"
    rows = []
    for i in range(n_clips):
        files = [folder / f"{i:03}_{video.name}" for video in (drive.left, drive.right)]
        for file, video in zip(files, (drive.left, drive.right), strict=True):
            file.unlink(missing_ok=True)
            os.link(video, file)
        rows.append((f"clip-{i:03}", files[0], "" if is_mono else files[1], drive.rig))
    with path.open("w", encoding="utf-8", newline="") as table:
        csv.writer(table).writerows([("clip", "left", "right", "rig"), *rows])
    return path


def _run_fleet(
    manifest: Path,
    out: Path,
    n_workers: int,
    arguments: Sequence[str],
    pinned_core: int | None = None,
) -> _FleetRun:
    """Run a fleet; its workers are pinned to a core as soon as they appear, None = they run on
    all.
    """
    from pyarrow import parquet

    command = [*PROGRAM, "fleet", "run", str(manifest), "--out", str(out)]
    command += ["--workers", str(n_workers), "--threads", "1", *arguments]
    cores = set() if pinned_core is None else {pinned_core}
    start_s = time.time()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    while process.returncode is None:
        with suppress(subprocess.TimeoutExpired):
            process.wait(_POLL_S)
        for pid in worker_pids(out) if cores else ():
            for thread in Path(f"/proc/{pid}/task").glob("*"):
                with suppress(OSError):
                    os.sched_setaffinity(int(thread.name), cores)
    wall_s = time.time() - start_s
    if process.returncode:
        raise RuntimeError("the fleet failed; its message is above.")
    rows: list[Figures] = parquet.read_table(out / "clips.parquet").to_pylist()
    for row in rows:
        row["end_s"] = (out / "tracks" / f"clip={row['clip']}" / "tracks.parquet").stat().st_mtime
    return _FleetRun(start_s, wall_s, sorted(rows, key=lambda row: row["end_s"]))


def worker_pids(out: Path) -> tuple[int, ...]:
    """Processes of the workers of a fleet, from fleet.json, which is up to 5 s old."""
    state = read_state(Location.of(str(out)))
    return (
        ()
        if state is None
        else tuple(worker["pid"] for worker in state.workers if worker.get("pid"))
    )


def _run_command(drive: LoopedDrive, out: Path, arguments: Sequence[str]) -> list[str]:
    command = [*PROGRAM, "--stereo", str(drive.left), str(drive.right)]
    return [
        *command,
        "--rig",
        str(drive.rig),
        "--out",
        str(out),
        "--no-overlay",
        "--write",
        "parquet",
        *arguments,
    ]


def _mb_per_s(videos: Sequence[Path], duration_s: float) -> float:
    return sum(video.stat().st_size for video in videos) / 1e6 / duration_s
