"""A case of a robustness test: a command, its end, and what is wrong with that end."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass, field
from pathlib import Path

MAX_MESSAGE = 300
"""Largest number of characters of an error message, without paths."""

MAX_GROWTH_MIB = 1500.0
"""Largest growth of the memory of a command on small inputs, MiB."""

_NOTE = "- "
"""Start of a note in the output of a run."""

_PREFIX = "track-range: "
"""Start of an error message."""

_NATIVE = ("libpng ", "Corrupt JPEG data", "Premature end of JPEG", "Invalid SOS", "Unsupported marker")
"""Starts of lines that image libraries print themselves."""

_USAGE = 2
"""Exit status of wrong usage."""


@dataclass(frozen=True, slots=True)
class End:
    """End of a process.

    Attributes:
        status: exit status; negative = number of the signal that killed it.
        stdout: printed text.
        stderr: printed errors.
        wall_s: duration in seconds.
        growth_mib: peak memory above that at the start, MiB.
    """

    status: int
    stdout: str = ""
    stderr: str = ""
    wall_s: float = 0.0
    growth_mib: float = 0.0


@dataclass(frozen=True, slots=True)
class Case:
    """A finished case.

    Attributes:
        part: part of the benchmark, such as `mutants`.
        kind: row of the table, such as the kind of the input.
        name: short description, such as the file and its mutation.
        outcome: accepted, noted or refused.
        problems: what is wrong; empty = nothing.
        command: arguments of `track-range`.
        folder: working folder of the command.
        end: end of the command.
    """

    part: str
    kind: str
    name: str
    outcome: str
    problems: tuple[str, ...] = ()
    command: tuple[str, ...] = ()
    folder: Path | None = None
    end: End = field(default_factory=lambda: End(0))

    def describe(self) -> str:
        """The problems and the command that reproduces them, on several lines."""
        place = f"cd {self.folder} && " if self.folder else ""
        lines = [f"{self.kind}: {self.name}", *(f"  {problem}" for problem in self.problems)]
        if self.command:
            lines.append(f"  {place}track-range {shlex.join(self.command)}")
        return "\n".join(lines)


def outcome(end: End, *, usual_notes: frozenset[str] = frozenset()) -> str:
    """Whether a command has refused its input, has noted something unusual, or has accepted it."""
    if end.status:
        return "refused"
    return "noted" if notes(end) - usual_notes else "accepted"


def notes(end: End) -> frozenset[str]:
    """The notes that a command has printed."""
    return frozenset(line for line in end.stdout.splitlines() if line.startswith(_NOTE))


def problems(end: End, *, names: tuple[str, ...] = ()) -> tuple[str, ...]:
    """What is wrong with the end of a command.

    Args:
        end: the end.
        names: file names of which an error message must contain at least one; empty = any message.
    """
    faults = []
    if "Traceback" in end.stderr + end.stdout:
        faults.append(f"traceback: {_last_line(end.stderr)}")
    elif end.status < 0:
        faults.append("hang" if -end.status in (9, 14) else f"killed by signal {-end.status}")
    elif end.status > _USAGE:
        faults.append(f"exit status {end.status}")
    elif end.status:
        faults += _message_problems(end, names)
    elif lines := _error_lines(end):
        faults.append(f"success with errors: {lines[-1][:200]}")
    if end.growth_mib > MAX_GROWTH_MIB:
        faults.append(f"memory: {end.growth_mib:.0f} MiB")
    return tuple(faults)


def _error_lines(end: End) -> list[str]:
    """Lines of stderr, without those of image libraries."""
    return [line for line in end.stderr.splitlines() if line.strip() and not line.startswith(_NATIVE)]


def _message_problems(end: End, names: tuple[str, ...]) -> list[str]:
    lines = _error_lines(end)
    messages = [line for line in lines if line.startswith(_PREFIX)]
    if end.status == _USAGE and lines and not messages:  # in a frame, as the command-line library prints it
        messages = lines = [" ".join(lines)]
    if not messages:
        return [f"no message: {_last_line(end.stderr)}"]
    faults = []
    message = messages[-1].removeprefix(_PREFIX)
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
