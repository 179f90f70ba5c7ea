"""Readings: what the methods that are fused say in one frame, as arrays over methods and tracks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.ranging.ranges import Ranges

FUSED_METHODS = ("mono", "ground", "lane", "stereo")
"""In the order of all arrays here; "sgbm" stands in for "stereo"."""

MONO, GROUND, LANE, STEREO = range(len(FUSED_METHODS))
_STANDS_IN_FOR = {"stereo": "sgbm"}

_NOISE_SHARE = np.array([[0.6], [0.6], [0.6], [0.3]])
"""Part of each method's sigma that is new in every frame: fixed, for fusion's split into bias and noise.

Not the shares of `track_range.run.pipeline.noise_shares`, which only start the distance filters and are learnt there.
"""

_KEPT_SHARE = np.sqrt(1 - _NOISE_SHARE**2)


@dataclass(frozen=True, slots=True)
class Readings:
    """A frame's measurements: (M, N) log distances and relative sigmas (0 where there is none), and which there are."""

    log_m: FloatArray
    sigma: FloatArray
    there: BoolArray

    def without(self, left_out: BoolArray) -> Readings:
        """But for those, (M, N)."""
        there = self.there & ~left_out
        return Readings(self.log_m * there, self.sigma * there, there)

    @property
    def kept(self) -> FloatArray:
        """(M, N) the part k of sigma."""
        return np.asarray(self.sigma * _KEPT_SHARE)

    @property
    def noise(self) -> FloatArray:
        """(M, N) the part n of sigma."""
        return np.asarray(self.sigma * _NOISE_SHARE)


def readings_of(by_method: Mapping[str, Ranges], n: int) -> Readings:
    """The readings of `n` tracks."""
    distance_m, sigma_m = np.full((2, len(FUSED_METHODS), n), np.nan)
    for i, name in enumerate(FUSED_METHODS):
        for source in (name, _STANDS_IN_FOR.get(name, "")):
            if source in by_method:
                missing = np.isnan(distance_m[i])
                np.copyto(distance_m[i], by_method[source].distance_m, where=missing)
                np.copyto(sigma_m[i], by_method[source].sigma_m, where=missing)
    there = np.isfinite(distance_m) & (distance_m > 0) & (sigma_m > 0)
    distance_m = np.where(there, distance_m, 1.0)
    return Readings(np.log(distance_m), np.where(there, sigma_m, 0.0) / distance_m, there)
