"""Supported values: those that several frames of a track agree on, of which minima and maxima are
taken.

A frame counts if the box was detected and neither the left nor the right image border cuts it. Its
value is known if its standard deviation is unknown or at most half of it. A value is supported if
it was known in all frames that count over the last 0.2 s, at least three: it is then the least
critical of them, each carried to the present by the time that has passed and its closing speed. So
one or two frames make no minimum, and a time to collision that falls by a second per second is not
reported late.
"""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray

# largest standard deviation of a distance, closing speed or time to collision that counts,
# relative to it
MAX_RELATIVE_SIGMA = 0.5
# frames and time that have to agree, and the longest interruption between two of them; definitions
_MIN_FRAMES, _MIN_S, _MAX_GAP_S = 3, 0.2, 1.0
_EPSILON_S = 1e-6


class Columns(Protocol):
    """Values of N rows by name, such as `Rows`."""

    def __getitem__(self, name: str, /) -> npt.NDArray[np.generic]:
        """(N,) values."""


def supported_values(
    rows: Columns, distance_m: FloatArray, sigma_m: FloatArray
) -> Mapping[str, FloatArray]:
    """(N,) supported values of rows in any order, by name; NaN = none.

    Names: `distance_m`, which is given with its sigma, `closing_mps`, and the measures `gap_m`,
    `headway_s`, `ttc_front_s`, `drac_mps2` and `mdrac_mps2`. Of the speed and the decelerations,
    the largest is the most critical value.
    """
    names = ("closing_mps", "gap_m", "headway_s", "ttc_front_s", "drac_mps2", "mdrac_mps2")
    known = {name: np.asarray(rows[name], np.float64) for name in names}
    closing_mps, ttc_s = known["closing_mps"], np.asarray(rows["ttc_s"], np.float64)
    is_near = _is_known(distance_m, sigma_m)
    is_closing = _is_known(closing_mps, np.asarray(rows["closing_sigma_mps"], np.float64))
    ttc_s = np.where(np.isnan(ttc_s), known["ttc_front_s"], ttc_s)
    is_timed = _is_known(ttc_s, np.asarray(rows["ttc_sigma_s"], np.float64))
    n = len(distance_m)
    frames = _Frames(
        np.asarray(rows["track_id"], np.int64),
        np.asarray(rows["time_s"], np.float64),
        np.asarray(rows["observed"], np.bool_) & ~np.asarray(rows["is_cut"], np.bool_),
    )
    rate_mps = -np.nan_to_num(np.where(is_closing, closing_mps, 0.0))

    def largest(values: FloatArray, is_certain: BoolArray, rate: Any = 0.0) -> FloatArray:
        return frames.largest(np.where(is_certain, values, np.nan), np.broadcast_to(rate, n))

    with np.errstate(divide="ignore", invalid="ignore"):
        headway_per_s = np.nan_to_num(rate_mps * known["headway_s"] / known["gap_m"], neginf=0.0)
        # 1 / DRAC = 2 g / c^2, which falls with the gap
        inverse = {name: 1.0 / known[name] for name in ("drac_mps2", "mdrac_mps2")}
        inverse_per_s = np.where(is_closing, -2.0 / closing_mps, 0.0)
    return {
        "distance_m": largest(distance_m, is_near, rate_mps),
        "gap_m": largest(known["gap_m"], is_near, rate_mps),
        "headway_s": largest(known["headway_s"], is_near, headway_per_s),
        "ttc_front_s": largest(known["ttc_front_s"], is_timed, -1.0),
        "closing_mps": -largest(-closing_mps, is_closing),
        **{
            name: 1.0 / largest(values, is_closing & np.isfinite(values), inverse_per_s)
            for name, values in inverse.items()
        },
    }


def _is_known(values: FloatArray, sigma: FloatArray) -> BoolArray:
    """(N,) whether values are positive, and certain enough."""
    return np.asarray((values > 0) & ~(sigma > MAX_RELATIVE_SIGMA * values))


class _Frames:
    """The frames that count, of tracks in the order of time, each with the first one of those that
    have to agree with it.
    """

    def __init__(self, track_id: IntArray, time_s: FloatArray, counts: BoolArray) -> None:
        order = np.lexsort((time_s, track_id))
        self._rows, self._n = order[counts[order]], len(time_s)
        self._time_s = time_s[self._rows]
        number = np.arange(len(self._rows))
        is_new = np.diff(track_id[self._rows], prepend=-1) != 0
        is_new |= np.diff(self._time_s, prepend=-np.inf) > _MAX_GAP_S
        begin = np.maximum.accumulate(np.where(is_new, number, 0))
        first, is_short = number - (_MIN_FRAMES - 1), np.zeros(len(number), np.bool_)
        while True:
            is_short = self._time_s - self._time_s[np.maximum(first, 0)] < _MIN_S - _EPSILON_S
            if not (is_short & (first > begin)).any():
                break
            first -= is_short & (first > begin)
        self._first, self._number = first, number
        self._is_supported = (first >= begin) & ~is_short

    def largest(self, values: FloatArray, rate_per_s: FloatArray) -> FloatArray:
        """(N,) for each row, the largest value of the frames that have to agree, NaN = one of them
        has none; each is carried to the time of the row with its own rate.
        """
        own = np.where(np.isnan(values), np.inf, values)[self._rows]
        rate = rate_per_s[self._rows]
        largest = own.copy()
        for back in range(1, int((self._number - self._first).max(initial=0)) + 1):
            earlier = np.maximum(self._number - back, 0)
            carried = own[earlier] + rate[earlier] * (self._time_s - self._time_s[earlier])
            is_one = self._number - back >= self._first
            largest = np.where(is_one, np.maximum(largest, carried), largest)
        supported = np.full(self._n, np.nan)
        supported[self._rows] = np.where(self._is_supported & np.isfinite(largest), largest, np.nan)
        return supported
