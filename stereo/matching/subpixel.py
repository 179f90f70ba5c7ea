"""Refinement: a window's disparity between pixels, and how surely, from the grey values themselves.

Census knows the order of grey values only: about a pixel it is sure, within it the steps of its bits pull. Least
squares on grey values (Lucas & Kanade 1981), from where census left off: with g the left window's derivative along
the row,

    left(x) = gain right(x - d) + s g(x) + bias        d <- d - s        twice

`gain` and `bias` belong to each window, so that the eyes' exposures may differ, as with census. The derivative is the
left window's throughout, and the cubic that reads right(x - d) moves all that a smoothed image holds by nearly the same
amount: no fraction of a pixel is preferred. The variance of d is that of the least squares, with what is left over as
the noise. A window is as wide as in the census, and two rows higher, since the margin is there.

Rows of the two eyes that do not quite match move slanted edges sideways: on KITTI's cars up to half a pixel per pixel.
So one row offset per box is fitted to what is left over, and its share in each window's d taken out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import BoolArray, FloatArray32, IntArray
from track_range.stereo.matching.sample_windows import WINDOW_HW, BoxWindows, GreyLevels
from track_range.stereo.matching.surfaces import WindowMatches

_MAX_STEP_PX = 0.5

_REACH = 2
"""Pixels that are read right and left of the whole disparity's place: four of the five for any fraction within 1 px."""

_MAX_MOVE_PX = 0.75
"""A window that wants to be farther than this from its census disparity did not fit."""

_MIN_GAIN = 0.3
"""Nor did one whose right pixels hardly look like the left ones, or are 0.3 times as bright."""

_SURE_SD_PX = 0.2
"""Nor did one whose variance is larger."""

_UNFIT_SD_PX = 0.6
"""Standard deviation of a window that did not fit: its census disparity is kept."""

_LEAST_NOISE_GREY2 = 0.14
"""Variance of a smoothed grey value that was rounded, or compressed, as the least: 1 grey level before smoothing."""

_ALIKE = 3.5
"""Smoothing makes neighbours' noise alike, and least squares think of it as independent: measured on exact shifts."""

_ROWS_SD_PX = 0.3
"""How far apart rows may be expected to be: what is worse is corrected beforehand (`alignment.py`)."""

_FLOOR_PX = 0.06
_FLOOR_SHARE = 0.006
"""Standard deviation that the best window keeps, and the same as a share of its disparity: objects are not planes."""


def refined_windows(
    left: GreyLevels, right: GreyLevels, windows: BoxWindows, found: WindowMatches, *, first: IntArray
) -> tuple[WindowMatches, BoolArray]:
    """The windows' matches with offsets -1 .. 1 by least squares, and 1 / variance (px of the level) as weights.

    Args:
        left: grey levels of the left eye.
        right: of the right one.
        windows: N boxes' windows.
        found: what census costs say; a window without a minimum keeps weight 0.
        first: (N,) disparity of the costs' index 0, px of the level.

    Returns:
        The matches, and (N, G) which of them the grey values confirm; the others keep their census disparities.
    """
    ours = _smooth(left.windows(windows, windows.column, width=WINDOW_HW[1]))
    strip_from = windows.column - (first[:, None] + found.index) - _REACH + 1
    theirs = _smooth(right.windows(windows, strip_from, width=WINDOW_HW[1] + 2 * _REACH - 2))
    at = start = found.offset.ravel().astype(np.float32)
    equations = _Equations.of(ours)
    for weights_at in (_linear_weights, _cubic_weights):
        seen = _read(theirs, weights_at(-at))
        fit = equations.fit(seen)
        at = np.clip(at - np.clip(fit.step, -_MAX_STEP_PX, _MAX_STEP_PX), -1.0, 1.0)
    fits = (np.abs(at - start) < _MAX_MOVE_PX) & (fit.gain > _MIN_GAIN) & (fit.gain * _MIN_GAIN < 1.0)
    shape = found.offset.shape
    is_sure = (fits & (fit.variance < _SURE_SD_PX**2)).reshape(shape) & (found.weight > 0)
    at = np.clip(at + _moved_by_rows(ours, seen, equations, fit, is_sure), -1.0, 1.0)
    variance = np.where(is_sure, fit.variance.reshape(shape).astype(np.float64), _UNFIT_SD_PX**2)
    variance += _FLOOR_PX**2 + (_FLOOR_SHARE * (first[:, None] + found.index)) ** 2
    offset = np.where(is_sure, at.reshape(shape), found.offset)
    return WindowMatches(found.index, offset, np.where(found.weight > 0, 1.0 / variance, 0.0)), is_sure


def _smooth(grey: npt.NDArray[np.uint8]) -> FloatArray32:
    """(H - 2, W - 2, P) of (H, W, P), by 1 2 1 both ways: what is finer than the cubic reads well is mostly noise."""
    values = grey.astype(np.uint16)
    down = values[:-2] + values[2:]
    down += 2 * values[1:-1]
    smooth = down[:, :-2] + down[:, 2:]
    smooth += 2 * down[:, 1:-1]
    return np.asarray(np.multiply(smooth, np.float32(1 / 16), dtype=np.float32))


def _centred(values: FloatArray32) -> FloatArray32:
    """(K, P) of (H, W, P): the pixels of a window in one axis, their mean taken off."""
    flat = values.reshape(-1, values.shape[-1])
    return np.asarray(flat - flat.mean(axis=0))


