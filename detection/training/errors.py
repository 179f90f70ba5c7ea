"""Exceptions of training, in a module that can be imported without PyTorch."""

from __future__ import annotations

from track_range.foundation.errors import UserError


class TrainingError(UserError):
    """Training cannot start or continue; the message gives the reason and what to do."""


class CheckpointError(TrainingError):
    """A checkpoint cannot be read, used or written; the message gives the reason and what to do."""
