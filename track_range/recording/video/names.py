"""Names of recordings: a file or folder, several files that are one recording, a topic of a bag, or
a live source.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from glob import glob, has_magic
from pathlib import Path
from typing import Literal

from track_range.foundation.files.input_files import counted
from track_range.recording.video.address import LiveAddress, live_address


@dataclass(frozen=True, slots=True)
class Segments:
    """At least two video files that form one recording, as a dashcam writes them."""

    paths: tuple[Path, ...]

    def __str__(self) -> str:
        return f"{self.paths[0]} and {counted(len(self.paths) - 1, 'other file')}"


@dataclass(frozen=True, slots=True)
class BagTopic:
    """A topic with images (None = the only topic) of an MCAP file, ROS bag, or folder of a ROS 2
    bag.
    """

    path: Path
    topic: str | None

    def __str__(self) -> str:
        return str(self.path) if self.topic is None else f"{self.path} ({self.topic})"


PackedLayout = Literal["side-by-side", "right-left", "top-bottom", "bottom-top"]
"""Layout of the images of two cameras in one image: beside or below each other, the left camera's
first or second."""

STACKED: tuple[PackedLayout, ...] = ("top-bottom", "bottom-top")  # below each other
REVERSED: tuple[PackedLayout, ...] = ("right-left", "bottom-top")  # the right camera's first

StereoLayout = Literal[PackedLayout, "tracks"]  # the same, or in two video tracks of a recording

LayoutOption = Literal["auto", StereoLayout]
# colours of the first two pixels of the first two rows
Bayer = Literal["rggb", "bggr", "gbrg", "grbg"]


@dataclass(frozen=True, slots=True)
class VideoTrack:
    """One of several video tracks of the files of a recording, counted from 0 without cover art."""

    recording: Path | Segments
    number: int

    def __str__(self) -> str:
        return f"{self.recording} (video track {self.number})"


# a source of all images of a recording
WholeName = Path | LiveAddress | Segments | BagTopic | VideoTrack


@dataclass(frozen=True, slots=True)
class Half:
    """The images of one camera in a recording whose images contain both cameras."""

    recording: WholeName
    layout: PackedLayout
    is_right: bool

    def __str__(self) -> str:
        return f"{self.recording} ({'right' if self.is_right else 'left'} camera)"


RecordedName = Path | Segments | BagTopic | VideoTrack | Half
"""A video file, folder, pattern such as `DIR/*_F.mp4`, several files, a topic of a bag, or a part
of these."""

VideoName = WholeName | Half  # any source of one camera's images


def video_name(name: str | VideoName | Sequence[str | Path]) -> VideoName:
    """The source or pattern with this name, or several files; ValueError for no name or several
    live sources.
    """
    if isinstance(name, str):
        return live_address(name) or Path(name)
    if isinstance(name, Path | LiveAddress | Segments | BagTopic | VideoTrack | Half):
        return name
    names = [video_name(part) for part in name]
    paths = tuple(part for part in names if isinstance(part, Path))
    if not names or len(paths) < len(names):
        raise ValueError("expected one camera, one stream, or video files")
    return paths[0] if len(paths) == 1 else Segments(paths)


def is_pattern(path: Path) -> bool:
    """Whether a path is a pattern such as `DIR/*_F.mp4` instead of the name of a file or folder."""
    return has_magic(str(path)) and not path.exists()


def matching_files(pattern: Path) -> list[Path]:
    """Files that match a pattern, sorted by name."""
    return sorted(Path(name) for name in glob(str(pattern)))


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Sorting key in which numbers are compared by value: clip2 < clip10."""
    return [
        (0, int(part), "") if part.isdecimal() else (1, 0, part)
        for part in re.split(r"(\d+)", name)
        if part
    ]


def files_of(name: VideoName) -> list[Path]:
    """Files and folders that a name denotes; none for a live source."""
    if isinstance(name, VideoTrack | Half):
        return files_of(name.recording)
    if isinstance(name, Segments):
        return list(name.paths)
    if isinstance(name, BagTopic):
        return [name.path]
    if isinstance(name, Path):
        return matching_files(name) if is_pattern(name) else [name]
    return []


def stem_of(name: VideoName) -> str:
    """Stem of file names for a recording: the stem of its first file, or for a pattern the name of
    the folder.
    """
    if isinstance(name, VideoTrack | Half):
        return stem_of(name.recording)
    if isinstance(name, LiveAddress):
        return name.stem
    path = (
        name.paths[0]
        if isinstance(name, Segments)
        else name.path
        if isinstance(name, BagTopic)
        else name
    )
    return (path.absolute().parent.name or "recording") if is_pattern(path) else path.stem
