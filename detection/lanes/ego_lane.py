"""EgoLane: tracking of the two lines of the ego lane from image to image, with real time steps.

In each image, two lines are chosen and fitted with the prediction as the prior. The fit updates the state; if several
images in a row contradict the state, it is reset. Lines that have not been seen for a while are not reported.
"""

from __future__ import annotations

import numpy as np

from track_range.detection.lanes.choice import own_pair
from track_range.detection.lanes.fit import SIDES, LaneFit, fit_lane
from track_range.detection.lanes.lines import LaneLine, LaneLines
from track_range.detection.lanes.markings import Markings, Proposals, proposals
from track_range.detection.lanes.model import LaneState
from track_range.foundation.arrays import FloatArray

_MAX_UNSEEN_S = 0.5
"""Time without observations after which a line is no longer reported."""

_MAX_CONTRADICTED_S = 0.25
"""Time of observations that contradict the state after which the state is replaced by the observed lane."""

_MAX_JUMP = 0.25
"""Largest change of the lane between images, in lane widths in a near row."""

_WIDTH_SLOPE_LIMITS = (0.8, 6.0)
"""Smallest and largest plausible lane width / camera height."""

_MAX_CLUTTER = 1.2
"""Largest `LaneFit.clutter` of a lane: it is 0 to 0.7 on roads, and 2 to 3 in tree shade, which has edges all over."""


class EgoLane:
    """Tracker of the ego lane in one video.

    Attributes:
        state: the lane after the latest image; None = no lane.
    """

    def __init__(self) -> None:
        """Start without a lane."""
        self.state: LaneState | None = None
        self._time_s = -np.inf
        self._agreed_s = -np.inf
        self._seen_s = [-np.inf, -np.inf]
        self._rows_px: list[tuple[float, float]] = [(np.nan, np.nan), (np.nan, np.nan)]

    def reset(self) -> None:
        """Remove the lane."""
        self.state = None
        self._seen_s = [-np.inf, -np.inf]

    def update(self, markings: Markings, time_s: float, image_hw: tuple[int, int]) -> LaneLines:
        """The lines of the ego lane in an image, (height, width) `image_hw`, with these markings."""
        is_stale = time_s - self._time_s > _MAX_UNSEEN_S
        if self.state is not None and (is_stale or self.state.image_hw != image_hw):
            self.reset()
        expected = None if self.state is None else self.state.after(max(time_s - self._time_s, 0.0))
        self._time_s = time_s
        fit = self._fit(markings, expected, image_hw)
        self.state = expected if fit is None else fit.state
        if fit is not None:
            self._update_seen(fit, time_s)
        if self.state is not None and max(self._seen_s) < time_s - _MAX_UNSEEN_S:
            self.reset()
        return self._lines(time_s)

    def _fit(self, markings: Markings, expected: LaneState | None, image_hw: tuple[int, int]) -> LaneFit | None:
        """The lane in this image: the tracked one or a new one; None = no plausible lane."""
        proposed = proposals(markings, image_hw)
        pair = own_pair(proposed, image_hw, expected)
        observed = None if pair is None else _fit_pair(markings, proposed, pair, image_hw)
        if expected is None:
            self._agreed_s = self._time_s
            return observed
        if observed is None or _jump(observed.state, expected) < _MAX_JUMP:
            self._agreed_s = self._time_s
        elif self._time_s - self._agreed_s >= _MAX_CONTRADICTED_S:
            self.reset()
            return observed
        numbers = _numbers(proposed, pair) if observed is not None and self._agreed_s == self._time_s else (-1, -1)
        fit = fit_lane(markings, expected, numbers)
        return fit if any(fit.seen_px) and _is_lane(fit) else None

    def _update_seen(self, fit: LaneFit, time_s: float) -> None:
        for side, rows_px in enumerate(fit.seen_px):
            if rows_px is not None:
                self._seen_s[side], self._rows_px[side] = time_s, rows_px

    def _lines(self, time_s: float) -> LaneLines:
        lines: list[LaneLine | None] = [None, None]
        for side, sign in enumerate(SIDES):
            if self.state is not None and self._seen_s[side] >= time_s - _MAX_UNSEEN_S:
                y_top_px, y_bottom_px = self._rows_px[side]
                lines[side] = self.state.line(sign, y_top_px=y_top_px, y_bottom_px=y_bottom_px)
        return LaneLines(*lines)


def _fit_pair(
    markings: Markings, proposed: Proposals, pair: tuple[int, int], image_hw: tuple[int, int]
) -> LaneFit | None:
    """The lane of a pair of proposals in this image, without a prediction; None if it is not plausible."""
    left, right = ((float(proposed.constant[i]), float(proposed.slope[i])) for i in pair)
    start = LaneState.from_straight_lines(left, right, image_hw)
    fit = fit_lane(markings, start, _numbers(proposed, pair))
    return fit if all(fit.seen_px) and _is_lane(fit) else None


def _numbers(proposed: Proposals, pair: tuple[int, int] | None) -> tuple[int, int]:
    """Line numbers of a pair of proposals; -1 = no number."""
    return (-1, -1) if pair is None else (int(proposed.line[pair[0]]), int(proposed.line[pair[1]]))


def _is_lane(fit: LaneFit) -> bool:
    """Whether the lane is plausible: its width, the clutter, and lines that do not cross where they are seen."""
    opening = fit.state.mean[3] / fit.state.image_hw[0]
    if not _WIDTH_SLOPE_LIMITS[0] < opening < _WIDTH_SLOPE_LIMITS[1]:
        return False
    top_px = min(rows_px[0] for rows_px in fit.seen_px if rows_px is not None)
    return bool(fit.state.horizon_px < top_px) and fit.clutter < _MAX_CLUTTER


def _jump(state: LaneState, expected: LaneState) -> float:
    """Distance of two lanes in a near row, in lane widths."""
    y_px: FloatArray = np.array([0.9 * state.image_hw[0]])
    width_px = max(float(expected.width_px(y_px)[0]), 1.0)
    return max(abs(float((state.x_px(y_px, side) - expected.x_px(y_px, side))[0])) for side in SIDES) / width_px
