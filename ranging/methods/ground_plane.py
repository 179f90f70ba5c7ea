r"""GroundRanger: distance from the contact point of an object, the camera height and the horizon.

    d = fy H / (y - y0)

              o camera -------------- y0, horizon (vanishing line of the road; moves with pitch and slope)
              |  \
            H |     \   y, bottom edge of the box
    __________|________\[object]___

The horizon y0 is not part of a calibration: it moves with every bump, and differs between roads by 3 degrees or 40 px.
It is estimated from the objects on the road: with its distance d_i by size, object i is a measurement

    y_i = y0 + H s_i,   s_i = fy / d_i,   variance = (H s_i)^2 (sigma_i / d_i)^2 + R
    R = pitch^2 + edge^2 + (kerb s_i)^2

of y0 and H, which are solved for by weighted least squares over all tracks (with H nearly known if the camera height is
given). A track contributes the average of its recent measurements once, since its size error is the same in every
frame. For the same reason each object is ranged with the horizon from the other objects only; otherwise its distance
would repeat that by size. The pitch variance (pitch, slopes) is estimated from the residuals.

The bottom edge belongs to the nearest point on the ground, while `distance_m` is where the ray through the box centre
meets the object, for a car seen from the side up to half a metre farther (`surface_offset_m`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from track_range.detection.lanes.lines import LaneLines
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.ranging.method import ErrorSource, MethodContext, RangingMethod
from track_range.ranging.ranger import Ranger
from track_range.ranging.ranges import Ranges
from track_range.ranging.size_models.shared_ground import solve_ground
from track_range.ranging.size_models.size_model import BORDER_PX, SIZE_CLASSES
from track_range.ranging.size_models.surface_offset import surface_offset_m
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

GROUND_CLASSES = ("person", "bicycle", "car", "motorcycle", "bus", "truck", "van")
"""Size classes of objects on the ground."""

_ON_GROUND = np.array([name in GROUND_CLASSES for name in SIZE_CLASSES])
"""(size classes,) whether objects of the class are on the ground."""

_HUBER_SIGMA = 2.0
"""Residual in standard deviations beyond which measurements are down-weighted (Huber)."""

_LANES_ID = -1
"""Id of the horizon measured by lane lines among the track ids, which are positive."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundSettings:
    """Settings of the ground plane.

    Attributes:
        height_m: prior mean of the camera height H above the road.
        height_sigma_m: standard deviation of `height_m`: small if measured, large if assumed.
        horizon_sigma_rad: prior standard deviation of the angle between the camera's axis and the horizon.
        average_s: time constant for averaging the measurements of a track.
        memory_s: time constant of the decay of a track's measurement after the track ended.
        pitch_sigma_rad: initial standard deviation of pitch and slope; updated from the residuals.
        pitch_memory_s: time constant of the update of `pitch_sigma_rad`.
        kerb_m: standard deviation of the height of contact points above the road (kerbs, camber).
        box_sigma_px: standard deviation of one box edge.
        max_sigma: largest relative standard deviation of a reported distance.
    """

    height_m: float = 1.5
    height_sigma_m: float = 0.3
    horizon_sigma_rad: float = 0.03
    average_s: float = 0.3
    memory_s: float = 1.5
    pitch_sigma_rad: float = 0.008
    pitch_memory_s: float = 5.0
    kerb_m: float = 0.1
    box_sigma_px: float = 1.5
    max_sigma: float = 0.5

    @classmethod
    def of_known_height(cls, height_m: float) -> GroundSettings:
        """Settings for a camera with a measured height."""
        return cls(height_m=height_m, height_sigma_m=0.05)


@dataclass(frozen=True, slots=True)
class Horizon:
    """Vanishing line of the road at the middle column of the image.

    Attributes:
        y_px: row of the horizon in px of the frame.
        sigma_px: standard deviation of `y_px`.
        height_m: height H of the camera above the road.
    """

    y_px: float
    sigma_px: float
    height_m: float


_N_TERMS = 5
"""Terms of the normal equations for (y0, H): a symmetric 2 x 2 matrix (3) and a vector (2)."""

_MIN_INFORMATION = 1e-3
"""Smallest information of a track about the horizon, relative to a new measurement; tracks with less are dropped."""


class _Plane(NamedTuple):
    """Least-squares estimates of ground planes and their covariances, (N,) each.

    Attributes:
        y0: horizon in px below the camera's axis.
        H: camera height in m.
        y0_variance: variance of `y0`.
        covariance: covariance of `y0` and `H`.
        H_variance: variance of `H`.
    """

    y0: FloatArray
    H: FloatArray
    y0_variance: FloatArray
    covariance: FloatArray
    H_variance: FloatArray

    def variance(self, s: FloatArray) -> FloatArray:
        """(N,) variance in px^2 of the row y0 + H s of the ground, for s = fy / d (N,) in px/m."""
        return self.y0_variance + s * (2 * self.covariance + s * self.H_variance)


