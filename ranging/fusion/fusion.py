"""Fusion: one distance from several methods, weighted by variance, with what each track's past says of their biases.

    z_i = log d + k_i u_i + n_i         for method i, with z_i the logarithm of its distance

A method's relative sigma has a part that a track keeps, k (a tall car stays a tall car; a rig that is askew stays
askew), and a part n that is new in every frame. u, of variance 1, is how wrong a method is about this very track, in
units of k. It cannot be seen from one method, but differences between methods tell: stereo teaches mono the track's
true size while it sees, and mono carries on with it where stereo is blind. It is a Kalman filter whose state is log d,
about which every frame begins knowing nothing, and u, which forgets slowly. At most two methods count for a track in a
frame (`odd_readings`), one by the looks of the box, i, and one by a pair of eyes or of lines, j. With h = k_i e_i -
k_j e_j, which takes from u what their difference has of it, and A = K C K' + N of u's covariance C:

    nu = z_i - z_j - h' u,   S = h' C h + var(n_i - n_j) = A_ii - 2 A_ij + A_jj,   s = (A_ii - A_ij) / S
    log d = (1 - s) (z_i - k_i u_i) + s (z_j - k_j u_j),    its variance (1 - s)^2 A_ii + 2 s (1 - s) A_ij + s^2 A_jj
    u' = u + g nu,   C' = C - g (C h)' - (C h) g' + S g g',   g = C h / S without its row for stereo

Stereo's own u is reckoned with but not learnt (Schmidt's filter): the others know its metres from nobody else, and a
match can be wrong in one frame by more than any bias.

N is not diagonal: mono, ground and lane read the same bottom edge of the same box. Where the two contradict each other
by more than their sigmas allow sigma is widened (Birge's ratio, chi^2 = nu^2 / S), what has been learnt of the track is
doubted, and one of them may be left out (`odd_readings`). Dense and patch matching look at the same pixels of the same
pair and share their errors, so dense matching only stands in where patch matching has no answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.track_state import TrackState
from track_range.ranging.fusion.measurements import FUSED_METHODS, MONO, STEREO, Readings, readings_of
from track_range.ranging.fusion.outliers import TRUSTED_FRAMES, impossible, odd, other_lane, silent
from track_range.ranging.fusion.track_biases import TrackBiases, blank_track
from track_range.ranging.ranges import Ranges

_M = len(FUSED_METHODS)
_SHARED_NOISE = np.array([[1.0, 0.5, 0.4, 0.0], [0.5, 1.0, 0.7, 0.0], [0.4, 0.7, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""Correlation of the methods' n: half of a height's noise is its bottom edge's, nearly all of ground's and lane's."""

_MEMORY_LOG = 5.0
"""What a track keeps is another thing after its distance changed by e^5: mono's errors along KITTI's labelled tracks
have lost 16 % of their variance after a factor of e, and nothing over time alone."""

_MEMORY_S = 60.0
_MAX_GAP_S = 3.0
_CONTRADICTION = 9.0
"""chi^2 per degree of freedom from which methods contradict each other."""

_MOST_TRUSTED_FRAMES = 2 * TRUSTED_FRAMES  # a contradiction weighs as much as two agreements
_DOUBT = 0.5
"""Variance that u gains in a frame of contradiction."""

_LARGEST_BIAS = 2.5
"""In sigmas: what differs by more is no object's size, but a match on another one, or a box that it cuts."""

_IS_LEARNT = np.array([[1.0], [1.0], [1.0], [0.0]])
"""Rows of u: of all but stereo."""

_SIGN = np.array([[1.0], [1.0], [-1.0], [-1.0]])
"""Of methods in the difference of two."""

_TAUGHT_S, _TAUGHT_VARIANCE = 0.5, 0.3
"""For so long after stereo's last word distances count as stereo's, and while mono's u is as well known as that."""

_Rows = TypeVar("_Rows", FloatArray, BoolArray)


@dataclass(frozen=True, slots=True)
class Fused:
    """Fused ranges of a frame.

    Attributes:
        ranges: distance and sigma, NaN = nobody measured.
        way: (N,) odd where the scale is stereo's, now or learnt from it, even where it is not; another number also
            where methods contradict each other and no past decides. A step between two numbers is no motion
            (`DistanceFilters.update`, `ways`).
    """

    ranges: Ranges
    way: IntArray


@dataclass(frozen=True, slots=True)
class _Estimate:
    """What readings say, given biases.

    Attributes:
        log_m: (N,) log distance,
        variance: and its variance.
        difference: (N,) nu,
        spread: and its variance S; infinite where fewer than two methods measure.
        chi2: (N,) of that.
        pull: (M, N) C h.
    """

    log_m: FloatArray
    variance: FloatArray
    difference: FloatArray
    spread: FloatArray
    chi2: FloatArray
    pull: FloatArray


