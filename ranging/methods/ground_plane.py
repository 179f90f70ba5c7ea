r"""GroundPlaneRanger: distance from where an object stands: its box's bottom edge, the camera's height and a horizon.

    d = fy H / (y_bottom - y_horizon)

              o camera -------------- y_horizon (where the road's plane would end; moves with pitch and slope)
              |  \
            H |     \   y_bottom
    __________|________\[object]___

The horizon is not where a calibration puts it: it nods with every bump and differs between roads by 3 degrees, 40 px.
It is tracked from what stands on the road: each object whose size tells its distance d_i says

    y_bottom_i = y_horizon + H fy / d_i,   variance = (H fy / d_i)^2 (sigma_i / d_i)^2 + roughness^2 + edge^2

and the two unknowns (H nearly known where the camera's height is given) are a weighted least squares over all tracks.
A track counts once, with the average of what it said of late: its size is wrong in the same way in every frame. For the
same reason the horizon that an object is measured against is that of the others, without its own say: else the ground
would only repeat the size. Roughness (slopes, kerbs, pitch) is learnt from how badly the tracks agree.

The bottom edge belongs to the nearest point that touches the ground, while `distance_m` is where the ray through the
box's centre meets the object: a car seen from its side is met up to half a metre later (`surface_offset_m`).
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
from track_range.ranging.size_models.size_model import BORDER_PX, SIZE_CLASSES
from track_range.ranging.size_models.surface_offset import surface_offset_m
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

STANDING_CLASSES = ("person", "bicycle", "car", "motorcycle", "bus", "truck", "van")
"""What stands on the ground."""

_STANDS = np.array([name in STANDING_CLASSES for name in SIZE_CLASSES])
_HUBER_SIGMA = 2.0
_HINT_ID = -1  # beside the tracks' own, which are positive


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundSettings:
    """Settings of the ground plane.

    Attributes:
        height_m: of the camera above the road.
        height_sigma_m: standard deviation of it: small where it was measured, large where it is a guess.
        horizon_sigma_rad: how far from the camera's axis the horizon may be, before anything is seen.
        average_s: what a track says is averaged over about so long,
        memory_s: and is forgotten in about so long when the track is gone.
        roughness_rad: start of the learnt roughness of road and ride, as an angle,
        roughness_memory_s: and over how long it is learnt.
        kerb_m: how much higher or lower than the road things stand: kerbs, camber.
        box_sigma_px: standard deviation of a box's edge.
        max_sigma: relative; less certain distances are not given.
    """

    height_m: float = 1.5
    height_sigma_m: float = 0.3
    horizon_sigma_rad: float = 0.03
    average_s: float = 0.3
    memory_s: float = 1.5
    roughness_rad: float = 0.008
    roughness_memory_s: float = 5.0
    kerb_m: float = 0.1
    box_sigma_px: float = 1.5
    max_sigma: float = 0.5

    @classmethod
    def of_known_height(cls, height_m: float) -> GroundSettings:
        """For a camera whose height was measured."""
        return cls(height_m=height_m, height_sigma_m=0.05)


@dataclass(frozen=True, slots=True)
class Horizon:
    """Where the road's plane would end, at the image's middle column.

    Attributes:
        y_px: row, in the frame's pixels.
        sigma_px: its standard deviation.
        height_m: of the camera above the road.
    """

    y_px: float
    sigma_px: float
    height_m: float


_N_TERMS = 5  # of a symmetric 2 x 2 matrix (3) and a vector (2): information about horizon and height
_LEAST_INFORMATION = 1e-3  # in units of one sure track's; what has faded below is dropped


class _Plane(NamedTuple):
    """(N,) horizons below the camera's axis, camera's heights, and their covariance; a tuple, since many are made."""

    horizon_px: FloatArray
    height_m: FloatArray
    horizon_variance: FloatArray
    covariance: FloatArray
    height_variance: FloatArray

    def variance(self, slope_px: FloatArray) -> FloatArray:
        """(N,) px^2 of where the bottom edge belongs of what a metre of height is `slope_px` px for."""
        return self.horizon_variance + slope_px * (2 * self.covariance + slope_px * self.height_variance)


@dataclass(frozen=True, slots=True)
class _Seen:
    """One frame's tracks, (N,) each.

    Attributes:
        bottom_px: row of the bottom edge below the camera's axis.
        offset_m: from the point on the ground to the surface that is measured to.
        slope_px: fy / d by size: what a metre of the camera's height is in px; 1 where the size tells nothing.
        slope_variance: of that.
        stray_px2: variance of the bottom edge about the plane.
        is_standing: whether the bottom edge is seen and stands on the ground.
        tells: whether the size also tells something of the horizon.
    """

    bottom_px: FloatArray
    offset_m: FloatArray
    slope_px: FloatArray
    slope_variance: FloatArray
    stray_px2: FloatArray
    is_standing: BoolArray
    tells: BoolArray


class GroundPlane:
    """The horizon and the camera's height as the tracks of a video tell them."""

    def __init__(self, camera: PinholeCamera, settings: GroundSettings | None = None) -> None:
        """Start from the settings alone; no track has said anything."""
        self._camera = camera
        self._settings = settings or GroundSettings()
        self._ids = np.zeros(0, np.int64)
        self._terms = np.zeros((_N_TERMS, 0))
        self._variance_px2 = (self._settings.roughness_rad * camera.fy_px) ** 2
        self._time_s: float | None = None
        self._prior = _information(self._settings, camera)

    @property
    def horizon(self) -> Horizon:
        """What is known now."""
        found = _solved(self._information)
        return Horizon(
            float(self._camera.cy_px + found.horizon_px), float(np.sqrt(found.horizon_variance)), float(found.height_m)
        )

    @property
    def _information(self) -> FloatArray:
        """(5,) all that is known."""
        return np.asarray(self._prior + self._terms.sum(axis=1))

    def hint(self, y_px: float, sigma_px: float) -> None:
        """Take in a horizon seen otherwise: where lane lines meet; forgotten as a track's is."""
        weight = 1.0 / (sigma_px**2 + self._variance_px2)
        (place,) = self._places_of(np.array([_HINT_ID]))
        self._terms[:, place] = [weight, 0.0, 0.0, weight * (y_px - self._camera.cy_px), 0.0]

    def measure(self, tracks: Tracks, by_size: Ranges, frame: Frame) -> Ranges:
        """Distances of what stands on the ground; takes in what the tracks' sizes say of the horizon.

        NaN for predicted boxes, boxes cut at the bottom, above the horizon, and where the horizon is too unsure.
        """
        step_s = 0.0 if self._time_s is None else max(frame.time_s - self._time_s, 0.0)
        self._time_s = frame.time_s
        self._terms *= math.exp(-step_s / self._settings.memory_s)
        if not len(tracks):
            return Ranges.unmeasured(tracks.track_id)
        seen = self._seen(tracks, by_size, frame)
        places = self._places_of(tracks.track_id)
        told = self._taken_in(seen, places, step_s=step_s)
        others = _solved(self._information[:, None] - told)
        self._learn_roughness(seen, others, step_s=step_s)
        return self._ranges(tracks.track_id, seen, others)

    def _seen(self, tracks: Tracks, by_size: Ranges, frame: Frame) -> _Seen:
        bottom_px = tracks.xyxy_px[:, 3]
        last_px = frame.left.shape[0] - 0.5 - BORDER_PX
        is_standing = tracks.observed & _STANDS[tracks.class_id] & (bottom_px <= last_px)
        offset_m = surface_offset_m(tracks.xyxy_px, tracks.class_id)
        tells = is_standing & (by_size.distance_m > 2 * offset_m)  # NaN tells nothing
        slope_px = self._camera.fy_px / np.where(tells, by_size.distance_m - offset_m, self._camera.fy_px)
        slope_sigma_px = slope_px * np.where(tells, by_size.sigma_m / by_size.distance_m, 1.0)
        return _Seen(
            bottom_px=bottom_px - self._camera.cy_px,
            offset_m=offset_m,
            slope_px=slope_px,
            slope_variance=slope_sigma_px * slope_sigma_px,
            stray_px2=self._stray_px2(slope_px),
            is_standing=is_standing,
            tells=tells,
        )

    def _places_of(self, track_id: IntArray) -> IntArray:
        """(N,) place of each track in the memory; faded ones make room, new ones get a place that says nothing."""
        same = track_id[:, None] == self._ids
        is_known, is_here = same.any(axis=1), same.any(axis=0)
        keep = is_here | (self._terms[0] * self._variance_px2 > _LEAST_INFORMATION)
        if is_known.all() and keep.all():
            return np.asarray(same.argmax(axis=1))
        fresh = track_id[~is_known]
        self._ids = np.concatenate([self._ids[keep], fresh])
        self._terms = np.concatenate([self._terms[:, keep], np.zeros((_N_TERMS, len(fresh)))], axis=1)
        return np.asarray((track_id[:, None] == self._ids).argmax(axis=1))

    def _taken_in(self, seen: _Seen, places: IntArray, *, step_s: float) -> FloatArray:
        """(5, N) what the tracks say now averaged into what they said of late."""
        plane = _solved(self._information)
        slope_px, bottom_px = seen.slope_px, seen.bottom_px
        variance = plane.height_m**2 * seen.slope_variance + seen.stray_px2
        excess = np.abs(bottom_px - plane.horizon_px - plane.height_m * slope_px)
        excess /= _HUBER_SIGMA * np.sqrt(variance + plane.variance(slope_px))
        weight = 1.0 / (variance * np.maximum(1.0, excess))
        before = self._terms.take(places, axis=1)
        share = seen.tells * np.where(before[0] == 0, 1.0, 1.0 - math.exp(-step_s / self._settings.average_s))
        now = np.array([np.ones_like(slope_px), slope_px, slope_px * slope_px, bottom_px, slope_px * bottom_px])
        told = share * weight * now + (1.0 - share) * before
        self._terms[:, places] = told
        return np.asarray(told)

    def _learn_roughness(self, seen: _Seen, plane: _Plane, *, step_s: float) -> None:
        """Move the roughness to where the squares of the tracks' residuals are as large as expected."""
        if step_s == 0.0:
            return
        slope_px, now = seen.slope_px, self._variance_px2
        residual = seen.bottom_px - plane.horizon_px - plane.height_m * slope_px
        expected = plane.height_m**2 * seen.slope_variance + plane.variance(slope_px) + seen.stray_px2
        surprise = np.minimum(residual**2, 10 * expected) - expected
        trust = seen.tells * (now / expected) ** 2  # what is unsure for other reasons tells little
        share = 1.0 - math.exp(-step_s / self._settings.roughness_memory_s)
        now += share * float(trust @ surprise) / (1.0 + float(trust.sum()))
        start = (self._settings.roughness_rad * self._camera.fy_px) ** 2
        self._variance_px2 = min(max(now, start / 16), 9 * start)

    def _ranges(self, track_id: IntArray, seen: _Seen, plane: _Plane) -> Ranges:
        below_px = seen.bottom_px - plane.horizon_px
        is_below = seen.is_standing & (below_px > 1.0) & (plane.height_m > 0.1)
        below_px, height_m = np.where(is_below, (below_px, plane.height_m), 1.0)
        slope_px = below_px / height_m
        sigma = np.sqrt(plane.variance(slope_px) + self._stray_px2(slope_px)) / below_px
        good = is_below & (sigma < self._settings.max_sigma)
        touch_m = np.where(good, self._camera.fy_px / slope_px, np.nan)
        return Ranges(track_id, touch_m + seen.offset_m, touch_m * sigma)

    def _stray_px2(self, slope_px: FloatArray) -> FloatArray:
        """(N,) variance of bottom edges about the plane, where a metre of height is `slope_px` px."""
        edge_px2 = self._settings.box_sigma_px**2
        return np.asarray(self._variance_px2 + edge_px2 + (self._settings.kerb_m * slope_px) ** 2)


