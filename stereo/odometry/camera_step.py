"""CameraStep: motion of the camera between two frames in metres, with their images."""

from __future__ import annotations

from dataclasses import dataclass

from track_range.foundation.arrays import FloatArray
from track_range.foundation.sparse_flow import FlowFrame


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraStep:
    """Motion of the camera since the previous frame."""

    time_s: float  # time of the frame
    dt_s: float  # time since the previous frame
    rotation: FloatArray  # (3, 3) rotation `now_from_before` of the static scene
    rotation_sigma_rad: float  # standard deviation of the yaw between the frames, which does not average out
    travel: FloatArray  # (2,) x, y of the ray at depth 1 along the direction of travel, in this frame
    travelled_m: float  # distance travelled
    travelled_sigma: float  # relative standard deviation of `travelled_m`, the same in all frames
    now: FlowFrame  # the images of this frame
