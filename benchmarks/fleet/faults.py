"""Faults of a fleet: killed workers, a corrupt clip, and a killed driver, each against a run
without faults.
"""

from __future__ import annotations

import csv
import os
import random
import signal
import subprocess
import tempfile
import time
from argparse import Namespace
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import pyarrow as pa
from pyarrow import parquet

from benchmarks.fleet.throughput import worker_pids
from benchmarks.harness import PROGRAM, Figures, option, workload
from benchmarks.inputs.drives import REAL_DATA

PARTS = ("kills", "corrupt", "driver")

_SIMULATED = {
    "highway": 2,
    "town": 3,
    "city": 4,
    "cut-in": 5,
    "crossing": 6,
    "queue": 8,
    "night": 20,
}
"""Scenario and duration in seconds of the simulated clips."""

_REAL_PAIRS = ("kitti_stereo/0003", "kitti_stereo/0005")
_REAL_VIDEOS = (
    ("dashcam/solid_white_right.mp4", "750"),
    ("dashcam/highway_two_cars.mp4", "1150"),
    ("kitti_stereo/0003/left.mp4", "721.5"),
)
"""Real recordings of two cameras, and of one camera with a focal length in pixels."""

_COLUMNS = ("clip", "left", "right", "rig", "focal_px")


@workload(
    option("--data", default=REAL_DATA, help="folder of the real recordings"),
    option("--only", default=PARTS, choices=PARTS, help="parts"),
    option("--clips", default=100, help="clips"),
    option("--kills", default=20, help="workers that are killed"),
    option("--interval", default=8.0, help="mean time between them in seconds"),
    option("--seed", default=1, help="seed of the times and of the workers"),
)
def fleet_faults(options: Namespace) -> Figures:
    parts = {"kills": _kills, "corrupt": _corrupt, "driver": _driver}
    with tempfile.TemporaryDirectory() as folder:
        clips = _Clips(Path(folder), options.data)
        return {name: parts[name](clips, options) for name in options.only}


class _Clips:
    def __init__(self, folder: Path, data: Path) -> None:
        self.folder = folder
        self._distinct = [*_simulated(folder / "drives"), *_real(data.resolve())]
        manifest = self.manifest(len(self._distinct), "distinct")
        out = folder / "undisturbed"
        _fleet(manifest, out).wait()
        self._expected = [_table(out, _name(i)) for i in range(len(self._distinct))]

    def manifest(self, n_clips: int, name: str, corrupt: str | None = None) -> Path:
        """Manifest with `n_clips` names of the distinct clips in turn; the first video is `corrupt`
        if given.
        """
        path = self.folder / f"{name}.csv"
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(_COLUMNS)
            for i in range(n_clips):
                left, *others = self._distinct[i % len(self._distinct)]
                if corrupt is not None and i == n_clips // 2:
                    left, others = corrupt, ["", "", "700"]
                writer.writerow((_name(i), left, *others))
        return path

    def compared(self, out: Path, n_clips: int) -> dict[str, int]:
        """Numbers of complete, doubled, missing and differing results."""
        rows = parquet.read_table(out / "clips.parquet").to_pylist()
        done = {row["clip"] for row in rows if row["status"] == "done"}
        files = [path.parent.name for path in out.glob("tracks/*/*.parquet")]
        n_equal = 0
        for i in range(n_clips):
            expected = self._expected[i % len(self._expected)]
            n_equal += _name(i) in done and _table(out, _name(i)).equals(expected)
        return {
            "clips": n_clips,
            "done": len(done),
            "rows of clips.parquet": len(rows),
            "files of tracks": len(files),
            "equal to the undisturbed run": n_equal,
            "unfinished files left": len(
                [path for path in out.glob("unfinished/**/*") if path.is_file()]
            ),
        }


