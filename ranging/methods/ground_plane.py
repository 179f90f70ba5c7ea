r"""GroundRanger: distance from an object's contact point: bottom edge of the box, height of the camera, horizon.

    d = fy H / (y_bottom - y_horizon)

              o camera -------------- y_horizon (vanishing line of the road; moves with pitch and slope)
              |  \
            H |     \   y_bottom
    __________|________\[object]___

No calibration gives the horizon: it moves with every bump, and differs between roads by 3 degrees, 40 px. It is
estimated from the objects on the road: one whose size gives the distance d_i is a measurement

    y_bottom_i = y_horizon + H fy / d_i,   variance = (H fy / d_i)^2 (sigma_i / d_i)^2 + pitch^2 + edge^2

and the two unknowns (H nearly known where the camera's height is given) are found by weighted least squares over all
tracks. A track counts once, with the average of its recent measurements: its size is wrong in the same way in every
frame. For the same reason an object is measured against the horizon of the others, without its own measurement: the
ground would else only repeat the size. The pitch variance (slopes, kerbs, pitch) is learnt from the residuals.

The bottom edge belongs to the nearest point that touches the ground, while `distance_m` is where the ray through the
centre of the box meets the object: for a car seen from its side up to half a metre farther (`surface_offset_m`).
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
"""Size classes whose objects stand on the ground."""

_ON_GROUND = np.array([name in GROUND_CLASSES for name in SIZE_CLASSES])

_HUBER_SIGMA = 2.0
"""Residuals beyond this many sigmas count linearly (Huber)."""

_LANES_ID = -1
"""Of the horizon measured by lane lines, beside the track ids, which are positive."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundSettings:
    """Settings of the ground plane.

    Attributes:
        height_m: of the camera above the road.
        height_sigma_m: its standard deviation: small where it was measured, large where it is assumed.
        horizon_sigma_rad: standard deviation of the angle between the camera's axis and the horizon, a priori.
        average_s: time constant over which the measurements of a track are averaged.
        memory_s: time constant with which a track's measurement is forgotten when the track is gone.
        pitch_sigma_rad: initial standard deviation of pitch and slope; it is learnt from the residuals.
        pitch_memory_s: time constant over which it is learnt.
        kerb_m: standard deviation of the contact points' height above the road: kerbs, camber.
        box_sigma_px: standard deviation of one edge of a box.
        max_sigma: largest relative standard deviation of a distance that is given.
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
        """Settings for a camera whose height was measured."""
        return cls(height_m=height_m, height_sigma_m=0.05)


@dataclass(frozen=True, slots=True)
class Horizon:
    """The vanishing line of the road, at the middle column of the image.

    Attributes:
        y_px: row, in the frame's pixels.
        sigma_px: its standard deviation.
        height_m: of the camera above the road.
    """

    y_px: float
    sigma_px: float
    height_m: float


_N_TERMS = 5
"""Terms of the information about (horizon, height): a symmetric 2 x 2 matrix (3) and a vector (2)."""

_MIN_INFORMATION = 1e-3
"""In units of one certain track's: what has faded below is dropped."""


class _Plane(NamedTuple):
    """(N,) horizons, px below the camera's axis, heights of the camera, and their covariance."""

    horizon_px: FloatArray
    height_m: FloatArray
    horizon_variance: FloatArray
    covariance: FloatArray
    height_variance: FloatArray

    def variance(self, slope_px: FloatArray) -> FloatArray:
        """(N,) variance, px^2, of the row of the ground at a distance where a metre of height has `slope_px` px."""
        return self.horizon_variance + slope_px * (2 * self.covariance + slope_px * self.height_variance)


@dataclass(frozen=True, slots=True)
class _Contacts:
    """Contact points of the tracks of one frame, (N,) each.

    Attributes:
        bottom_px: row of the bottom edge below the camera's axis.
        offset_m: from the contact point to the surface whose distance is given.
        slope_px: fy / d by size, px per metre of height; 1 where there is no distance by size.
        slope_variance: variance of slope_px.
        variance_px2: variance of the bottom edge about the plane.
        on_ground: whether the bottom edge is seen and belongs to an object on the ground.
        is_informative: whether it has a distance by size as well, and so measures the horizon.
    """

    bottom_px: FloatArray
    offset_m: FloatArray
    slope_px: FloatArray
    slope_variance: FloatArray
    variance_px2: FloatArray
    on_ground: BoolArray
    is_informative: BoolArray


