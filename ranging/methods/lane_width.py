r"""LaneWidthRanger: distance from the image width of the lane at an object's contact point (Luo).

     \  w  /       d = fx W / w      W: distance between the two lines in m; w: the same in px, in the row y of the
      \___/                          box's bottom edge. Neighbouring lanes are assumed to be as wide as the ego lane.
      |box|        sigma_d / d = sqrt((sigma_w / w)^2 + (sigma_W / W)^2 + (w' sigma_y / w)^2)
     /-----\
    /   W   \      w' = dw/dy. On a flat road w = w' (y - y0) with the horizon y0, so the last term, the error of the
                   bottom edge, grows with the distance as for all methods that use the contact point.

Pitch cancels if lines and box come from the same image; a run detects lines ten times per second and uses the latest
ones in between. The contact point is that of the nearest surface, so d is the distance of an upright surface such as
the rear of a car.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.lanes.lines import LaneLines
from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.ranging.method import ErrorSource, MethodContext, Ranger, RangingMethod
from track_range.ranging.ranges import Ranges
from track_range.ranging.size_models.size_model import BORDER_PX
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

LANE_WIDTH_M = 3.5  # default distance W in m between the centre lines of the lane markings, of main roads in Europe

LANE_WIDTH_SIGMA = 0.15
"""Relative standard deviation of the default width.

Lanes are 2.75 to 3.75 m wide depending on country and road type; wider on roads without shoulders (4.2 m on KITTI
0005).
"""

_ON_THE_ROAD = np.array([name not in ("traffic light", "traffic sign") for name in ROAD_CLASSES])
"""(road classes,) whether objects of the class are on the road."""

_LATERAL_RANGE = (-1.1, 2.1)  # lane widths from the left line: the ego lane, 0 to 1, and one lane on either side
_MAX_EXTRAPOLATION, _MIN_EXTRAPOLATION = 2.0, 0.5  # factors of the distances of the farthest and nearest row
_MIN_WIDTH_PX = 8.0  # smallest usable width of the lane in the image
_MAX_SIGMA = 0.3  # largest relative standard deviation of a reported distance

_MIN_WIDTH_SIGMA, _MAX_WIDTH_SIGMA = 0.015, 0.25
"""Limits of the relative standard deviation of a learnt width.

