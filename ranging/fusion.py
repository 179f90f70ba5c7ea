"""Fusion: one distance from several methods, weighted by variance, with what each track's past says of their biases.

    z_i = log d + k_i u_i + n_i         for method i, with z_i the logarithm of its distance
    d  from   w = A^-1 1 / (1' A^-1 1),   log d = w' (z - K u),   var = 1 / (1' A^-1 1),   A = K C K' + N

A method's relative sigma has a part that a track keeps, k (a tall car stays a tall car; a rig that is askew stays
askew), and a part n that is new in every frame. u, of variance 1, is how wrong a method is about this very track, in
units of k. It cannot be seen from one method, but differences between methods tell: stereo teaches mono the track's
true size while it sees, and mono carries on with it where stereo is blind. It is a Kalman filter whose state is log d,
about which every frame begins knowing nothing, and u, which forgets slowly:

    u' = u + G (z - K u),   G = C K' B without its row for stereo,   B = A^-1 - A^-1 1 1' A^-1 / (1' A^-1 1)

Stereo's own u is reckoned with but not learnt (Schmidt's filter): the others know its metres from nobody else, and a
match can be wrong in one frame by more than any bias.

N is not diagonal: mono, ground and lane read the same bottom edge of the same box. Where methods contradict each other
by more than their sigmas allow sigma is widened (Birge's ratio, chi^2 per degree of freedom), what has been learnt of
the track is doubted, and, if they have long agreed before, the one is left out that is farthest from where the track
has just been. A track without a past goes by size: where stereo and mono are apart by more than a factor of 2.5 stereo
is left out. An object that is partly hidden can look half as large as it is, but none of its class is that much larger
or smaller, while a match on what stands in front of it, or on the background, can be anywhere.
Dense and patch matching look at the same pixels of the same pair and share their errors, so dense matching only stands
in where patch matching has no answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from detection.detections import BoolArray, FloatArray, IntArray
from ranging.ranges import Ranges
from ranging.remembered import TrackRows

FUSED_METHODS = ("mono", "ground", "lane", "stereo")
"""In the order of all arrays here; "sgbm" stands in for "stereo"."""

_STEREO = FUSED_METHODS.index("stereo")
_STANDS_IN_FOR = {"stereo": "sgbm"}

_ONLY_WITHOUT = (("ground", "mono"), ("lane", "stereo"))
"""The first counts only where the second is silent: mono's sizes have the frame's ground in them already (a mean of
both is no better on KITTI, and too sure), and stereo has taught the lane its width."""

_NOISE_SHARE = np.array([0.6, 0.6, 0.6, 0.3])
"""Part of each method's sigma that is new in every frame."""

