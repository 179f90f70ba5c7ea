"""A case of a robustness test: a command, its end, and what is wrong with that end and with the
result files."""

from __future__ import annotations

import re
import shlex
import shutil
from dataclasses import dataclass, field
from pathlib import Path

import av

from tests.torture.processes import End

MAX_MESSAGE = 300  # characters of an error message, without paths
MAX_GROWTH_MIB = 1500.0  # of a command on small inputs
MAX_LAG_FRAMES = 5  # by which the overlay may lag behind the rows after a kill
FRAMES_BEFORE_PLAYABLE = 10  # a second of video, after which the overlay must be playable
PREFIX = "track-range: "
NATIVE = (
    "libpng ",
    "Corrupt JPEG data",
    "Premature end of JPEG",
    "Invalid SOS",
    "Unsupported marker",
)
"""Starts of lines that image libraries print themselves."""
USAGE = 2  # exit status
MOT_COLUMNS = 10


@dataclass(frozen=True, slots=True)
class Case:
    """A finished case; `kind` is its row of the table, and `folder` the working folder of the
    command."""

    part: str
    kind: str
    name: str
    outcome: str  # accepted, noted or refused
    problems: tuple[str, ...] = ()
    command: tuple[str, ...] = ()
    folder: Path | None = None
    end: End = field(default_factory=lambda: End(0))

    def describe(self) -> str:
        """The problems and the command that reproduces them, on several lines."""
        place = f"cd {self.folder} && " if self.folder else ""
        lines = [f"{self.kind}: {self.name}", *(f"  {problem}" for problem in self.problems)]
        return "\n".join([*lines, f"  {place}track-range {shlex.join(self.command)}"])


def finished(case: Case) -> Case:
    """The case; its folder is removed if it has no problem."""
    if case.folder and not case.problems:
        shutil.rmtree(case.folder)
    return case


def outcome(end: End, *, usual_notes: frozenset[str] = frozenset()) -> str:
    """Whether a command has refused its input, has noted something unusual, or has accepted it."""
    if end.status:
        return "refused"
    return "noted" if notes(end) - usual_notes else "accepted"


def notes(end: End) -> frozenset[str]:
    return frozenset(line for line in end.stdout.splitlines() if line.startswith("- "))


def problems(end: End, *, names: tuple[str, ...] = ()) -> tuple[str, ...]:
    """What is wrong with the end of a command, whose error message must contain one of the names,
    if any."""
    faults = []
    error_lines = [
        line for line in end.stderr.splitlines() if line.strip() and not line.startswith(NATIVE)
    ]
    if "Traceback" in end.stderr + end.stdout:
        faults.append(f"traceback: {_last_line(end.stderr)}")
    elif end.status < 0:
        faults.append("hang" if -end.status in (9, 14) else f"killed by signal {-end.status}")
    elif end.status > USAGE:
        faults.append(f"exit status {end.status}")
    elif end.status:
        faults += _message_problems(end, error_lines, names)
    elif error_lines:
        faults.append(f"success with errors: {error_lines[-1][:200]}")
    if end.growth_mib > MAX_GROWTH_MIB:
        faults.append(f"memory: {end.growth_mib:.0f} MiB")
    return tuple(faults)


def _message_problems(end: End, lines: list[str], names: tuple[str, ...]) -> list[str]:
    messages = [line for line in lines if line.startswith(PREFIX)]
    # in a frame, as the command-line library prints it
    if end.status == USAGE and lines and not messages:
        messages = lines = [" ".join(lines)]
    if not messages:
        return [f"no message: {_last_line(end.stderr)}"]
    faults = []
    message = messages[-1].removeprefix(PREFIX)
    if len(lines) > 1:
        faults.append(f"more than one line: {lines[0][:200]}")
    if len(re.sub(r"\S*/\S*", "", message)) > MAX_MESSAGE:
        faults.append(f"a message of {len(message)} characters: {message[:100]}...")
    if names and not any(name in message for name in names):
        faults.append(f"the file is not named: {message[:200]}")
    return faults


def _last_line(text: str) -> str:
    lines = [line for line in text.splitlines() if line.strip() and "please report" not in line]
    return lines[-1][:200] if lines else "no output"


def result_problems(
    folder: Path, *, has_overlay: bool = False, max_lag: int = 0
) -> tuple[str, ...]:
    """What is wrong with the result files of a run that may have ended early.

    Args:
        folder: folder of the run.
        has_overlay: whether overlay.mp4 is checked.
        max_lag: largest number of frames that overlay.mp4 may lack.
    """
    faults: list[str] = []
    frames = _frames(folder / "tracks.csv", faults, offset=0)
    mot_frames = _frames(folder / "mot.txt", faults, offset=1)
    if frames is not None and mot_frames is not None:
        last_row, last_mot = max(frames, default=0), max(mot_frames, default=0)
        if abs(last_row - last_mot) > 1 or {
            f for f in frames ^ mot_frames if f < min(last_row, last_mot)
        }:
            faults.append(f"frames of tracks.csv to {last_row}, of mot.txt to {last_mot}")
    if has_overlay and frames:
        n_shown, error = _decodable_frames(folder / "overlay.mp4")
        n_rows = max(frames) + 1
        if error and n_rows > FRAMES_BEFORE_PLAYABLE:
            faults.append(f"overlay.mp4 is not playable: {error}")
        elif n_rows - n_shown > (FRAMES_BEFORE_PLAYABLE if error else max_lag):
            faults.append(f"overlay.mp4 has {n_shown} frames, tracks.csv {n_rows}")
    return tuple(faults)


def _decodable_frames(video: Path) -> tuple[int, str]:
    """Number of frames of a video that can be decoded, and the error that ends it, if any."""
    n_frames = 0
    try:
        with av.open(str(video)) as reader:
            for _ in reader.decode(video=0):
                n_frames += 1
    except (av.FFmpegError, OSError, IndexError) as error:
        return n_frames, f"{type(error).__name__} after {n_frames} frames"
    return n_frames, ""


def _frames(path: Path, faults: list[str], *, offset: int) -> set[int] | None:
    """Numbers of the frames in a file of rows; None if there is no such file or it is damaged,
    which is recorded."""
    if not path.exists():
        return None
    text = path.read_text(encoding="utf-8")
    if text and not text.endswith("\n"):
        faults.append(f"{path.name} ends inside a row: {text.splitlines()[-1][:80]!r}")
        return None
    rows = [line.split(",") for line in text.splitlines()]
    n_columns = MOT_COLUMNS if offset else len(rows[0]) if rows else 0
    if cut := [row for row in rows if len(row) != n_columns]:
        faults.append(f"{path.name} has a cut row: {','.join(cut[0])[:80]!r}")
        return None
    return {int(row[0]) - offset for row in rows if row[0].isdigit()}
