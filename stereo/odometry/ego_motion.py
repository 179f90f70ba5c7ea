"""EgoMotion: speed and yaw rate of the camera; CameraStep: motion between images; Ego: what one
frame shows of both and of the road; Odometry measures them.
"""

import math
from dataclasses import dataclass, replace
from typing import Protocol

from track_range.foundation.arrays import FloatArray
from track_range.foundation.sparse_flow import FlowFrame
from track_range.stereo.alignment.health import Move
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.road_horizon import RoadView
from track_range.stereo.right_camera.correction import RightCamera


@dataclass(frozen=True, slots=True)
class EgoMotion:
    """Motion of the left camera since the previous frame."""

    # speed along the optical axis, negative = backwards; NaN = not measured
    speed_mps: float = math.nan
    speed_sigma_mps: float = math.nan  # its standard deviation; NaN = not measured
    yaw_rad_s: float = math.nan  # rate of the heading, positive = to the right; NaN = not measured
    is_still: bool = False  # whether the camera is at rest; False if unknown
    # speed to the right of the optical axis, of a camera that does not look along the drive, and its
    # standard deviation; NaN like the speed
    right_mps: float = 0.0
    right_sigma_mps: float = 0.0
    is_predicted: bool = False  # whether the speed has no measurement of its frame
    # the part of the standard deviation of the speed that is new in each frame; the rest lasts
    noise_mps: float = 0.0
    # factor of a given speed by the error of the focal length (`FocalScale`); NaN = not given
    stretch: float = math.nan
    # factor of a measured speed by an estimate of the scale (`RigScale`)
    scale: float = 1.0

    def scaled(self, factor: float) -> "EgoMotion":
        """The motion with the speed along the axis and its standard deviations times a factor."""
        return replace(
            self,
            speed_mps=self.speed_mps * factor,
            speed_sigma_mps=self.speed_sigma_mps * factor,
            noise_mps=self.noise_mps * factor,
        )


# random walk of a speed that is not measured, m/s per root of a second: 2.5 m/s after one second
PREDICTED_NOISE = 2.5
# largest standard deviation of an ego speed that filters and warnings use, that of the largest error
# of a rate that they report: a less certain one would make rates of what may be static unknown
MAX_EGO_SIGMA_MPS = 1.5


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraStep:
    """Motion of the camera between two frames, the later of which is the last one, or one shortly
    before it.
    """

    time_s: float  # time of the later frame
    dt_s: float  # time since the earlier one
    rotation: FloatArray  # (3, 3) rotation `now_from_before` of the static scene
    # standard deviation of the yaw between the frames, which does not average out
    rotation_sigma_rad: float
    travel: FloatArray  # (3,) unit vector of the direction of travel, in this frame
    travelled_m: float  # distance travelled
    travelled_sigma: float  # relative standard deviation of `travelled_m`, the same in all frames
    now: FlowFrame  # the images of the later frame


@dataclass(frozen=True, slots=True, kw_only=True)
class Ego:
    """The camera's own motion as one frame shows it; None = unknown, or not measured."""

    motion: EgoMotion  # speed and yaw rate that are used
    road: RoadView | None = None  # the road in the frame, lengths in metres
    step: CameraStep | None = None  # motion of the camera since the previous frame
    # by stereo odometry, also where `motion` was given, with the scale of the rig
    by_pair: EgoMotion | None = None
    by_road: EgoMotion | None = None  # by the motion of the road, with the assumed camera height
    given: EgoMotion | None = None  # as given, also where it is not trusted
    # how the right camera moved against its rig; None = not measured
    right_camera: RightCamera | None = None
    # logarithm of the given speed over that by the pair, or else by the road, in the whole drive,
    # and its standard deviation; None = unknown
    speed_ratio: tuple[float, float] | None = None
    focal_change: float = 0.0  # relative change of the focal length of both cameras
    trusts_given: bool = True  # whether a given speed is used


class Odometry(Protocol):
    """Measures the motion of the camera from the frames of one stream, in order."""

    @property
    def source(self) -> str:
        """Name of the method, for notes: "stereo odometry"."""
        ...

    def update(self, frame: Frame, xyxy_px: FloatArray) -> EgoMotion:
        """Motion since the previous frame, with boxes (N, 4) of road users, which are not static;
        unknown at first.
        """
        ...


class PairOdometry(Odometry, Protocol):
    """Odometry by both images of a pair, which also measures how the pair moved."""

    @property
    def right_camera(self) -> RightCamera | None:
        """How the right camera moved so far against its rig; None = not measured."""
        ...

    @property
    def move(self) -> Move | None:
        """The first movement of the right camera that changed disparities; None = none."""
        ...

    @property
    def focal_change(self) -> float:
        """Relative change of the focal length of both cameras since the start."""
        ...

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user so far."""
        ...