@dataclass(frozen=True, slots=True)
class _Contacts:
    """Contact points of the tracks of one frame, (N,) each.

    Attributes:
        y: row of the bottom edge in px below the camera's axis.
        offset_m: distance from the contact point to the visible surface.
        s: fy / d with the distance by size, in px/m; 1 = no distance by size.
        s_variance: variance of `s`.
        R: variance of `y` about the ground plane, px^2.
        on_ground: whether the bottom edge is visible and the object is on the ground.
        is_informative: whether there is also a distance by size, so that the track measures the horizon.
    """

    y: FloatArray
    offset_m: FloatArray
    s: FloatArray
    s_variance: FloatArray
    R: FloatArray
    on_ground: BoolArray
    is_informative: BoolArray


class GroundPlane:
    """Estimator of the horizon and the camera height from the tracks of a video."""

    def __init__(self, camera: PinholeCamera, settings: GroundSettings | None = None) -> None:
        """Start from the prior in the settings; `camera` is undistorted."""
        self._camera = camera
        self._settings = settings or GroundSettings()
        self._ids = np.zeros(0, np.int64)
        self._terms = np.zeros((_N_TERMS, 0))
        self._pitch_px2 = (self._settings.pitch_sigma_rad * camera.fy_px) ** 2
        self._time_s: float | None = None
        self._prior = _information(self._settings, camera)

    @property
    def horizon(self) -> Horizon:
        """Current estimate of the horizon and the camera height."""
        plane = _solved(self._information)
        return Horizon(float(self._camera.cy_px + plane.y0), float(np.sqrt(plane.y0_variance)), float(plane.H))

    @property
    def _information(self) -> FloatArray:
        """(5,) information of the prior and of all tracks."""
        return np.asarray(self._prior + self._terms.sum(axis=1))

    def add_horizon(self, y_px: float, sigma_px: float) -> None:
        """Add the row at which lane lines meet as a measurement of the horizon; it decays like that of a track."""
        weight = 1.0 / (sigma_px**2 + self._pitch_px2)
        (slot,) = self._slots(np.array([_LANES_ID]))
        self._terms[:, slot] = [weight, 0.0, 0.0, weight * (y_px - self._camera.cy_px), 0.0]

    def measure(self, tracks: Tracks, by_size: Ranges, frame: Frame) -> Ranges:
        """Distances of the tracks on the ground; their distances by size update the horizon first.

        NaN for predicted boxes, boxes truncated at the bottom or above the horizon, and sigmas above `max_sigma`.
        """
        step_s = 0.0 if self._time_s is None else max(frame.time_s - self._time_s, 0.0)
        self._time_s = frame.time_s
        self._terms *= math.exp(-step_s / self._settings.memory_s)
        if not len(tracks):
            return Ranges.unmeasured(tracks.track_id)
        contacts = self._contacts(tracks, by_size, frame)
        slots = self._slots(tracks.track_id)
        own = self._accumulated(contacts, slots, step_s=step_s)
        others = _solved(self._information[:, None] - own)
        self._update_pitch(contacts, others, step_s=step_s)
        return self._ranges(tracks.track_id, contacts, others)

    def _contacts(self, tracks: Tracks, by_size: Ranges, frame: Frame) -> _Contacts:
        y = tracks.xyxy_px[:, 3]
        last_px = frame.left.shape[0] - 0.5 - BORDER_PX
        on_ground = tracks.observed & _ON_GROUND[tracks.class_id] & (y <= last_px)
        offset_m = surface_offset_m(tracks.xyxy_px, tracks.class_id)
        is_informative = on_ground & (by_size.distance_m > 2 * offset_m)  # False for NaN
        s = self._camera.fy_px / np.where(is_informative, by_size.distance_m - offset_m, self._camera.fy_px)
        s_sigma = s * np.where(is_informative, by_size.sigma_m / by_size.distance_m, 1.0)
        return _Contacts(
            y=y - self._camera.cy_px,
            offset_m=offset_m,
            s=s,
            s_variance=s_sigma * s_sigma,
            R=self._row_variance(s),
            on_ground=on_ground,
            is_informative=is_informative,
        )

    def _slots(self, track_id: IntArray) -> IntArray:
        """(N,) index of each track in `_terms`; removes tracks with too little information and adds new ones."""
        is_same = track_id[:, None] == self._ids
        is_known, is_present = is_same.any(axis=1), is_same.any(axis=0)
        stays = is_present | (self._terms[0] * self._pitch_px2 > _MIN_INFORMATION)
        if is_known.all() and stays.all():
            return np.asarray(is_same.argmax(axis=1))
        new_id = track_id[~is_known]
        self._ids = np.concatenate([self._ids[stays], new_id])
        self._terms = np.concatenate([self._terms[:, stays], np.zeros((_N_TERMS, len(new_id)))], axis=1)
        return np.asarray((track_id[:, None] == self._ids).argmax(axis=1))

    def _accumulated(self, contacts: _Contacts, slots: IntArray, *, step_s: float) -> FloatArray:
        """(5, N) information of the tracks, with this frame's measurements in their running averages."""
        plane = _solved(self._information)
        s, y = contacts.s, contacts.y
        variance = plane.H**2 * contacts.s_variance + contacts.R
        excess = np.abs(y - plane.y0 - plane.H * s)
        excess /= _HUBER_SIGMA * np.sqrt(variance + plane.variance(s))
        weight = 1.0 / (variance * np.maximum(1.0, excess))
        previous = self._terms.take(slots, axis=1)
        gain = contacts.is_informative * np.where(
            previous[0] == 0, 1.0, 1.0 - math.exp(-step_s / self._settings.average_s)
        )
        terms = np.array([np.ones_like(s), s, s * s, y, s * y])
        average = gain * weight * terms + (1.0 - gain) * previous
        self._terms[:, slots] = average
        return np.asarray(average)

    def _update_pitch(self, contacts: _Contacts, plane: _Plane, *, step_s: float) -> None:
        """Update the pitch variance so that the squared residuals agree with their expected values."""
        if step_s == 0.0:
            return
        s, pitch_px2 = contacts.s, self._pitch_px2
        residual = contacts.y - plane.y0 - plane.H * s
        expected = plane.H**2 * contacts.s_variance + plane.variance(s) + contacts.R
        excess = np.minimum(residual**2, 10 * expected) - expected
        weight = contacts.is_informative * (pitch_px2 / expected) ** 2  # small if other errors dominate
        gain = 1.0 - math.exp(-step_s / self._settings.pitch_memory_s)
        pitch_px2 += gain * float(weight @ excess) / (1.0 + float(weight.sum()))
        initial_px2 = (self._settings.pitch_sigma_rad * self._camera.fy_px) ** 2
        self._pitch_px2 = min(max(pitch_px2, initial_px2 / 16), 9 * initial_px2)

    def _ranges(self, track_id: IntArray, contacts: _Contacts, plane: _Plane) -> Ranges:
        below_px = contacts.y - plane.y0
        is_below = contacts.on_ground & (below_px > 1.0) & (plane.H > 0.1)
        below_px, H = np.where(is_below, (below_px, plane.H), 1.0)
        s = below_px / H
        sigma = np.sqrt(plane.variance(s) + self._row_variance(s)) / below_px
        is_valid = is_below & (sigma < self._settings.max_sigma)
        contact_m = np.where(is_valid, self._camera.fy_px / s, np.nan)
        return Ranges(track_id, contact_m + contacts.offset_m, contact_m * sigma)

    def _row_variance(self, s: FloatArray) -> FloatArray:
        """(N,) variance R in px^2 of bottom edges about the ground plane, for s = fy / d (N,) in px/m."""
        return np.asarray(self._pitch_px2 + self._settings.box_sigma_px**2 + (self._settings.kerb_m * s) ** 2)


