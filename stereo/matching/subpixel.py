"""Subpixel disparities: least squares on the grey values of each window of a surface (Lucas &
Kanade 1981).

Census uses only the order of grey values: it determines the disparity to a pixel, but the steps of
its bits bias the subpixel minimum. Starting from the surface d(x, y) through the census
disparities, with g the left tile's derivative along the row,

    left(x) = a right(x - d(x, y)) + s g(x) + b        d of the window <- d - s        twice

The gain a and the bias b belong to each window, so that the cameras' exposures may differ, as with
census. The derivative is the left tile's in both iterations. The first one uses every third column
and interpolates right(x - d) linearly, the last one by a cubic, which shifts all frequencies of a
smoothed image by nearly the same amount: no fraction of a pixel is preferred. The variance of d
follows from the least squares, with the residuals as the noise. The surface is fitted again to the
windows that the grey values confirm.

A vertical offset between the images shifts slanted edges sideways: on KITTI's cars by up to half a
pixel per pixel. So one vertical offset per box is fitted to the residuals, and its effect on each
window's d removed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, FloatArray32, IntArray
from track_range.stereo.matching.surfaces import (
    SurfaceFit,
    centre_weights,
    fit_surfaces,
    surface_terms,
)
from track_range.stereo.matching.tiles import MARGIN_PX, BoxTiles, Grey, window_sums

_N_FIT_ITERATIONS = (2, 3)  # of the surface, for each iteration of the least squares on grey values

_STEP = 3  # the first iterations use every third column
_MAX_STEP_PX = 0.75  # largest |s| of a confirmed window, px of the tile
# smallest gain a, and 1 / a, of a confirmed window: below, the pixels hardly resemble each other
_MIN_GAIN = 0.3
_MAX_SIGMA_PX = 0.2  # largest standard deviation of d of a confirmed window, px of the tile
_UNCONFIRMED_SIGMA_PX = 0.2  # of a window that keeps its census disparity, px of the tile
_BINOMIAL, _MIDDLE_GREY = np.array([0.25, 0.5, 0.25], np.float32), 128.0
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


def _rows(sums: str, covariances: str) -> IntArray:
    """(3, C) row of the product and of both factors of each covariance among the sums, all by their
    names in `_Equations`: <g, l> has the sums gl, g and l.
    """
    names = sums.split()
    parts = ((product, *product) for product in covariances.split())
    return np.array([[names.index(name) for name in part] for part in parts]).T


# of the last iteration, and of those without the derivative h down the column
_COVARIANCES = _rows("l g ll gg gl h hl gh hh r rr gr rl hr", "ll gg gl rr gr rl hl gh hh hr")
_SOME_COVARIANCES = _rows("l g ll gg gl r rr gr rl", "ll gg gl rr gr rl")


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
    disparity = np.maximum(tiles.first + plane.p[:, 0], 0.1)
    floor = _FLOOR_PX**2 + (_FLOOR_FRACTION * disparity[:, None]) ** 2
    central, terms = centre_weights(tiles.u, tiles.v), surface_terms(tiles.u, tiles.v)
    equations, fit = _Equations.of(tiles), plane
    last = tiles.n_disparities - 2.0
    for iteration, n_iterations in enumerate(_N_FIT_ITERATIONS):
        step = equations.solve(fit, is_last=iteration == len(_N_FIT_ITERATIONS) - 1)
        is_fitted = (
            (np.abs(step.s) < _MAX_STEP_PX) & (step.a > _MIN_GAIN) & (step.a * _MIN_GAIN < 1.0)
        )
        is_confirmed = is_fitted & (step.variance < _MAX_SIGMA_PX**2) & is_member
        s = (
            step.s
            if step.vertical is None
            else step.s - _vertical_offset_fraction(step.vertical, is_confirmed)
        )
        at_windows = np.minimum(np.maximum(fit.at_terms(terms), 1.0), last)
        refined = np.where(is_confirmed, at_windows - s, index)
        variance = np.where(is_confirmed, step.variance, _UNCONFIRMED_SIGMA_PX**2) + floor
        weight = np.where(is_member, 1.0 / variance, 0.0)
        fit = fit_surfaces(
            refined,
            weight * central,
            terms,
            disparity=disparity,
            is_curved=True,
            n_iterations=n_iterations,
        )
    residual = np.where(is_member, refined - fit.at_terms(terms), np.nan)
    return RefinedSurface(fit, residual, weight, is_confirmed)


def _smooth(grey: Grey) -> FloatArray32:
    """(W, N, H) grey values smoothed by the binomial filter 1 2 1 on both axes: the cubic then
    interpolates well. The first and the last row of a box have no meaning.

    They are about 0, since sums of small numbers keep the precision of 32 bits.
    """
    # The rows of all boxes are one axis of an image.
    columns = grey.reshape(len(grey), -1)
    smooth = cv2.sepFilter2D(columns, cv2.CV_32F, _BINOMIAL, _BINOMIAL, delta=-_MIDDLE_GREY)
    return np.asarray(smooth, np.float32).reshape(grey.shape)


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

    # (9, W, N, H) left grey values l, less the middle grey, their derivative g along the row, the
    # products ll, gg and gl; their derivative h down the column, hl, gh and hh
    values: FloatArray32
    sums: FloatArray  # (9, N, G) their sums over the windows' pixels
    some_sums: FloatArray  # (5, N, G) sums of the first five of every third column
    grey: FloatArray32  # (W', N, H + 8) grey values of both images, less the middle grey
    tiles: BoxTiles
    positions: tuple[FloatArray, FloatArray]  # u (W, N) of the columns and v (N, H) of the rows

    @classmethod
    def of(cls, tiles: BoxTiles) -> _Equations:
        (height, width), n = tiles.shape.hw, tiles.both.shape[1]
        grey = _smooth(tiles.both)
        columns, rows = slice(MARGIN_PX, MARGIN_PX + width), slice(MARGIN_PX, -MARGIN_PX)
        values = np.empty((9, width, n, height), np.float32)
        l, g, _, _, _, h = values[:6]  # noqa: E741
        l[:] = grey[columns, :, rows]
        np.subtract(
            grey[MARGIN_PX + 1 :, :, rows][:width], grey[MARGIN_PX - 1 :, :, rows][:width], out=g
        )
        np.subtract(
            grey[columns, :, MARGIN_PX + 1 : 1 - MARGIN_PX],
            grey[columns, :, MARGIN_PX - 1 : -1 - MARGIN_PX],
            out=h,
        )
        values[1:6:4] *= np.float32(0.5)
        np.square(values[:2], out=values[2:4])
        np.multiply(g, l, out=values[4])
        np.multiply(values[:2], h, out=values[6:8])
        np.square(h, out=values[8])
        sums, some_sums = _by_window(values, tiles), _by_window(values[:5, ::_STEP], tiles, _STEP)
        return cls(values, sums, some_sums, grey, tiles, tiles.pixel_positions())

    def solve(self, surface: SurfaceFit, *, is_last: bool) -> _Step:
        """The solution with the right values at the disparities of a surface.

        The first steps use every third column, and interpolate linearly; only the last one needs
        exact fractions and the vertical offset.
        """
        step = 1 if is_last else _STEP
        l, g, _, _, _, h = self.values[:6, ::step]  # noqa: E741
        n = self.tiles.shape.window_px / step
        # r, rr, gr, rl and hr
        products = np.empty((5 if is_last else 4, *l.shape), np.float32)
        r = self._right_at(surface, products[0], step)
        np.square(r, out=products[1])
        for product, factor in zip(products[2:], (g, l, h), strict=False):
            np.multiply(r, factor, out=product)
        sums = np.concatenate(
            [self.sums if is_last else self.some_sums, _by_window(products, self.tiles, step)]
        )
        product, factor, other = _COVARIANCES if is_last else _SOME_COVARIANCES
        ll, gg, gl, rr, gr, rl, *of_h = sums[product] - sums[factor] * sums[other] / n
        determinant = gg * rr - gr**2 + 1e-3
        s = (gl * rr - rl * gr) / determinant
        a = (rl * gg - gl * gr) / determinant
        residual = np.maximum(ll - a * rl - s * gl, 0.0) / (n - 4)
        information = np.maximum(determinant / (np.maximum(rr, 0.0) + 1e-3), 1e-6)
        # as of all columns
        noise = _NOISE_CORRELATION / step * (residual + _MIN_NOISE_GREY2)
        vertical = None
        if is_last:
            hl, gh, hh, hr = of_h
            fraction = gh / np.maximum(gg, 1e-3)
            vertical = _Vertical(
                fraction, (hl - s * gh - a * hr) / noise, (hh - fraction * gh) / noise
            )
        return _Step(s, a, noise / information, vertical)

    def _right_at(self, surface: SurfaceFit, out: FloatArray32, step: int) -> FloatArray32:
        """Fill (W / step, N, H) right values at the disparities of a surface in every `step`-th
        column, by a line between two pixels, or in all columns by Lagrange's cubic through four.
        """
        width, n, height = out.shape
        padded_height = height + 2 * MARGIN_PX
        # float columns of `grey` with the right pixels, (W / step, N, H)
        column_u, row_v = self.positions
        p0, p1, p2, p3, p4 = surface.p.T
        columns = p0 + column_u[::step] * (p1 + p3 * column_u[::step])
        rows = row_v * (p2[:, None] + p4[:, None] * row_v)
        index = columns.astype(np.float32)[:, :, None] + rows.astype(np.float32)
        np.clip(index, 1.0, self.tiles.n_disparities - 2.0, out=index)
        # The strip follows the left tile with its margins. The first of the four pixels is in the
        # column before.
        zero = self.tiles.shape.hw[1] + 3 * MARGIN_PX + self.tiles.n_disparities - 2
        first = np.arange(zero, zero + width * step, step, dtype=np.float32)
        t = np.subtract(first[:, None, None], index, out=index)
        place = np.floor(t)
        t -= place
        # from columns to places in the flat array, which 32 bits can hold
        n_per_column = n * padded_height
        box, row = np.arange(n)[:, None], np.arange(MARGIN_PX, MARGIN_PX + height)
        place *= np.float32(n_per_column)
        place += (box * padded_height + row).astype(np.float32)
        place = place.astype(np.int64)
        pixels = self.grey.reshape(-1)
        at = pixels[n_per_column:].take(place, mode="wrap")
        after = pixels[2 * n_per_column :].take(place, mode="wrap")
        if step > 1:
            after -= at
            np.multiply(after, t, out=out)
            out += at
            return out
        before = pixels.take(place, mode="wrap")
        next_after = pixels[3 * n_per_column :].take(place, mode="wrap")
        # at + t (slope + (t - 1) / 6 (3 bend + (t + 1) twist)), with the first three differences
        slope = after - at
        bend = at - before
        np.subtract(slope, bend, out=bend)
        twist = next_after - after
        twist -= slope
        twist -= bend
        twist *= t + np.float32(1)
        bend *= np.float32(3)
        twist += bend
        twist *= (t - np.float32(1)) * np.float32(1 / 6)
        twist += slope
        twist *= t
        return np.asarray(np.add(twist, at, out=out))


def _by_window(values: FloatArray32, tiles: BoxTiles, column_step: int = 1) -> FloatArray:
    """(K, N, G) sums over the windows of arrays (K, W / column_step, N, H)."""
    return window_sums(values, tiles.shape.cell_hw, column_step=column_step).astype(np.float64)


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
