"""OwnLane: follows the own lane's two lines from image to image, by real time steps.

choose two lines -> fit them about what the past expects -> accept, or start anew where images go on contradicting it.
A line that is not seen for a while, and lines that cross, are no lines.
"""

from __future__ import annotations

import numpy as np

from track_range.detection.lanes.choice import own_pair
from track_range.detection.lanes.fit import SIDES, LaneFit, fit_lane
from track_range.detection.lanes.lines import LaneLine, LaneLines
from track_range.detection.lanes.markings import Markings, Proposals, proposals
from track_range.detection.lanes.model import LaneState
from track_range.foundation.arrays import FloatArray

_FORGOTTEN_S = 0.5  # a line unseen for longer is not where it was
_CONTRADICTED_S = 0.25  # after so long of images that show another lane, that one is followed
_JUMP = 0.25  # lane widths in a near row: another lane, or nonsense
_WIDTH_SLOPE_LIMITS = (0.8, 6.0)  # lane width / camera height
_MAX_CLUTTER = 1.2  # 0 to 0.7 on roads, 2 to 3 in the shade of trees, where edges are all over the asphalt


class OwnLane:
    """The lane of one video.

    Attributes:
        state: the lane as believed after the last image; None = none.
    """

    def __init__(self) -> None:
        """Know nothing yet."""
        self.state: LaneState | None = None
        self._time_s = -np.inf
        self._agreed_s = -np.inf
        self._seen_s = [-np.inf, -np.inf]
        self._rows_px: list[tuple[float, float]] = [(np.nan, np.nan), (np.nan, np.nan)]

    def forget(self) -> None:
        """Start anew."""
        self.state = None
        self._seen_s = [-np.inf, -np.inf]

    def update(self, markings: Markings, time_s: float, image_hw: tuple[int, int]) -> LaneLines:
        """The own lane in an image with these markings."""
        is_stale = time_s - self._time_s > _FORGOTTEN_S
        if self.state is not None and (is_stale or self.state.image_hw != image_hw):
            self.forget()
        expected = None if self.state is None else self.state.after(max(time_s - self._time_s, 0.0))
        self._time_s = time_s
        fit = self._fit(markings, expected, image_hw)
        self.state = expected if fit is None else fit.state
        if fit is not None:
            self._remember(fit, time_s)
        if self.state is not None and max(self._seen_s) < time_s - _FORGOTTEN_S:
            self.forget()
        return self._lines(time_s)

    def _fit(self, markings: Markings, expected: LaneState | None, image_hw: tuple[int, int]) -> LaneFit | None:
        """The lane that this image shows: the one that was followed, or a new one; None = none that can be believed."""
        proposed = proposals(markings, image_hw)
        pair = own_pair(proposed, image_hw, expected)
        found = None if pair is None else _fit_pair(markings, proposed, pair, image_hw)
        if expected is None:
            self._agreed_s = self._time_s
            return found
        if found is None or _jump(found.state, expected) < _JUMP:
            self._agreed_s = self._time_s
        elif self._time_s - self._agreed_s >= _CONTRADICTED_S:
            self.forget()
            return found
        numbers = _numbers(proposed, pair) if found is not None and self._agreed_s == self._time_s else (-1, -1)
        fit = fit_lane(markings, expected, numbers)
        return fit if any(fit.seen_px) and _is_lane(fit) else None

    def _remember(self, fit: LaneFit, time_s: float) -> None:
        for side, rows_px in enumerate(fit.seen_px):
            if rows_px is not None:
                self._seen_s[side], self._rows_px[side] = time_s, rows_px

    def _lines(self, time_s: float) -> LaneLines:
        lines: list[LaneLine | None] = [None, None]
        for side, sign in enumerate(SIDES):
            if self.state is not None and self._seen_s[side] >= time_s - _FORGOTTEN_S:
                y_top_px, y_bottom_px = self._rows_px[side]
                lines[side] = self.state.line(sign, y_top_px=y_top_px, y_bottom_px=y_bottom_px)
        return LaneLines(*lines)


def _fit_pair(
    markings: Markings, proposed: Proposals, pair: tuple[int, int], image_hw: tuple[int, int]
) -> LaneFit | None:
    """A lane of this image alone; None unless both lines are seen and make a lane."""
    left, right = ((float(proposed.constant[i]), float(proposed.slope[i])) for i in pair)
    start = LaneState.from_straight_lines(left, right, image_hw)
    fit = fit_lane(markings, start, _numbers(proposed, pair))
    return fit if all(fit.seen_px) and _is_lane(fit) else None


def _numbers(proposed: Proposals, pair: tuple[int, int] | None) -> tuple[int, int]:
    return (-1, -1) if pair is None else (int(proposed.line[pair[0]]), int(proposed.line[pair[1]]))


def _is_lane(fit: LaneFit) -> bool:
    """Whether the lines do not cross where they are seen, and open as a lane does."""
    opening = fit.state.mean[3] / fit.state.image_hw[0]
    if not _WIDTH_SLOPE_LIMITS[0] < opening < _WIDTH_SLOPE_LIMITS[1]:
        return False
    top_px = min(rows_px[0] for rows_px in fit.seen_px if rows_px is not None)
    return bool(fit.state.horizon_px < top_px) and fit.clutter < _MAX_CLUTTER


def _jump(state: LaneState, expected: LaneState) -> float:
    """How far two lanes are apart in a near row, in lane widths."""
    y_px: FloatArray = np.array([0.9 * state.image_hw[0]])
    width_px = max(float(expected.width_px(y_px)[0]), 1.0)
    return max(abs(float((state.x_px(y_px, side) - expected.x_px(y_px, side))[0])) for side in SIDES) / width_px
