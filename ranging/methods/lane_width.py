r"""LaneWidthRanger: distance from the image width of the lane at an object's contact point (Luo).

     \  w  /       d = fx W / w      W: distance between the two lines in m; w: the same in px, in the row y of the
      \___/                          box's bottom edge. Neighbouring lanes are assumed to be as wide as the ego lane.
      |box|        sigma_d / d = sqrt((sigma_w / w)^2 + (sigma_W / W)^2 + (w' sigma_y / w)^2)
     /-----\
    /   W   \      w' = dw/dy. On a flat road w = w' (y - y0) with the horizon y0, so the last term, the error of the
                   bottom edge, grows with the distance as for all methods that use the contact point.

Pitch cancels if lines and box come from the same image; a run detects lines ten times per second and uses the latest
lines in between. The contact point belongs to the nearest surface, or to tyres behind it (`surface_offset_m`).

W has a prior by region and road, and is learnt from the distances d_i of the tracks by another method:

    log (w_i d_i / fx) = log W + b + e_i        b: error that all d_i share, e_i: error of the track (its size)

A track counts once, and the width that ranges a track is learnt from other tracks, since its own width would repeat
d_i. Where d_i are distances by size, b is the error of the drive (`DriveScale`): the prior of W keeps a part of its
weight, and the error source `drive_scale` is what both methods have in common. A width far from the prior does not
belong to a lane, nor one that differs between the tracks. Where the height H of the camera is known, the lines show
their distance: W = H w' fy / fx.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.lanes.lines import LaneLines
from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.foundation.robust_statistics import median_of, quantile_of
from track_range.foundation.track_state import TrackState
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.method import (
    ErrorSource,
    Measured,
    MethodContext,
    Ranger,
    RangingMethod,
)
from track_range.ranging.size_models.drive_scale import NO_EVIDENCE, DriveScale
from track_range.ranging.size_models.region import Region
from track_range.ranging.size_models.size_model import BORDER_PX, surface_offset_m
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.ego_motion import CameraStep
from track_range.tracking.tracks import Tracks


@dataclass(frozen=True, slots=True)
class LaneWidth:
    """Estimate of the width of the lane."""

    width_m: float  # distance W in m between the centre lines of the lane markings
    sigma: float  # relative standard deviation of W


# relative, of widths given by the user and of those below
_GIVEN_SIGMA, _ANY_SIGMA, _FAST_SIGMA = 0.05, 0.13, 0.08
# relative, of a width from the height of the camera: the opening of the lines, height, hills
_HEIGHT_SIGMA = 0.06
_FAST_MPS = 22.0  # 80 km/h; slower vehicles may be on any road
_WIDTHS_M: Mapping[Region, tuple[float, float]] = {
    "unknown": (3.5, 3.6),
    "europe": (3.5, 3.6),
    "north-america": (3.5, 3.66),
    "east-asia": (3.4, 3.65),
}
"""Width of a lane on any road, and where traffic is fast.

