"""Runs that are killed at random times, and two runs into one folder at the same time."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from random import Random

from benchmarks.torture.cases import Case, End, outcome, problems
from benchmarks.torture.processes import Child, run, start
from benchmarks.torture.result_files import MAX_LAG_FRAMES, result_problems
from benchmarks.torture.seeds import FOCAL_PX, simulate

_N_FRAMES = 60
"""Number of frames of the drive: some seconds of work."""

_GRACE_S = 0.5
"""Time after the creation of the folder until settings.yaml must exist, in seconds, on a busy machine."""

_TIME_LIMIT_S = 120.0
"""Time limit of a run, in seconds."""

_POLL_S = 0.005
"""Interval in s at which a run is watched."""

_MONO = (
    *("--mono", "drive/left.mp4", "--focal-px", str(FOCAL_PX), "--detections", "drive/detections.txt"),
    *("--out", "out"),
)
_STEREO = (
    *("--stereo", "drive/left.mp4", "drive/right.mp4", "--rig", "drive/rig.yaml"),
    *("--detections", "drive/detections.txt", "--no-sgbm", "--out", "out"),
)
_COMMANDS = {"mono": _MONO, "stereo, alignment from the drive": _STEREO}


def run_kills(folder: Path, seed: int, n_cases: int, n_jobs: int) -> Iterator[Case]:
    """Cases of runs that are killed at random times after their folder exists."""
    simulate(folder / "drive", n_frames=_N_FRAMES)
    random = Random(seed)
    duration_s = {kind: _uninterrupted_s(command, folder) for kind, command in _COMMANDS.items()}
    for number in range(n_cases):
        kind = random.choice(list(_COMMANDS))
        yield _killed(folder / f"kill-{number}", kind, random.uniform(0, duration_s[kind]))


def run_locks(folder: Path, seed: int, n_cases: int, n_jobs: int) -> Iterator[Case]:
    """Cases of two runs into one folder: the second is refused, and the first ends as usual."""
    simulate(folder / "drive", n_frames=_N_FRAMES)
    random = Random(seed)
    for number in range(n_cases):
        place = _copy(folder, folder / f"lock-{number}")
        children = [start(_MONO, place, time_limit_s=_TIME_LIMIT_S)]
        if number % 2:  # half of the pairs start at the same moment
            _wait_for_folder(children[0], place)
            time.sleep(random.uniform(0, 0.5))
        children.append(start(_MONO, place, time_limit_s=_TIME_LIMIT_S))
        ends = sorted((child.wait() for child in children), key=lambda end: end.status)
        faults = list(problems(ends[1], names=("out",)))
        if [end.status for end in ends] != [0, 1]:
            faults.append(f"exit status {ends[0].status} and {ends[1].status}: {ends[0].stderr[-200:]}")
        faults += result_problems(place / "out", has_overlay=True)
        yield _finished(Case("locks", "two runs", f"pair {number}", "refused", tuple(faults), _MONO, place, ends[1]))


def _uninterrupted_s(command: tuple[str, ...], folder: Path) -> float:
    """Time in s from the creation of the folder of the results to the end of the run."""
    child = start(command, folder, time_limit_s=_TIME_LIMIT_S)
    _wait_for_folder(child, folder)
    started_s = time.monotonic()
    end = child.wait()
    if end.status:
        raise RuntimeError(f"track-range {' '.join(command)}: {end.stderr[-500:]}")
    return time.monotonic() - started_s


def _wait_for_folder(child: Child, folder: Path) -> None:
    while not (folder / "out").exists() and time.monotonic() < child.started_s + _TIME_LIMIT_S:
        time.sleep(_POLL_S)


def _killed(place: Path, kind: str, delay_s: float) -> Case:
    """A run that is killed some time after its folder exists, and the commands after it."""
    _copy(place.parent, place)
    command, out = _COMMANDS[kind], place / "out"
    child = start(command, place, time_limit_s=_TIME_LIMIT_S)
    _wait_for_folder(child, place)
    time.sleep(delay_s)
    killed = child.kill()
    faults = list(result_problems(out, has_overlay=True, max_lag=MAX_LAG_FRAMES))
    if delay_s > _GRACE_S and not (out / "settings.yaml").exists():
        faults.append("no settings.yaml")
    n_rows = len((out / "tracks.csv").read_text(encoding="utf-8").splitlines()) if (out / "tracks.csv").exists() else 0
    faults += _problems_after("report", ("report", "out"), place, must_succeed=n_rows > 1)
    faults += _problems_after("next run", (*_MONO, "--no-overlay", "--lanes", "off"), place, must_succeed=True)
    name = f"after {delay_s:.2f} s, {n_rows} rows"
    end = End(0 if killed.status == -9 else killed.status, killed.stdout, killed.stderr, killed.wall_s)
    return _finished(Case("kills", kind, name, "accepted", tuple(faults), command, place, end))


def _problems_after(name: str, command: tuple[str, ...], place: Path, *, must_succeed: bool) -> list[str]:
    """What is wrong with a command on the folder of a killed run."""
    end = run(command, place)
    faults = [f"{name}: {problem}" for problem in problems(end)]
    if must_succeed and outcome(end) == "refused":
        faults.append(f"{name}: {end.stderr[:300]}")
    return faults


def _copy(drive_folder: Path, place: Path) -> Path:
    """A new folder with a link to the drive."""
    place.mkdir()
    (place / "drive").symlink_to(drive_folder / "drive")
    return place


def _finished(case: Case) -> Case:
    """The case; its files are removed if it has no problem."""
    if not case.problems and case.folder:
        shutil.rmtree(case.folder)
    return case
