r"""LaneWidthRanger: distance from the width of the lane that an object stands on (Luo, the lane-width paper).

     \  w  /       d = fx W / w      W metres between the two lines, w pixels between them in the row of the box's
      \___/                          bottom edge; neighbouring lanes are taken to be as wide as the own one
      |box|        sigma_d / d = |sigma_w / w, sigma_W / W, w' sigma_y / w|
     /-----\
    /   W   \      w is linear in the row, w = w' (y - horizon), so the last term grows with the distance: it is the
                   error of the bottom edge, as for any method that uses the ground

Where lines and box are of the same image, pitch moves both and cancels; a run finds lines ten times per second and
uses the last ones in between. The point on the ground below the bottom edge is where the object begins, so d is the
distance of its surface where that is upright: a car's rear.
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
"""Default distance between the middles of the lines."""

LANE_WIDTH_SIGMA = 0.15
"""Relative standard deviation of the default.

Lanes are 2.75 to 3.75 m wide by country and kind of road; wider where a road has no shoulders (4.2 m on KITTI 0005).
"""

_ON_THE_ROAD = np.array([name not in ("traffic light", "traffic sign") for name in ROAD_CLASSES])

_REACH = (-1.1, 2.1)
"""Lateral range in lane widths from the left line: the own lane, 0 to 1, and a neighbour on either side."""

_MAX_EXTRAPOLATION, _MIN_EXTRAPOLATION = 2.0, 0.5
"""Largest and smallest distance, in distances of the farthest and nearest row in which both lines were found."""

_MIN_WIDTH_PX = 8.0
"""Smallest width of the lane in the image."""

_MAX_SIGMA = 0.3
"""Largest relative standard deviation of a distance that is given."""

_MIN_WIDTH_SIGMA, _MAX_WIDTH_SIGMA = 0.015, 0.25
"""Limits of the relative standard deviation of a learnt width.

