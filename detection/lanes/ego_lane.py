"""EgoLane: tracking of the two lines of the ego lane from image to image, with real time steps.

In each image, two of the proposed straight lines are chosen, by the score

    score(l, r) = support(l) + support(r) - cost * (sum of squared deviations in sigmas from a typical lane)
                                          - cost * (squared distance in sigmas from the tracked lane)

with the deviations of lane width / camera height, horizon, vanishing point and lateral camera position. The lane is
then fitted with the prediction as the prior. The fit updates the state; if several images in a row contradict the
state, it is reset. Lines that have not been seen for a while are not reported.

The height of the camera is constant, and lanes differ in width by some 10 %, so the ratio of both is learnt. Then,
where a line of the lane is hidden, the line of the neighbouring lane is not mistaken for it, since the lane would be
twice as wide.

Robust least-squares fit of a lane to the pixels of its two lines, with a prior and Tukey's biweight.

    minimise over s  sum_i rho((x_i - x(y_i; s)) / sigma_i) + (s - s0)' P^-1 (s - s0)

s is the lane state, s0 and P are the mean and covariance of the expected state. The minimum is found by iterative
reweighting (Beaton and Tukey 1974). Errors of neighbouring pixels are correlated, so the pixels of a line have the
weight of only a few independent ones. If only one line is visible, the other follows from the expected width.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from track_range.detection.lanes.lines import LaneLine, LaneLines
from track_range.detection.lanes.markings import Markings, Proposals, proposals
from track_range.detection.lanes.model import (
    HORIZON,
    HORIZON_SIGMA,
    WIDTH_SLOPE,
    WIDTH_SLOPE_LOG_SIGMA,
    LaneState,
)
from track_range.foundation.arrays import BoolArray, FloatArray

SIDES = (-1.0, 1.0)  # `side` of the left and the right line in `LaneState`'s methods
# distance of a line's pixels from it in the rounds of reweighting, in lane widths
_GATES = tuple(np.geomspace(0.10, 0.03, 4).tolist())
_TUKEY = 4.0  # residual in sigmas above which pixels have no weight (Tukey's constant)
# in lane widths, of the detected centre of a painted line, which is 0.1 to 0.3 m wide
_PAINT_SIGMA = 0.01
_MAX_INDEPENDENT = 8.0  # total weight of a line's pixels, in independent pixels
_MIN_PIXELS = 6  # of a visible line
# from the lines in lane widths, within which markings are not clutter, for double lines
_MARGIN = 0.12
_MIN_SPAN = 0.06  # extent in y of a visible line, in image heights


@dataclass(frozen=True, slots=True)
class LaneFit:
    """Result of a fit."""

    state: LaneState  # the fitted lane
    # top and bottom row of the pixels of the left and of the right line; None = line not visible
    seen_px: tuple[tuple[float, float] | None, tuple[float, float] | None]
    # number of markings between the lines divided by the number on them, in the rows of the lines
    clutter: float


def fit_lane(markings: Markings, expected: LaneState, lines: tuple[int, int] = (-1, -1)) -> LaneFit:
    """The lane fitted to the markings near `expected`, the prior and first value of the fit.

    `lines` are the numbers of the left and the right line among the markings; -1 = all markings
    near the line.
    """
    state = expected
    pixels = _Pixels.of(markings, expected, lines)
    information = np.asarray(np.linalg.inv(expected.covariance), np.float64)
    prior = information, information @ expected.mean
    for gate in _GATES:
        x_of_lines = pixels.rows @ state.mean
        seen = pixels.seen(x_of_lines, gate)
        state = pixels.fitted(x_of_lines, seen, prior)
    x, y = markings.xy_px.T
    left, right = seen
    on_lines, clutter = left | right, 0.0
    if on_lines.any():
        across = (x - state.x_px(y, SIDES[0])) / np.maximum(state.width_px(y), 1.0)
        between = (
            (across > _MARGIN)
            & (across < 1 - _MARGIN)
            & (y >= y[on_lines].min())
            & (y <= y[on_lines].max())
        )
        clutter = float(between.sum() / on_lines.sum())
    left_px, right_px = (
        (float(y[seen].min()), float(y[seen].max())) if seen.any() else None
        for seen in (left, right)
    )
    return LaneFit(state, (left_px, right_px), clutter)


class _Pixels(NamedTuple):
    """N markings as pixels of the left and of the right line."""

    x: FloatArray  # (N,)
    y: FloatArray  # (N,)
    # (2, N, 5) derivatives of the x of each line with respect to the state in their rows
    rows: FloatArray
    is_candidate: BoolArray  # (2, N) which may belong to each line
    sigma_px: float
    image_hw: tuple[int, int]

    @classmethod
    def of(cls, markings: Markings, expected: LaneState, lines: tuple[int, int]) -> "_Pixels":
        """The markings with the numbers `lines` in an image of the expected lane; -1 = all."""
        x, y = markings.xy_px.T.copy()
        rows = np.stack([expected.rows(y, side) for side in SIDES])
        number = np.array(lines)[:, None]
        is_candidate = (number < 0) | (markings.line == number)
        return cls(x, y, rows, is_candidate, markings.sigma_px, expected.image_hw)

    def seen(self, x_of_lines: FloatArray, gate: float) -> BoolArray:
        """(2, N) masks of the markings that belong to each line; none if there are too few.

        `x_of_lines` (2, N) are the lines in the rows of the markings.
        """
        width_px = x_of_lines[1] - x_of_lines[0]
        reach_px = np.where(width_px > 0, gate * width_px + 2 * self.sigma_px, 0.0)
        is_on_line = np.abs(self.x - x_of_lines) < reach_px
        is_on_line &= self.is_candidate
        for is_seen in is_on_line:
            y = self.y[is_seen]
            if len(y) < _MIN_PIXELS or y.max() - y.min() < _MIN_SPAN * self.image_hw[0]:
                is_seen[:] = False
        return np.asarray(is_on_line)

    def fitted(
        self, x_of_lines: FloatArray, seen: BoolArray, prior: tuple[FloatArray, FloatArray]
    ) -> LaneState:
        """One iteration: the state from the prior, as information (5, 5) and its product with the
        mean, and the markings `seen` (2, N), weighted by their distances from lines (2, N).
        """
        information, pull = prior
        width_px = x_of_lines[1] - x_of_lines[0]
        variance_px2 = self.sigma_px**2 + (_PAINT_SIGMA * width_px) ** 2
        residual2 = (self.x - x_of_lines) ** 2 / variance_px2
        n_seen = np.maximum(np.count_nonzero(seen, axis=1), 1)
        fraction = np.minimum(1.0, _MAX_INDEPENDENT / n_seen)[:, None]
        weight = np.maximum(1 - residual2 / _TUKEY**2, 0.0) ** 2 / variance_px2 * (fraction * seen)
        weighted = self.rows.reshape(-1, 5).T * weight.ravel()
        information = information + weighted @ self.rows.reshape(-1, 5)
        pull = pull + weighted @ np.concatenate([self.x, self.x])
        covariance = np.asarray(np.linalg.inv(information), np.float64)
        return LaneState(covariance @ pull, covariance, self.image_hw)


_MAX_UNSEEN_S = 0.5  # after which a line without observations is no longer reported
# of observations that contradict the state, after which the observed lane replaces it
_MAX_CONTRADICTED_S = 0.25
_MAX_JUMP = 0.25  # of the lane between images, in lane widths in a near row
_WIDTH_SLOPE_LIMITS = (0.8, 6.0)  # plausible lane width / camera height
_LEARNT_SIGMA = 0.13  # of the logarithm of that ratio in a drive: lanes are 3.0 to 3.75 m wide
_OBSERVED_SIGMA = 1.0  # of it as one image shows it: a wrong lane stays wrong in many images
# largest `LaneFit.clutter`: 0 to 0.7 on roads, 2 to 3 in tree shade, which has edges all over
_MAX_CLUTTER = 1.2
_MIN_SUPPORT = 0.3  # of a line, relative to the one with the largest support in the image
_MAX_SIGMAS = 3.0  # deviation of a pair in each of the quantities of a typical lane
_OFFSET_SIGMA = 0.25  # of the camera's lateral offset from the lane centre, in lane widths
# largest such offset: 0.5 above a line, and 0.1 each for the place and the yaw of the camera
_MAX_OFFSET = 0.7
_CENTRE_SIGMA = 0.15  # of the vanishing point's x from the image centre, in image widths
_COST = 0.2  # of a deviation of one sigma, in units of support
_MIN_SCORE = 0.3  # of a pair: two lines of full support (2) may deviate by a total of 3 sigmas
# of a line inside a pair, from its middle and between two rows, in widths of the pair
_INSIDE, _MAX_SKEW = 0.25, 0.1
_TRACKED_SIGMA = 0.12  # of a line's x from the tracked lane, in lane widths
# from the tracked lane, in sigmas squared, large enough to recover from a wrong lane
_MAX_DEPARTURE = 1.5


class EgoLane:
    """Tracker of the ego lane in one video; `state` is the lane after the latest image, None = no
    lane.
    """

    def __init__(self) -> None:
        self.state: LaneState | None = None
        # mean and sigma in this drive
        self._width_slope = math.log(WIDTH_SLOPE), WIDTH_SLOPE_LOG_SIGMA
        self._time_s = -np.inf
        self._agreed_s = -np.inf
        self._seen_s = [-np.inf, -np.inf]
        self._rows_px: list[tuple[float, float]] = [(np.nan, np.nan), (np.nan, np.nan)]

    def reset(self) -> None:
        """Remove the lane."""
        self.state = None
        self._seen_s = [-np.inf, -np.inf]

    def update(self, markings: Markings, time_s: float, image_hw: tuple[int, int]) -> LaneLines:
        """The lines of the ego lane in an image, (height, width) `image_hw`, from its markings."""
        is_stale = time_s - self._time_s > _MAX_UNSEEN_S
        if self.state is not None and (is_stale or self.state.image_hw != image_hw):
            self.reset()
        expected = None if self.state is None else self.state.after(max(time_s - self._time_s, 0.0))
        self._time_s = time_s
        fit = self._fit(markings, expected, image_hw)
        self.state = expected if fit is None else fit.state
        lines: list[LaneLine | None] = [None, None]
        for side, sign in enumerate(SIDES):
            if fit is not None and (rows_px := fit.seen_px[side]) is not None:
                self._seen_s[side], self._rows_px[side] = time_s, rows_px
            if self.state is not None and self._seen_s[side] >= time_s - _MAX_UNSEEN_S:
                y_top_px, y_bottom_px = self._rows_px[side]
                lines[side] = self.state.line(sign, y_top_px=y_top_px, y_bottom_px=y_bottom_px)
        if self.state is not None and None not in lines:
            self._learn_width(math.log(self.state.mean[3] / image_hw[0]))
        if lines == [None, None]:
            self.reset()
        return LaneLines(*lines)

    def _learn_width(self, log_slope: float) -> None:
        mean, sigma = self._width_slope
        gain = sigma**2 / (sigma**2 + _OBSERVED_SIGMA**2)
        self._width_slope = (
            mean + gain * (log_slope - mean),
            max(sigma * math.sqrt(1.0 - gain), _LEARNT_SIGMA),
        )

    def _fit(
        self, markings: Markings, expected: LaneState | None, image_hw: tuple[int, int]
    ) -> LaneFit | None:
        proposed = proposals(markings, image_hw)
        pair = own_pair(proposed, image_hw, expected, self._width_slope)
        observed, numbers = None, (-1, -1)
        if pair is not None:
            numbers = int(proposed.line[pair[0]]), int(proposed.line[pair[1]])
            left, right = np.column_stack([proposed.constant, proposed.slope])[list(pair)].tolist()
            fit = fit_lane(markings, LaneState.from_straight_lines(left, right, image_hw), numbers)
            observed = fit if all(fit.seen_px) and _is_lane(fit) else None
        if expected is None:
            self._agreed_s = self._time_s
            return observed
        if observed is None or _jump(observed.state, expected) < _MAX_JUMP:
            self._agreed_s = self._time_s
        elif self._time_s - self._agreed_s >= _MAX_CONTRADICTED_S:
            self.reset()
            return observed
        is_same_lane = observed is not None and self._agreed_s == self._time_s
        fit = fit_lane(markings, expected, numbers if is_same_lane else (-1, -1))
        return fit if any(fit.seen_px) and _is_lane(fit) else None


def _is_lane(fit: LaneFit) -> bool:
    """Whether the lane has a plausible width and little clutter, the camera is in it, and its lines
    do not cross where they are seen.
    """
    height, width = fit.state.image_hw
    opening = fit.state.mean[3] / height
    bottom_px: FloatArray = np.array([float(height)])
    left_px, right_px = (float(fit.state.x_px(bottom_px, side)[0]) for side in SIDES)
    offset_px = abs(width - left_px - right_px) / 2
    is_own = offset_px < _MAX_OFFSET * (right_px - left_px)
    if not is_own or not _WIDTH_SLOPE_LIMITS[0] < opening < _WIDTH_SLOPE_LIMITS[1]:
        return False
    horizon_px, (left, right) = fit.state.horizon_px, fit.seen_px
    is_below_horizon = (left is None or horizon_px < left[0]) and (
        right is None or horizon_px < right[0]
    )
    return is_below_horizon and fit.clutter < _MAX_CLUTTER


def _jump(state: LaneState, expected: LaneState) -> float:
    """Distance between two lanes in a near row, in lane widths."""
    y_px: FloatArray = np.array([0.9 * state.image_hw[0]])
    width_px = max(float(expected.width_px(y_px)[0]), 1.0)
    return (
        max(abs(float((state.x_px(y_px, side) - expected.x_px(y_px, side))[0])) for side in SIDES)
        / width_px
    )


def own_pair(
    proposed: Proposals,
    image_hw: tuple[int, int],
    tracked: LaneState | None,
    log_width_slope: tuple[float, float] = (math.log(WIDTH_SLOPE), WIDTH_SLOPE_LOG_SIGMA),
) -> tuple[int, int] | None:
    """Numbers of the proposals that are the lane's left and right line, given a `tracked` lane;
    None = no such pair.

    `log_width_slope` is the logarithm of lane width / camera height and its standard deviation.
    """
    if len(proposed) < 2:
        return None
    sigmas = _deviations(proposed, image_hw, log_width_slope)
    is_strong = proposed.support >= _MIN_SUPPORT
    is_possible = (sigmas < _MAX_SIGMAS).all(axis=0) & is_strong[:, None] & is_strong
    score = proposed.support[:, None] + proposed.support[None, :] - _COST * (sigmas**2).sum(axis=0)
    is_possible &= score >= _MIN_SCORE
    score -= _between(proposed, image_hw, is_possible)
    if tracked is not None:
        score = score - _COST * _departure(proposed, tracked)
    score = np.where(is_possible, score, -np.inf)
    left, right = np.unravel_index(int(score.argmax()), score.shape)
    return (int(left), int(right)) if np.isfinite(score[left, right]) else None


def _between(proposed: Proposals, image_hw: tuple[int, int], is_possible: BoolArray) -> FloatArray:
    """(K, K) support of the strongest line inside each possible pair, parallel to it on the road:
    the pair is then of two lanes.
    """
    y_px = image_hw[0] * np.array([0.95, 0.75])
    x_px = proposed.constant[:, None] + proposed.slope[:, None] * y_px
    left, right = np.nonzero(is_possible)
    first, width_px = x_px[left, None], x_px[right, None] - x_px[left, None]
    near, far = np.moveaxis((x_px - first) / np.where(width_px > 0, width_px, np.nan), 2, 0)
    is_inside = (np.abs(near - 0.5) < _INSIDE) & (np.abs(near - far) < _MAX_SKEW)
    support = np.zeros(is_possible.shape)
    support[left, right] = (is_inside * proposed.support).max(axis=1, initial=0.0)
    return support


def _deviations(
    proposed: Proposals, image_hw: tuple[int, int], log_width_slope: tuple[float, float]
) -> FloatArray:
    """(4, K, K) deviations of each pair (left, right) from a typical lane, in sigmas; inf if it
    cannot be a lane.
    """
    height, width = image_hw
    slope_left, slope_right = proposed.slope[:, None], proposed.slope[None, :]
    opening = slope_right - slope_left
    is_lane = opening > 0.2
    opening = np.where(is_lane, opening, 1.0)
    horizon_px = (proposed.constant[:, None] - proposed.constant[None, :]) / opening
    vanishing_x_px = proposed.constant[:, None] + slope_left * horizon_px
    offset = (slope_left + slope_right) / 2 / opening
    sigmas = np.stack(
        [
            (np.log(opening) - log_width_slope[0]) / log_width_slope[1],
            (horizon_px / height - HORIZON) / HORIZON_SIGMA,
            (vanishing_x_px / width - 0.5) / _CENTRE_SIGMA,
            offset / _OFFSET_SIGMA,
        ]
    )
    return np.where(is_lane, np.abs(sigmas), np.inf)


def _departure(proposed: Proposals, tracked: LaneState) -> FloatArray:
    """(K, K) squared distance in sigmas of each pair from the tracked lane, mean of a near and a
    middle row.
    """
    y_px = tracked.image_hw[0] * np.array([0.95, 0.75])
    x_px = proposed.constant[:, None] + proposed.slope[:, None] * y_px
    width_px = np.maximum(tracked.width_px(y_px), 1.0)
    left, right = (
        ((x_px - tracked.x_px(y_px, side)) / width_px / _TRACKED_SIGMA) ** 2 for side in SIDES
    )
    both = (left.mean(axis=1)[:, None] + right.mean(axis=1)[None, :]) / 2
    return np.asarray(np.minimum(both, _MAX_DEPARTURE), np.float64)
