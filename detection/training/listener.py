"""The `Listener` protocol: callbacks on the progress of training, for example for a progress bar."""

from __future__ import annotations

from typing import Protocol

from track_range.detection.training.losses.detection_loss import Losses


class Listener(Protocol):
    """Callbacks on the progress of training."""

    def step(self, epoch: int, i: int, n: int, losses: Losses) -> None:
        """Called after batch `i` of `n`."""
        ...

    def validated(self, epoch: int, i: int, n: int) -> None:
        """Called after validation image `i` of `n`."""
        ...

    def epoch(self, row: dict[str, float]) -> None:
        """Called after each epoch with its row of results.csv."""
        ...
