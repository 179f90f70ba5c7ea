"""Base classes of all errors that a user's input can cause.

The command line prints such an error as one sentence and exits with its status; any other exception
is a defect of the program and keeps its traceback.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, ClassVar, Literal, Self


class UserError(Exception):
    """An unusable input or output; the message names it, what was expected, and what to do."""

    exit_status: ClassVar[int] = 1


class ConfigError(UserError):
    """An invalid setting; the message names it."""


class UsageError(ConfigError):
    """Options that contradict each other or are out of range: wrong usage, not an unusable
    input.
    """

    exit_status: ClassVar[int] = 2


class RunStoppedError(UserError):
    """The user stopped a run early with Ctrl-C or SIGTERM; the results of the finished frames are
    kept.
    """


@contextmanager
def named_errors(module: str, name: str, kind: type[UserError]) -> Iterator[None]:
    """Context that turns exceptions of a user's code in `module` into `kind`, with its name, the
    cause and the line.

    UserErrors, and all exceptions of our own modules, are raised as they are.
    """
    try:
        yield
    except Exception as error:
        if isinstance(error, UserError) or module.startswith("track_range."):
            raise
        lines = [
            f" (line {line} of {frame.f_code.co_filename.rpartition('/')[2]})"
            for frame, line in traceback.walk_tb(error.__traceback__)
            if frame.f_globals.get("__name__") == module
        ]
        cause = f"{type(error).__name__}: {str(error).rstrip('.')}".removesuffix(": ")
        raise kind(f"{name}: {cause}{lines[-1] if lines else ''}.") from error


def call_all(steps: Iterable[Callable[[], object]]) -> None:
    """Call functions in order, even after a UserError; the first such error is raised at the
    end.
    """
    errors = []
    for step in steps:
        try:
            step()
        except UserError as error:
            errors.append(error)
    if errors:
        raise errors[0]


Severity = Literal["ok", "warning", "error"]
"""Of a note: works as it should; works with larger errors or gaps; does not work."""


class Note(str):
    """A sentence for the user with a code for programs; as a text it is the sentence alone.

    Attributes:
        code: name of what it says, such as "right-camera-moved"; the sentence may change, the code
            does not.
        severity: "ok", "warning" or "error".
        sensor: what it is about: "left", "right", "pair", "speed", "detector", "calibration",
            "methods" or "pipeline".
    """

    __slots__ = ("code", "sensor", "severity")
    code: str
    severity: Severity
    sensor: str

    def __new__(
        cls,
        sentence: str,
        code: str = "note",
        severity: Severity = "ok",
        sensor: str = "pipeline",
    ) -> Self:
        """A sentence with its code."""
        note = super().__new__(cls, sentence)
        note.code, note.severity, note.sensor = code, severity, sensor
        return note

    def format(self, *values: object, **named: object) -> Note:
        """The sentence with values, and with the same code."""
        return self.said(str.format(self, *values, **named))

    def said(self, sentence: str) -> Note:
        """Another sentence with the same code."""
        return Note(sentence, self.code, self.severity, self.sensor)

    def __reduce__(self) -> tuple[Any, ...]:
        return Note, (str(self), self.code, self.severity, self.sensor)
