"""Subpixel disparities: least squares on the grey values of each window (Lucas & Kanade 1981).

Census uses only the order of grey values: it determines the disparity to a pixel, but the steps of its bits bias the
subpixel minimum. Starting from census, with g the left window's derivative along the row,

    left(x) = a right(x - d) + s g(x) + b        d <- d - s        twice

The gain a and the bias b belong to each window, so that the cameras' exposures may differ, as with census. The
derivative is the left window's in both iterations, and the cubic that interpolates right(x - d) shifts all frequencies
of a smoothed image by nearly the same amount: no fraction of a pixel is preferred. The variance of d is that of the
least squares, with the residuals as the noise. A window is as wide as in the census, and two rows higher, because the
margin is available.

A vertical offset between the images shifts slanted edges sideways: on KITTI's cars by up to half a pixel per pixel. So
one vertical offset per box is fitted to the residuals, and its effect on each window's d removed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import BoolArray, FloatArray32, IntArray
from track_range.stereo.matching.sample_windows import WINDOW_HW, BoxWindows, GreyLevels
from track_range.stereo.matching.window_sgm import WindowMatches

_MAX_STEP_PX = 0.5
"""Largest |s| of one iteration, px of the level."""

_REACH = 2
"""Pixels read on either side of an integer disparity: the cubic needs four of these five for |fraction| <= 1 px."""

_MAX_CHANGE_PX = 0.75
"""Largest distance of a confirmed window from its census disparity, px of the level."""

_MIN_GAIN = 0.3
"""Smallest gain a of a confirmed window, and of its inverse: below, the right pixels hardly resemble the left ones."""

_MAX_SIGMA_PX = 0.2
"""Largest standard deviation of d of a confirmed window, px of the level."""

_UNCONFIRMED_SIGMA_PX = 0.6
"""Standard deviation of a window that is not confirmed and keeps its census disparity, px of the level."""

_MIN_NOISE_GREY2 = 0.14
"""Smallest variance of a smoothed grey value: rounding or compression, 1 grey level before smoothing."""

_NOISE_CORRELATION = 3.5
"""Factor on the variance, because smoothing correlates the noise of neighbours, which least squares assumes to be
independent; measured on exact shifts."""

_VERTICAL_SIGMA_PX = 0.3
"""Prior standard deviation of the vertical offset, px of the level; larger ones are corrected by the alignment."""

_FLOOR_PX, _FLOOR_SHARE = 0.06, 0.006
"""Lower limit of a window's standard deviation, px of the level, and as a fraction of its disparity: objects are not
planes."""


def refine_windows(
    left: GreyLevels, right: GreyLevels, windows: BoxWindows, matches: WindowMatches, *, first: IntArray
) -> tuple[WindowMatches, BoolArray]:
    """Window matches with offsets -1 .. 1 by least squares, and 1 / variance (px^-2 of the level) as weights.

    Args:
        left: grey levels of the left image.
        right: grey levels of the right image.
        windows: windows of N boxes, G each.
        matches: matches by census; a window without a minimum keeps weight 0.
        first: (N,) disparity of the costs' index 0, px of the level.

    Returns:
        The matches, and (N, G) whether the grey values confirm them; the others keep their census disparities.
    """
    smooth_left = _smooth(left.windows(windows, windows.column, width=WINDOW_HW[1]))
    strip_column = windows.column - (first[:, None] + matches.index) - _REACH + 1
    smooth_right = _smooth(right.windows(windows, strip_column, width=WINDOW_HW[1] + 2 * _REACH - 2))
    d = d_census = matches.offset.ravel().astype(np.float32)
    equations = _Equations.of(smooth_left)
    for interpolation_weights in (_linear_weights, _cubic_weights):
        right_at_d = _interpolated(smooth_right, interpolation_weights(-d))
        fit = equations.fit(right_at_d)
        d = np.clip(d - np.clip(fit.s, -_MAX_STEP_PX, _MAX_STEP_PX), -1.0, 1.0)
    is_fitted = (np.abs(d - d_census) < _MAX_CHANGE_PX) & (fit.a > _MIN_GAIN) & (fit.a * _MIN_GAIN < 1.0)
    shape = matches.offset.shape
    is_confirmed = (is_fitted & (fit.variance < _MAX_SIGMA_PX**2)).reshape(shape) & (matches.weight > 0)
    d = np.clip(d + _vertical_offset_share(smooth_left, right_at_d, equations, fit, is_confirmed), -1.0, 1.0)
    variance = np.where(is_confirmed, fit.variance.reshape(shape).astype(np.float64), _UNCONFIRMED_SIGMA_PX**2)
    variance += _FLOOR_PX**2 + (_FLOOR_SHARE * (first[:, None] + matches.index)) ** 2
    offset = np.where(is_confirmed, d.reshape(shape), matches.offset)
    return WindowMatches(matches.index, offset, np.where(matches.weight > 0, 1.0 / variance, 0.0)), is_confirmed


def _smooth(grey: npt.NDArray[np.uint8]) -> FloatArray32:
    """(H - 2, W - 2, P) of (H, W, P), by the binomial filter 1 2 1 both ways, so that the cubic interpolates well."""
    values = grey.astype(np.uint16)
    down = values[:-2] + values[2:]
    down += 2 * values[1:-1]
    smooth = down[:, :-2] + down[:, 2:]
    smooth += 2 * down[:, 1:-1]
    return np.asarray(np.multiply(smooth, np.float32(1 / 16), dtype=np.float32))


def _centred(values: FloatArray32) -> FloatArray32:
    """(K, P) of (H, W, P): the pixels of each window in one axis, less their mean."""
    flat = values.reshape(-1, values.shape[-1])
    return np.asarray(flat - flat.mean(axis=0))


def _interpolated(right: FloatArray32, weights: FloatArray32) -> FloatArray32:
    """(H, W - 4, P) right values between pixels of (H, W, P): sums of 3 or 5 neighbours with weights (3 or 5, P)."""
    width = right.shape[1] - 2 * _REACH
    first = _REACH - len(weights) // 2
    total = np.asarray(weights[0] * right[:, first : first + width])
    part = np.empty_like(total)
    for start, weight in enumerate(weights[1:], first + 1):
        total += np.multiply(weight, right[:, start : start + width], out=part)
    return total


def _linear_weights(position: FloatArray32) -> FloatArray32:
    """(3, P) weights of the pixels -1, 0, 1 for positions (P,) within -1 .. 1; sufficient for the first iteration."""
    return np.asarray(np.stack([np.maximum(-position, 0.0), 1.0 - np.abs(position), np.maximum(position, 0.0)]))


def _cubic_weights(position: FloatArray32) -> FloatArray32:
    """(5, P) weights of the pixels -2 .. 2 for positions (P,) within -1 .. 1: Lagrange's cubic through four of them."""
    below = np.minimum(np.floor(position), 0.0)
    t = position - below
    four = (
        -t * (t - 1) * (t - 2) / 6,
        (t + 1) * (t - 1) * (t - 2) / 2,
        -(t + 1) * t * (t - 2) / 2,
        (t + 1) * t * (t - 1) / 6,
    )
    weights = np.zeros((2 * _REACH + 1, len(position)), np.float32)
    is_left = below < 0
    for number, weight in enumerate(four):
        weights[number] += np.where(is_left, weight, np.float32(0.0))
        weights[number + 1] += np.where(is_left, np.float32(0.0), weight)
    return weights