class GroundPlane:
    """Estimates the horizon and the height of the camera from the tracks of a video."""

    def __init__(self, camera: PinholeCamera, settings: GroundSettings | None = None) -> None:
        """Start from the settings alone."""
        self._camera = camera
        self._settings = settings or GroundSettings()
        self._ids = np.zeros(0, np.int64)
        self._terms = np.zeros((_N_TERMS, 0))
        self._pitch_px2 = (self._settings.pitch_sigma_rad * camera.fy_px) ** 2
        self._time_s: float | None = None
        self._prior = _information(self._settings, camera)

    @property
    def horizon(self) -> Horizon:
        """The current estimate."""
        found = _solved(self._information)
        return Horizon(
            float(self._camera.cy_px + found.horizon_px), float(np.sqrt(found.horizon_variance)), float(found.height_m)
        )

    @property
    def _information(self) -> FloatArray:
        """(5,) information of the settings and of all tracks."""
        return np.asarray(self._prior + self._terms.sum(axis=1))

    def add_horizon(self, y_px: float, sigma_px: float) -> None:
        """Take in the row where lane lines meet; it is forgotten like a track's measurement."""
        weight = 1.0 / (sigma_px**2 + self._pitch_px2)
        (slot,) = self._slots(np.array([_LANES_ID]))
        self._terms[:, slot] = [weight, 0.0, 0.0, weight * (y_px - self._camera.cy_px), 0.0]

    def measure(self, tracks: Tracks, by_size: Ranges, frame: Frame) -> Ranges:
        """Distances of the tracks on the ground, after their distances by size have updated the horizon.

        NaN for predicted boxes, boxes cut at the bottom, above the horizon, and where the horizon is too uncertain.
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
        self._learn_pitch(contacts, others, step_s=step_s)
        return self._ranges(tracks.track_id, contacts, others)

    def _contacts(self, tracks: Tracks, by_size: Ranges, frame: Frame) -> _Contacts:
        bottom_px = tracks.xyxy_px[:, 3]
        last_px = frame.left.shape[0] - 0.5 - BORDER_PX
        on_ground = tracks.observed & _ON_GROUND[tracks.class_id] & (bottom_px <= last_px)
        offset_m = surface_offset_m(tracks.xyxy_px, tracks.class_id)
        is_informative = on_ground & (by_size.distance_m > 2 * offset_m)  # False for NaN
        slope_px = self._camera.fy_px / np.where(is_informative, by_size.distance_m - offset_m, self._camera.fy_px)
        slope_sigma_px = slope_px * np.where(is_informative, by_size.sigma_m / by_size.distance_m, 1.0)
        return _Contacts(
            bottom_px=bottom_px - self._camera.cy_px,
            offset_m=offset_m,
            slope_px=slope_px,
            slope_variance=slope_sigma_px * slope_sigma_px,
            variance_px2=self._row_variance_px2(slope_px),
            on_ground=on_ground,
            is_informative=is_informative,
        )

    def _slots(self, track_id: IntArray) -> IntArray:
        """(N,) slot of each track in `_terms`; slots that have faded are removed, new tracks get empty ones."""
        same = track_id[:, None] == self._ids
        is_known, is_here = same.any(axis=1), same.any(axis=0)
        keep = is_here | (self._terms[0] * self._pitch_px2 > _MIN_INFORMATION)
        if is_known.all() and keep.all():
            return np.asarray(same.argmax(axis=1))
        fresh = track_id[~is_known]
        self._ids = np.concatenate([self._ids[keep], fresh])
        self._terms = np.concatenate([self._terms[:, keep], np.zeros((_N_TERMS, len(fresh)))], axis=1)
        return np.asarray((track_id[:, None] == self._ids).argmax(axis=1))

    def _accumulated(self, contacts: _Contacts, slots: IntArray, *, step_s: float) -> FloatArray:
        """(5, N) information of the tracks, after this frame's measurements were averaged into the recent ones."""
        plane = _solved(self._information)
        slope_px, bottom_px = contacts.slope_px, contacts.bottom_px
        variance = plane.height_m**2 * contacts.slope_variance + contacts.variance_px2
        excess = np.abs(bottom_px - plane.horizon_px - plane.height_m * slope_px)
        excess /= _HUBER_SIGMA * np.sqrt(variance + plane.variance(slope_px))
        weight = 1.0 / (variance * np.maximum(1.0, excess))
        before = self._terms.take(slots, axis=1)
        share = contacts.is_informative * np.where(
            before[0] == 0, 1.0, 1.0 - math.exp(-step_s / self._settings.average_s)
        )
        now = np.array([np.ones_like(slope_px), slope_px, slope_px * slope_px, bottom_px, slope_px * bottom_px])
        own = share * weight * now + (1.0 - share) * before
        self._terms[:, slots] = own
        return np.asarray(own)

    def _learn_pitch(self, contacts: _Contacts, plane: _Plane, *, step_s: float) -> None:
        """Move the pitch variance to where the squares of the residuals are as large as expected."""
        if step_s == 0.0:
            return
        slope_px, now = contacts.slope_px, self._pitch_px2
        residual = contacts.bottom_px - plane.horizon_px - plane.height_m * slope_px
        expected = plane.height_m**2 * contacts.slope_variance + plane.variance(slope_px) + contacts.variance_px2
        surprise = np.minimum(residual**2, 10 * expected) - expected
        trust = contacts.is_informative * (now / expected) ** 2  # little where other reasons dominate
        share = 1.0 - math.exp(-step_s / self._settings.pitch_memory_s)
        now += share * float(trust @ surprise) / (1.0 + float(trust.sum()))
        start = (self._settings.pitch_sigma_rad * self._camera.fy_px) ** 2
        self._pitch_px2 = min(max(now, start / 16), 9 * start)

    def _ranges(self, track_id: IntArray, contacts: _Contacts, plane: _Plane) -> Ranges:
        below_px = contacts.bottom_px - plane.horizon_px
        is_below = contacts.on_ground & (below_px > 1.0) & (plane.height_m > 0.1)
        below_px, height_m = np.where(is_below, (below_px, plane.height_m), 1.0)
        slope_px = below_px / height_m
        sigma = np.sqrt(plane.variance(slope_px) + self._row_variance_px2(slope_px)) / below_px
        good = is_below & (sigma < self._settings.max_sigma)
        touch_m = np.where(good, self._camera.fy_px / slope_px, np.nan)
        return Ranges(track_id, touch_m + contacts.offset_m, touch_m * sigma)

    def _row_variance_px2(self, slope_px: FloatArray) -> FloatArray:
        """(N,) variance of bottom edges about the plane, where a metre of height has `slope_px` px."""
        return np.asarray(self._pitch_px2 + self._settings.box_sigma_px**2 + (self._settings.kerb_m * slope_px) ** 2)


