r"""How the road bends and climbs, and how a camera that drives on it is turned.

World axes: x right, y down, z forward, those of a level camera on the road at time 0. The middle of the ego lane is at
    x(z) = swing (sin(2 pi z / l + p) - sin p)        y(z) = -hill (sin(2 pi z / m + q) - sin q)
and the cross-section at every z lies along x: the road is a straight one sheared sideways and upwards, so that every
stretch of it is a parallelogram. A place on the road is (across, z): `across` metres to the right of the lane's middle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray

WOBBLE_HZ = (0.7, 1.3, 2.1)
"""A car's body on its springs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadShape:
    """A winding, rolling road.

    Attributes:
        swing_m, swing_length_m, swing_phase_rad: how far it swings sideways, and over which length.
        hill_m, hill_length_m, hill_phase_rad: likewise upwards.
    """

    swing_m: float = 0.0
    swing_length_m: float = 320.0
    swing_phase_rad: float = 0.0
    hill_m: float = 0.0
    hill_length_m: float = 380.0
    hill_phase_rad: float = 0.0

    @property
    def is_straight(self) -> bool:
        """Whether it neither bends nor climbs."""
        return self.swing_m == 0.0 and self.hill_m == 0.0

    def x_m(self, z_m: FloatArray) -> FloatArray:
        """Where the ego lane's middle is; 0 at z = 0."""
        return _wave(z_m, self.swing_m, self.swing_length_m, self.swing_phase_rad)

    def y_m(self, z_m: FloatArray) -> FloatArray:
        """How high the asphalt is, y down; 0 at z = 0."""
        return -_wave(z_m, self.hill_m, self.hill_length_m, self.hill_phase_rad)

    def yaw_rad(self, z_m: FloatArray) -> FloatArray:
        """The road's direction, positive = to the right of z."""
        return np.arctan(_wave_slope(z_m, self.swing_m, self.swing_length_m, self.swing_phase_rad))

    def climb_rad(self, z_m: FloatArray) -> FloatArray:
        """The road's slope, positive = uphill."""
        return np.arctan(_wave_slope(z_m, self.hill_m, self.hill_length_m, self.hill_phase_rad))

    def stretch(self, z_m: float) -> float:
        """Metres of road per metre of z."""
        at = np.array(z_m)
        return float(np.sqrt(1 + np.tan(self.yaw_rad(at)) ** 2 + np.tan(self.climb_rad(at)) ** 2))


STRAIGHT = RoadShape()


@dataclass(frozen=True, slots=True, kw_only=True)
class Wobble:
    """How the camera's car pitches and rolls on its springs: a few sines whose phases follow from a seed.

    Attributes:
        pitch_rad, roll_rad: root mean squares.
        seed: of the phases.
    """

    pitch_rad: float = 0.0
    roll_rad: float = 0.0
    seed: int = 0

    def pitch_roll_rad(self, time_s: float) -> tuple[float, float]:
        """Pitch (positive = the camera looks up) and roll (positive = it leans to the right) at a time."""
        phases = np.random.default_rng([self.seed, 6]).uniform(0, 2 * np.pi, (2, len(WOBBLE_HZ)))
        waves = np.sin(2 * np.pi * np.array(WOBBLE_HZ) * time_s + phases).sum(axis=1) * np.sqrt(2 / len(WOBBLE_HZ))
        return float(self.pitch_rad * waves[0]), float(self.roll_rad * waves[1])


STEADY = Wobble()


@dataclass(frozen=True, slots=True)
class CameraPose:
    """Where the left camera is, and how it is turned.

    Attributes:
        place_m: (3,) in the world.
        camera_from_world: (3, 3) turn.
        yaw_rad: of the road under it, which is what its headings are counted from.
    """

    place_m: FloatArray
    camera_from_world: FloatArray
    yaw_rad: float


def pose_on_road(road: RoadShape, z_m: float, *, height_m: float, pitch_roll_rad: tuple[float, float]) -> CameraPose:
    """The pose of a camera `height_m` above the middle of the ego lane that looks along the road."""
    at = np.array(z_m)
    yaw_rad = float(road.yaw_rad(at))
    standing = turned_on_slope(float(road.climb_rad(at)))
    place = np.array([road.x_m(at), road.y_m(at), z_m], np.float64) - standing[:, 1] * height_m
    pitch, roll = pitch_roll_rad
    lean = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1.0]])
    world_from_camera = standing @ turned_about_y(yaw_rad) @ turned_on_slope(pitch) @ lean
    return CameraPose(place, world_from_camera.T, yaw_rad)


def turned_on_slope(climb_rad: FloatArray | float) -> FloatArray:
    """(..., 3, 3) turns that lift what looks along z by angles (...)."""
    cos, sin = np.cos(climb_rad), np.sin(climb_rad)
    zero, one = np.zeros_like(cos), np.ones_like(cos)
    return _rows((one, zero, zero), (zero, cos, -sin), (zero, sin, cos))


def turned_about_y(yaw_rad: FloatArray | float) -> FloatArray:
    """(..., 3, 3) turns from a body's own axes by KITTI's rotation_y (...)."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    zero, one = np.zeros_like(cos), np.ones_like(cos)
    return _rows((cos, zero, sin), (zero, one, zero), (-sin, zero, cos))


def _rows(*rows: tuple[FloatArray, FloatArray, FloatArray]) -> FloatArray:
    """Matrices from their rows."""
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _wave(z_m: FloatArray, height_m: float, length_m: float, phase_rad: float) -> FloatArray:
    return np.asarray(height_m * (np.sin(2 * np.pi * z_m / length_m + phase_rad) - np.sin(phase_rad)))


def _wave_slope(z_m: FloatArray, height_m: float, length_m: float, phase_rad: float) -> FloatArray:
    return np.asarray(height_m * 2 * np.pi / length_m * np.cos(2 * np.pi * z_m / length_m + phase_rad))
