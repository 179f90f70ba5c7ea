r"""LaneWidthRanger: distance from the width of the lane that an object stands on (Luo, the lane-width paper).

     \  w  /       d = fx W / w      W metres between the two lines, w pixels between them in the row of the box's
      \___/                          bottom edge; neighbouring lanes are taken to be as wide as the own one
      |box|        sigma_d / d = |sigma_w / w, sigma_W / W, w' sigma_y / w|
     /-----\
    /   W   \      w is linear in the row, w = w' (y - horizon), so the last term grows with the distance: it is the
                   bottom edge's error, as for any method that looks at the ground

Where lines and box are of the same image, pitching moves both, and cancels; a run looks for lines ten times a second,
and takes those of the last look in between. The point on the ground below the bottom edge is where the object begins,
so d is the distance of its surface where that is upright: a car's rear.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.lanes.lines import LaneLine, LaneLines
from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.ranging.method import ErrorSource, MethodContext, RangingMethod
from track_range.ranging.ranger import Ranger
from track_range.ranging.ranges import Ranges
from track_range.ranging.size_models.size_model import BORDER_PX
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

LANE_WIDTH_M = 3.5
"""Between the middles of the lines, unless told otherwise."""

LANE_WIDTH_SIGMA = 0.15
"""Relative, of that guess: lanes are 2.75 to 3.75 m wide by country and kind of road, and wider where a road has no
shoulders (4.2 m on KITTI 0005)."""

_ON_THE_ROAD = np.array([name not in ("traffic light", "traffic sign") for name in ROAD_CLASSES])
_REACH = (-1.1, 2.1)  # in lane widths from the left line: own lane 0 to 1, and a neighbour on either side
_FARTHEST_SEEN = 2.0  # times the distance of the farthest row in which both lines were seen
_NEAREST_SEEN = 0.5
_MIN_WIDTH_PX = 8.0
_LARGEST_SIGMA = 0.3  # relative: less sure than that is not measured
_SUREST = 0.015  # relative: what all measurements of a drive share, a detector's bottom edges, the pair's alignment
_LEAST_SURE = 0.25
_SHAKEN = 1.4
_GATE = 3.0
_FORGETTING_S = 60.0
_ROAD_SIGMA = 0.01  # relative: roads are not planes, lanes not of one width

_Widths = tuple[FloatArray, FloatArray, BoolArray]
"""(N,) lane's width in the rows of the bottom edges, px, its relative error with theirs, and whom it serves."""


@dataclass(frozen=True, slots=True)
class LaneWidth:
    """The lane's width as a guess that measurements sharpen, in logarithms.

    Attributes:
        width_m: metres between the lines.
        sigma: relative standard deviation.
    """

    width_m: float = LANE_WIDTH_M
    sigma: float = LANE_WIDTH_SIGMA

    def after(self, step_s: float) -> LaneWidth:
        """Less sure some time later: roads change."""
        variance = self.sigma**2 + LANE_WIDTH_SIGMA**2 * step_s / _FORGETTING_S
        return replace(self, sigma=min(variance**0.5, max(LANE_WIDTH_SIGMA, self.sigma)))

    def updated_with(self, width_m: FloatArray, sigma: FloatArray) -> LaneWidth:
        """Put together with widths (N,) measured in one image and their relative standard deviations, N >= 1.

        They share most of their errors, and count as one. Strays count nothing, but shake the belief: where all of them
        are strays for a while, it is the belief that is wrong (other lines are followed now).
        """
        log = np.log(width_m / self.width_m)
        good = np.abs(log) < _GATE * np.hypot(sigma, self.sigma)
        if not good.any():
            return replace(self, sigma=min(_SHAKEN * self.sigma, _LEAST_SURE))
        weight = 1.0 / sigma[good] ** 2
        found, variance = float((weight * log[good]).sum() / weight.sum()), float(1.0 / weight.mean())
        gain = self.sigma**2 / (self.sigma**2 + variance)
        return LaneWidth(self.width_m * float(np.exp(gain * found)), max(self.sigma * (1 - gain) ** 0.5, _SUREST))