def _kills(clips: _Clips, options: Namespace) -> Figures:
    out = clips.folder / "kills"
    start_s = time.perf_counter()
    driver = _fleet(clips.manifest(options.clips, "kills"), out)
    generator, killed = random.Random(options.seed), list[int]()  # noqa: S311
    while len(killed) < options.kills and driver.returncode is None:
        with suppress(subprocess.TimeoutExpired):
            driver.wait(generator.expovariate(1 / options.interval))
        alive = [
            pid for pid in worker_pids(out) if pid not in killed and Path(f"/proc/{pid}").exists()
        ]
        if alive and driver.returncode is None:
            killed.append(generator.choice(alive))
            with suppress(ProcessLookupError):
                os.kill(killed[-1], signal.SIGKILL)
    status = driver.wait()
    attempts = parquet.read_table(out / "clips.parquet")["attempts"].to_pylist()
    return {
        "exit status": status,
        "kills": len(killed),
        **clips.compared(out, options.clips),
        "largest number of attempts": max(attempts),
        "duration, s": time.perf_counter() - start_s,
    }


def _corrupt(clips: _Clips, options: Namespace) -> Figures:
    damaged = clips.folder / "damaged.mp4"
    damaged.write_bytes(random.Random(options.seed).randbytes(100_000))  # noqa: S311
    out = clips.folder / "corrupt"
    status = _fleet(clips.manifest(options.clips, "corrupt", str(damaged)), out).wait()
    failed = [
        row
        for row in parquet.read_table(out / "clips.parquet").to_pylist()
        if row["status"] == "failed"
    ]
    return {
        "exit status": status,
        **clips.compared(out, options.clips),
        "failed": ", ".join(row["clip"] for row in failed),
        "error": "; ".join(row["error"] for row in failed).replace(str(clips.folder), "DIR"),
    }


def _driver(clips: _Clips, options: Namespace) -> Figures:
    out = clips.folder / "driver"
    manifest = clips.manifest(options.clips, "driver")
    driver = _fleet(manifest, out)
    while driver.poll() is None and len(_complete(out)) < options.clips // 3:
        time.sleep(0.2)
    driver.kill()
    driver.wait()
    time.sleep(1)  # workers end after their driver
    complete = _complete(out)
    status = _fleet(manifest, out).wait()
    after = _complete(out)
    return {
        "complete when killed": len(complete),
        "of them written again": sum(after[name] != written for name, written in complete.items()),
        "exit status of the second run": status,
        **clips.compared(out, options.clips),
    }


def _complete(out: Path) -> dict[str, int]:
    """Modification time of the results of clips with a record, ns."""
    recorded = {path.stem for path in out.glob("journal/*.json")}
    with suppress(OSError, pa.ArrowException):
        recorded |= set(
            parquet.read_table(out / "clips.parquet", columns=["clip"])["clip"].to_pylist()
        )
    times = dict[str, int]()
    for name in recorded:
        with suppress(OSError):
            times[name] = (out / "tracks" / f"clip={name}" / "tracks.parquet").stat().st_mtime_ns
    return times


def _fleet(manifest: Path, out: Path) -> subprocess.Popen[bytes]:
    command = [*PROGRAM, "fleet", "run", str(manifest), "--out", str(out)]
    command += ["--workers", "2", "--threads", "1"]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _name(index: int) -> str:
    return f"clip-{index:03}"


def _table(out: Path, clip: str) -> pa.Table:
    """Rows of a clip, without metadata."""
    file = out / "tracks" / f"clip={clip}" / "tracks.parquet"
    return parquet.ParquetFile(file).read().replace_schema_metadata()


def _simulated(folder: Path) -> list[tuple[str, ...]]:
    rows = list[tuple[str, ...]]()
    for seed, (scenario, seconds) in enumerate(_SIMULATED.items()):
        drive = folder / f"{scenario}-{seconds}"
        command = [*PROGRAM, "simulate", "--scenario", scenario, "--seed", str(seed)]
        command += ["--seconds", str(seconds), "--out", str(drive)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        rows.append(
            (str(drive / "left.mp4"), str(drive / "right.mp4"), str(drive / "rig.yaml"), "")
        )
    return rows


def _real(data: Path) -> Sequence[tuple[str, ...]]:
    pairs = [data / name for name in _REAL_PAIRS]
    videos = [(data / name, focal_px) for name, focal_px in _REAL_VIDEOS]
    if missing := [path for path in (*pairs, *(video for video, _ in videos)) if not path.exists()]:
        raise SystemExit(f"{missing[0]}: expected a recording; give its folder with --data")
    return [
        *(
            (str(pair / "left.mp4"), str(pair / "right.mp4"), str(pair / "calib.txt"), "")
            for pair in pairs
        ),
        *((str(video), "", "", focal_px) for video, focal_px in videos),
    ]
