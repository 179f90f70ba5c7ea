"""Subpixel disparities: least squares on the grey values of each window of a surface (Lucas &
Kanade 1981).

Census uses only the order of grey values: it determines the disparity to a pixel, but the steps of
its bits bias the subpixel minimum. Starting from the surface d(x, y) through the census
disparities, with g the left tile's derivative along the row,

    left(x) = a right(x - d(x, y)) + s g(x) + b        d of the window <- d - s        twice

The gain a and the bias b belong to each window, so that the cameras' exposures may differ, as with
census. The derivative is the left tile's in both iterations. The first one interpolates right(x -
d) linearly, the last one by a cubic, which shifts all frequencies of a smoothed image by nearly the
same amount: no fraction of a pixel is preferred. The variance of d follows from the least squares,
with the residuals as the noise. The surface is fitted again to the windows that the grey values
confirm.

A vertical offset between the images shifts slanted edges sideways: on KITTI's cars by up to half a
pixel per pixel. So one vertical offset per box is fitted to the residuals, and its effect on each
window's d removed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, FloatArray32
from track_range.stereo.matching.surfaces import (
    SurfaceFit,
    centre_weights,
    fit_surfaces,
    surface_terms,
)
from track_range.stereo.matching.tiles import MARGIN_PX, BoxTiles, Grey, window_sums

_N_FIT_ITERATIONS = (2, 3)  # of the surface, for each iteration of the least squares on grey values
_MAX_STEP_PX = 0.75  # largest |s| of a confirmed window, px of the tile
# smallest gain a, and 1 / a, of a confirmed window: below, the pixels hardly resemble each other
_MIN_GAIN = 0.3
_MAX_SIGMA_PX = 0.2  # largest standard deviation of d of a confirmed window, px of the tile
_UNCONFIRMED_SIGMA_PX = 0.2  # of a window that keeps its census disparity, px of the tile
# smallest variance of a smoothed grey value: rounding or compression, 1 level before smoothing
_MIN_NOISE_GREY2 = 0.14
# Factor on the variance, because smoothing correlates the noise of neighbours, which least squares
# assumes to be independent; measured on exact shifts.
_NOISE_CORRELATION = 3.5
# prior of the vertical offset, px of the tile; the alignment corrects larger ones
_VERTICAL_SIGMA_PX = 0.3
# Lower limit of a window's standard deviation, px of the tile and fraction of its disparity: no
# object is smooth.
_FLOOR_PX, _FLOOR_FRACTION = 0.06, 0.01


@dataclass(frozen=True, slots=True)
class RefinedSurface:
    """The surfaces of N boxes with G windows each, px of the tile."""

    fit: SurfaceFit  # the surfaces, relative to index 0 of the costs
    # (N, G) disparity of a window minus the surface; NaN for windows that are not part of it
    residual: FloatArray
    # (N, G) 1 / variance of the windows, px^-2; 0 for windows that are not part of it
    weight: FloatArray
    # (N, G) windows whose disparity the grey values confirm; the others have their census disparity
    is_confirmed: BoolArray


def refine_surface(
    tiles: BoxTiles, index: FloatArray, is_member: BoolArray, plane: SurfaceFit
) -> RefinedSurface:
    """The surface with subpixel disparities, from census disparities (N, G) relative to index 0, px
    of the tile.

    `is_member` (N, G) are the windows of the surface, `plane` is the plane through them.
    """
    u, v = tiles.u, tiles.v
    column_u, row_v = tiles.pixel_positions()
    disparity = np.maximum(tiles.first + plane.p[:, 0], 0.1)
    floor = _FLOOR_PX**2 + (_FLOOR_FRACTION * disparity[:, None]) ** 2
    central, terms = centre_weights(u, v), surface_terms(u, v)
    equations, fit = _Equations.of(tiles), plane
    last = tiles.n_disparities - 2.0
    for iteration in range(len(_N_FIT_ITERATIONS)):
        p0, p1, p2, p3, p4 = fit.p.T
        rows, columns = row_v * (p2 + p4 * row_v), p0 + column_u * (p1 + p3 * column_u)
        at_pixels = rows.astype(np.float32)[:, None] + columns.astype(np.float32)
        at_pixels = np.minimum(np.maximum(at_pixels, np.float32(1.0)), np.float32(last))
        step = equations.solve(at_pixels, is_last=iteration == len(_N_FIT_ITERATIONS) - 1)
        is_fitted = (
            (np.abs(step.s) < _MAX_STEP_PX) & (step.a > _MIN_GAIN) & (step.a * _MIN_GAIN < 1.0)
        )
        is_confirmed = is_fitted & (step.variance < _MAX_SIGMA_PX**2) & is_member
        s = (
            step.s
            if step.vertical is None
            else step.s - _vertical_offset_fraction(step.vertical, is_confirmed)
        )
        refined = np.where(is_confirmed, np.minimum(np.maximum(fit.at(u, v), 1.0), last) - s, index)
        variance = np.where(is_confirmed, step.variance, _UNCONFIRMED_SIGMA_PX**2) + floor
        weight = np.where(is_member, 1.0 / variance, 0.0)
        central_weight, n_iterations = weight * central, _N_FIT_ITERATIONS[iteration]
        fit = fit_surfaces(
            refined,
            central_weight,
            terms,
            disparity=disparity,
            is_curved=True,
            n_iterations=n_iterations,
        )
    residual = np.where(is_member, refined - fit.at(u, v), np.nan)
    return RefinedSurface(fit, residual, weight, is_confirmed)


def _smooth(grey: Grey) -> FloatArray32:
    """(H - 2, W - 2, N) of (H, W, N), by the binomial filter 1 2 1 on both axes: the cubic then
    interpolates well.
    """
    values = grey.astype(np.uint16)
    down = values[:-2] + values[2:]
    down += 2 * values[1:-1]
    smooth = down[:, :-2] + down[:, 2:]
    smooth += 2 * down[:, 1:-1]
    return np.asarray(np.multiply(smooth, np.float32(1 / 16), dtype=np.float32))


class _Vertical(NamedTuple):
    """For the vertical offset t of a box, (N, G) each: <g, h> / <g, g>, and the window's part of
    t's equation.
    """

    fraction: FloatArray
    numerator: FloatArray
    information: FloatArray


class _Step(NamedTuple):
    """Least squares of the windows, (N, G) each: the step s, the gain a, and the variance of s."""

    s: FloatArray
    a: FloatArray
    variance: FloatArray
    vertical: _Vertical | None


class _Equations(NamedTuple):
    """The parts of `l = a r + s g + b` in windows of K pixels that do not change with the
    iterations.

    With <x, y> the covariance sum over a window's pixels, sum(x y) - sum(x) sum(y) / K, which
    removes b, the normal equations of (s, a) and their solution are

        <g, g> s + <g, r> a = <g, l>        s = (<g, l> <r, r> - <r, l> <g, r>) / D
        <g, r> s + <r, r> a = <r, l>        a = (<r, l> <g, g> - <g, l> <g, r>) / D

        D = <g, g> <r, r> - <g, r>^2        var s = noise <r, r> / D
                                            noise = (<l, l> - a <r, l> - s <g, l>) / (K - 4)

    With h the left derivative down the column, a vertical offset t between the images adds t h to
    the model; s absorbs t <g, h> / <g, g>.
    """

    l: FloatArray32  # noqa: E741  (H, W, N) left grey values, less the tile's mean
    g: FloatArray32  # (H, W, N) their derivative along the row
    h: FloatArray32  # (H, W, N) their derivative down the column
    grey: FloatArray32  # (H, W', N) grey values of both images, less the same mean
    # (9, N, G) sums of l, g, h, l l, g g, h h, g l, g h and h l over the windows' pixels
    sums: FloatArray
    tiles: BoxTiles

    @classmethod
    def of(cls, tiles: BoxTiles) -> _Equations:
        (height, width), n = tiles.shape.hw, tiles.both.shape[2]
        inner = slice(MARGIN_PX - 2, -(MARGIN_PX - 2))
        grey = _smooth(tiles.both[inner, inner])
        left = grey[:, : width + 2]
        grey -= left[::4, ::4].mean(axis=(0, 1))  # small numbers keep the precision of 32 bits
        values = np.empty((9, height, width, n), np.float32)
        l, g, h = values[:3]  # noqa: E741
        l[:] = left[1:-1, 1:-1]
        np.subtract(left[1:-1, 2:], left[1:-1, :-2], out=g)
        np.subtract(left[2:, 1:-1], left[:-2, 1:-1], out=h)
        values[1:3] *= np.float32(0.5)
        np.square(values[:3], out=values[3:6])
        np.multiply(g, l, out=values[6])
        np.multiply(h, values[1::-1], out=values[7:])
        return cls(l, g, h, np.ascontiguousarray(grey[1:-1]), _by_window(values, tiles), tiles)

    def solve(self, index: FloatArray32, *, is_last: bool) -> _Step:
        """The solution with the right values at the disparities index (H, W, N).

        The first steps interpolate linearly; only the last one needs exact fractions and the
        vertical offset.
        """
        l, g, h, n = self.l, self.g, self.h, self.tiles.shape.window_px  # noqa: E741
        values = np.empty((5 if is_last else 4, *l.shape), np.float32)
        r = self._right_at(index, values[0], is_linear=not is_last)
        np.square(r, out=values[1])
        for product, factor in zip(values[2:], (g, l, h), strict=False):
            np.multiply(r, factor, out=product)
        sum_l, sum_g, sum_h, sum_ll, sum_gg, sum_hh, sum_gl, sum_gh, sum_hl = self.sums
        sum_r, sum_rr, sum_gr, sum_rl, *sum_hr = _by_window(values, self.tiles)
        ll = sum_ll - sum_l * sum_l / n
        gg = sum_gg - sum_g * sum_g / n
        rr = sum_rr - sum_r * sum_r / n
        gl = sum_gl - sum_g * sum_l / n
        gr = sum_gr - sum_g * sum_r / n
        rl = sum_rl - sum_r * sum_l / n
        determinant = gg * rr - gr**2 + 1e-3
        s = (gl * rr - rl * gr) / determinant
        a = (rl * gg - gl * gr) / determinant
        residual = np.maximum(ll - a * rl - s * gl, 0.0) / (n - 4)
        information = np.maximum(determinant / (np.maximum(rr, 0.0) + 1e-3), 1e-6)
        noise = _NOISE_CORRELATION * (residual + _MIN_NOISE_GREY2)
        vertical = None
        if is_last:
            hh = sum_hh - sum_h * sum_h / n
            gh = sum_gh - sum_g * sum_h / n
            hl = sum_hl - sum_h * sum_l / n
            hr = sum_hr[0] - sum_h * sum_r / n
            fraction = gh / np.maximum(gg, 1e-3)
            vertical = _Vertical(
                fraction, (hl - s * gh - a * hr) / noise, (hh - fraction * gh) / noise
            )
        return _Step(s, a, noise / information, vertical)

    def _right_at(self, index: FloatArray32, out: FloatArray32, *, is_linear: bool) -> FloatArray32:
        """Fill (H, W, N) right values at the disparities index, by Lagrange's cubic through four
        pixels, or a line.
        """
        height, width, n = index.shape
        # Column of the first of the four pixels; the strip follows the left tile with its margins.
        zero = width + 2 * MARGIN_PX + self.tiles.n_disparities - 1
        column = np.arange(zero, zero + width, dtype=np.float32)[:, None] - index
        first = column.astype(np.int32)  # positive, so that this is the floor
        t = column
        t -= first
        first *= np.int32(n)
        first += np.arange(n, dtype=np.int32)
        first += np.arange(height, dtype=np.int32)[:, None, None] * np.int32(self.grey.shape[1] * n)
        pixels = self.grey.reshape(-1)
        at, after = pixels[n:].take(first, mode="wrap"), pixels[2 * n :].take(first, mode="wrap")
        if is_linear:
            after -= at
            np.multiply(after, t, out=out)
            out += at
            return out
        before, next_after = (
            pixels.take(first, mode="wrap"),
            pixels[3 * n :].take(first, mode="wrap"),
        )
        # at + t (c1 + t (c2 + t c3))
        c3 = at - after
        c3 *= np.float32(3)
        c3 += next_after
        c3 -= before
        c3 *= np.float32(1 / 6)
        c2 = before
        c2 += after
        c2 *= np.float32(0.5)
        c2 -= at
        c1 = after
        c1 -= at
        c1 -= c2
        c1 -= c3
        np.multiply(c3, t, out=out)
        for coefficient in (c2, c1):
            out += coefficient
            out *= t
        out += at
        return out


def _by_window(values: FloatArray32, tiles: BoxTiles) -> FloatArray:
    """(K, N, G) sums over the windows of arrays (K, H, W, N)."""
    sums = window_sums(values, tiles.shape.cell_hw)
    return sums.reshape(len(sums), -1, sums.shape[-1]).swapaxes(1, 2).astype(np.float64)


def _vertical_offset_fraction(vertical: _Vertical, is_confirmed: BoolArray) -> FloatArray:
    """(N, G) part of each window's s that is due to the vertical offset t of its box, from all
    confirmed windows.

    t = sum_w <h, l - a r - s g> / noise / (sum_w (<h, h> - <g, h>^2 / <g, g>) / noise + 1 /
    sigma^2)
    """
    numerator = (is_confirmed * vertical.numerator).sum(axis=1)
    information = (is_confirmed * vertical.information).sum(axis=1)
    t = numerator / (information + _VERTICAL_SIGMA_PX**-2)
    return np.asarray(vertical.fraction * t[:, None])
