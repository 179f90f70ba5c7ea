"""Names of files: patterns such as `DIR/*_F.mp4`, their order, and the stem for files of results."""

import re
from glob import glob, has_magic
from pathlib import Path


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


def stem_of_path(path: Path) -> str:
    """The stem of a file, or the name of the folder of a pattern."""
    return (path.absolute().parent.name or "recording") if is_pattern(path) else path.stem
