"""Registry of the file formats of camera calibrations: a new format is a module with a RigFormat, and a row here."""

from __future__ import annotations

from track_range.stereo.rig_formats.kalibr import KALIBR
from track_range.stereo.rig_formats.kitti import KITTI
from track_range.stereo.rig_formats.opencv import OPENCV
from track_range.stereo.rig_formats.rig_format import RigFormat, RigWriter
from track_range.stereo.rig_formats.rig_yaml import RIG_YAML
from track_range.stereo.rig_formats.ros import ROS

RIG_FORMATS: tuple[RigFormat, ...] = (OPENCV, KALIBR, KITTI, ROS, RIG_YAML)
"""Formats in the order in which they are tried; the first that recognises a file reads it.

OpenCV's precedes KITTI's, because both have lines P1 and P2.
"""

FORMAT_TITLES = ", ".join(rig_format.title for rig_format in RIG_FORMATS[::-1])  # list of the formats for messages


def rig_writers() -> dict[str, RigWriter]:
    """The writers by name of the format, rig.yaml's first."""
    return {rig_format.name: rig_format.write for rig_format in RIG_FORMATS[::-1] if rig_format.write is not None}
