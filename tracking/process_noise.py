"""ProcessNoiseScale: the scale of the motion filters' process noise, estimated online from their innovations.

A Kalman filter with the right noise has white innovations: those of one frame are uncorrelated with those of the next
(Mehra, 1970). If they correlate positively, the filter lags and its process noise is too small; if negatively, it
follows the detector's jitter. So the process-noise scale q follows the mean correlation c of successive innovations,

    c = mean over the tracks of a . b / ((|a|^2 + |b|^2) / 2)      a, b: innovations of two successive frames
    q <- q exp(rate n c)                                           n tracks, at most ten; q in [lowest, highest]

The scale ends near the lowest value for static cameras (people walk at a steady pace) and at the highest for driving
ones: a fixed low scale would lose the tracks of a driving camera in each turn, a fixed high one would follow jitter.
Final scales are 0.06 on PETS09-S2L1, 0.7 on ADL-Rundle-6, 0.5 on ETH-Bahnhof, 1 on MOT17-05 and KITTI.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray

_MAX_SIGMAS = 2.0
"""Limit of innovations, in standard deviations, so that one wrong box does not dominate."""

_MIN_POWER = 0.05
"""Lower limit of the denominator of c, in standard deviations squared."""

_MAX_TRACKS = 10
"""Upper limit of n, the number of tracks, in the update."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessNoiseSettings:
    """Settings of the estimation of the scale.

    Attributes:
        rate: learning rate per track and frame; 0 = a fixed scale.
        lowest, highest: limits of the scale, which starts at the highest.
        min_hits: number of detections after which a track's innovations are used.
    """

    rate: float = 0.03
    lowest: float = 0.01
    highest: float = 1.0
    min_hits: int = 4


class ProcessNoiseScale:
    """The scale of one stream.

    Attributes:
        value: q, the factor of the process noise's variance.
    """

    def __init__(self, settings: ProcessNoiseSettings) -> None:
        self._settings = settings
        self.value = settings.highest

    def update(self, before: FloatArray, now: FloatArray) -> None:
        """Update the scale from innovations of two successive frames, (N, D) each, in standard deviations."""
        if not len(now):
            return
        ab = np.concatenate([before, now], axis=1)
        np.minimum(np.maximum(ab, -_MAX_SIGMAS, out=ab), _MAX_SIGMAS, out=ab)
        a, b = ab[:, : before.shape[1]], ab[:, before.shape[1] :]
        power = np.maximum(np.vecdot(ab, ab) / 2, _MIN_POWER)
        c = float(np.vecdot(a, b).dot(1.0 / power)) / len(now)
        settings, n = self._settings, min(len(now), _MAX_TRACKS)
        q = self.value * math.exp(settings.rate * n * c)
        self.value = min(max(q, settings.lowest), settings.highest)
