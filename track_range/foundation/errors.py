"""The base of all errors that a user's input can cause.

The command line prints such an error as one sentence and ends with its exit status; any other exception is a defect of
the program and keeps its traceback.
"""

from __future__ import annotations

from typing import ClassVar


class UserError(Exception):
    """An input or output that cannot be used; the message names it, what was expected, and what to do."""

    exit_status: ClassVar[int] = 1


class ConfigError(UserError):
    """Settings that cannot be used; the message names the setting."""


class UsageError(ConfigError):
    """Options that contradict each other or are out of range: wrong usage, not a wrong input."""

    exit_status: ClassVar[int] = 2


class RunStoppedError(UserError):
    """The user ended a run early, by Ctrl-C or SIGTERM; the results of the finished frames are kept."""
