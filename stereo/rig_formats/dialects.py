"""Calibrations with matrices or numbers by name, from OpenCV, scripts, data sets and programs: one
row of a table for each kind of file.

The names of quantities in files are rows of `values.aliases.QUANTITIES`. A draft holds the values
that a file and those beside it state, and `values.resolution` makes a rig of it.
"""

import re
from functools import partial
from pathlib import Path

from track_range.stereo.geometry.rig_checks import RigCalibration
from track_range.stereo.rig_formats.rig_format import format_by_pattern
from track_range.stereo.rig_formats.values.containers import (
    K_AND_BASELINE,
    VIRTUAL_KITTI,
    plain_values,
)
from track_range.stereo.rig_formats.values.dialect import PLAIN, Dialect, Unit
from track_range.stereo.rig_formats.values.draft import draft_of
from track_range.stereo.rig_formats.values.partners import completed
from track_range.stereo.rig_formats.values.resolution import resolved

DIALECTS = (
    Dialect(
        name="middlebury",
        title="Middlebury's calib.txt",
        pattern=re.compile(r"^cam0\s*=\s*\[", re.MULTILINE),
        metres_per_unit=0.001,
        is_rectified=True,
    ),
    Dialect(
        name="cityscapes",
        title="Cityscapes' camera.json",
        pattern=re.compile(r'\A(?=[\s\S]*"baseline")[\s\S]*"u0"'),
        metres_per_unit=1.0,
        assumed={"size": [2048, 1024]},
        assumption="images of 2048x1024 px, the size of all Cityscapes images",
        is_rectified=True,
    ),
    Dialect(
        name="foundation-stereo",
        title="FoundationStereo's K.txt",
        pattern=K_AND_BASELINE,
        metres_per_unit=1.0,
        is_rectified=True,
    ),
    Dialect(
        name="virtual-kitti",
        title="Virtual KITTI's intrinsic.txt",
        pattern=VIRTUAL_KITTI,
        metres_per_unit=1.0,
        assumed={"baseline": 0.532725, "size": [1242, 375]},  # europe.naverlabs.com
        assumption="the baseline of Virtual KITTI 2 and its images of 1242x375 px",
        is_rectified=True,
    ),
    Dialect(
        name="orb-slam",
        title="ORB-SLAM's settings",
        pattern=re.compile(r"^(?:Camera1?\.fx|LEFT\.K)\s*:", re.MULTILINE),
        metres_per_unit=1.0,
        is_baseline_rectified=True,
    ),
    Dialect(
        name="matlab",
        title="MATLAB's stereoParameters",
        pattern=re.compile("(?i)RotationOfCamera2|RadialDistortion"),
        usual_unit=Unit(0.001, "assuming millimetres, MATLAB's default"),
        first_pixel=1.0,
    ),
    Dialect(
        name="realsense-json",
        title="RealSense's intrinsics and extrinsics in JSON",
        pattern=re.compile(r'"(?:ppx|PPX)"'),
        metres_per_unit=1.0,
    ),
    Dialect(
        name="opencv",
        title="the files of OpenCV's stereo_calib",
        pattern=re.compile("opencv-matrix|<opencv_storage>"),
        priority=-10,  # other programs write OpenCV's files, too
        expected="a calibration of OpenCV",
    ),
    PLAIN,
)
"""Kinds of files."""


def read_dialect(dialect: Dialect, text: str, path: Path, *, is_pair: bool) -> RigCalibration:
    """The cameras of a file of a dialect; with the files beside it that complete a pair, if
    `is_pair`.
    """
    draft = draft_of(plain_values(text, path, dialect.expected), path, dialect)
    return resolved(completed(draft, is_pair=is_pair))


FORMATS = {
    dialect.name: format_by_pattern(
        dialect.name,
        dialect.title,
        dialect.pattern,
        partial(read_dialect, dialect, is_pair=False),
        "M2, D2, R and T in this file or in intrinsics/extrinsics{suffix} in its folder",
        partial(read_dialect, dialect, is_pair=True),
        dialect.priority,
    )
    for dialect in DIALECTS
}
READ_ONLY = tuple(form for name, form in FORMATS.items() if name != "opencv")
