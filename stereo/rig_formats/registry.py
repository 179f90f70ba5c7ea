"""The file formats of camera calibrations. A new one is a module with a RigFormat, and a row here."""

from __future__ import annotations

from track_range.stereo.rig_formats.kalibr import KALIBR
from track_range.stereo.rig_formats.kitti import KITTI
from track_range.stereo.rig_formats.opencv import OPENCV
from track_range.stereo.rig_formats.rig_format import RigFormat, RigWriter
from track_range.stereo.rig_formats.rig_yaml import RIG_YAML

RIG_FORMATS: tuple[RigFormat, ...] = (OPENCV, KALIBR, KITTI, RIG_YAML)
"""In the order in which they are tried; the first that recognises a file reads it.

OpenCV's comes before KITTI's, since both have lines P1 and P2.
"""

FORMAT_TITLES = ", ".join(rig_format.title for rig_format in RIG_FORMATS[::-1])


def rig_writers() -> dict[str, RigWriter]:
    """The writers of the formats that have one, by the format's name; our own first."""
    return {rig_format.name: rig_format.write for rig_format in RIG_FORMATS[::-1] if rig_format.write is not None}