class _Fit(NamedTuple):
    """Least squares of P windows, (P,) each: the step s, the gain a, the variance of s, and of a grey value."""

    s: FloatArray32
    a: FloatArray32
    variance: FloatArray32
    noise: FloatArray32


class _Equations(NamedTuple):
    """The parts of `l = a r + s g + b` in P windows of K pixels that do not change with the iterations.

    Centring l and g removes b. With <x, y> the dot product over a window's pixels of the centred values, the normal
    equations of (s, a) and their solution are

        <g, g> s + <g, r> a = <g, l>        s = (<g, l> <r, r> - <r, l> <g, r>) / D
        <g, r> s + <r, r> a = <r, l>        a = (<r, l> <g, g> - <g, l> <g, r>) / D

        D = <g, g> <r, r> - <g, r>^2        var s = noise <r, r> / D
                                            noise = (<l, l> - a <r, l> - s <g, l>) / (K - 4)

    Attributes:
        l: (K, P) left grey values, centred.
        g: (K, P) their derivative along the row, centred.
        ll, gg, gl: (P,) <l, l>, <g, g>, <g, l>.
    """

    l: FloatArray32  # noqa: E741 (as in the equations)
    g: FloatArray32
    ll: FloatArray32
    gg: FloatArray32
    gl: FloatArray32

    @classmethod
    def of(cls, left: FloatArray32) -> _Equations:
        """From smoothed left windows (H, W + 2, P)."""
        g, l = _centred(0.5 * (left[:, 2:] - left[:, :-2])), _centred(left[:, 1:-1])  # noqa: E741
        return cls(l, g, _dot(l, l), _dot(g, g), _dot(g, l))

    def fit(self, right: FloatArray32) -> _Fit:
        """The solution for right values (H, W, P), not centred: products with centred values need only one centred."""
        r = right.reshape(-1, right.shape[-1])
        rr = _dot(r, r) - r.sum(axis=0) ** 2 / len(r)
        gr, rl = _dot(self.g, r), _dot(r, self.l)
        determinant = self.gg * rr - gr**2 + np.float32(1e-3)
        s = (self.gl * rr - rl * gr) / determinant
        a = (rl * self.gg - self.gl * gr) / determinant
        residual = np.maximum(self.ll - a * rl - s * self.gl, 0.0) / (len(r) - 4)
        information = np.maximum(determinant / (np.maximum(rr, 0.0) + np.float32(1e-3)), np.float32(1e-6))
        noise = np.float32(_NOISE_CORRELATION) * (residual + np.float32(_MIN_NOISE_GREY2))
        return _Fit(s, a, noise / information, noise)