class GroundRanger(Ranger):
    """The ground plane as a ranging method: the horizon comes from mono's distances and from lane lines.

    Attributes:
        plane: the estimator of the horizon.
    """

    def __init__(self, camera: PinholeCamera, settings: GroundSettings | None = None) -> None:
        """Range for `camera` (undistorted)."""
        self.plane = GroundPlane(camera, settings)

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances of the objects on the ground, by the horizon estimated so far."""
        return self.measure_with(tracks, frame, {})

    def measure_with(self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges]) -> Ranges:
        """Distances of the objects on the ground, see `GroundPlane.measure`; mono's distances update the horizon."""
        by_size = others.get("mono", Ranges.unmeasured(tracks.track_id))
        return self.plane.measure(tracks, by_size, frame)

    def update_lanes(self, lines: LaneLines) -> None:
        """Take the row where the lines meet as a measurement of the horizon."""
        if (horizon := lines.horizon_px()) is not None:
            self.plane.add_horizon(*horizon)


def _information(settings: GroundSettings, camera: PinholeCamera) -> FloatArray:
    """(5,) information of the settings alone."""
    horizon = 1.0 / (settings.horizon_sigma_rad * camera.fy_px) ** 2
    height = 1.0 / settings.height_sigma_m**2
    return np.array([horizon, 0.0, height, 0.0, height * settings.height_m])


def _solved(terms: FloatArray) -> _Plane:
    """The planes of (5, ...) information: the least-squares solutions and their covariances."""
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
"""The horizon is found by mono's sizes: where mono has measured a track, ground adds nothing to it."""
