"""Whether training can run here."""

from __future__ import annotations

from importlib.util import find_spec

from track_range.detection.training.errors import TrainingError


def check_torch() -> None:
    """Check that PyTorch is installed.

    Raises:
        TrainingError: it is not.
    """
    if find_spec("torch") is None:
        raise TrainingError("training requires PyTorch; install it with: pip install 'track-range[train]'.")