The lower limit covers errors common to all measurements of a drive: bias of box bottom edges, alignment of the pair.
"""

_CONFLICT_FACTOR = 1.4  # factor on the sigma of the width after an image with outliers only
_GATE = 3.0  # deviation of a measured width in standard deviations beyond which it is an outlier
_FORGETTING_S = 60.0  # time in s over which the variance of a learnt width grows by that of the default
_ROAD_SIGMA = 0.01  # relative standard deviation of w from uneven roads and varying lane widths

_Widths = tuple[FloatArray, FloatArray, BoolArray]
"""(N,) lane width w in px in the rows of the bottom edges, its relative sigma, and whether the track can be ranged."""


@dataclass(frozen=True, slots=True)
class LaneWidth:
    """Estimate of the width of the lane: a Kalman filter of its logarithm."""

    width_m: float = LANE_WIDTH_M  # distance W between the lines
    sigma: float = LANE_WIDTH_SIGMA  # relative standard deviation of W

    def after(self, step_s: float) -> LaneWidth:
        """The estimate after `step_s` seconds without a measurement: the same width with a larger sigma."""
        variance = self.sigma**2 + LANE_WIDTH_SIGMA**2 * step_s / _FORGETTING_S
        return replace(self, sigma=min(variance**0.5, max(LANE_WIDTH_SIGMA, self.sigma)))

    def updated_with(self, width_m: FloatArray, sigma: FloatArray) -> LaneWidth:
        """The estimate after N >= 1 widths (N,) measured in one image, with their relative standard deviations.

        The widths share most of their errors and count as one measurement: their weighted mean, with their harmonic
        mean variance. Outliers are ignored; if all are outliers the sigma of the estimate grows, so that it can
        follow a change of lane.
        """
        log_ratio = np.log(width_m / self.width_m)
        is_inlier = np.abs(log_ratio) < _GATE * np.hypot(sigma, self.sigma)
        if not is_inlier.any():
            return replace(self, sigma=min(_CONFLICT_FACTOR * self.sigma, _MAX_WIDTH_SIGMA))
        weight = 1.0 / sigma[is_inlier] ** 2
        nu, R = float((weight * log_ratio[is_inlier]).sum() / weight.sum()), float(1.0 / weight.mean())
        K = self.sigma**2 / (self.sigma**2 + R)
        return LaneWidth(self.width_m * float(np.exp(K * nu)), max(self.sigma * (1 - K) ** 0.5, _MIN_WIDTH_SIGMA))


class LaneWidthRanger(Ranger):
    """Ranges observed boxes in the ego lane or a neighbouring lane."""

    def __init__(
        self,
        camera: PinholeCamera,
        *,
        width_m: float = LANE_WIDTH_M,
        width_sigma: float = LANE_WIDTH_SIGMA,
        box_sigma_px: float = 1.5,
        width_from: str | None = None,
    ) -> None:
        """Create a ranger for `camera` (undistorted).

        Args:
            width_m: lane width W between the centre lines of the lane markings.
            width_sigma: relative standard deviation of `width_m`.
            box_sigma_px: standard deviation of the bottom edge of a detected box.
            width_from: method with distances that `measure_with` learns the width from; None = the width is fixed.
        """
        self._camera = camera
        self._box_sigma_px = box_sigma_px
        self.lane = LaneWidth(width_m, width_sigma)  # the current estimate
        self._width_from = width_from
        self._lines = LaneLines()
        self._last: tuple[Tracks, _Widths] | None = None  # cache: `update_width` needs the widths of `measure`
        self._learnt_s = np.nan

    def update_lanes(self, lines: LaneLines) -> None:
        """Use `lines` for the following measurements."""
        self._lines, self._last = lines, None

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances of the tracks; NaN unless both lines of the ego lane are known.

        NaN also for predicted boxes, boxes truncated at the bottom, traffic lights and signs, objects beyond the
        neighbouring lanes, and contact points far outside the rows in which the lines were detected.
        """
        widths = self._widths_of(tracks, frame)
        if widths is None:
            return Ranges.unmeasured(tracks.track_id)
        w, sigma_w, is_valid = widths
        distance_m = self._camera.fx_px * self.lane.width_m / np.where(is_valid, w, np.nan)
        sigma = np.hypot(sigma_w, self.lane.sigma)
        is_certain = sigma < _MAX_SIGMA
        distance_m = np.where(is_certain, distance_m, np.nan)
        return Ranges(tracks.track_id, distance_m, distance_m * sigma)

    def measure_with(self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges]) -> Ranges:
        """Distances as by `measure`, with sigmas inflated if the other methods disagree with those of the whole frame.

        The lane width is then updated from the method `width_from`.
        """
        ranges = inflated_by_disagreement(self.measure(tracks, frame), list(others.values()))
        if self._width_from is not None and self._width_from in others:
            self.update_width(tracks, frame, others[self._width_from])
        return ranges

    def update_width(self, tracks: Tracks, frame: Frame, measured: Ranges) -> None:
        """Update the lane width from another method's distances of the same tracks.

        The distances of `measure` are not independent of that method afterwards.
        """
        widths = self._widths_of(tracks, frame)
        if widths is None:
            return
        w, sigma_w, is_valid = widths
        usable = is_valid & np.isfinite(measured.distance_m) & np.isfinite(measured.sigma_m)
        if not usable.any():
            return
        distance_m, sigma_m = measured.distance_m[usable], measured.sigma_m[usable]
        step_s = 0.0 if np.isnan(self._learnt_s) else max(frame.time_s - self._learnt_s, 0.0)
        self._learnt_s = frame.time_s
        self.lane = self.lane.after(step_s).updated_with(
            w[usable] * distance_m / self._camera.fx_px, np.hypot(sigma_w[usable], sigma_m / distance_m)
        )

    def _widths_of(self, tracks: Tracks, frame: Frame) -> _Widths | None:
        """Lane widths at the tracks, computed once per frame; None = the lines are unknown."""
        if self._last is not None and self._last[0] is tracks:
            return self._last[1]
        left, right = self._lines.left, self._lines.right
        if left is None or right is None or not len(tracks):
            return None
        x1_px, _, x2_px, y_px = tracks.xyxy_px.T
        powers = np.array([np.ones_like(y_px), y_px, y_px * y_px])
        width = right.coefficients - left.coefficients  # coefficients of w as a polynomial in the row
        left_px, w = left.coefficients @ powers, width @ powers
        divisor = np.maximum(w, 1.0)
        lateral = ((x1_px + x2_px) / 2 - left_px) / divisor
        # Rows within the allowed extrapolation of both lines.
        top, bottom = max(left.y_top_px, right.y_top_px), min(left.y_bottom_px, right.y_bottom_px)
        constant, slope, curvature = width.tolist()
        min_px = (constant + top * (slope + top * curvature)) / _MAX_EXTRAPOLATION
        max_px = (constant + bottom * (slope + bottom * curvature)) / _MIN_EXTRAPOLATION
        is_valid = (
            tracks.observed
            & _ON_THE_ROAD[tracks.class_id]
            & (y_px < frame.left.shape[0] - 0.5 - BORDER_PX)
            & (w >= max(_MIN_WIDTH_PX, min_px))
            & (w <= max_px)
            & (top < bottom)
            & (lateral > _LATERAL_RANGE[0])
            & (lateral < _LATERAL_RANGE[1])
        )
        w_slope = width[1] + 2.0 * width[2] * y_px  # w'
        line_variance = ((left.covariance + right.covariance) @ powers * powers).sum(axis=0)
        sigma_px = np.sqrt(np.maximum(line_variance, 0.0) + (self._box_sigma_px * w_slope) ** 2)
        widths = w, np.hypot(sigma_px / divisor, _ROAD_SIGMA), is_valid
        self._last = tracks, widths
        return widths


