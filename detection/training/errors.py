"""What can go wrong in training; kept apart so that it can be named where PyTorch is not installed."""

from __future__ import annotations

from track_range.foundation.errors import UserError


class TrainingError(UserError):
    """Training cannot start or go on; the message says why and what to do."""


class CheckpointError(TrainingError):
    """A checkpoint that cannot be used or written; the message says why and what to do."""
