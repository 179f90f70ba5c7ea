"""Listener: whoever wants to hear how training goes, such as a progress bar."""

from __future__ import annotations

from typing import Protocol

from track_range.detection.training.losses.detection_loss import Losses


class Listener(Protocol):
    """Hears how training goes."""

    def step(self, epoch: int, i: int, n: int, losses: Losses) -> None:
        """After batch `i` of `n`."""
        ...

    def validated(self, epoch: int, i: int, n: int) -> None:
        """After validation image `i` of `n`."""
        ...

    def epoch(self, row: dict[str, float]) -> None:
        """After each epoch, with its row of results.csv."""
        ...
