"""Names of files: suffixes of videos, patterns such as `DIR/*_F.mp4`, their order, and the stem for
files of results.
"""

import os
import re
from glob import glob, has_magic
from pathlib import Path

VIDEO_SUFFIXES = frozenset(
    ".264 .265 .3g2 .3gp .asf .avi .dav .flv .h264 .h265 .hevc .insv .m2ts .m4v .mjpeg .mjpg .mkv "
    ".mov .mp4 .mpeg .mpg .mts .mxf .ogv .ts .vob .webm .wmv".split()
)


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


# GX020001: chapter 2 of recording 1; GOPR0001, GPFR0001, GPBK0001: the first chapter of earlier
# cameras (GoPro)
_CHAPTER = re.compile(
    r"(?<![a-z0-9])(?:gopr|gpfr|gpbk|g[a-z](?P<chapter>\d\d))(?P<recording>\d{4})(?!\d)",
    re.IGNORECASE,
)


def recording_of_chapter(name: str) -> str | None:
    """Number of the recording of which a file is a chapter; None = the name does not show it."""
    match = _CHAPTER.search(name)
    return match["recording"] if match else None


def recording_key(name: str) -> list[tuple[int, int, str]]:
    """Sorting key of files of a recording: chapters after the number of their recording, else
    `natural_key`.
    """
    return natural_key(
        _CHAPTER.sub(lambda match: f"G{match['recording']}.{match['chapter'] or '00'}", name)
    )


def stem_of_path(path: Path) -> str:
    """The stem of a file, or the name of a folder, such as ".", or of the folder of a pattern."""
    if is_pattern(path):
        return path.absolute().parent.name or "recording"
    if path.stem in ("", ".."):
        return Path(os.path.realpath(path)).name or "recording"
    return path.stem
