"""Common parts of formats with 3-D scenes: tracks with boxes in the image and in metres, and
optional packages.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import FloatArray
from track_range.foundation.errors import UserError
from track_range.foundation.files.input_files import shortened
from track_range.foundation.library_telemetry import disable_telemetry
from track_range.pipeline.colours import track_colour, warning_colour
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.world.cuboid_corners import cuboid_corners
from track_range.ranging.world.ego_path import EgoPose
from track_range.ranging.world.object_motion import MOTION_STATES
from track_range.results.rows.column import ResultColumn
from track_range.stereo.geometry.mounting import Mounting

CAMERA_FRAME, VEHICLE_FRAME, MAP_FRAME = "camera", "vehicle", "map"
"""Coordinate frames: camera (x right, y down, z forward), vehicle (x forward, y left, z up; at the
place of the camera if its mounting is unknown), and the world of `EgoPose`, in which the vehicle
moves."""

# quaternion that rotates vectors from camera to vehicle, of a camera that looks along x
VEHICLE_FROM_CAMERA_XYZW = (-0.5, 0.5, -0.5, 0.5)
_CAMERA_FROM_LEVEL = Rotation.from_quat(VEHICLE_FROM_CAMERA_XYZW).inv()


@dataclass(frozen=True, slots=True)
class TrackObject:
    """A track of one frame."""

    track_id: int
    class_name: str
    score: float
    is_observed: bool
    xyxy_px: tuple[float, float, float, float]  # pixel centres at integers
    figures: Mapping[str, float]  # the known values of `viewer_columns`, by name with unit
    centre_m: tuple[float, float, float]  # of the cuboid in the camera frame; NaN = unknown
    lwh_m: tuple[float, float, float]  # its length, width and height
    # quaternion that rotates its axes (to its front, to its left, up) to those of the camera
    xyzw: tuple[float, float, float, float]
    yaw_sigma_rad: float  # modulo 180 degrees where the front is not known
    front_known: bool  # whether front and back of the cuboid are told apart
    covariance_m2: FloatArray  # (3, 3) of the centre in the camera frame; NaN = unknown
    corners_m: FloatArray  # (8, 3) in the camera frame, see `cuboid_corners`
    is_parked: bool  # whether it stands
    rgb: tuple[int, int, int]  # 0 to 255; red and amber shortly before a predicted collision

    def figure(self, name: str) -> float:
        """One of the figures; NaN = unknown."""
        return self.figures.get(name, math.nan)

    @property
    def distance_m(self) -> float:
        """Fused distance along z."""
        return self.figure("distance_m")

    @property
    def has_cuboid(self) -> bool:
        """Whether centre, size and direction of the cuboid are known."""
        return bool(np.isfinite(self.corners_m).all())

    @property
    def label(self) -> str:
        """Class, identity and distance, such as "car 3  24.1 ± 0.6 m"."""
        name = f"{self.class_name} {self.track_id}"
        if not self.distance_m > 0:  # also where it is not known
            return name
        sigma = f" ± {self.figures['sigma_m']:.1f}" if "sigma_m" in self.figures else ""
        return f"{name}  {self.distance_m:.1f}{sigma} m"


def track_objects(
    result: FrameResult, columns: Mapping[str, ResultColumn]
) -> Iterator[TrackObject]:
    """The tracks of a frame with their cuboids; `columns` are the `viewer_columns`."""
    tracks, cuboids = result.tracks, result.cuboids
    figures = {name: column.read(result) for name, column in columns.items()}
    turns = _CAMERA_FROM_LEVEL * Rotation.from_euler(
        "z", np.nan_to_num(cuboids.yaw_deg)[:, None], degrees=True
    )
    xyzw, covariance_m2, corners_m = turns.as_quat(), cuboids.covariance_m2, cuboid_corners(cuboids)
    is_parked = result.motion.state == MOTION_STATES.index("parked")
    for i, track_id in enumerate(tracks.track_id.tolist()):
        blue, green, red = warning_colour(result, i) or track_colour(track_id)
        yield TrackObject(
            track_id=track_id,
            class_name=ROAD_CLASSES[int(tracks.class_id[i])],
            score=float(tracks.score[i]),
            is_observed=bool(tracks.observed[i]),
            xyxy_px=tuple(tracks.xyxy_px[i].tolist()),
            centre_m=tuple(cuboids.centre_m[i].tolist()),
            lwh_m=tuple(cuboids.lwh_m[i].tolist()),
            xyzw=tuple(xyzw[i].tolist()),
            yaw_sigma_rad=math.radians(cuboids.yaw_sigma_deg[i]),
            front_known=bool(cuboids.front_known[i]),
            covariance_m2=covariance_m2[i],
            corners_m=corners_m[i],
            is_parked=bool(is_parked[i]),
            rgb=(red, green, blue),
            figures={
                name: float(values[i]) for name, values in figures.items() if np.isfinite(values[i])
            },
        )


class Transform(NamedTuple):
    """A coordinate frame in another one."""

    parent: str
    child: str
    at_m: tuple[float, float, float]  # its origin in the parent
    xyzw: tuple[float, float, float, float]  # quaternion that rotates vectors to the parent


def transforms(pose: EgoPose | None, mounting: Mounting | None) -> tuple[Transform, Transform]:
    """The vehicle in the frame `map`, at its origin if the pose of the camera is unknown, and the
    camera in the vehicle, at its place without a mounting.

    `pose` is that of the camera. The vehicle is on the plane z = 0, and so is a camera whose height
    is not known.
    """
    x_m = y_m = heading_rad = 0.0
    if pose is not None and math.isfinite(pose.x_m):
        x_m, y_m, heading_rad = pose.x_m, pose.y_m, pose.heading_rad
    at_m, xyzw = (0.0, 0.0, 0.0), VEHICLE_FROM_CAMERA_XYZW
    if mounting is not None:
        xyzw = tuple(Rotation.from_matrix(mounting.vehicle_from_camera).as_quat().tolist())
        at_m = mounting.x_m, mounting.y_m, mounting.z_m or 0.0
        heading_rad -= math.radians(mounting.yaw_deg)
        c, s = math.cos(heading_rad), math.sin(heading_rad)
        x_m, y_m = x_m - c * at_m[0] + s * at_m[1], y_m - s * at_m[0] - c * at_m[1]
    half_rad = heading_rad / 2
    turn = 0.0, 0.0, math.sin(half_rad), math.cos(half_rad)
    return (
        Transform(MAP_FRAME, VEHICLE_FRAME, (x_m, y_m, 0.0), turn),
        Transform(VEHICLE_FRAME, CAMERA_FRAME, at_m, xyzw),
    )


class ExtraError(UserError):
    """A result format requires a package that is not installed."""


def check_extra(format_name: str, extra: str, *packages: str) -> None:
    """Import packages of a format, which `extra` installs, without their telemetry; ExtraError if
    one is missing.
    """
    disable_telemetry()
    for package in packages:
        top_level = package.partition(".")[0]
        try:
            import_module(package)
        except ImportError as error:
            is_missing = (
                isinstance(error, ModuleNotFoundError)
                and (error.name or "").partition(".")[0] == top_level
            )
            raise ExtraError(
                f"the format {format_name} requires the package {top_level}: install it with "
                f"pip install 'track-range[{extra}]'."
                if is_missing
                else f"the format {format_name}: the package {top_level} cannot be imported "
                f"({shortened(str(error))}); reinstall it with pip install --force-reinstall "
                f"'track-range[{extra}]'."
            ) from error
