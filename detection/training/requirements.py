"""Check of the packages that training requires."""

from __future__ import annotations

from importlib.util import find_spec

from track_range.detection.training.errors import TrainingError


def check_torch() -> None:
    """Check that PyTorch is installed.

    Raises:
        TrainingError: PyTorch is not installed.
    """
    if find_spec("torch") is None:
        raise TrainingError("training requires PyTorch; install it with: pip install 'track-range[train]'.")