class GroundPlaneRanger(Ranger):
    """The ground plane as a ranging method: the horizon comes from mono's distances and from lane lines.

    Attributes:
        plane: the estimator of the horizon.
    """

    def __init__(self, camera: PinholeCamera, settings: GroundSettings | None = None) -> None:
        """Range for `camera` (undistorted)."""
        self.plane = GroundPlane(camera, settings)

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances of what stands on the ground, by the horizon as known so far."""
        return self.measure_with(tracks, frame, {})

    def measure_with(self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges]) -> Ranges:
        """Distances of what stands on the ground, see `GroundPlane.measure`; mono's teach the horizon."""
        by_size = others.get("mono", Ranges.unmeasured(tracks.track_id))
        return self.plane.measure(tracks, by_size, frame)

    def update_lanes(self, lines: LaneLines) -> None:
        """Take the row where the lines meet as a measurement of the horizon."""
        if (horizon := lines.horizon_px()) is not None:
            self.plane.hint(*horizon)


def _information(settings: GroundSettings, camera: PinholeCamera) -> FloatArray:
    """(5,) what the settings alone say."""
    horizon = 1.0 / (settings.horizon_sigma_rad * camera.fy_px) ** 2
    height = 1.0 / settings.height_sigma_m**2
    return np.array([horizon, 0.0, height, 0.0, height * settings.height_m])


def _solved(terms: FloatArray) -> _Plane:
    """The planes that (5, ...) information tells."""
    a, b, c, u, v = terms
    scale = 1.0 / (a * c - b * b)
    return _Plane((c * u - b * v) * scale, (a * v - b * u) * scale, c * scale, -b * scale, a * scale)


def _create(context: MethodContext) -> Ranger:
    height_m, box_sigma_px = context.camera_height_m, context.box_sigma_px
    settings = GroundSettings() if height_m is None else GroundSettings.of_known_height(height_m)
    if box_sigma_px is not None:
        settings = replace(settings, box_sigma_px=box_sigma_px)
    return GroundPlaneRanger(context.camera, settings)


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