class Fusion:
    """Fuses the methods of a video frame by frame, remembering per track how they differ."""

    def __init__(self) -> None:
        """Start without tracks."""
        self._tracks = TrackState(blank_track(_M))

    def fuse(self, by_method: Mapping[str, Ranges], track_id: IntArray, time_s: float) -> Fused:
        """The fused ranges of `track_id` from those of `FUSED_METHODS` and sgbm that are there, all in its order."""
        columns = self._tracks.get(track_id)
        biases = TrackBiases.in_columns(columns, _M)
        heard = readings_of(by_method, len(track_id))
        # Once for a gap, when it ends: until then `biases.time_s` stays.
        since_s = np.fmax(time_s - biases.time_s, 0.0) * heard.there.any(axis=0)
        biases.forget(np.exp(since_s / -_MEMORY_S))
        readings = heard.without(silent(heard) | impossible(heard, biases))
        estimate = _estimate(readings, biases)
        contradicts = estimate.chi2 > _CONTRADICTION
        if contradicts.any():
            wrong = odd(readings, biases, contradicts, time_s)
            wrong |= other_lane(heard, readings, contradicts & ~wrong.any(axis=0))
            readings = readings.without(wrong)
            estimate = _estimate(readings, biases)
            contradicts = wrong.any(axis=0) | (estimate.chi2 > _CONTRADICTION)
        _learn(biases, readings, estimate, contradicts=contradicts)
        _place(biases, readings, estimate, time_s)
        is_recent = time_s - TrackBiases.in_columns(self._tracks.known, _M).time_s <= _MAX_GAP_S
        self._tracks.put(track_id, columns, keep=is_recent)
        distance_m = np.where(readings.there.any(axis=0), np.exp(estimate.log_m), np.nan)
        sigma_m = distance_m * np.sqrt(estimate.variance * np.maximum(1.0, estimate.chi2))
        by_stereo = (time_s - biases.stereo_s <= _TAUGHT_S) | (biases.own_variance[MONO] < _TAUGHT_VARIANCE)
        return Fused(Ranges(track_id, distance_m, sigma_m), (2 * biases.n_upsets + by_stereo).astype(np.int64))


def _learn(biases: TrackBiases, readings: Readings, estimate: _Estimate, *, contradicts: BoolArray) -> None:
    """Take in what the differences between methods tell."""
    caution = np.sqrt(_CONTRADICTION / np.maximum(estimate.chi2, _CONTRADICTION))
    taken = _IS_LEARNT * estimate.pull * (caution * ~_is_implausible(readings))
    gain = taken / estimate.spread
    biases.mean[:] += gain * estimate.difference
    step = gain[:, None] * (taken / 2 - estimate.pull)  # half of what C changes by: that is symmetric
    biases.covariance[:] += step + step.transpose(1, 0, 2)
    biases.own_variance[:] += _DOUBT * _IS_LEARNT * contradicts
    agrees = (estimate.spread < np.inf) & ~contradicts
    biases.n_upsets[:] += (estimate.chi2 > _CONTRADICTION) & (biases.trust < TRUSTED_FRAMES)
    biases.trust[:] = (biases.trust + agrees - 2.0 * contradicts).clip(0, _MOST_TRUSTED_FRAMES)


def _place(biases: TrackBiases, readings: Readings, estimate: _Estimate, time_s: float) -> None:
    """Remember where the tracks are."""
    measured = readings.there.any(axis=0)
    moved = np.fmax(np.abs(estimate.log_m - biases.log_m), 0.0) * measured  # a new track has not moved
    biases.forget(np.exp(moved / -_MEMORY_LOG))
    np.copyto(biases.log_m, estimate.log_m, where=measured)
    np.copyto(biases.variance, estimate.variance, where=measured)
    np.copyto(biases.time_s, time_s, where=measured)
    np.copyto(biases.stereo_s, time_s, where=readings.there[STEREO])


def _estimate(readings: Readings, biases: TrackBiases) -> _Estimate:
    """Log d by generalised least squares, and by how much the two methods differ."""
    kept, noise = readings.kept, readings.noise
    differs, scatters = _SIGN * kept, _SIGN * noise
    pull = (biases.covariance * differs).sum(axis=1)
    apart = _by_pair(differs * pull + scatters * (_SHARED_NOISE @ scatters))  # A_ii - A_ij, A_jj - A_ij
    alone = _by_pair(kept * kept * biases.own_variance + noise * noise)  # A_ii, A_jj
    told = _by_pair(readings.log_m - kept * biases.mean)
    is_there = _by_pair(readings.there)
    spread = np.where(is_there[0] & is_there[1], apart[0] + apart[1], np.inf)
    share = apart[0] / spread + (is_there[1] & ~is_there[0])
    rest, together = 1.0 - share, alone[0] - apart[0]
    difference = told[0] - told[1]
    return _Estimate(
        log_m=rest * told[0] + share * told[1],
        variance=rest * (rest * alone[0] + 2.0 * share * together) + share * share * alone[1],
        difference=difference,
        spread=spread,
        chi2=difference * difference / spread,
        pull=pull,
    )


def _by_pair(rows: _Rows) -> tuple[_Rows, _Rows]:
    """(N,) of the first method, mono or ground, and of the second, lane or stereo, from (M, N), 0 = not there."""
    mono, ground, lane, stereo = rows
    return mono + ground, lane + stereo


def _is_implausible(readings: Readings) -> BoolArray:
    """(N,) whether stereo and mono differ by more than sizes do: such a frame teaches nothing."""
    apart = np.abs(readings.log_m[STEREO] - readings.log_m[MONO])
    expected = np.hypot(readings.sigma[MONO], readings.sigma[STEREO])
    return np.asarray(readings.there[MONO] & readings.there[STEREO] & (apart > _LARGEST_BIAS * expected))
