"""Robust least-squares fit of a lane to the pixels of its two lines, with a prior and Tukey's biweight.

    minimise over s  sum_i rho((x_i - x(y_i; s)) / sigma_i) + (s - s0)' P^-1 (s - s0)

s is the lane state, s0 and P are the mean and covariance of the expected state. The minimum is found by iterative
reweighting (Beaton and Tukey 1974). Errors of neighbouring pixels are correlated, so the pixels of a line have the
weight of only a few independent ones. If only one line is visible, the other follows from the expected width.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.detection.lanes.markings import Markings
from track_range.detection.lanes.model import LaneState
from track_range.foundation.arrays import BoolArray, FloatArray

SIDES = (-1.0, 1.0)
"""`side` of the left and the right line in `LaneState`'s methods."""

_N_ROUNDS = 4  # of reweighting
_FIRST_GATE, _LAST_GATE = 0.10, 0.03  # distance of a line's pixels from it in the first and last round, in lane widths
_TUKEY = 4.0  # residual in sigmas above which pixels have no weight (Tukey's constant)
_PAINT_SIGMA = 0.01  # in lane widths, of the detected centre of a painted line, which is 0.1 to 0.3 m wide
_MAX_INDEPENDENT = 8.0  # total weight of a line's pixels, in independent pixels
_MIN_PIXELS = 6  # of a visible line
_MARGIN = 0.12  # from the lines in lane widths, within which markings are not clutter, for double lines
_MIN_SPAN = 0.06  # extent in y of a visible line, in image heights


@dataclass(frozen=True, slots=True)
class LaneFit:
    """Result of a fit.

    Attributes:
        seen_px: top and bottom row of the pixels of the left and of the right line; None = line not visible.
    """

    state: LaneState  # the fitted lane
    seen_px: tuple[tuple[float, float] | None, tuple[float, float] | None]
    clutter: float  # number of markings between the lines divided by the number on them, in the rows of the lines


def fit_lane(markings: Markings, expected: LaneState, lines: tuple[int, int] = (-1, -1)) -> LaneFit:
    """The lane fitted to the markings near `expected`, the prior and first value of the fit.

    `lines` are the numbers of the left and the right line among the markings; -1 = all markings near the line.
    """
    state = expected
    prior = np.asarray(np.linalg.inv(expected.covariance), np.float64)
    for gate in np.geomspace(_FIRST_GATE, _LAST_GATE, _N_ROUNDS).tolist():
        left = _pixels(markings, state, SIDES[0], lines[0], gate)
        right = _pixels(markings, state, SIDES[1], lines[1], gate)
        state = _updated(markings, expected, prior, about=state, seen=(left, right))
    y_px = markings.xy_px[:, 1]
    return LaneFit(state, (_span(y_px[left]), _span(y_px[right])), _clutter(markings, state, left | right))


def _pixels(markings: Markings, state: LaneState, side: float, number: int, gate: float) -> BoolArray:
    """(N,) mask of the markings that belong to a line; none if they are too few."""
    x, y = markings.xy_px.T
    width_px = state.width_px(y)
    off_px = np.abs(x - state.x_px(y, side))
    is_on_line = (width_px > 0) & (off_px < gate * width_px + 2 * markings.sigma_px)
    if number >= 0:
        is_on_line &= markings.line == number
    is_visible = is_on_line.sum() >= _MIN_PIXELS and np.ptp(y[is_on_line]) >= _MIN_SPAN * state.image_hw[0]
    return np.asarray(is_on_line & is_visible)


def _updated(
    markings: Markings, expected: LaneState, prior: FloatArray, *, about: LaneState, seen: tuple[BoolArray, BoolArray]
) -> LaneState:
    """One iteration: the state from the prior, with information matrix `prior`, and pixels weighted about `about`."""
    information = prior
    pull = information @ expected.mean
    for side, is_on_line in zip(SIDES, seen, strict=True):
        if not is_on_line.any():
            continue
        x, y = markings.xy_px[is_on_line].T
        rows = about.rows(y, side)
        sigma_px = np.hypot(markings.sigma_px, _PAINT_SIGMA * about.width_px(y))
        residual = (x - rows @ about.mean) / sigma_px
        fraction = min(1.0, _MAX_INDEPENDENT / is_on_line.sum())
        weight = np.maximum(1 - (residual / _TUKEY) ** 2, 0.0) ** 2 / sigma_px**2 * fraction
        information = information + (rows * weight[:, None]).T @ rows
        pull = pull + rows.T @ (weight * x)
    covariance = np.asarray(np.linalg.inv(information), np.float64)
    return LaneState(covariance @ pull, covariance, expected.image_hw)


def _clutter(markings: Markings, state: LaneState, on_lines: BoolArray) -> float:
    """See `LaneFit`."""
    if not on_lines.any():
        return 0.0
    x, y = markings.xy_px.T
    across = (x - state.x_px(y, SIDES[0])) / np.maximum(state.width_px(y), 1.0)
    between = (across > _MARGIN) & (across < 1 - _MARGIN) & (y >= y[on_lines].min()) & (y <= y[on_lines].max())
    return float(between.sum() / on_lines.sum())


def _span(y_px: FloatArray) -> tuple[float, float] | None:
    return (float(y_px.min()), float(y_px.max())) if len(y_px) else None
