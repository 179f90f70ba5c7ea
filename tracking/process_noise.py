"""ProcessNoiseScale: the scale of the motion filters' process noise, estimated online from their innovations.

A Kalman filter with the right noise has white innovations: those of one frame are uncorrelated with those of the next
(Mehra, 1970). With a positive correlation the filter lags, and its process noise is too small; with a negative one it
follows the detector's jitter. So the scale q of process noise follows their correlation c over one frame,

    q <- q exp(rate n c)        n tracks, at most ten; q in [lowest, highest]

A static camera (people walk at a steady pace) ends near the lowest, a driving one at the highest: the lowest alone
costs a driving camera its tracks at each turn, the highest alone lets a static one follow jitter. Final scales are 0.06
on PETS09-S2L1, 0.7 on ADL-Rundle-6, 0.5 on ETH-Bahnhof, 1 on MOT17-05 and KITTI.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray

_MAX_SIGMAS = 2.0
"""Innovations are clipped here, so that one wrong box does not decide."""

_MIN_POWER = 0.05
"""Least mean square of two innovations, in sigmas squared, that their correlation is divided by."""

_MAX_TRACKS = 10
"""Tracks of a frame that count at most."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessNoiseSettings:
    """How the scale is estimated.

    Attributes:
        rate: learning rate per track and frame; 0 = a fixed scale.
        lowest, highest: limits of the scale, which starts at the highest.
        min_hits: detections of a track before its innovations count.
    """

    rate: float = 0.03
    lowest: float = 0.01
    highest: float = 1.0
    min_hits: int = 4


class ProcessNoiseScale:
    """The scale of one stream.

    Attributes:
        value: factor of the process noise's variance.
    """

    def __init__(self, settings: ProcessNoiseSettings) -> None:
        self._settings = settings
        self.value = settings.highest

    def update(self, before: FloatArray, now: FloatArray) -> None:
        """Use the innovations of tracks detected in two successive frames: (N, D) each, in standard deviations."""
        if not len(now):
            return
        a, b = (np.maximum(np.minimum(nu, _MAX_SIGMAS), -_MAX_SIGMAS) for nu in (before, now))
        power = np.maximum((a * a + b * b).sum(axis=1) / 2, _MIN_POWER)
        correlation = float(((a * b).sum(axis=1) / power).mean())
        settings = self._settings
        value = self.value * float(np.exp(settings.rate * min(len(now), _MAX_TRACKS) * correlation))
        self.value = min(max(value, settings.lowest), settings.highest)