Germany: 2.75 to 3.25 m in towns, 3.5 m, 3.5 and 3.75 m on motorways (RASt 06, RAL 2012, RAA 2008);
USA: 10 to 12 ft, 12 ft on freeways (AASHTO, A Policy on Geometric Design of Highways and Streets,
2018); Japan: 2.75 to 3.5 m (Road Structure Ordinance); China: 3.5 m, 3.75 m from 80 km/h (JTG
B01-2014). Roads without shoulders have wider lanes: 4.2 m on KITTI 0005.
"""


def usual_width(region: Region, width_m: float | None = None) -> LaneWidth:
    """The width of a lane on any road of a region, or a given width."""
    return (
        LaneWidth(_WIDTHS_M[region][0], _ANY_SIGMA)
        if width_m is None
        else LaneWidth(width_m, _GIVEN_SIGMA)
    )


_ON_THE_ROAD = np.array([name not in ("traffic light", "traffic sign") for name in ROAD_CLASSES])
"""(road classes,) whether objects of the class are on the road."""

# lane widths from the left line: the ego lane, 0 to 1, and one lane on either side
_LATERAL_RANGE = (-1.1, 2.1)
# factors of the distances of the farthest and nearest row
_MAX_EXTRAPOLATION, _MIN_EXTRAPOLATION = 2.0, 0.5
_MIN_WIDTH_PX = 8.0  # smallest usable width of the lane in the image
_MAX_SIGMA = 0.3  # largest relative standard deviation of a reported distance
# smallest relative sigma of a learnt width: bias of bottom edges, alignment of the pair
_MIN_WIDTH_SIGMA = 0.015
# time constant with which tracks are forgotten: the lane widens, or is another one
_MEMORY_S = 30.0
_FRAMES = 5.0  # frames over which the width at a track is averaged; the errors of more are the same
_MIN_OWN = 0.4  # smallest fraction of the variance of a distance that belongs to the track
# scale of the weights 1 / (1 + (residual / scale)^2) in sigmas, and rounds
_CAUCHY_SIGMA, _N_ROUNDS = 2.0, 2
# of the prior where a calibrated pair measures the width, whatever the lines are
_MEASURABLE_SIGMA = 0.25
# of a width by sizes from the prior, in sigmas; more is not the width of a lane: 2.5 to 4.9 m
_MAX_DEVIATION = 2.5
# of the widths at four of five tracks, in sigmas (1.3 is usual), and the smallest number of
# tracks: a lane is equally wide at all of them, lines that do not meet at the horizon are not
_MAX_SCATTER, _MOST_TRACKS, _MIN_TRACKS = 2.2, 0.8, 4
# error of the row in which the lines meet, by hills and the fit: 0.001 to 0.006 on real roads
_HILL_RAD = 0.004
_ROAD_SIGMA = 0.01  # relative standard deviation of w from uneven roads and varying lane widths


class _Widths(NamedTuple):
    """The lane at the bottom edges of N boxes, (N,) each."""

    w: FloatArray  # width in the image, px
    sigma: FloatArray  # its relative standard deviation
    is_valid: BoolArray  # whether it may be used
    offset_m: FloatArray  # depth of the visible surface behind the bottom edge


class LaneWidthRanger(Ranger):
    """Ranges observed boxes in the ego lane or a neighbouring lane."""

    def __init__(
        self,
        camera: PinholeCamera,
        *,
        region: Region = "unknown",
        width_m: float | None = None,
        width_sigma: float = _GIVEN_SIGMA,
        box_sigma_px: float = 1.5,
        width_from: str | None = None,
        camera_height_m: float | None = None,
        has_visible_boxes: bool = False,
    ) -> None:
        """Create a ranger for `camera` (undistorted).

        `width_m` is the lane width W between the centre lines of the markings, None = the usual
        width of the region; its relative standard deviation is `width_sigma`. `width_from` is the
        method that it is learnt from, None = it is fixed. `has_visible_boxes`: boxes end at the
        tyres, as a detector's boxes do, within `box_sigma_px`.
        """
        self._camera = camera
        self._box_sigma_px = box_sigma_px
        self._fast_m = None if width_m else _WIDTHS_M[region][1]
        self._prior = LaneWidth(width_m, width_sigma) if width_m else usual_width(region)
        self.lane = self._prior  # the current estimate
        self._width_from = width_from
        self._height_m, self._has_visible_boxes = camera_height_m, has_visible_boxes
        self._lines = LaneLines()
        # of each track: number of frames, log width, its variance without the shared part, time of
        # the last frame
        self._tracks = TrackState(np.zeros(4))

    def update_lanes(self, lines: LaneLines) -> None:
        """Use `lines` for the following measurements."""
        self._lines = lines

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances of the tracks; NaN unless both lines of the ego lane are known.

        NaN also for predicted boxes, boxes truncated at the bottom, traffic lights and signs,
        objects beyond the neighbouring lanes, and contact points far outside the rows in which the
        lines were detected.
        """
        widths = self._widths_of(tracks, frame)
        if widths is None:
            return Ranges.unmeasured(tracks.track_id)
        return self._ranges(tracks, widths, *self._present)

    def measure_with(self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges]) -> Ranges:
        """See `measure_at_scale`; without a measured scale of the drive."""
        return self.measure_at_scale(tracks, frame, others, NO_EVIDENCE).ranges

    def measure_at_scale(
        self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges], scale: DriveScale
    ) -> Measured:
        """See `measure`; the width is learnt from the method `width_from` in this frame and earlier
        frames.

        Sigmas are inflated if the other methods disagree with the distances of the whole frame.
        """
        widths = self._widths_of(tracks, frame)
        if widths is None:
            return Measured(Ranges.unmeasured(tracks.track_id))
        log_width, sigma = self._present
        if self._width_from is not None and self._width_from in others:
            is_by_size = self._width_from == "mono"
            shared_sigma = scale.bias_of("car").sigma if is_by_size else _MIN_WIDTH_SIGMA
            own = self._learn(tracks, widths, others[self._width_from], shared_sigma, frame.time_s)
            log_width, sigma = self._learnt(
                own & is_by_size, shared_sigma, frame.time_s, is_measured=not is_by_size
            )
        ranges = self._ranges(tracks, widths, log_width, sigma)
        return Measured(inflated_by_disagreement(ranges, list(others.values())))

    @property
    def _present(self) -> tuple[FloatArray, FloatArray]:
        """() log of the present width of the lane, and its sigma."""
        return np.array(math.log(self.lane.width_m)), np.array(self.lane.sigma)

    def summary(self) -> dict[str, Any]:
        """Width of the lane and its sigma at the end: the usual one, sharpened by what the drive
        showed; nothing if the lines are no lane.
        """
        if math.isinf(self.lane.sigma):
            return {}
        sigma_m = self.lane.sigma * self.lane.width_m
        return {"lane_width_m": self.lane.width_m, "lane_width_sigma_m": sigma_m}

    def update_motion(self, step: CameraStep) -> None:
        """Expect the lanes of fast roads once the vehicle is fast."""
        if self._fast_m is not None and step.travelled_m > _FAST_MPS * step.dt_s:
            self._prior, self._fast_m = LaneWidth(self._fast_m, _FAST_SIGMA), None
            self.lane = self._prior

    def _learn(
        self, tracks: Tracks, widths: _Widths, measured: Ranges, shared_sigma: float, time_s: float
    ) -> BoolArray:
        """Add the widths at the tracks by another method's distances; returns which of the tracks
        (N,) have a width.
        """
        usable = widths.is_valid & np.isfinite(measured.distance_m) & np.isfinite(measured.sigma_m)
        w, sigma_w, ids = widths.w[usable], widths.sigma[usable], tracks.track_id[usable]
        distance_m = (measured.distance_m - widths.offset_m)[usable]
        variance = sigma_w * sigma_w + (measured.sigma_m[usable] / distance_m) ** 2
        variance = np.maximum(variance - shared_sigma**2, _MIN_OWN * variance)
        state = self._tracks.get(ids)
        n_frames, log_width = state[:2]
        np.minimum(n_frames + 1.0, _FRAMES, out=n_frames)
        log_width += (np.log(w * distance_m / self._camera.fx_px) - log_width) / n_frames
        state[2], state[3] = variance, time_s
        is_recent = time_s - self._tracks.known[3] < 3 * _MEMORY_S
        self._tracks.put(ids, state, keep_known=is_recent)
        return usable

    def _learnt(
        self, own: BoolArray, shared_sigma: float, time_s: float, *, is_measured: bool
    ) -> tuple[FloatArray, FloatArray]:
        """(N,) log width and its sigma for each of the tracks of the frame, from the other tracks;
        inf = not a lane.

        The tracks in the mask `own` (N,) are the first of the known tracks, and are left out for
        themselves. Sets `lane` to the estimate from all tracks.
        """
        _, z, variance, seen_s = self._tracks.known
        unweighted = weight = np.exp((seen_s - time_s) / _MEMORY_S) / variance
        for _ in range(_N_ROUNDS if len(z) else 0):
            mean = float(weight @ z / weight.sum())
            weight = unweighted / (1.0 + (z - mean) ** 2 / (_CAUCHY_SIGMA**2 * variance))
        n_own = int(own.sum())
        without = np.zeros((2, len(own) + 1))  # the last column leaves out none
        without[:, :-1][:, own] = weight[:n_own], weight[:n_own] * z[:n_own]
        information, weighted = np.array([weight.sum(), weight @ z])[:, None] - without
        information = np.maximum(information, 1e-9)
        prior = self._prior_of_lines()
        prior_log = math.log(prior.width_m)
        prior_variance = max(prior.sigma, _MEASURABLE_SIGMA if is_measured else 0.0) ** 2
        total = prior_variance + shared_sigma**2 + 1.0 / information
        deviation, K = weighted / information - prior_log, prior_variance / total
        log_width = prior_log + K * deviation
        sigma = np.maximum(np.sqrt((1.0 - K) * prior_variance), _MIN_WIDTH_SIGMA)
        if not is_measured:
            is_no_lane = deviation**2 > _MAX_DEVIATION**2 * total
            if len(z) >= _MIN_TRACKS:
                scatter = np.abs(z - median_of(z)) / np.sqrt(variance)
                is_no_lane |= quantile_of(scatter, _MOST_TRACKS) > _MAX_SCATTER
            sigma = np.where(is_no_lane, np.inf, sigma)
        self.lane = LaneWidth(float(np.exp(log_width[-1])), float(sigma[-1]))
        return log_width[:-1], sigma[:-1]

    def _ranges(
        self, tracks: Tracks, widths: _Widths, log_width: FloatArray, width_sigma: FloatArray
    ) -> Ranges:
        """Distances with the log width of the lane and its sigma, (N,) or () each."""
        sigma = np.hypot(widths.sigma, width_sigma)
        is_certain = widths.is_valid & (sigma < _MAX_SIGMA)
        w = np.where(is_certain, widths.w, np.nan)
        distance_m = self._camera.fx_px * np.exp(log_width) / w
        return Ranges(tracks.track_id, distance_m + widths.offset_m, distance_m * sigma)

    def _prior_of_lines(self) -> LaneWidth:
        """The prior, and the width of the lines in view from the height of the camera, if it is
        known.
        """
        left, right, prior = self._lines.left, self._lines.right, self._prior
        if self._height_m is None or left is None or right is None:
            return prior
        opening = float((right.coefficients - left.coefficients)[1])
        by_height_m = opening * self._height_m * self._camera.fy_px / self._camera.fx_px
        K = prior.sigma**2 / (prior.sigma**2 + _HEIGHT_SIGMA**2)
        return LaneWidth(prior.width_m ** (1 - K) * by_height_m**K, prior.sigma * math.sqrt(1 - K))

    def _widths_of(self, tracks: Tracks, frame: Frame) -> _Widths | None:
        """Lane widths at the tracks; None = the lines are unknown."""
        left, right = self._lines.left, self._lines.right
        if left is None or right is None or not len(tracks):
            return None
        x1_px, _, x2_px, y_px = tracks.xyxy_px.T
        powers = np.array([np.ones_like(y_px), y_px, y_px * y_px])
        # coefficients of w as a polynomial in the row
        width = right.coefficients - left.coefficients
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
        row_px = math.hypot(self._box_sigma_px, _HILL_RAD * self._camera.fy_px)
        line_variance = np.add.reduce(
            (left.covariance + right.covariance) @ powers * powers, axis=0
        )
        sigma_px = np.sqrt(np.maximum(line_variance, 0.0) + (row_px * w_slope) ** 2)
        offset_m = surface_offset_m(
            tracks.xyxy_px, tracks.class_id, has_visible_boxes=self._has_visible_boxes
        )
        return _Widths(w, np.hypot(sigma_px / divisor, _ROAD_SIGMA), is_valid, offset_m)


