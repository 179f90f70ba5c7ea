"""Dialect: a kind of file with values by name, how it is recognised, and what its files do not state."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from track_range.stereo.rig_formats.values.conventions import Convention


class Unit(NamedTuple):
    """Metres per unit of the lengths in a file."""

    metres: float
    reason: str  # for messages
    is_doubtful: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Dialect:
    """A kind of file with values by name: one row of `dialects.DIALECTS`."""

    name: str  # for messages and the table of formats
    title: str
    pattern: re.Pattern[str]  # in the text
    priority: int = 0  # see `RigFormat`
    expected: str = "a calibration"  # for messages on broken files
    # what a file of one camera lacks for a pair
    missing: str = "M2, D2, R and T in this file or in intrinsics/extrinsics{suffix} in its folder"
    metres_per_unit: float | None = None  # of lengths; None = by their size
    usual_unit: Unit | None = None  # of files that state none; None = by the lengths' size
    # values by name of all files of the kind, which the files do not state
    assumed: Mapping[str, object] = field(default_factory=dict)
    assumption: str = ""  # the same in words, for the note
    is_rectified: bool = False  # whether the images are rectified
    # whether a baseline beside distorted cameras is that of their rectified images
    is_baseline_rectified: bool = False
    first_pixel: float = 0.0  # number of the first pixel of a row
    # focal lengths and principal point in pixels, for files with another convention
    convention: Convention | None = None
    # whether coefficients that the file does not have are 0, also if it has none
    is_ideal_without: bool = False
    # whether k4 is the coefficient of r^8, and not that of OpenCV's denominator
    has_radial_k4: bool = False
    has_radial_only: bool = False  # whether three coefficients are k1, k2 and k3
    is_tangential_swapped: bool = False  # whether p1 is the coefficient of OpenCV's p2


# any file with matrices by name
PLAIN = Dialect(
    name="matrices",
    title="matrices by name, K1 D1 K2 D2 R T",
    pattern=re.compile(""),
    priority=-30,
)