def _read(theirs: FloatArray32, weights: FloatArray32) -> FloatArray32:
    """(H, W - 4, P) right values: the sums of 3 or 5 neighbours, weighted by (3, P) or (5, P)."""
    width = theirs.shape[1] - 2 * _REACH
    first = _REACH - len(weights) // 2
    total = np.asarray(weights[0] * theirs[:, first : first + width])
    part = np.empty_like(total)
    for start, weight in enumerate(weights[1:], first + 1):
        total += np.multiply(weight, theirs[:, start : start + width], out=part)
    return total


def _linear_weights(place: FloatArray32) -> FloatArray32:
    """(3, P) weights of the neighbours for a place within -1 .. 1; good enough for a first step."""
    return np.asarray(np.stack([np.maximum(-place, 0.0), 1.0 - np.abs(place), np.maximum(place, 0.0)]))


def _cubic_weights(place: FloatArray32) -> FloatArray32:
    """(5, P) weights of the neighbours for a place within -1 .. 1: Lagrange's cubic through the four around it."""
    below = np.minimum(np.floor(place), 0.0)
    t = place - below
    four = (
        -t * (t - 1) * (t - 2) / 6,
        (t + 1) * (t - 1) * (t - 2) / 2,
        -(t + 1) * t * (t - 2) / 2,
        (t + 1) * t * (t - 1) / 6,
    )
    weights = np.zeros((2 * _REACH + 1, len(place)), np.float32)
    is_left = below < 0
    for number, weight in enumerate(four):
        weights[number] += np.where(is_left, weight, np.float32(0.0))
        weights[number + 1] += np.where(is_left, np.float32(0.0), weight)
    return weights


class _Fit(NamedTuple):
    """Least squares of P windows: the step still to go, the gain, the variance of the step, and of a grey value."""

    step: FloatArray32
    gain: FloatArray32
    variance: FloatArray32
    noise: FloatArray32


class _Equations(NamedTuple):
    """left = gain right + step slope + bias in P windows of K pixels: `ours`, `slope` (K, P), centred, and products."""

    ours: FloatArray32
    slope: FloatArray32
    ours2: FloatArray32
    slope2: FloatArray32
    slope_ours: FloatArray32

    @classmethod
    def of(cls, left: FloatArray32) -> _Equations:
        """From smoothed left windows (H, W + 2, P)."""
        slope, ours = _centred(0.5 * (left[:, 2:] - left[:, :-2])), _centred(left[:, 1:-1])
        return cls(ours, slope, _dot(ours, ours), _dot(slope, slope), _dot(slope, ours))

    def fit(self, theirs: FloatArray32) -> _Fit:
        """Solved for right values (H, W, P) as they are: products with what is centred need not be."""
        theirs = theirs.reshape(-1, theirs.shape[-1])
        theirs2 = _dot(theirs, theirs) - theirs.sum(axis=0) ** 2 / len(theirs)
        slope_theirs, theirs_ours = _dot(self.slope, theirs), _dot(theirs, self.ours)
        determinant = self.slope2 * theirs2 - slope_theirs**2 + np.float32(1e-3)
        step = (self.slope_ours * theirs2 - theirs_ours * slope_theirs) / determinant
        gain = (theirs_ours * self.slope2 - self.slope_ours * slope_theirs) / determinant
        rest = np.maximum(self.ours2 - gain * theirs_ours - step * self.slope_ours, 0.0) / (len(theirs) - 4)
        information = np.maximum(determinant / (np.maximum(theirs2, 0.0) + np.float32(1e-3)), np.float32(1e-6))
        noise = np.float32(_ALIKE) * (rest + np.float32(_LEAST_NOISE_GREY2))
        return _Fit(step, gain, noise / information, noise)


def _moved_by_rows(
    left: FloatArray32, seen: FloatArray32, equations: _Equations, fit: _Fit, is_sure: BoolArray
) -> FloatArray32:
    """(P,) px that each window's disparity is too small because the rows of its box's two views do not match.

    Args:
        left: smoothed left windows (H, W + 2, P).
        seen: the right values (H, W, P) they were fitted to.
        equations: which were solved.
        fit: how.
        is_sure: (N, G) windows that say something of their box's rows.
    """
    width = seen.shape[1]
    inner = slice(width, -width)  # no derivative downwards in the first and the last row
    down = _centred(0.5 * (left[2:, 1:-1] - left[:-2, 1:-1]))
    slope, theirs = equations.slope[inner], seen.reshape(-1, seen.shape[2])[inner]
    down_slope = _dot(down, slope)
    share = down_slope / np.maximum(_dot(slope, slope), np.float32(1e-3))
    down_rest = _dot(down, equations.ours[inner]) - fit.step * down_slope - fit.gain * _dot(down, theirs)
    weight = is_sure.ravel() / fit.noise
    per_box = (is_sure.shape[0], -1)
    wanted = (weight * down_rest).reshape(per_box).sum(axis=1)
    known = (weight * (_dot(down, down) - share * down_slope)).reshape(per_box).sum(axis=1)
    rows_px = wanted / (known + _ROWS_SD_PX**-2)
    return np.asarray(share * np.repeat(rows_px, is_sure.shape[1]), np.float32)


def _dot(a: FloatArray32, b: FloatArray32) -> FloatArray32:
    """(P,) of (K, P) each."""
    return np.asarray(np.einsum("kp,kp->p", a, b), np.float32)