The lower one is what all measurements of a drive share: bottom edges of the detector, alignment of the pair.
"""

_CONFLICT_FACTOR = 1.4
"""By which the sigma of the width grows in an image all of whose measurements are outliers."""

_GATE = 3.0
"""Measured widths farther off than this many sigmas are outliers."""

_FORGETTING_S = 60.0
"""Time after which a learnt width is as uncertain as the default."""

_ROAD_SIGMA = 0.01
"""Relative: roads are not planes, lanes are not of one width."""

_Widths = tuple[FloatArray, FloatArray, BoolArray]
"""(N,) width of the lane in the rows of the bottom edges, px, its relative sigma, and which tracks can use it."""


@dataclass(frozen=True, slots=True)
class LaneWidth:
    """Estimate of the width of the lane, updated by measurements in logarithms.

    Attributes:
        width_m: metres between the lines.
        sigma: relative standard deviation.
    """

    width_m: float = LANE_WIDTH_M
    sigma: float = LANE_WIDTH_SIGMA

    def after(self, step_s: float) -> LaneWidth:
        """The estimate some time later: less certain, since roads change."""
        variance = self.sigma**2 + LANE_WIDTH_SIGMA**2 * step_s / _FORGETTING_S
        return replace(self, sigma=min(variance**0.5, max(LANE_WIDTH_SIGMA, self.sigma)))

    def updated_with(self, width_m: FloatArray, sigma: FloatArray) -> LaneWidth:
        """The estimate after N >= 1 widths (N,) measured in one image, with their relative standard deviations.

        They share most of their errors, and count as one. Outliers do not count; where all are outliers the estimate
        gets less certain, so that it follows when the lines are those of another lane.
        """
        log = np.log(width_m / self.width_m)
        good = np.abs(log) < _GATE * np.hypot(sigma, self.sigma)
        if not good.any():
            return replace(self, sigma=min(_CONFLICT_FACTOR * self.sigma, _MAX_WIDTH_SIGMA))
        weight = 1.0 / sigma[good] ** 2
        innovation, variance = float((weight * log[good]).sum() / weight.sum()), float(1.0 / weight.mean())
        gain = self.sigma**2 / (self.sigma**2 + variance)
        remaining = max(self.sigma * (1 - gain) ** 0.5, _MIN_WIDTH_SIGMA)
        return LaneWidth(self.width_m * float(np.exp(gain * innovation)), remaining)


class LaneWidthRanger(Ranger):
    """Ranges observed boxes in the own lane or in a neighbouring one.

    Attributes:
        lane: the current estimate of the lane's width.
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
            camera: in whose images the lines are found.
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
        self._learnt_s = np.nan

    def update_lanes(self, lines: LaneLines) -> None:
        """Measure against these lines from now on."""
        self._lines, self._last = lines, None

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances of the tracks; NaN where no two lines are known.

        NaN also for boxes that are predicted, cut off at the bottom, of lights and signs, farther aside than the
        neighbouring lanes, or far outside the rows in which the lines were seen.
        """
        widths = self._widths_of(tracks, frame)
        if widths is None:
            return Ranges.unmeasured(tracks.track_id)
        width_px, sigma_w, good = widths
        distance_m = self._camera.fx_px * self.lane.width_m / np.where(good, width_px, np.nan)
        sigma = np.hypot(sigma_w, self.lane.sigma)
        is_certain = sigma < _MAX_SIGMA
        distance_m = np.where(is_certain, distance_m, np.nan)
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
        widths = self._widths_of(tracks, frame)
        if widths is None:
            return
        width_px, sigma_w, good = widths
        usable = good & np.isfinite(measured.distance_m) & np.isfinite(measured.sigma_m)
        if not usable.any():
            return
        distance_m, sigma_m = measured.distance_m[usable], measured.sigma_m[usable]
        step_s = 0.0 if np.isnan(self._learnt_s) else max(frame.time_s - self._learnt_s, 0.0)
        self._learnt_s = frame.time_s
        self.lane = self.lane.after(step_s).updated_with(
            width_px[usable] * distance_m / self._camera.fx_px, np.hypot(sigma_w[usable], sigma_m / distance_m)
        )

    def _widths_of(self, tracks: Tracks, frame: Frame) -> _Widths | None:
        """`_widths` of the tracks, computed once per frame."""
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
        max_px, min_px = _width_limits_px(left, right, width)
        good = (
            tracks.observed
            & _ON_THE_ROAD[tracks.class_id]
            & (y_px < height_px - 0.5 - BORDER_PX)
            & (width_px >= max(_MIN_WIDTH_PX, min_px))
            & (width_px <= max_px)
            & (across > _REACH[0])
            & (across < _REACH[1])
        )
        opening = width[1] + 2.0 * width[2] * y_px
        of_lines = ((left.covariance + right.covariance) @ powers * powers).sum(axis=0)
        sigma_px = np.sqrt(np.maximum(of_lines, 0.0) + (self._box_sigma_px * opening) ** 2)
        return width_px, np.hypot(sigma_px / wide, _ROAD_SIGMA), good


def inflated_by_disagreement(ranges: Ranges, others: Sequence[Ranges]) -> Ranges:
    """Distances by lane, with sigmas that include a common error of the frame as other methods show it.

    The lines may be those of another lane, or of none: then all distances of a frame are wrong by one factor, which is
    not in the sigma of the lines. With e_i the logarithm of the most certain other distance of track i over lane's, and
    s_i its sigma, |median e| counts as such a factor as far as it exceeds its own standard error,

        1.25 (sum 1 / s_i^2)^-1/2

    Args:
        ranges: N tracks, by lane.
        others: the same tracks, by methods that do not use the lane.
    """
    variances = [
        (ranges.sigma_m / ranges.distance_m) ** 2 + (other.sigma_m / other.distance_m) ** 2 for other in others
    ]
    log_ratios = [np.log(other.distance_m / ranges.distance_m) for other in others]
    variance, log_ratio = np.array(variances), np.array(log_ratios)
    both = np.isfinite(variance).any(axis=0)
    if not both.any():
        return ranges
    best = np.nanargmin(variance[:, both], axis=0), np.arange(both.sum())
    error = 1.25 / math.sqrt(float((1.0 / variance[:, both][best]).sum()))
    shared = max(abs(float(np.median(log_ratio[:, both][best]))) - error, 0.0)
    return replace(ranges, sigma_m=np.hypot(ranges.sigma_m, shared * ranges.distance_m))


def _width_limits_px(left: LaneLine, right: LaneLine, width: FloatArray) -> tuple[float, float]:
    """Largest and smallest width, px, of rows not far beyond those in which both lines were found."""
    top, bottom = max(left.y_top_px, right.y_top_px), min(left.y_bottom_px, right.y_bottom_px)
    if top >= bottom:
        return -math.inf, math.inf  # in no row
    constant, slope, bend = width.tolist()
    top_px, bottom_px = (constant + y_px * (slope + y_px * bend) for y_px in (top, bottom))
    return bottom_px / _MIN_EXTRAPOLATION, top_px / _MAX_EXTRAPOLATION


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