def inflated_by_disagreement(ranges: Ranges, others: Sequence[Ranges]) -> Ranges:
    """Distances by lane width, with sigmas inflated by a common relative error that other methods show.

    If the lines are those of another lane, or no lane lines, all distances of a frame are wrong by the same factor,
    which the sigma of the lines does not contain. With e_i the log ratio of the other distance with the smallest sigma
    to that by lane width, and s_i its standard deviation, the common error is estimated as

        max(|median e| - 1.25 (sum 1 / s_i^2)^-1/2, 0)

    where the second term is the standard error of the median. `others` are methods that do not use the lane.
    """
    variance, log_ratio = np.full((2, len(ranges)), np.inf)
    for other in others:
        s2 = (ranges.sigma_m / ranges.distance_m) ** 2 + (other.sigma_m / other.distance_m) ** 2
        is_better = s2 < variance  # False for NaN
        np.copyto(variance, s2, where=is_better)
        np.copyto(log_ratio, np.log(other.distance_m / ranges.distance_m), where=is_better)
    both = np.isfinite(variance).nonzero()[0]
    if not len(both):
        return ranges
    standard_error = 1.25 / math.sqrt(float((1.0 / variance[both]).sum()))
    e = np.sort(log_ratio[both])
    common = max(abs(float(e[(len(e) - 1) // 2] + e[len(e) // 2]) / 2) - standard_error, 0.0)
    return Ranges(ranges.track_id, ranges.distance_m, np.hypot(ranges.sigma_m, common * ranges.distance_m))


def _create(context: MethodContext) -> Ranger:
    # The scale of an uncalibrated pair comes from object sizes, so it adds nothing to the assumed width.
    width_from = None if context.assumed_rig is not None else "stereo"
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
"""Lane width as a ranging method. It is a fallback for stereo: the width is learnt from stereo, so it adds no
information for a track that stereo has measured."""