class GroundRanger(Ranger):
    """Ranges objects on the ground plane; its horizon is estimated from mono's distances and from lane lines.

    Attributes:
        plane: estimator of the horizon.
    """

    def __init__(self, camera: PinholeCamera, settings: GroundSettings | None = None) -> None:
        """Create a ranger for `camera` (undistorted)."""
        self.plane = GroundPlane(camera, settings)

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances of the objects on the ground, from the horizon estimated so far."""
        return self.measure_with(tracks, frame, {})

    def measure_with(self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges]) -> Ranges:
        """Distances of the objects on the ground (`GroundPlane.measure`); mono's distances update the horizon."""
        by_size = others.get("mono", Ranges.unmeasured(tracks.track_id))
        return self.plane.measure(tracks, by_size, frame)

    def update_lanes(self, lines: LaneLines) -> None:
        """Add the row at which the lane lines meet as a measurement of the horizon."""
        if (horizon := lines.horizon_px()) is not None:
            self.plane.add_horizon(*horizon)


def _information(settings: GroundSettings, camera: PinholeCamera) -> FloatArray:
    """(5,) information of the prior in the settings."""
    of_y0 = 1.0 / (settings.horizon_sigma_rad * camera.fy_px) ** 2
    of_H = 1.0 / settings.height_sigma_m**2
    return np.array([of_y0, 0.0, of_H, 0.0, of_H * settings.height_m])


def _solved(terms: FloatArray) -> _Plane:
    """Least-squares solutions of (5, ...) normal equations, with their covariances."""
    return _Plane(*solve_ground(*terms))


def _create(context: MethodContext) -> Ranger:
    height_m, box_sigma_px = context.camera_height_m, context.box_sigma_px
    settings = GroundSettings() if height_m is None else GroundSettings.of_known_height(height_m)
    if box_sigma_px is not None:
        settings = replace(settings, box_sigma_px=box_sigma_px)
    return GroundRanger(context.camera, settings)


GROUND = RangingMethod(
    name="ground",
    title="ground plane",
    letter="P",
    colour="#a0714f",
    create=_create,
    reads=("mono",),
    error_sources=(
        ErrorSource("horizon", systematic=0.64),
        ErrorSource("contact_point", independent=0.315),
        ErrorSource("own", independent=0.045),
    ),
    fallback_for="mono",
)
"""The ground plane as a ranging method. It is a fallback for mono: its horizon comes from mono's distances, so it adds
no information for a track that mono has measured."""
