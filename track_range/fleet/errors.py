"""Errors of a fleet."""

from __future__ import annotations

from typing import ClassVar

from track_range.foundation.errors import UserError


class FleetError(UserError):
    """The fleet cannot run, or cannot continue; complete results remain."""


class ClipsFailedError(UserError):
    """Some clips failed; the message names them."""

    exit_status: ClassVar[int] = 3
