"""RigFormat: a file format of camera calibrations, one of `reading.RIG_FORMATS`."""

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from track_range.foundation.files.atomic_files import writable, write_text
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.geometry.rig_checks import RigCalibration

# path, comment lines; raises RigError
RigWriter = Callable[[StereoRig | PinholeCamera, Path, Sequence[str]], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class RigFormat:
    """One file format of camera calibrations."""

    name: str  # the format's name on the command line
    title: str  # the format's files, for messages, such as "KITTI's calib.txt"
    recognises: Callable[[str], bool]  # whether a file with this text is in the format
    # the cameras of a file from its text, its path (for messages and other files) and whether the
    # images are grey; raises RigError
    read: Callable[[str, Path, bool], RigCalibration]
    # the keys that a file with one camera lacks for a stereo rig, for messages, from the same
    # arguments
    missing: Callable[[str, Path, bool], str]
    # as `read`, for two videos: a file with one camera is completed by one beside it; None = `read`
    read_pair: Callable[[str, Path, bool], RigCalibration] | None = None
    write: RigWriter | None = None  # writes a file; None = the format is only read
    # 0 = `recognises` asks for a mark that no other format has, see `foundation.registry.Registry`
    priority: int = 0


def format_by_pattern(
    name: str,
    title: str,
    pattern: re.Pattern[str],  # in the text
    read: Callable[[str, Path], RigCalibration],
    missing: str,
    read_pair: Callable[[str, Path], RigCalibration] | None = None,
    priority: int = 0,
) -> RigFormat:
    """A format that is only read, without grey images; {suffix} in `missing` is the file's
    suffix.
    """
    return RigFormat(
        name=name,
        title=title,
        recognises=lambda text: pattern.search(text) is not None,
        read=lambda text, path, _is_grey: read(text, path),
        read_pair=lambda text, path, _is_grey: (read_pair or read)(text, path),
        missing=lambda _text, path, _is_grey: missing.format(suffix=path.suffix),
        priority=priority,
    )


def write_rig_text(path: Path, text: str) -> None:
    """Write a text file atomically. Raises RigError if the path is a folder, or cannot be
    written.
    """
    if os.path.isdir(path):
        raise RigError(f"{path}: expected a file to write, found a folder; give a file name.")
    with writable(path, RigError):
        write_text(path, text)