def _vertical_offset_share(
    left: FloatArray32, right: FloatArray32, equations: _Equations, fit: _Fit, is_confirmed: BoolArray
) -> FloatArray32:
    """(P,) px to add to each window's d because of the vertical offset t between the images of its box.

    With h the left derivative down the column, the model is l = a r + s g + t h + b; s absorbs t <g, h> / <g, g>. One t
    per box is estimated from all its confirmed windows, with the prior N(0, _VERTICAL_SIGMA_PX^2):

        t = sum_w <h, l - a r - s g> / noise / (sum_w (<h, h> - <g, h>^2 / <g, g>) / noise + 1 / sigma^2)

    Args:
        left: smoothed left windows (H, W + 2, P).
        right: right values (H, W, P) that they were fitted to.
        equations: the equations that were solved.
        fit: their solution.
        is_confirmed: (N, G) windows to use, P = N G.
    """
    width = right.shape[1]
    inner = slice(width, -width)  # no derivative down the column in the first and the last row
    h = _centred(0.5 * (left[2:, 1:-1] - left[:-2, 1:-1]))
    g, r = equations.g[inner], right.reshape(-1, right.shape[2])[inner]
    gh = _dot(h, g)
    share = gh / np.maximum(_dot(g, g), np.float32(1e-3))
    residual = _dot(h, equations.l[inner]) - fit.s * gh - fit.a * _dot(h, r)
    weight = is_confirmed.ravel() / fit.noise
    per_box = (is_confirmed.shape[0], -1)
    numerator = (weight * residual).reshape(per_box).sum(axis=1)
    information = (weight * (_dot(h, h) - share * gh)).reshape(per_box).sum(axis=1)
    t = numerator / (information + _VERTICAL_SIGMA_PX**-2)
    return np.asarray(share * np.repeat(t, is_confirmed.shape[1]), np.float32)


def _dot(a: FloatArray32, b: FloatArray32) -> FloatArray32:
    """(P,) of (K, P) each."""
    return np.asarray(np.einsum("kp,kp->p", a, b), np.float32)
