"""Base classes of all errors that a user's input can cause.

The command line prints such an error as one sentence and exits with its status; any other exception is a defect of the
program and keeps its traceback.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import ClassVar


class UserError(Exception):
    """An unusable input or output; the message names it, what was expected, and what to do."""

    exit_status: ClassVar[int] = 1


class ConfigError(UserError):
    """An invalid setting; the message names it."""


class UsageError(ConfigError):
    """Options that contradict each other or are out of range: wrong usage, not an unusable input."""

    exit_status: ClassVar[int] = 2


class RunStoppedError(UserError):
    """The user stopped a run early with Ctrl-C or SIGTERM; the results of the finished frames are kept."""


def call_all(steps: Iterable[Callable[[], object]]) -> None:
    """Call functions in order, even after a UserError; the first such error is raised at the end."""
    errors = []
    for step in steps:
        try:
            step()
        except UserError as error:
            errors.append(error)
    if errors:
        raise errors[0]
