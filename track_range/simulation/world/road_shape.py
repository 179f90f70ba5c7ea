r"""The shape of the road, and the pose of a camera that drives on it.

World axes: x right, y down, z forward, as for a level camera on the road at time 0. The centre of the ego lane is at
    x(z) = swing (sin(2 pi z / l + p) - sin p)        y(z) = -hill (sin(2 pi z / m + q) - sin q)
plus a bend between two straight stretches, whose slope is dx/dz = tan(turn / 2) tanh((z - at) / half). The
cross-section at every z is parallel to x: the road is a straight road, sheared laterally and vertically, so that every
stretch is a parallelogram. Positions on the road are (across, z), `across` metres to the right of the ego lane's
centre; before and after a bend, the road is as wide as a straight one, perpendicularly to its direction.
"""

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.geometry.mounting import Mounting

AHEAD = Mounting()
WOBBLE_HZ = (0.7, 1.3, 2.1)  # frequencies of a car's pitch and roll on its springs


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadShape:
    """A winding, hilly road: amplitude, period and phase of a lateral sine (swing) and of a
    vertical one (hill), and a bend: its whole turn (positive = to the right), the z of its middle,
    and the length over which half of it is driven.
    """

    swing_m: float = 0.0
    swing_length_m: float = 320.0
    swing_phase_rad: float = 0.0
    hill_m: float = 0.0
    hill_length_m: float = 380.0
    hill_phase_rad: float = 0.0
    bend_rad: float = 0.0
    bend_at_m: float = 0.0
    bend_half_m: float = 20.0

    @property
    def is_straight(self) -> bool:
        """Whether the road is straight and level."""
        return self.swing_m == 0.0 and self.hill_m == 0.0 and self.bend_rad == 0.0

    @property
    def widening(self) -> float:
        """Extent along x of a metre across the road, before and after the bend."""
        return float(1 / np.cos(self.bend_rad / 2))

    def x_m(self, z_m: FloatArray, across_m: FloatArray | float = 0.0) -> FloatArray:
        """X at `across_m` to the right of the ego lane's centre; this centre has 0 at z = 0."""
        middle_m = _wave(z_m, self.swing_m, self.swing_length_m, self.swing_phase_rad)
        if self.bend_rad != 0.0:
            at, start = (z_m - self.bend_at_m) / self.bend_half_m, self.bend_at_m / self.bend_half_m
            # ln cosh, without its constant, is the integral of tanh
            bent = np.logaddexp(at, -at) - np.logaddexp(start, -start)
            middle_m = middle_m + np.tan(self.bend_rad / 2) * self.bend_half_m * bent
        return np.asarray(middle_m + self.widening * across_m)

    def y_m(self, z_m: FloatArray) -> FloatArray:
        """Y of the road surface (y down); 0 at z = 0."""
        return -_wave(z_m, self.hill_m, self.hill_length_m, self.hill_phase_rad)

    def yaw_rad(self, z_m: FloatArray) -> FloatArray:
        """Direction of the road, positive = to the right of z."""
        slope = _wave_slope(z_m, self.swing_m, self.swing_length_m, self.swing_phase_rad)
        bend = np.tanh((z_m - self.bend_at_m) / self.bend_half_m)
        return np.asarray(np.arctan(slope + np.tan(self.bend_rad / 2) * bend))

    def climb_rad(self, z_m: FloatArray) -> FloatArray:
        """Slope of the road, positive = uphill."""
        return np.arctan(_wave_slope(z_m, self.hill_m, self.hill_length_m, self.hill_phase_rad))

    def stretch(self, z_m: float) -> float:
        """Length of road per metre of z."""
        z = np.array(z_m)
        return float(np.sqrt(1 + np.tan(self.yaw_rad(z)) ** 2 + np.tan(self.climb_rad(z)) ** 2))


STRAIGHT = RoadShape()


@dataclass(frozen=True, slots=True, kw_only=True)
class Wobble:
    """Pitch and roll of the ego car on its springs, with given root mean squares: sums of sines
    with random phases.
    """

    pitch_rad: float = 0.0
    roll_rad: float = 0.0
    seed: int = 0  # random seed of the phases

    def pitch_roll_rad(self, time_s: float) -> tuple[float, float]:
        """Pitch (positive = camera up) and roll (positive = to the right) at a time."""
        phases = np.random.default_rng([self.seed, 6]).uniform(0, 2 * np.pi, (2, len(WOBBLE_HZ)))
        waves = np.sin(2 * np.pi * np.array(WOBBLE_HZ) * time_s + phases).sum(axis=1) * np.sqrt(
            2 / len(WOBBLE_HZ)
        )
        return float(self.pitch_rad * waves[0]), float(self.roll_rad * waves[1])


STEADY = Wobble()


@dataclass(frozen=True, slots=True)
class CameraPose:
    """Pose of the left camera."""

    position_m: FloatArray  # (3,) in world axes
    camera_from_world: FloatArray  # (3, 3) rotation
    yaw_rad: float  # direction of the road at the camera


def pose_on_road(
    road: RoadShape,
    z_m: float,
    *,
    height_m: float,
    pitch_roll_rad: tuple[float, float],
    mounting: Mounting = AHEAD,
) -> CameraPose:
    """The pose of a camera `height_m` above the road, of a car on the ego lane's centre."""
    z = np.array(z_m)
    yaw_rad = float(road.yaw_rad(z))
    slope = slope_rotation(float(road.climb_rad(z)))
    world_from_car = slope @ yaw_rotation(yaw_rad)
    on_road_m = np.array([road.x_m(z), road.y_m(z), z_m], np.float64)
    camera_m = np.array([-mounting.y_m, -height_m, mounting.x_m])
    pitch, roll = pitch_roll_rad
    roll_rotation = np.array(
        [[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1.0]]
    )
    car_from_camera = AHEAD.vehicle_from_camera.T @ mounting.vehicle_from_camera
    on_springs = slope_rotation(pitch) @ roll_rotation
    world_from_camera = world_from_car @ on_springs @ car_from_camera
    return CameraPose(on_road_m + world_from_car @ camera_m, world_from_camera.T, yaw_rad)


def slope_rotation(climb_rad: FloatArray | float) -> FloatArray:
    """(..., 3, 3) rotations about x that raise the z axis by angles (...)."""
    cos, sin = np.cos(climb_rad), np.sin(climb_rad)
    zero, one = np.zeros_like(cos), np.ones_like(cos)
    return _rows((one, zero, zero), (zero, cos, -sin), (zero, sin, cos))


def yaw_rotation(yaw_rad: FloatArray | float) -> FloatArray:
    """(..., 3, 3) rotations about y by KITTI's rotation_y (...), from an object's frame."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    zero, one = np.zeros_like(cos), np.ones_like(cos)
    return _rows((cos, zero, sin), (zero, one, zero), (-sin, zero, cos))


def _rows(*rows: tuple[FloatArray, FloatArray, FloatArray]) -> FloatArray:
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _wave(z_m: FloatArray, height_m: float, length_m: float, phase_rad: float) -> FloatArray:
    return np.asarray(
        height_m * (np.sin(2 * np.pi * z_m / length_m + phase_rad) - np.sin(phase_rad))
    )


def _wave_slope(z_m: FloatArray, height_m: float, length_m: float, phase_rad: float) -> FloatArray:
    return np.asarray(
        height_m * 2 * np.pi / length_m * np.cos(2 * np.pi * z_m / length_m + phase_rad)
    )
