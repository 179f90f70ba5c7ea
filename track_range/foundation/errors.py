"""Base classes of all errors that a user's input can cause.

The command line prints such an error as one sentence and exits with its status; any other exception
is a defect of the program and keeps its traceback.
"""

import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import ClassVar


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