class LaneWidthRanger(Ranger):
    """Ranges observed boxes that stand in the own lane or in a neighbour of it.

    Attributes:
        lane: the lane's width as known so far.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        *,
        width_m: float = LANE_WIDTH_M,
        width_sigma: float = LANE_WIDTH_SIGMA,
        box_sigma_px: float = 1.5,
        width_from: str | None = None,
    ) -> None:
        """Range for `camera` (undistorted).

        Args:
            camera: whose images the lines are found in.
            width_m: the lanes' width, between the middles of the lines.
            width_sigma: its relative standard deviation.
            box_sigma_px: standard deviation of a detected box's bottom edge.
            width_from: the method that `measure_with` learns the width from; None = the width is known.
        """
        self._camera = camera
        self._box_sigma_px = box_sigma_px
        self.lane = LaneWidth(width_m, width_sigma)
        self._width_from = width_from
        self._lines = LaneLines()
        self._last: tuple[Tracks, _Widths | None] | None = None  # `update_width` needs what `measure` has used
        self._taught_s = np.nan

    def update_lanes(self, lines: LaneLines) -> None:
        """Measure against these lines from now on."""
        self._lines, self._last = lines, None

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances of the tracks; NaN where no two lines are known.

        NaN also for boxes that are predicted, cut off at the bottom, of lights and signs, farther aside than the
        neighbouring lanes, or far outside the rows in which the lines were seen.
        """
        seen = self._seen(tracks, frame)
        if seen is None:
            return Ranges.unmeasured(tracks.track_id)
        width_px, sigma_w, good = seen
        distance_m = self._camera.fx_px * self.lane.width_m / np.where(good, width_px, np.nan)
        sigma = np.hypot(sigma_w, self.lane.sigma)
        sure = sigma < _LARGEST_SIGMA
        distance_m = np.where(sure, distance_m, np.nan)
        return Ranges(tracks.track_id, distance_m, distance_m * sigma)

    def measure_with(self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges]) -> Ranges:
        """As `measure`, with sigmas inflated where the other methods disagree with all of a frame's distances.

        Then learns the width of the lane from one of them.
        """
        ranges = inflated_by_disagreement(self.measure(tracks, frame), list(others.values()))
        if self._width_from is not None and self._width_from in others:
            self.update_width(tracks, frame, others[self._width_from])
        return ranges

    def update_width(self, tracks: Tracks, frame: Frame, measured: Ranges) -> None:
        """Learn the width of the lane from another method's distances of the same tracks.

        From then on `measure` is no longer independent of that method.
        """
        seen = self._seen(tracks, frame)
        if seen is None:
            return
        width_px, sigma_w, good = seen
        usable = good & np.isfinite(measured.distance_m) & np.isfinite(measured.sigma_m)
        if not usable.any():
            return
        distance_m, sigma_m = measured.distance_m[usable], measured.sigma_m[usable]
        step_s = 0.0 if np.isnan(self._taught_s) else max(frame.time_s - self._taught_s, 0.0)
        self._taught_s = frame.time_s
        self.lane = self.lane.after(step_s).updated_with(
            width_px[usable] * distance_m / self._camera.fx_px, np.hypot(sigma_w[usable], sigma_m / distance_m)
        )

    def _seen(self, tracks: Tracks, frame: Frame) -> _Widths | None:
        """`_widths`, worked out once for the same tracks."""
        if self._last is None or self._last[0] is not tracks:
            self._last = tracks, self._widths(tracks, frame.left.shape[0])
        return self._last[1]

    def _widths(self, tracks: Tracks, height_px: int) -> _Widths | None:
        left, right = self._lines.left, self._lines.right
        if left is None or right is None or not len(tracks):
            return None
        x1_px, _, x2_px, y_px = tracks.xyxy_px.T
        powers = np.array([np.ones_like(y_px), y_px, y_px * y_px])
        width = right.coefficients - left.coefficients  # of a polynomial of the row, as the lines are
        left_px, width_px = left.coefficients @ powers, width @ powers
        wide = np.maximum(width_px, 1.0)
        across = ((x1_px + x2_px) / 2 - left_px) / wide
        nearest_px, farthest_px = _reached_px(left, right, width)
        good = (
            tracks.observed
            & _ON_THE_ROAD[tracks.class_id]
            & (y_px < height_px - 0.5 - BORDER_PX)
            & (width_px >= max(_MIN_WIDTH_PX, farthest_px))
            & (width_px <= nearest_px)
            & (across > _REACH[0])
            & (across < _REACH[1])
        )
        opening = width[1] + 2.0 * width[2] * y_px
        of_lines = ((left.covariance + right.covariance) @ powers * powers).sum(axis=0)
        sigma_px = np.sqrt(np.maximum(of_lines, 0.0) + (self._box_sigma_px * opening) ** 2)
        return width_px, np.hypot(sigma_px / wide, _ROAD_SIGMA), good


