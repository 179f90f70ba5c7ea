"""Fitting a lane to the pixels of its two lines: least squares about what is expected, with Tukey's biweight.

    minimise  sum_i rho((x_i - x(y_i)) / sigma_i) + (state - expected)' P^-1 (state - expected)

A few rounds of reweighting (Beaton and Tukey 1974). Neighbouring pixels of a line err together, so all of its pixels
count as no more than a few independent ones. With only one line in sight the other stays where
the expected width puts it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.detection.lanes.markings import Markings
from track_range.detection.lanes.model import LaneState
from track_range.foundation.arrays import BoolArray, FloatArray

SIDES = (-1.0, 1.0)
"""Left and right, as `LaneState` takes them."""

_ROUNDS = 4
_FIRST_GATE, _LAST_GATE = 0.10, 0.03  # lane widths that a pixel may be off, in the first and in the last round
_TUKEY = 4.0
_PAINT = 0.01  # lane widths: where across a line of 0.1 to 0.3 m its middle is seen
_INDEPENDENT = 8.0  # pixels of a line, at most
_MIN_PIXELS = 6
_EDGE = 0.12  # lane widths beside a line that are still of its paint, for double lines
_MIN_SPAN = 0.06  # image heights that a line must be seen over


@dataclass(frozen=True, slots=True)
class LaneFit:
    """A lane and where its lines were seen.

    Attributes:
        state: the lane.
        seen_px: top and bottom row of the left and of the right line; None = that line was not seen.
        clutter: markings between the lines per marking on them, in the rows where they are seen.
    """

    state: LaneState
    seen_px: tuple[tuple[float, float] | None, tuple[float, float] | None]
    clutter: float


def fit_lane(markings: Markings, expected: LaneState, lines: tuple[int, int] = (-1, -1)) -> LaneFit:
    """The lane near `expected` that the markings show.

    Args:
        markings: pixels of any lines.
        expected: where to look, with its covariance as the prior.
        lines: numbers of the left and the right line among the markings; -1 = whatever is near.
    """
    state = expected
    seen: list[BoolArray] = []
    prior = np.asarray(np.linalg.inv(expected.covariance), np.float64)
    for gate in np.geomspace(_FIRST_GATE, _LAST_GATE, _ROUNDS).tolist():
        seen = [_pixels(markings, state, side, number, gate) for side, number in zip(SIDES, lines, strict=True)]
        state = _updated(markings, expected, prior, about=state, seen=seen)
    left, right = (_span(markings.xy_px[mine, 1]) for mine in seen)
    return LaneFit(state, (left, right), _clutter(markings, state, seen))


def _pixels(markings: Markings, state: LaneState, side: float, number: int, gate: float) -> BoolArray:
    """Which markings belong to a line; none of them if they are too few."""
    x, y = markings.xy_px.T
    width_px = state.width_px(y)
    off_px = np.abs(x - state.x_px(y, side))
    mine = (width_px > 0) & (off_px < gate * width_px + 2 * markings.sigma_px)
    if number >= 0:
        mine &= markings.line == number
    enough = mine.sum() >= _MIN_PIXELS and np.ptp(y[mine]) >= _MIN_SPAN * state.image_hw[0]
    return np.asarray(mine & enough)


def _updated(
    markings: Markings, expected: LaneState, prior: FloatArray, *, about: LaneState, seen: list[BoolArray]
) -> LaneState:
    """One round: expected, known to the information `prior`, and the pixels weighted by how well they fit `about`."""
    information = prior
    pull = information @ expected.mean
    for side, mine in zip(SIDES, seen, strict=True):
        if not mine.any():
            continue
        x, y = markings.xy_px[mine].T
        rows = about.rows(y, side)
        sigma_px = np.hypot(markings.sigma_px, _PAINT * about.width_px(y))
        off = (x - rows @ about.mean) / sigma_px
        weight = np.maximum(1 - (off / _TUKEY) ** 2, 0.0) ** 2 / sigma_px**2 * min(1.0, _INDEPENDENT / mine.sum())
        information = information + (rows * weight[:, None]).T @ rows
        pull = pull + rows.T @ (weight * x)
    covariance = np.asarray(np.linalg.inv(information), np.float64)
    return LaneState(covariance @ pull, covariance, expected.image_hw)


def _clutter(markings: Markings, state: LaneState, seen: list[BoolArray]) -> float:
    """Markings between the lines per marking on them."""
    on_lines = seen[0] | seen[1]
    if not on_lines.any():
        return 0.0
    x, y = markings.xy_px.T
    across = (x - state.x_px(y, SIDES[0])) / np.maximum(state.width_px(y), 1.0)
    between = (across > _EDGE) & (across < 1 - _EDGE) & (y >= y[on_lines].min()) & (y <= y[on_lines].max())
    return float(between.sum() / on_lines.sum())


def _span(y_px: FloatArray) -> tuple[float, float] | None:
    return (float(y_px.min()), float(y_px.max())) if len(y_px) else None
