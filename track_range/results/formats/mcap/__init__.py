"""run.mcap: the tracks of a run for Foxglove, or for ROS 2."""

from collections.abc import Mapping
from pathlib import Path

LAYOUT = Path(__file__).with_name("foxglove_layout.json")
"""Layout for Foxglove: image with boxes, 3-D scene, plots of distance and closing speed, notes."""

PROFILES: Mapping[str, str] = {
    "foxglove": "track_range.results.formats.mcap.foxglove_profile:FoxgloveProfile",
    "ros2": "track_range.results.formats.mcap.ros2_profile:Ros2Profile",
}
"""Profiles by name, imported when one is used, since their packages are optional."""