_SHARED_NOISE = np.array([[1.0, 0.5, 0.4, 0.0], [0.5, 1.0, 0.7, 0.0], [0.4, 0.7, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""Correlation of that part: half of a height's noise is its bottom edge's, and nearly all of ground's and lane's."""

_MAX_SIZE_FACTOR = 2.5
_UNMEASURED = 1e9
"""Variance of a measurement that is not there."""

_MEMORY_LOG = 5.0
"""What a track keeps is another thing after its distance changed by e^5: mono's errors along KITTI's labelled tracks
have lost 16 % of their variance after a factor of e, and nothing over time alone."""

_MEMORY_S = 60.0
_MAX_GAP_S = 3.0
_CONTRADICTION = 9.0
"""chi^2 per degree of freedom from which methods contradict each other."""

_DOUBT = 0.5
"""Variance that u gains in a frame of contradiction."""

_TRUSTED_FRAMES, _MOST_TRUSTED_FRAMES = 5, 10
"""After so many frames of agreement a contradiction is one method's slip; two of them weigh as much as four."""

_LARGEST_BIAS = 2.5
"""In sigmas: what differs by more is no object's size, but a match on another one, or a box that it cuts."""

_IS_LEARNT = np.array([[1.0], [1.0], [1.0], [0.0]])
"""Rows of u: of all but stereo."""

_ODD_SIGMA = 3.0
_MAX_SPEED_MPS = 20.0
"""How fast distances change, for what is plainly elsewhere."""

_TAUGHT_S, _TAUGHT_VARIANCE = 0.5, 0.3
"""For so long after stereo's last word distances count as stereo's, and while mono's u is as well known as that."""


@dataclass(frozen=True, slots=True)
class Fused:
    """Fused ranges of a frame.

    Attributes:
        ranges: distance and sigma, NaN = nobody measured.
        way: (N,) odd where the scale is stereo's, now or learnt from it, even where it is not; another number also
            where methods contradict each other and no past decides. A step between two numbers is no motion
            (`DistanceFilter.update`).
    """

    ranges: Ranges
    way: IntArray


@dataclass(slots=True)
class _Biases(TrackRows):
    """What is known of each track: u (N, M), its covariance (N, M, M), and (N,) each of the rest."""

    mean: FloatArray
    covariance: FloatArray
    log_m: FloatArray
    variance: FloatArray
    time_s: FloatArray
    trust: IntArray  # frames in which methods have agreed
    n_upsets: IntArray  # frames of contradiction that no past decided
    stereo_s: FloatArray  # when stereo counted last

    @classmethod
    def blank(cls, track_id: IntArray) -> _Biases:
        n, m = len(track_id), len(FUSED_METHODS)
        log_m, variance, time_s, stereo_s = np.full((4, n), np.nan)
        identity = np.tile(np.eye(m), (n, 1, 1))
        trust, n_upsets = np.zeros((2, n), np.int64)
        return cls(track_id, np.zeros((n, m)), identity, log_m, variance, time_s, trust, n_upsets, stereo_s)


@dataclass(frozen=True, slots=True)
class _Readings:
    """A frame's measurements: (N, M) log distances (0 where there is none), relative sigmas, and which there are."""

    log_m: FloatArray
    sigma: FloatArray
    there: BoolArray

    def without(self, left_out: BoolArray) -> _Readings:
        return _Readings(self.log_m, self.sigma, self.there & ~left_out)

    @property
    def kept(self) -> FloatArray:
        """(N, M) the part k of sigma."""
        return np.asarray(self.sigma * np.sqrt(1 - _NOISE_SHARE**2))

    @property
    def noise(self) -> FloatArray:
        """(N, M, M) covariance of the part n; beyond all bounds where there is no measurement."""
        one = np.where(self.there, self.sigma * _NOISE_SHARE, 0.0)
        absent = np.where(self.there, 0.0, _UNMEASURED)
        shared = one[:, :, None] * one[:, None, :] * _SHARED_NOISE
        return np.asarray(shared + absent[:, :, None] * np.eye(len(FUSED_METHODS)))


@dataclass(frozen=True, slots=True)
class _Estimate:
    """(N,) log distance, its variance, chi^2 per degree of freedom; (N, M, M) G, and (N, M) what it is to be put on."""

    log_m: FloatArray
    variance: FloatArray
    chi2: FloatArray
    gain: FloatArray
    told: FloatArray


class Fusion:
    """Fuses the methods of a video frame by frame, remembering per track how they differ."""

    def __init__(self) -> None:
        """Start without tracks."""
        self._known = _Biases.blank(np.zeros(0, np.int64))

    def fuse(self, by_method: Mapping[str, Ranges], track_id: IntArray, time_s: float) -> Fused:
        """The fused ranges of `track_id` from those of `FUSED_METHODS` and sgbm that are there, all in its order."""
        readings = _readings(by_method, len(track_id))
        biases = _Biases.blank(track_id).recalling(self._known)
        _forget(biases, np.exp(-np.nan_to_num(time_s - biases.time_s) / _MEMORY_S))
        readings = readings.without(_impossible(readings, biases))
        estimate = _estimate(readings, biases)
        odd = _odd(readings, biases, estimate, time_s)
        readings = readings.without(odd)
        estimate = _estimate(readings, biases)
        _learn(biases, readings, estimate, contradicts=odd.any(axis=1) | (estimate.chi2 > _CONTRADICTION))
        _place(biases, readings, estimate, time_s)
        is_recent = time_s - self._known.time_s <= _MAX_GAP_S
        self._known = biases.with_absent(self._known, is_recent=is_recent)
        distance_m = np.where(readings.there.any(axis=1), np.exp(estimate.log_m), np.nan)
        widened = estimate.variance * np.maximum(1.0, estimate.chi2)
        by_stereo = (time_s - biases.stereo_s <= _TAUGHT_S) | (biases.covariance[:, 0, 0] < _TAUGHT_VARIANCE)
        way = 2 * biases.n_upsets + by_stereo
        return Fused(Ranges(track_id, distance_m, distance_m * np.sqrt(widened)), way)


def _learn(biases: _Biases, readings: _Readings, estimate: _Estimate, *, contradicts: BoolArray) -> None:
    """Take in what the differences between methods tell."""
    identity = np.eye(len(FUSED_METHODS))
    caution = np.sqrt(_CONTRADICTION / np.maximum(estimate.chi2, _CONTRADICTION))
    gain = (caution * ~_is_implausible(readings))[:, None, None] * estimate.gain
    biases.mean += np.einsum("nij,nj->ni", gain, estimate.told)
    left = identity - gain * readings.kept[:, None, :]
    biases.covariance = left @ biases.covariance @ left.transpose(0, 2, 1)
    biases.covariance += gain @ readings.noise @ gain.transpose(0, 2, 1)
    biases.covariance[contradicts] += _DOUBT * _IS_LEARNT * identity
    agrees = (readings.there.sum(axis=1) > 1) & ~contradicts
    biases.n_upsets += contradicts & (biases.trust < _TRUSTED_FRAMES)
    biases.trust = np.clip(biases.trust + agrees - 2 * contradicts, 0, _MOST_TRUSTED_FRAMES)


def _place(biases: _Biases, readings: _Readings, estimate: _Estimate, time_s: float) -> None:
    """Remember where the tracks are."""
    measured = np.asarray(readings.there.any(axis=1))
    moved = np.where(measured, np.abs(np.nan_to_num(estimate.log_m - biases.log_m)), 0.0)
    _forget(biases, np.exp(-moved / _MEMORY_LOG))
    biases.log_m = np.where(measured, estimate.log_m, biases.log_m)
    biases.variance = np.where(measured, estimate.variance, biases.variance)
    biases.time_s = np.where(measured, time_s, biases.time_s)
    biases.stereo_s = np.where(readings.there[:, _STEREO], time_s, biases.stereo_s)


def _forget(biases: _Biases, left: FloatArray) -> None:
    """Back towards u = 0 of variance 1; `left` (N,) is the share that stays."""
    biases.mean *= left[:, None]
    squared = left[:, None, None] ** 2
    biases.covariance = squared * biases.covariance + (1 - squared) * np.eye(len(FUSED_METHODS))


def _estimate(readings: _Readings, biases: _Biases) -> _Estimate:
    """Generalised least squares for log d, and what the differences between methods say of u."""
    kept = readings.kept
    reach = biases.covariance * kept[:, None, :]  # C K'
    total = kept[:, :, None] * reach + readings.noise
    inverse = np.linalg.inv(total)
    column = inverse.sum(axis=2)
    precision = column.sum(axis=1)
    told = np.where(readings.there, readings.log_m - kept * biases.mean, 0.0)
    log_m = (column * told).sum(axis=1) / precision
    contrast = inverse - column[:, :, None] * column[:, None, :] / precision[:, None, None]
    pull = np.einsum("nij,nj->ni", contrast, told)
    freedom = np.maximum(readings.there.sum(axis=1) - 1, 1)
    return _Estimate(
        log_m,
        1 / precision,
        (told * pull).sum(axis=1) / freedom,
        _IS_LEARNT * (reach @ contrast),
        told,
    )


def _impossible(readings: _Readings, biases: _Biases) -> BoolArray:
    """(N, M) stereo that no object's size explains, of tracks without much of a past."""
    apart = np.abs(readings.log_m[:, _STEREO] - readings.log_m[:, 0]) > np.log(_MAX_SIZE_FACTOR)
    left_out = np.zeros_like(readings.there)
    left_out[:, _STEREO] = apart & readings.there[:, 0] & readings.there[:, _STEREO] & (biases.trust < _TRUSTED_FRAMES)
    return left_out


def _is_implausible(readings: _Readings) -> BoolArray:
    """(N,) whether stereo and mono differ by more than sizes do: such a frame teaches nothing."""
    apart = np.abs(readings.log_m[:, _STEREO] - readings.log_m[:, 0])
    expected = np.hypot(readings.sigma[:, 0], readings.sigma[:, _STEREO])
    both = readings.there[:, 0] & readings.there[:, _STEREO]
    return np.asarray(both & (apart > _LARGEST_BIAS * expected))


def _odd(readings: _Readings, biases: _Biases, estimate: _Estimate, time_s: float) -> BoolArray:
    """(N, M) of contradicting methods the one farthest from where the track has just been, if another is near."""
    kept, noise = readings.kept, np.diagonal(readings.noise, axis1=1, axis2=2)
    moved = _MAX_SPEED_MPS * (time_s - biases.time_s) / np.exp(biases.log_m)
    expected = (
        kept**2 * np.diagonal(biases.covariance, axis1=1, axis2=2) + noise + (biases.variance + moved**2)[:, None]
    )
    away = np.abs(readings.log_m - kept * biases.mean - biases.log_m[:, None]) / np.sqrt(expected)
    away = np.where(readings.there & np.isfinite(away), away, 0.0)
    near = (readings.there & (away < _ODD_SIGMA)).any(axis=1)
    is_farthest = away == away.max(axis=1, keepdims=True)
    contradicts = (estimate.chi2 > _CONTRADICTION) & near & (biases.trust >= _TRUSTED_FRAMES)
    return np.asarray(contradicts[:, None] & is_farthest & (away > _ODD_SIGMA))


def _readings(by_method: Mapping[str, Ranges], n: int) -> _Readings:
    shape = (n, len(FUSED_METHODS))
    distance_m, sigma_m = np.full(shape, np.nan), np.full(shape, np.nan)
    for i, name in enumerate(FUSED_METHODS):
        for source in (name, _STANDS_IN_FOR.get(name, "")):
            if source in by_method:
                missing = np.isnan(distance_m[:, i])
                distance_m[missing, i] = by_method[source].distance_m[missing]
                sigma_m[missing, i] = by_method[source].sigma_m[missing]
    there = np.isfinite(distance_m) & (distance_m > 0) & (sigma_m > 0)
    for silent, heard in _ONLY_WITHOUT:
        there[:, FUSED_METHODS.index(silent)] &= ~there[:, FUSED_METHODS.index(heard)]
    distance_m = np.where(there, distance_m, 1.0)
    return _Readings(np.log(distance_m), np.where(there, sigma_m, 0.0) / distance_m, there)
