"""Exceptions of training, in a module that can be imported without PyTorch."""

from importlib.util import find_spec

from track_range.foundation.errors import UserError


class TrainingError(UserError):
    """Training cannot start or continue; the message gives the reason and what to do."""


class CheckpointError(TrainingError):
    """A checkpoint cannot be read, used or written; the message gives the reason and what to do."""


def check_torch() -> None:
    """TrainingError unless PyTorch is installed."""
    if find_spec("torch") is None:
        raise TrainingError(
            "training requires PyTorch; install it with: pip install 'track-range[train]'."
        )
