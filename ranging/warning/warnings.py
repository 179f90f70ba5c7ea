"""Warnings of a frame: probability of contact and state of the alarm of each track."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class Warnings:
    """Collision warnings of one frame, in the order of its N tracks.

    Example:
        >>> import numpy as np, track_range as tr
        >>> warnings = tr.Warnings(np.array([0.9, 0.1]), np.array([True, False]), np.array([0.2, 3.5]))
        >>> warnings.select(slice(1)).probability.tolist()
        [0.9]

    Attributes:
        probability: (N,) probability of contact within the horizon, 0..1; NaN = unknown.
        active: (N,) whether an alarm is on.
        path_offset_m: (N,) lateral offset of the object's centre from the middle of the ego path,
            positive = right; NaN = unknown.
        path_offset_sigma_m: (N,) its standard deviation; None = unknown.
    """

    probability: FloatArray
    active: BoolArray
    path_offset_m: FloatArray
    path_offset_sigma_m: FloatArray | None = None

    @classmethod
    def unknown(cls, n: int) -> Self:
        """Warnings of n tracks without a known probability."""
        nan = np.full(n, np.nan)
        return cls(nan, np.zeros(n, np.bool_), nan)

    def select(self, rows: slice) -> Warnings:
        """The warnings in the given rows."""
        sigma_m = None if self.path_offset_sigma_m is None else self.path_offset_sigma_m[rows]
        return Warnings(
            self.probability[rows], self.active[rows], self.path_offset_m[rows], sigma_m
        )
