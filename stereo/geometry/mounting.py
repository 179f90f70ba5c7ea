"""Mounting: where a camera is in its vehicle, and where it looks.

Axes of the vehicle (ISO 8855): x forward, y to the left, z up, from a point of the vehicle whose
speed is known, at the height of the road. The camera's axes are x right, y down, z forward:

    vehicle_from_camera = Rz(yaw) Ry(pitch) Rx(roll) L        L: camera axes of a camera that looks along x, level

so that a positive yaw turns the axis to the left, a positive pitch turns it down, as in a
calibration from the road, and a positive roll lowers the right side of the camera.

The camera of a vehicle with the speed V along x and the yaw rate w (to the left) moves with

    v = [V - w y, w x, 0]        in the axes of the vehicle, at x, y from its reference point
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from numbers import Real
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from track_range.foundation.arrays import FloatArray
from track_range.stereo.geometry.virtual_pinhole import view_from_camera

# of the axes of a level camera that looks forward, in those of the vehicle
_LEVEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
# Largest angle in the road's plane between the axis and the drive of a camera that looks ahead.
# Lane lines, the path of the vehicle and gaps are taken along the axis: at 10 degrees, the path is
# half a lane beside it at 10 m, where warnings begin to matter, and a whole lane at 20 m.
AHEAD_DEG = 10.0
# smallest and largest value of each number
_LIMITS = {
    "yaw_deg": (-180.0, 180.0),
    "pitch_deg": (-90.0, 90.0),
    "roll_deg": (-180.0, 180.0),
    "x_m": (-30.0, 30.0),
    "y_m": (-5.0, 5.0),
    "z_m": (0.2, 60.0),  # of a camera on a mast or a building
    "front_m": (-30.0, 30.0),
    "sigma_deg": (0.0, 90.0),
}
_MAY_BE_UNKNOWN = ("z_m", "front_m")


@dataclass(frozen=True, slots=True, kw_only=True)
class Mounting:
    """Angles and place of a camera in its vehicle, in keys of rig.yaml; ValueError for a value
    that is no number in its range.

    Example:
        >>> import track_range as tr
        >>> to_the_right = tr.Mounting(yaw_deg=-58.0)
        >>> to_the_right.velocity_mps(10.0).round(1).tolist()  # of the camera: right, down, forward
        [-8.5, 0.0, 5.3]
        >>> to_the_right.is_ahead
        False
    """

    __pydantic_config__: ClassVar = {
        "extra": "forbid"
    }  # of rig.yaml, whose unknown keys are errors

    yaw_deg: float = 0.0  # of the axis, positive = to the left, -180 to 180
    pitch_deg: float = 0.0  # of the axis, positive = down, -90 to 90
    roll_deg: float = 0.0  # about the axis, positive = the right side is lower, -180 to 180
    x_m: float = 0.0  # of the camera, forward of the vehicle's reference point
    y_m: float = 0.0  # the same to the left
    z_m: float | None = None  # height of the camera above the road; None = unknown
    # of the front of the vehicle, forward of the reference point; None = unknown
    front_m: float | None = None
    sigma_deg: float = 2.0  # standard deviation of each angle; by default that of a sketch

    def __post_init__(self) -> None:
        for name, (low, high) in _LIMITS.items():
            value = getattr(self, name)
            is_unknown = value is None and name in _MAY_BE_UNKNOWN
            is_number = isinstance(value, Real) and not isinstance(value, bool)
            if not is_unknown and not (is_number and low <= value <= high):
                raise ValueError(f"expected {_key(name)} from {low:g} to {high:g}, found {value!r}")
        if self.front_m is not None and self.front_m < self.x_m:
            raise ValueError(
                f"expected front, that of the vehicle, at least at x of the camera, {self.x_m:g}, "
                f"found {self.front_m:g}"
            )

    @classmethod
    def of(cls, texts: Iterable[str]) -> Mounting:
        """The mounting of texts such as "yaw=-58,pitch=2" with the names of the fields without
        units; ValueError for another text, or a name that is given twice.
        """
        names = {_key(field.name): field.name for field in fields(cls)}
        values: dict[str, float] = {}
        for part in ",".join(texts).split(","):
            key, _, number = map(str.strip, part.partition("="))
            if key not in names:
                raise ValueError(f"expected NAME=NUMBER with {', '.join(names)}, found {part!r}")
            if names[key] in values:
                raise ValueError(f"expected {key} once, found it twice")
            try:
                values[names[key]] = float(number)
            except ValueError:
                raise ValueError(f"expected a number after {key}=, found {number!r}") from None
        return cls(**values)

    @property
    def parts(self) -> tuple[str, ...]:
        """The texts from which `of` makes this mounting."""
        values = {_key(field.name): getattr(self, field.name) for field in fields(self)}
        return tuple(
            f"{key}={float(value)!r}" for key, value in values.items() if value is not None
        )

    @property
    def place_m(self) -> FloatArray:
        """(3,) place of the camera in the axes of the vehicle; z is NaN if it is unknown."""
        return np.array([self.x_m, self.y_m, math.nan if self.z_m is None else self.z_m])

    @property
    def bumper_m(self) -> float | None:
        """Distance along x from the camera to the front of the vehicle; None = unknown."""
        return None if self.front_m is None else self.front_m - self.x_m

    def in_vehicle(self, points_m: FloatArray) -> FloatArray:
        """(N, 3) points in the axes of the vehicle, from those of the camera (N, 3)."""
        return np.asarray(points_m @ self.vehicle_from_camera.T + self.place_m)

    @property
    def vehicle_from_camera(self) -> FloatArray:
        """(3, 3) rotation from the axes of the camera to those of the vehicle."""
        return _rotation(self.yaw_deg, self.pitch_deg, self.roll_deg)

    @property
    def travel_from_camera(self) -> FloatArray:
        """(3, 3) rotation from the axes of the camera to those of travel: right, down, forward."""
        return _LEVEL.T @ self.vehicle_from_camera

    @property
    def is_ahead(self) -> bool:
        """Whether the axis looks along the drive: within 10 degrees to either side, whatever its
        pitch.
        """
        return abs(self.yaw_deg) <= AHEAD_DEG

    def apart_deg(self, other: Mounting) -> float:
        """Angle between the directions of travel in the camera's axes by this mounting and another,
        0 to 180.
        """
        cosine = float(self.travel_from_camera[2] @ other.travel_from_camera[2])
        return math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))

    def turned(self, right_deg: float) -> Mounting:
        """The mounting of a view of the camera whose axis is `right_deg` to the right of the
        camera's axis, as `--yaw-deg` counts.
        """
        matrix = self.vehicle_from_camera @ view_from_camera(right_deg).T @ _LEVEL.T
        yaw, pitch, roll = Rotation.from_matrix(matrix).as_euler("ZYX", degrees=True).tolist()
        return replace(self, yaw_deg=yaw, pitch_deg=pitch, roll_deg=roll)

    def velocity_mps(self, speed_mps: float, yaw_rad_s: float = 0.0) -> FloatArray:
        """(3,) velocity of the camera along its axes (right, down, forward), if the reference point
        of the vehicle has this speed along x, and the vehicle this yaw rate, positive = to the
        right as in `EgoMotion`; NaN = it does not turn.
        """
        left_rad_s = -np.nan_to_num(yaw_rad_s)
        vehicle_mps = [speed_mps - left_rad_s * self.y_m, left_rad_s * self.x_m, 0.0]
        return np.asarray(self.vehicle_from_camera.T @ vehicle_mps)


def looks_ahead(mounting: Mounting | None) -> bool:
    """Whether a camera looks along the drive; one whose mounting is not known is taken to."""
    return mounting is None or mounting.is_ahead


@lru_cache(maxsize=64)  # of few cameras, for each frame
def _rotation(yaw_deg: float, pitch_deg: float, roll_deg: float) -> FloatArray:
    turn = Rotation.from_euler("ZYX", (yaw_deg, pitch_deg, roll_deg), degrees=True)
    matrix = np.asarray(turn.as_matrix() @ _LEVEL)
    matrix.setflags(write=False)
    return matrix


def _key(name: str) -> str:
    """The name of a field without its unit."""
    return name.rpartition("_")[0]
