r"""GroundRanger: distance from the contact point of an object, the camera height and the horizon.

    d = fy H / (y - y0)

              o camera -------------- y0, horizon (vanishing line of the road; moves with pitch and slope)
              |  \
            H |     \   y, bottom edge of the box
    __________|________\[object]___

The horizon y0 is not part of a calibration: it moves with every bump, and differs between roads by 3 degrees or 40 px.
Image motion measures it, and the curvature k of the road in the vertical plane (`stereo.odometry.road_horizon`):

    y = y0 + H s - fy k d / 2,   s = fy / d

The objects on the road add to this estimate, and replace it where there are no images or no motion. With its distance
d_i by size, object i is a measurement

    y_i = y0 + H s_i (1 - b) - fy k d_i / 2,   variance = (H s_i)^2 (sigma_i / d_i)^2 + R
    R = pitch^2 + edge^2 + (kerb s_i)^2 + (crossfall x_i)^2 + curvature ahead^2

of y0, H, k and the bias b that all distances by size share, which are solved for by weighted least squares over all
tracks, with priors from image motion, the camera height and the drive (`DriveScale`). A track contributes the average
of its recent measurements once, since its size error is the same in every frame. For the same reason each object is
ranged with the road from the other objects only; otherwise its distance would repeat the distance by size. Without
image motion, k and b are 0, and the pitch variance (pitch, slopes) is estimated from the residuals.

Where the camera height is known, distances from image motion alone, without any size, are the reference from which the
drive's scale is measured.

The bottom edge belongs to the nearest point on the ground, while `distance_m` is where the ray through the box centre
meets the object, for a car seen from the side up to half a metre farther (`surface_offset_m`). The box of a detector
ends at the tyres, which in a rear view are behind the bumper.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from track_range.detection.lanes.lines import LaneLines
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.track_state import TrackState
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.known_plane import KnownPlaneRanger
from track_range.ranging.methods.method import (
    ErrorSource,
    Measured,
    MethodContext,
    Ranger,
    RangingMethod,
)
from track_range.ranging.size_models.drive_scale import NO_EVIDENCE, DriveScale, ScaleEvidence
from track_range.ranging.size_models.size_model import BORDER_PX, SIZE_CLASSES, surface_offset_m
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.road_horizon import (
    RoadView,
    curvature_fraction,
    unknown_curvature_variance,
)
from track_range.tracking.tracks import Tracks

GROUND_CLASSES = ("person", "bicycle", "car", "motorcycle", "bus", "truck", "van")  # on the ground
_ON_GROUND = np.array([name in GROUND_CLASSES for name in SIZE_CLASSES])  # (size classes,)
# residual in standard deviations beyond which measurements are down-weighted (Huber)
_HUBER_SIGMA = 2.0
# largest relative standard deviation of a measured camera height that counts as known
_MAX_HEIGHT_SIGMA = 0.05
# relative, of all distances from image motion: camera height, crown of the street, and lower edges
_REFERENCE_SIGMA = 0.05
# fraction of the standard deviation of distances from image motion that all tracks share: horizon,
# slopes and crown of the street
_COMMON = 0.95
# time constant with which tracks that left are forgotten: the angle of the mounting changes with
# load
_DRIVE_S = 60.0
# of a track that left: tracks that are in view together have the pitch in common
_PAST_WEIGHT = 0.25
# error of the row in which lane lines meet as a measurement of the horizon: hills, curves
_LINES_RAD = 0.006
# deviation of that row from the horizon by all else beyond which they are not lane lines
_MAX_LINES_SIGMA = 2.5


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundSettings:
    """Settings of the ground plane."""

    height_m: float = 1.5  # prior mean of the camera height H above the road
    # standard deviation of `height_m`: small if measured, large if assumed
    height_sigma_m: float = 0.3
    # prior standard deviation of the angle between the camera's axis and the horizon
    horizon_sigma_rad: float = 0.05
    # error of the horizon from image motion that lasts: the difference from planes fitted to stereo
    # on KITTI 0003, 0005 and gray51 is 0.003, 0.003 and 0.006 rad
    road_sigma_rad: float = 0.0035
    average_s: float = 0.3  # time constant for averaging the measurements of a track
    # time constant of the decay of a track's measurement after the track ended
    memory_s: float = 1.5
    # initial standard deviation of pitch and slope; updated from the residuals
    pitch_sigma_rad: float = 0.008
    pitch_memory_s: float = 5.0  # time constant of the update of `pitch_sigma_rad`
    # standard deviation of the height of contact points above the road (kerbs, camber)
    kerb_m: float = 0.08
    # standard deviation of the slope to the side within the road; roads are built with 0.02 to
    # 0.025
    crossfall: float = 0.02
    # boxes end at the tyres (detector), not at the bumper (projected 3-D boxes)
    has_visible_boxes: bool = False
    box_sigma_px: float = 1.5  # standard deviation of one box edge
    max_sigma: float = 0.5  # largest relative standard deviation of a reported distance

    def place_sigma_m(self, across_m: FloatArray) -> FloatArray:
        """(N,) standard deviations of the heights of contact points above the plane of the road, at
        distances (N,) across it from the camera.
        """
        verge = np.minimum(np.abs(across_m) / _VERGE_M, _MAX_VERGE)
        return np.hypot(self.kerb_m, self.crossfall * (1.0 + verge) * across_m)

    @classmethod
    def of_known_height(cls, height_m: float) -> GroundSettings:
        """Settings for a camera with a measured height."""
        return cls(height_m=height_m, height_sigma_m=0.03)


@dataclass(frozen=True, slots=True)
class Horizon:
    """Vanishing line of the road at the middle column of the image."""

    y_px: float  # row of the horizon in px of the frame
    sigma_px: float  # standard deviation of `y_px`
    height_m: float  # height H of the camera above the road


_N = 4  # number of the unknowns x = (y0, H, fy k, b)
_NO_TRACKS = np.zeros(0, np.int64)
_FIXED = 1e-3  # standard deviation of unknowns that are taken to be 0, in px/m and as a fraction
# of fixed-point iteration on a curved road; the fraction of the curvature changes slowly
_N_CURVE_ROUNDS = 3
# smallest change of the row with distance, relative to that on a plane road: near a crest
_MIN_SLOPE = 0.3
# smallest fraction of the variance of a distance by size that belongs to the object and the box
_MIN_OWN = 0.4
_MOVING_PITCH_RAD = 0.001  # error of the horizon from image motion that is new in every frame
# Distance to the side over which the slope to the side doubles: beyond the road are pavements,
# verges and side streets. Heights of contact points on KITTI and nuScenes, in m: 0.12 and 0.21 at 3
# to 6 m, 0.29 and 0.39 at 6 to 10 m, 0.4 to 0.9 at 10 to 16 m, 0.6 and 1.2 beyond.
_VERGE_M, _MAX_VERGE = 10.0, 1.0
# about the horizon, relative to a new measurement; tracks with less are dropped
_MIN_INFORMATION = 1e-3


# Normal equations of the weighted measurements y = a'x are arrays (4, 5), with the tracks on
# further axes:
#
#     A x = v,   [A | v] = sum of w [a a' | a y],   a = (1, s, -fraction(d) d / 2, -H s)


class _Plane(NamedTuple):
    """Least-squares estimates of the road, one per track or, with an axis of length 1, for all."""

    x: FloatArray  # (4, ...) y0 in px below the expected horizon, H in m, fy k in px/m, b
    P: FloatArray  # (4, 4, ...) covariance

    def rows(self, basis: FloatArray) -> FloatArray:
        """(...) rows of the ground, in px below the expected horizon, from the basis (4, ...) of
        their distances.
        """
        return np.asarray(np.add.reduce(basis * self.x, axis=0))

    def variance(self, basis: FloatArray) -> FloatArray:
        """(...) variances of `rows` in px^2."""
        P_a = np.add.reduce(self.P * basis, axis=1)
        return np.asarray(np.add.reduce(basis * P_a, axis=0))


class _Contacts(NamedTuple):
    """Contact points of the tracks of one frame, (N,) each."""

    y: FloatArray  # row of the bottom edge in px below the expected horizon at its column
    offset_m: FloatArray  # distance from the contact point to the visible surface
    s: FloatArray  # fy / d with the distance by size, in px/m; 1 = no distance by size
    s_variance: FloatArray  # variance of `s`
    # (4, N) derivatives of the row of the ground at `s` by the unknowns, without b
    basis: FloatArray
    R: FloatArray  # variance of `y` about the ground plane, px^2
    across_px: FloatArray  # distance across the road from the camera times `s`
    on_ground: BoolArray  # whether the bottom edge is visible and the object is on the ground
    # whether there is also a distance by size, so that the track measures the horizon
    is_informative: BoolArray


class GroundPlane:
    """Estimator of the horizon, the camera height and the curvature of the road from the tracks of
    a video.
    """

    def __init__(self, camera: PinholeCamera, settings: GroundSettings | None = None) -> None:
        """Start from the prior in the settings; `camera` is undistorted."""
        self._camera = camera
        self._settings = settings or GroundSettings()
        self._tracks = TrackState(np.zeros((_N, _N + 1)))  # terms of each track
        self._lane_terms = np.zeros((_N, _N + 1))
        # of tracks that left, about the mounting of the camera
        self._past_terms = np.zeros((_N, _N + 1))
        self._pitch_px2 = (self._settings.pitch_sigma_rad * camera.fy_px) ** 2
        self._time_s: float | None = None
        self._road: RoadView | None = None
        self._bias_variance = _FIXED**2
        # computed when it is needed: its inputs change more often
        self._known_prior: FloatArray | None = None

    @property
    def horizon(self) -> Horizon:
        """Current estimate of the horizon and the camera height."""
        plane = _solved(self._information)
        y_px = float(self._expected_px(np.array(self._camera.cx_px)) + plane.x[0, 0])
        return Horizon(y_px, math.sqrt(plane.P[0, 0, 0]), float(plane.x[1, 0]))

    @property
    def _information(self) -> FloatArray:
        """(4, 5, 1) normal equations of the prior, of lane lines and of all tracks."""
        of_tracks = np.add.reduce(self._tracks.known, axis=-1)
        return np.asarray(self._prior + self._lane_terms + of_tracks)[..., None]

    @property
    def has_seen_horizon(self) -> bool:
        """Whether image motion or lane lines show the horizon."""
        return self._road is not None or bool(self._lane_terms[0, 0] > 0)

    def update_road(self, road: RoadView | None, *, bias_sigma: float | None = None) -> None:
        """Set the road in the next frame as image motion shows it, with lengths in metres; None =
        unknown.

        `bias_sigma` is the standard deviation of the bias that all distances by size share; None =
        no change.
        """
        self._road = road
        if bias_sigma is not None:
            self._bias_variance = bias_sigma**2
        self._known_prior = None

    def set_height(self, height_m: float, sigma_m: float) -> None:
        """Set the prior of the camera height."""
        if (height_m, sigma_m) == (self._settings.height_m, self._settings.height_sigma_m):
            return
        self._settings = replace(self._settings, height_m=height_m, height_sigma_m=sigma_m)
        self._known_prior = None

    def add_horizon(self, y_px: float, sigma_px: float) -> None:
        """Add the row at which lane lines meet as a measurement of the horizon; it decays like
        measurements of tracks.

        It is ignored where it contradicts image motion and the objects on the road: the detected
        lines are then not lines of a lane.
        """
        nothing = self._tracks.get(_NO_TRACKS)
        self._tracks.put(_NO_TRACKS, nothing, keep_known=self._is_informed())
        self._lane_terms = np.zeros((_N, _N + 1))
        below_px = y_px - float(self._expected_px(np.array(self._camera.cx_px)))
        lasting_px2 = self._pitch_px2
        if self._road is not None:
            lasting_px2 = (_LINES_RAD * self._camera.fy_px) ** 2
        variance = sigma_px**2 + lasting_px2
        plane = _solved(self._information)
        deviation_px = abs(below_px - float(plane.x[0, 0]))
        if deviation_px > _MAX_LINES_SIGMA * math.sqrt(variance + float(plane.P[0, 0, 0])):
            return
        self._lane_terms[0, 0], self._lane_terms[0, -1] = 1.0 / variance, below_px / variance

    def measure(self, tracks: Tracks, by_size: Ranges, frame: Frame) -> Ranges:
        """Distances of the tracks on the ground; their distances by size update the road first.

        NaN for predicted boxes, boxes truncated at the bottom or above the horizon, and sigmas
        above `max_sigma`.
        """
        step_s = self._age(tracks, frame.time_s)
        contacts = self._contacts(tracks, by_size, frame)
        others = self._updated(contacts, tracks.track_id, step_s=step_s)
        return Ranges(tracks.track_id, *self._distances(contacts, others))

    def measure_alone(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances of the tracks on the ground from image motion and the camera height, without
        any size.
        """
        contacts = self._contacts(tracks, Ranges.unmeasured(tracks.track_id), frame)
        return Ranges(tracks.track_id, *self._distances(contacts, self._plane_alone))

    def measure_both(self, tracks: Tracks, by_size: Ranges, frame: Frame) -> tuple[Ranges, Ranges]:
        """Distances as by `measure`, independent of the other method, and as by `measure_alone`."""
        alone = self._plane_alone
        step_s = self._age(tracks, frame.time_s)
        contacts = self._contacts(tracks, by_size, frame)
        others = self._updated(contacts, tracks.track_id, step_s=step_s)
        # the axis of both planes stands before that of the tracks
        x, P = np.empty((_N, 2, len(tracks))), np.empty((_N, _N, 2, len(tracks)))
        x[:, 0], x[:, 1], P[:, :, 0], P[:, :, 1] = others.x, alone.x, others.P, alone.P
        distance_m, sigma_m = self._distances(contacts, _Plane(x, P))
        of_all, of_motion = (
            Ranges(tracks.track_id, distance_m[i], sigma_m[i], is_fallback=False) for i in (0, 1)
        )
        return of_all, of_motion

    def _age(self, tracks: Tracks, time_s: float) -> float:
        """Let the measurements decay to the time of a frame with these tracks; returns the time
        step in s.
        """
        step_s = 0.0 if self._time_s is None else max(time_s - self._time_s, 0.0)
        self._time_s = time_s
        memory = math.exp(-step_s / self._settings.memory_s)
        if self._road is None and step_s > 0:
            self._keep_past(tracks, step_s, forgotten=1.0 - memory)
        terms = self._tracks.known
        terms *= memory
        self._lane_terms *= (
            memory if self._lane_terms[0, 0] * self._pitch_px2 > _MIN_INFORMATION else 0.0
        )
        return step_s

    def _updated(self, contacts: _Contacts, track_id: IntArray, *, step_s: float) -> _Plane:
        """The road at each of N tracks from all other objects, with the measurements of the
        frame.
        """
        if not len(track_id):
            return _Plane(np.zeros((_N, 0)), np.zeros((_N, _N, 0)))
        own = self._accumulated(contacts, track_id, step_s=step_s)
        others = _solved(self._information - own)
        self._update_pitch(contacts, others, step_s=step_s)
        return others

    def _keep_past(self, tracks: Tracks, step_s: float, *, forgotten: float) -> None:
        """Keep a part of what is forgotten of the tracks that left."""
        has_left = self._tracks.is_absent(tracks.track_id)
        if not has_left.any() and not self._past_terms.any():
            return
        self._past_terms *= math.exp(-step_s / _DRIVE_S)
        of_left = self._tracks.known[..., has_left].sum(axis=-1)
        self._past_terms += _PAST_WEIGHT * forgotten * of_left
        self._known_prior = None

    @property
    def _plane_alone(self) -> _Plane:
        """The road without the objects on it."""
        return _solved((self._prior + self._lane_terms)[..., None])

    @property
    def _prior(self) -> FloatArray:
        """(4, 5) normal equations of the settings, of image motion or the mounting, and of the
        drive's bias.
        """
        if self._known_prior is None:
            self._known_prior = self._prior_terms()
        return self._known_prior

    def _prior_terms(self) -> FloatArray:
        settings, fy, road = self._settings, self._camera.fy_px, self._road
        curvature = covariance = 0.0  # of the road, without image motion
        if road is None:
            horizon_variance, curvature_variance = settings.horizon_sigma_rad**2, 0.0
        else:
            curvature, covariance = road.curvature_per_m, road.covariance
            horizon_variance = road.horizon_variance + settings.road_sigma_rad**2
            curvature_variance = road.curvature_variance
        # P^-1 of y0 and fy k, which alone are correlated, by the inverse of a matrix (2, 2)
        P_yy, P_yk = fy**2 * horizon_variance, fy**2 * covariance
        P_kk = fy**2 * curvature_variance + _FIXED**2
        determinant = P_yy * P_kk - P_yk**2
        of_y, of_yk, of_k = P_kk / determinant, -P_yk / determinant, P_yy / determinant
        of_H, H, k = settings.height_sigma_m**-2, settings.height_m, fy * curvature
        terms = np.array(
            [
                [of_y, 0.0, of_yk, 0.0, of_yk * k],
                [0.0, of_H, 0.0, 0.0, of_H * H],
                [of_yk, 0.0, of_k, 0.0, of_k * k],
                [0.0, 0.0, 0.0, 1.0 / self._bias_variance, 0.0],
            ]
        )
        if road is None and self._past_terms.any():  # since those tracks the pitch has changed
            known = _solved((terms + self._past_terms)[..., None])
            known.P[0, 0] += (settings.pitch_sigma_rad * fy) ** 2
            information = np.linalg.inv(known.P[..., 0])
            information = (information + information.T) / 2  # symmetric but for rounding
            terms = np.concatenate([information, information @ known.x], axis=1)
        return terms

    def _expected_px(self, x_px: FloatArray) -> FloatArray:
        """Row (...) of the expected horizon at columns (...), from image motion or the camera's
        axis.
        """
        camera, road = self._camera, self._road
        if road is None:
            return np.full(x_px.shape, camera.cy_px)
        tangent = road.horizon + road.slope * (x_px - camera.cx_px) / camera.fx_px
        return np.asarray(camera.cy_px + camera.fy_px * tangent)

    def _of_ground(self, s: FloatArray, across_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(4, ...) derivatives of the row of the ground at s = fy / d (...) in px/m by the unknowns,
        without b, and (...) variance R in px^2 of bottom edges about it.
        """
        settings, fy = self._settings, self._camera.fy_px
        distance_m = fy / s
        basis = np.zeros((_N, *s.shape))
        basis[0], basis[1] = 1.0, s
        np.multiply(curvature_fraction(distance_m), distance_m / -2, out=basis[2])
        place_px = settings.place_sigma_m(across_px / s) * s
        box_and_kerb = settings.box_sigma_px**2 + place_px * place_px
        if self._road is None:
            return basis, np.asarray(self._pitch_px2 + box_and_kerb)
        ahead_px2 = unknown_curvature_variance(distance_m) * (fy * distance_m / 2) ** 2
        return basis, np.asarray((_MOVING_PITCH_RAD * fy) ** 2 + ahead_px2 + box_and_kerb)

    def _contacts(self, tracks: Tracks, by_size: Ranges, frame: Frame) -> _Contacts:
        y = tracks.xyxy_px[:, 3]
        x = (tracks.xyxy_px[:, 0] + tracks.xyxy_px[:, 2]) / 2
        last_px = frame.left.shape[0] - 0.5 - BORDER_PX
        on_ground = tracks.observed & _ON_GROUND[tracks.class_id] & (y <= last_px)
        has_visible_boxes = self._settings.has_visible_boxes
        offset_m = surface_offset_m(
            tracks.xyxy_px, tracks.class_id, has_visible_boxes=has_visible_boxes
        )
        is_informative = on_ground & (by_size.distance_m > 2 * offset_m)  # False for NaN
        s = self._camera.fy_px / np.where(
            is_informative, by_size.distance_m - offset_m, self._camera.fy_px
        )
        right, ahead = (1.0, 0.0) if self._road is None else self._road.across
        across_px = right * (x - self._camera.cx_px) + ahead * self._camera.fy_px
        s_sigma = s * np.where(is_informative, by_size.sigma_m / by_size.distance_m, 1.0)
        basis, R = self._of_ground(s, across_px)
        return _Contacts(
            y=y - self._expected_px(x),
            offset_m=offset_m,
            s=s,
            s_variance=np.maximum(
                s_sigma * s_sigma - self._bias_variance * s * s, _MIN_OWN * s_sigma * s_sigma
            ),
            basis=basis,
            R=R,
            across_px=across_px,
            on_ground=on_ground,
            is_informative=is_informative,
        )

    def _is_informed(self) -> BoolArray:
        """(K,) which of the known tracks still say something about the horizon."""
        return np.asarray(self._tracks.known[0, 0] * self._pitch_px2 > _MIN_INFORMATION)

    def _accumulated(self, contacts: _Contacts, track_id: IntArray, *, step_s: float) -> FloatArray:
        """(4, 5, N) normal equations of the tracks, with this frame's measurements in their running
        averages.
        """
        previous = self._tracks.get(track_id)
        # new tracks are added, and forgotten ones left out, before the road is estimated
        self._tracks.put(track_id, previous, keep_known=self._is_informed())
        plane = _solved(self._information)
        a, H = contacts.basis.copy(), float(plane.x[1, 0])
        variance = H**2 * contacts.s_variance + contacts.R
        a[3] = -H * contacts.s  # by b: an object farther by b is at s (1 - b)
        excess = np.abs(contacts.y - plane.rows(a))
        excess /= _HUBER_SIGMA * np.sqrt(variance + plane.variance(a))
        weight = 1.0 / (variance * np.maximum(1.0, excess))
        gain = contacts.is_informative * np.where(
            previous[0, 0] == 0, 1.0, 1.0 - math.exp(-step_s / self._settings.average_s)
        )
        terms = a[:, None] * np.concatenate([a, contacts.y[None]]) * weight
        average = np.asarray(gain * terms + (1.0 - gain) * previous)
        self._tracks.known[..., : len(track_id)] = average  # the tracks of `put` are the first
        return average

    def _update_pitch(self, contacts: _Contacts, plane: _Plane, *, step_s: float) -> None:
        """Update the pitch variance so that the squared residuals agree with their expected
        values.
        """
        if step_s == 0.0 or self._road is not None:
            return
        basis, pitch_px2 = contacts.basis, self._pitch_px2
        residual = contacts.y - plane.rows(basis)
        expected = plane.x[1] ** 2 * contacts.s_variance + plane.variance(basis) + contacts.R
        excess = np.minimum(residual**2, 10 * expected) - expected
        # small if other errors dominate
        weight = contacts.is_informative * (pitch_px2 / expected) ** 2
        gain = 1.0 - math.exp(-step_s / self._settings.pitch_memory_s)
        pitch_px2 += gain * float(weight @ excess) / (1.0 + float(weight.sum()))
        initial_px2 = (self._settings.pitch_sigma_rad * self._camera.fy_px) ** 2
        self._pitch_px2 = min(max(pitch_px2, initial_px2 / 16), 9 * initial_px2)

    def _distances(self, contacts: _Contacts, plane: _Plane) -> tuple[FloatArray, FloatArray]:
        """(..., N) distances of N tracks, for each of several roads, and their standard
        deviations.
        """
        fy, (y0, H, fy_k, _) = self._camera.fy_px, plane.x
        below_px = contacts.y - y0
        is_below = contacts.on_ground & (below_px > 1.0) & (H > 0.1)
        H, fy_k = np.where(is_below, H, 1.0), np.where(is_below, fy_k, 1.0)
        contact_m = _distance_on_curve_m(np.where(is_below, below_px, 1.0) / fy, H, fy_k / fy)
        s = fy / contact_m
        basis, R = self._of_ground(s, contacts.across_px)
        per_log_m = np.maximum(H * s - basis[2] * fy_k, _MIN_SLOPE * H * s)  # -d row / d log d
        sigma = np.sqrt(plane.variance(basis) + R) / per_log_m
        is_valid = is_below & (sigma < self._settings.max_sigma)
        contact_m = np.where(is_valid, contact_m, np.nan)
        return contact_m + contacts.offset_m, contact_m * sigma


class GroundRanger(Ranger):
    """Ranger of objects on the road; its horizon comes from image motion, or mono's distances and
    lane lines.

    Attributes:
        plane: estimator of the horizon.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        settings: GroundSettings | None = None,
        *,
        is_reference: bool = False,
        has_stereo: bool = False,
    ) -> None:
        """Create a ranger for `camera` (undistorted).

        `is_reference` is whether the camera height is known, so that image motion measures the
        drive's scale. With a calibrated pair (`has_stereo`), the ground remains a fallback in
        fusion, since kerbs are an error that mono has as well, and stereo measures the drive's
        scale.
        """
        self._has_stereo = has_stereo
        self._usual = settings or GroundSettings()
        self.plane = GroundPlane(camera, self._usual)
        self._is_reference = self._has_height = is_reference
        self._road: RoadView | None = None

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances of the objects on the ground, from the horizon estimated so far."""
        return self.measure_with(tracks, frame, {})

    def measure_with(self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges]) -> Ranges:
        """Distances of the objects on the ground (`GroundPlane.measure`); mono's distances update
        the horizon.
        """
        return self.measure_at_scale(tracks, frame, others, NO_EVIDENCE).ranges

    def measure_at_scale(
        self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges], scale: DriveScale
    ) -> Measured:
        """See `measure_with`; mono's distances share the uncertainty of the scale, which a known
        height measures.
        """
        self.plane.update_road(self._road, bias_sigma=scale.bias_of("car").sigma)
        by_size = others["mono"] if "mono" in others else Ranges.unmeasured(tracks.track_id)
        is_independent = self._is_reference and self.plane.has_seen_horizon and not self._has_stereo
        if not is_independent:
            return Measured(self.plane.measure(tracks, by_size, frame))
        ranges, alone = self.plane.measure_both(tracks, by_size, frame)
        if self._road is None or "mono" not in others:
            return Measured(ranges)
        common = _COMMON * alone.sigma_m / alone.distance_m
        evidence = ScaleEvidence(tracks.class_id, None, alone, _REFERENCE_SIGMA, common)
        return Measured(ranges, evidence)

    def update_road(self, road: RoadView) -> None:
        """Use the road in the next frame as image motion shows it."""
        self._road = road
        # a height that is no longer measured, since its speed is in doubt, is unknown again
        if not self._has_height:
            height_m, sigma_m = road.height_m or (self._usual.height_m, self._usual.height_sigma_m)
            self.plane.set_height(height_m, sigma_m)
            self._is_reference = sigma_m < _MAX_HEIGHT_SIGMA * height_m
        self.plane.update_road(road)

    def update_lanes(self, lines: LaneLines) -> None:
        """Add the row at which the lane lines meet as a measurement of the horizon."""
        if (horizon := lines.horizon_px()) is not None:
            self.plane.add_horizon(*horizon)


def _solved(normal: FloatArray) -> _Plane:
    """Least-squares solutions of (4, 5, N) normal equations, with their covariances."""
    A, v = normal[:, :_N], normal[:, _N]
    P = np.asarray(np.linalg.inv(A.transpose(2, 0, 1)).transpose(1, 2, 0), np.float64)
    return _Plane(np.asarray(np.add.reduce(P * v, axis=1)), P)


def _distance_on_curve_m(below: FloatArray, H: FloatArray, k: FloatArray) -> FloatArray:
    """(N,) distances d of contact points: below = H / d - fraction(d) k d / 2; beyond a crest, the
    largest visible one.

    `below` (N,) are tangents below the horizon, positive; camera heights H in m, curvatures k of
    the road in 1/m.
    """
    distance_m = H / below
    for _ in range(_N_CURVE_ROUNDS):
        root = np.sqrt(np.maximum(below**2 + 2 * curvature_fraction(distance_m) * k * H, 0.0))
        distance_m = 2 * H / (below + root)
    return np.asarray(distance_m)


def _create(context: MethodContext) -> Ranger:
    if context.road_plane is not None:
        return KnownPlaneRanger(context.road_plane)
    height_m, box_sigma_px = context.camera_height_m, context.box_sigma_px
    settings = GroundSettings() if height_m is None else GroundSettings.of_known_height(height_m)
    settings = replace(settings, has_visible_boxes=context.has_visible_boxes)
    if box_sigma_px is not None:
        settings = replace(settings, box_sigma_px=box_sigma_px)
    return GroundRanger(
        context.camera,
        settings,
        is_reference=height_m is not None,
        has_stereo=context.rig is not None,
    )


GROUND = RangingMethod(
    name="ground",
    title="ground plane",
    letter="P",
    colour="#73702e",
    create=_create,
    reads=("mono",),
    uses_road_plane=True,
    error_sources=(
        ErrorSource("horizon", systematic=0.25),
        ErrorSource("contact_point", systematic=0.2, independent=0.4),
        ErrorSource("own", independent=0.15),
    ),
    fallback_for="mono",
)
"""The ground plane as a ranging method. It is a fallback for mono unless image motion and a known
camera height determine it: otherwise its horizon comes from mono's distances, and it adds nothing
for a track that mono measures."""
