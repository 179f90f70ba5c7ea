"""Runs on a disk that is full after a random number of bytes, and runs in which a random write fails."""

from __future__ import annotations

import errno
import os
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from random import Random

from benchmarks.torture.cases import Case, End, problems
from benchmarks.torture.processes import TIME_LIMIT_S, run
from benchmarks.torture.result_files import MAX_LAG_FRAMES, result_problems
from benchmarks.torture.seeds import FOCAL_PX, simulate

_N_FRAMES = 20
"""Number of frames of the drive."""

_SHIM = Path(__file__).with_name("failing_write.c")

_MAX_WRITES = 60
"""Largest number of the write that fails; a run has about as many."""

_RUN = (
    *("--mono", "drive/left.mp4", "--focal-px", str(FOCAL_PX), "--detections", "drive/detections.txt"),
    *("--lanes", "off", "--out", "out"),
)

_RESULTS = (
    "tracks.csv",
    "mot.txt",
    "tracks.parquet",
    "tracks.arrows",
    "overlay.mp4",
    "report.html",
    "summary.json",
    "settings.yaml",
)


def run_full_disks(folder: Path, seed: int, n_cases: int, n_jobs: int) -> Iterator[Case]:
    """Cases of runs with a limit on the size of files, or where possible on a small file system (every other case)."""
    simulate(folder / "drive", n_frames=_N_FRAMES)
    sizes = _result_sizes(folder)
    random = Random(seed)
    mounts = _can_mount()
    if not mounts:
        print("No small file systems: mounting in a private namespace requires root and `unshare`.")
    for number in range(n_cases):
        place = folder / f"disk-{number}"
        _prepare(folder, place)
        if mounts and number % 2:
            n_kib = random.randint(4, sum(sizes) // 1024 + 8)
            yield _case("full-disk", "small file system", f"{n_kib} KiB", place, _run_mounted(place, n_kib))
        else:
            n_bytes = random.randint(100, max(sizes))
            end = run(_RUN, place, prepare=partial(_limit_file_size, n_bytes))
            yield _case("full-disk", "file-size limit", f"{n_bytes} bytes", place, end)


def run_failing_writes(folder: Path, seed: int, n_cases: int, n_jobs: int) -> Iterator[Case]:
    """Cases of runs in which one write, or all from one on, fail with ENOSPC or EIO; none without a C compiler."""
    compiler = shutil.which("cc")
    if compiler is None or sys.platform != "linux":
        print("No failing writes: they require Linux and a C compiler, `cc`.")
        return
    library = folder / "failing_write.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", library, _SHIM, "-ldl"], check=True)
    simulate(folder / "drive", n_frames=_N_FRAMES)
    random = Random(seed)
    for number in range(n_cases):
        place = folder / f"write-{number}"
        _prepare(folder, place)
        code = random.choice((errno.ENOSPC, errno.EIO))
        environment = {
            "LD_PRELOAD": str(library),
            "TORTURE_FOLDER": str(place / "out"),
            "TORTURE_WRITE": str(random.randint(1, _MAX_WRITES)),
            "TORTURE_ERROR": str(code),
        }
        if is_lasting := random.random() < 0.5:
            environment["TORTURE_FOREVER"] = "1"
        kind = f"{errno.errorcode[code]}, {'lasting' if is_lasting else 'once'}"
        end = _run_program([*_program(), *_RUN], place, environment)
        yield _case("failing-writes", kind, f"write {environment['TORTURE_WRITE']}", place, end)


def _case(part: str, kind: str, name: str, place: Path, end: End) -> Case:
    """The finished case; its files are removed if there is no problem."""
    faults = list(problems(end, names=_RESULTS))
    out = place / "out"
    if out.exists():
        faults += result_problems(out, has_overlay=True, max_lag=MAX_LAG_FRAMES)
    if not end.status and not (out / "summary.json").exists():
        faults.append("success without summary.json")
    if not faults:
        shutil.rmtree(place)
    return Case(part, kind, name, "refused" if end.status else "accepted", tuple(faults), _RUN, place, end)


def _prepare(folder: Path, place: Path) -> None:
    place.mkdir()
    (place / "drive").symlink_to(folder / "drive")


def _result_sizes(folder: Path) -> list[int]:
    """Sizes in bytes of the files of a complete run."""
    end = run(_RUN, folder)
    if end.status:
        raise RuntimeError(end.stderr)
    return [file.stat().st_size for file in (folder / "out").iterdir()]


def _limit_file_size(n_bytes: int) -> None:
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, n_bytes))


def _can_mount() -> bool:
    """Whether a small file system can be mounted in a private namespace."""
    if shutil.which("unshare") is None or shutil.which("mount") is None:
        return False
    command = ["unshare", "-m", "sh", "-c", "mount -t tmpfs -o size=64k none /mnt"]
    return subprocess.run(command, capture_output=True).returncode == 0


def _run_mounted(place: Path, n_kib: int) -> End:
    """The run in a private namespace, into a file system in memory; its files are copied out at the end."""
    script = (
        f"mkdir out && mount -t tmpfs -o size={n_kib}k none out || exit 99; "
        '"$@"; status=$?; cp -a out copy; umount out; rmdir out; mv copy out; exit $status'
    )
    return _run_program(["unshare", "-m", "sh", "-c", script, "sh", *_program(), *_RUN], place, {})


def _program() -> list[str]:
    """Start of a command of track-range in a separate process."""
    return [sys.executable, "-m", "track_range"]


def _run_program(command: list[str], place: Path, environment: dict[str, str]) -> End:
    """A command in a separate process."""
    limit_s = 4 * TIME_LIMIT_S  # including the start of Python
    try:
        done = subprocess.run(
            command, cwd=place, env={**os.environ, "COLUMNS": "200", **environment}, capture_output=True, text=True,
            timeout=limit_s, stdin=subprocess.DEVNULL,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return End(-signal.SIGALRM)
    return End(done.returncode, done.stdout, done.stderr)
