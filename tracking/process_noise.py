"""NoiseLevel: how restless a stream's motion is, learnt from the filters' own innovations.

A Kalman filter whose noise is right has white innovations: what is new in one frame says nothing about the next (Mehra,
1970). If they go on in one direction, the filter lags and its motion is noisier than it thinks; if they go to and fro,
it runs after the detector's jitter. So the level q of process noise follows their correlation c over one frame,

    q <- q exp(rate n c)        n tracks, at most ten; q in [lowest, highest]

A camera that stands (people walk at a steady pace) comes out near the lowest, one that drives at the highest: the
lowest alone costs a driving camera its tracks at each turn, the highest alone lets a standing one run after jitter.
Found on PETS09-S2L1 (0.06), ADL-Rundle-6 (0.7), ETH-Bahnhof (0.5), MOT17-05 and KITTI (1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray

_MAX_SIGMAS = 2.0
"""Innovations count no further: one wrong box must not speak for the stream."""

_MIN_POWER = 0.05
"""Below this mean square, in sigmas, two innovations are too small to tell a direction."""

_MAX_TRACKS = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseLevelSettings:
    """How the level is learnt.

    Attributes:
        rate: of learning, per track and frame; 0 = the level stays.
        lowest, highest: limits of the level; it begins at the highest.
        min_hits: boxes that a track has had before it is listened to.
    """

    rate: float = 0.03
    lowest: float = 0.01
    highest: float = 1.0
    min_hits: int = 4


class NoiseLevel:
    """The level of one stream.

    Attributes:
        value: factor of the process noise's variance.
    """

    def __init__(self, settings: NoiseLevelSettings) -> None:
        self._settings = settings
        self.value = settings.highest

    def learn(self, before: FloatArray, now: FloatArray) -> None:
        """Compare the innovations of tracks seen in two frames running: (N, D) each, in standard deviations."""
        if not len(now):
            return
        a, b = (np.maximum(np.minimum(each, _MAX_SIGMAS), -_MAX_SIGMAS) for each in (before, now))
        power = np.maximum((a * a + b * b).sum(axis=1) / 2, _MIN_POWER)
        correlation = float(((a * b).sum(axis=1) / power).mean())
        keep = self._settings
        grown = self.value * float(np.exp(keep.rate * min(len(now), _MAX_TRACKS) * correlation))
        self.value = min(max(grown, keep.lowest), keep.highest)
