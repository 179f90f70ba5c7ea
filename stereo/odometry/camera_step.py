"""CameraStep: motion of the camera between two frames in metres, with their images."""

from __future__ import annotations

from dataclasses import dataclass

from track_range.foundation.arrays import FloatArray
from track_range.foundation.sparse_flow import FlowFrame


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraStep:
    """Motion of the camera since the previous frame.

    Attributes:
        time_s: time of the frame.
        dt_s: time since the previous frame.
        rotation: (3, 3) rotation `now_from_before` of the static scene.
        rotation_sigma_rad: standard deviation of the yaw between the frames, which does not average out.
        travel: (2,) x, y of the ray at depth 1 along the direction of travel, in this frame.
        travelled_m: distance travelled.
        travelled_sigma: relative standard deviation of `travelled_m`, the same in all frames.
        now: the images of this frame.
    """

    time_s: float
    dt_s: float
    rotation: FloatArray
    rotation_sigma_rad: float
    travel: FloatArray
    travelled_m: float
    travelled_sigma: float
    now: FlowFrame