def inflated_by_disagreement(ranges: Ranges, others: Sequence[Ranges]) -> Ranges:
    """Distances by lane width, with sigmas inflated by a common relative error that other methods
    show.

    If the lines belong to another lane, or are no lane lines, all distances of a frame are wrong by
    the same factor, which the sigma of the lines does not contain. With e_i the log ratio of the
    other distance with the smallest sigma to the distance by lane width, and s_i its standard
    deviation, the common error is estimated as

        max(|median e| - 1.25 (sum 1 / s_i^2)^-1/2, 0)

    where the second term is the standard error of the median. `others` are methods that do not use
    the lane.
    """
    own_variance = (ranges.sigma_m / ranges.distance_m) ** 2
    variance, log_ratio = np.full((2, len(ranges)), np.inf)
    for other in others:
        s2 = own_variance + (other.sigma_m / other.distance_m) ** 2
        is_better = s2 < variance  # False for NaN
        np.copyto(variance, s2, where=is_better)
        np.copyto(log_ratio, np.log(other.distance_m / ranges.distance_m), where=is_better)
    both = np.isfinite(variance).nonzero()[0]
    if not len(both):
        return ranges
    standard_error = 1.25 / math.sqrt(float((1.0 / variance[both]).sum()))
    e = np.sort(log_ratio[both])
    common = max(abs(float(e[(len(e) - 1) // 2] + e[len(e) // 2]) / 2) - standard_error, 0.0)
    return Ranges(
        ranges.track_id, ranges.distance_m, np.hypot(ranges.sigma_m, common * ranges.distance_m)
    )


def _create(context: MethodContext) -> Ranger:
    return LaneWidthRanger(
        context.camera,
        region=context.region,
        width_m=context.lane_width_m,
        width_from="mono" if context.rig is None else "stereo",
        camera_height_m=context.camera_height_m,
        has_visible_boxes=context.has_visible_boxes,
    )


LANE = RangingMethod(
    name="lane",
    title="lane",
    letter="L",
    colour="#9467bd",
    create=_create,
    needs=frozenset({"lane_lines"}),
    reads=("mono", "stereo"),
    error_sources=(
        ErrorSource("lane_width", systematic=0.25),
        ErrorSource("drive_scale", systematic=0.15),
        ErrorSource("contact_point", independent=0.25),
        ErrorSource("own", independent=0.35),
    ),
    fallback_for="stereo",
)
"""Lane width as a ranging method. It is a fallback for stereo: with a calibrated pair the width is
learnt from stereo, so it adds no information for a track that stereo has measured."""
