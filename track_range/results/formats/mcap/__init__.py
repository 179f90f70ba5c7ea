"""run.mcap: the tracks of a run for Foxglove, or for ROS 2."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # not imported for help pages, which name the profiles
    from track_range.stereo.geometry.camera import PinholeCamera

# for Foxglove: image with boxes, 3-D scene, plots
LAYOUT = Path(__file__).with_name("foxglove_layout.json")
# messages by family of readers, imported when used: packages are optional
PROFILES: Mapping[str, str] = {
    "foxglove": "track_range.results.formats.mcap.foxglove_profile:FoxgloveProfile",
    "ros2": "track_range.results.formats.mcap.ros2_profile:Ros2Profile",
}
ANNOTATIONS, DETECTIONS_2D = "/camera/annotations", "/camera/detections"
SCENE, DETECTIONS_3D, RANGES = "/tracks/scene", "/tracks/detections", "/tracks/ranges"
TRANSFORMS, TRACKED_OBJECTS = "/tf", "/tracks/objects"
NANOSECONDS = 1_000_000_000  # nanoseconds per second
Message = tuple[str, bytes]  # topic and encoded message


def calibration_matrices(camera: PinholeCamera) -> tuple[list[float], list[float], list[float]]:
    """K, R and P of a rectified camera, row by row."""
    fx, fy, cx, cy = camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px
    k = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    return k, r, [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