def inflated_by_disagreement(found: Ranges, others: Sequence[Ranges]) -> Ranges:
    """Distances by lane whose sigmas know what they are all off by together, as other methods see it.

    The lines may be those of another lane, or of none: then all distances of a frame are wrong by one factor, which
    no sigma of a line's pixels tells. With e_i the logarithm of the surest other distance of track i over lane's, of
    sigma s_i together, |median e| is taken for such a factor as far as it is more than its own standard error,

        1.25 (sum 1 / s_i^2)^-1/2

    Args:
        found: N tracks, by lane.
        others: the same tracks, by other methods; those that see with two eyes or by size.
    """
    told = [(found.sigma_m / found.distance_m) ** 2 + (other.sigma_m / other.distance_m) ** 2 for other in others]
    apart = [np.log(other.distance_m / found.distance_m) for other in others]
    variance, off = np.array(told), np.array(apart)
    both = np.isfinite(variance).any(axis=0)
    if not both.any():
        return found
    surest = np.nanargmin(variance[:, both], axis=0), np.arange(both.sum())
    error = 1.25 / math.sqrt(float((1.0 / variance[:, both][surest]).sum()))
    shared = max(abs(float(np.median(off[:, both][surest]))) - error, 0.0)
    return replace(found, sigma_m=np.hypot(found.sigma_m, shared * found.distance_m))


def _reached_px(left: LaneLine, right: LaneLine, width: FloatArray) -> tuple[float, float]:
    """Lane widths as near and as far as is not much beyond the rows in which both lines were seen."""
    top, bottom = max(left.y_top_px, right.y_top_px), min(left.y_bottom_px, right.y_bottom_px)
    if top >= bottom:
        return -math.inf, math.inf  # in no row
    constant, slope, bend = width.tolist()
    top_px, bottom_px = (constant + y_px * (slope + y_px * bend) for y_px in (top, bottom))
    return bottom_px / _NEAREST_SEEN, top_px / _FARTHEST_SEEN


def _create(context: MethodContext) -> Ranger:
    # Stereo of an uncalibrated pair knows no metres that a lane's width could be learnt from.
    width_from = None if context.focal_sigma else "stereo"
    return LaneWidthRanger(context.camera, width_m=context.lane_width_m, width_from=width_from)


LANE = RangingMethod(
    name="lane",
    title="lane",
    letter="L",
    colour="#9467bd",
    create=_create,
    needs=frozenset({"lane_lines"}),
    reads=("mono", "stereo"),
    error_sources=(
        ErrorSource("lane_width", systematic=0.64),
        ErrorSource("contact_point", independent=0.2016),
        ErrorSource("own", independent=0.1584),
    ),
    fallback_for="stereo",
)
"""Stereo teaches it the width of the lane: where stereo has measured a track, lane adds nothing to it."""
