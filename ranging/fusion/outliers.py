"""Which of the methods that are fused does not count for a track in a frame: another one does, or contradicts it.

All functions give (M, N), True = left out.

Methods that have long agreed on a track: the one that is farther from where the track has just been. A track without a
past goes by size: where stereo and mono are apart by more than a factor of 2.5 stereo is left out. An object that is
partly hidden can look half as large as it is, but none of its class is that much larger or smaller, while a match on
what stands in front of it, or on the background, can be anywhere. But if the foot of the box, which asks for no class,
stands by stereo, mono is left out: the class is wrong. And where lane contradicts mono it is left out, as the lines may
be those of another lane, unless the foot stands by it.
"""

from __future__ import annotations

import math

import numpy as np

from track_range.foundation.arrays import BoolArray
from track_range.ranging.fusion.measurements import GROUND, LANE, MONO, STEREO, Readings
from track_range.ranging.fusion.track_biases import TrackBiases

_ONLY_WITHOUT = ((GROUND, MONO), (LANE, STEREO))
"""The first counts only where the second is silent: mono's sizes have the frame's ground in them already (a mean of
both is no better on KITTI, and too sure), and stereo has taught the lane its width."""

TRUSTED_FRAMES = 5
"""After so many frames of agreement a contradiction is one method's slip."""

_LOG_MAX_SIZE = math.log(2.5)

_ODD_SIGMA = 3.0
_MAX_SPEED_MPS = 20.0
"""How fast distances change, for what is plainly elsewhere."""


def silent(readings: Readings) -> BoolArray:
    """(M, N) what does not count beside another method."""
    left_out = np.zeros_like(readings.there)
    for method, other in _ONLY_WITHOUT:
        left_out[method] = readings.there[other]
    return left_out


def impossible(readings: Readings, biases: TrackBiases) -> BoolArray:
    """(M, N) of stereo and mono that no object's size reconciles, of tracks without much of a past, which to leave out.

    Stereo, unless the foot of the box, by ground or lane, stands by it: then it is a car taken for a truck, say.
    """
    there, log_m, sigma = readings.there, readings.log_m, readings.sigma
    is_new = there[MONO] & there[STEREO] & (biases.trust < TRUSTED_FRAMES)
    apart = is_new & (np.abs(log_m[STEREO] - log_m[MONO]) > _LOG_MAX_SIZE)
    left_out = np.zeros_like(there)
    if apart.any():
        foot = [GROUND, LANE]
        off = np.abs(log_m[foot] - log_m[STEREO])
        agrees = there[foot] & (off < _ODD_SIGMA * np.hypot(sigma[foot], sigma[STEREO]))
        is_other_class = (agrees & (off < np.abs(log_m[foot] - log_m[MONO]))).any(axis=0)
        left_out[MONO], left_out[STEREO] = apart & is_other_class, apart & ~is_other_class
    return left_out


def other_lane(heard: Readings, readings: Readings, contradicts: BoolArray) -> BoolArray:
    """(M, N) lane where it contradicts mono: its lines may be another lane's, which its sigma knows nothing of.

    But mono where ground, which knows neither lane nor class, is nearer to lane.
    """
    off = np.abs(heard.log_m - heard.log_m[GROUND])
    by_lane = heard.there[GROUND] & (off[LANE] < off[MONO])
    contradicts = contradicts & readings.there[LANE] & readings.there[MONO]
    left_out = np.zeros_like(readings.there)
    left_out[MONO], left_out[LANE] = contradicts & by_lane, contradicts & ~by_lane
    return left_out


def odd(readings: Readings, biases: TrackBiases, contradicts: BoolArray, time_s: float) -> BoolArray:
    """(M, N) of contradicting methods the one farther from where the track has just been, if the other is near."""
    kept, noise = readings.kept, readings.noise
    moved = _MAX_SPEED_MPS * (time_s - biases.time_s) / np.exp(biases.log_m)
    expected = kept * kept * biases.own_variance + noise * noise + biases.variance + moved * moved
    away = np.abs(readings.log_m - kept * biases.mean - biases.log_m) / np.sqrt(expected)
    away = np.where(readings.there & np.isfinite(away), away, 0.0)
    near = (readings.there & (away < _ODD_SIGMA)).any(axis=0)
    is_farther = away == away.max(axis=0)
    return np.asarray(contradicts & near & (biases.trust >= TRUSTED_FRAMES) & is_farther & (away > _ODD_SIGMA))
