"""Recordings given without --mono or --stereo, and patterns of files that the shell has expanded."""

import re
import shlex
from collections.abc import Sequence
from itertools import takewhile
from pathlib import Path

from track_range.foundation.errors import UsageError


def run_of_recordings(arguments: Sequence[str]) -> list[str] | None:
    """Arguments of the run that a single recording in the first place stands for; None = it is no recording.

    UsageError: several recordings, whose roles are unknown; the message has the possible commands.
    """
    names = [*takewhile(lambda argument: not argument.startswith("-"), arguments)]
    if not names or not all(map(_is_recording, names)):
        return None
    if len(names) == 1:
        return ["run", "--mono", *arguments]
    refuse_expanded("--mono", names, most=2)
    parts = shlex.join(part for name in names for part in ("--mono", name))
    pair = f"`track-range --stereo {shlex.join(names)}` for a left and a right camera, or " if len(names) == 2 else ""
    raise UsageError(
        f"expected --mono or --stereo before the recordings, found {len(names)} recordings without it: use {pair}"
        f"`track-range {parts}` for the parts of one recording."
    )


def refuse_expanded(option: str, names: Sequence[str], most: int) -> None:
    """Raise UsageError if there are more than `most` names, and all are those of recorded files."""
    if len(names) > most and all(map(_is_recorded_file, names)):
        raise UsageError(
            f"{option}: expected {'one recording' if most == 1 else 'at most two recordings'}, found {len(names)} "
            "files, as after a pattern that the shell has expanded; quote the pattern: "
            f"{option} {' '.join(_patterns(names))}"
        )


def _patterns(names: Sequence[str]) -> list[str]:
    """Quoted patterns of the files: one for each folder, beginning of the name and suffix."""
    paths = [*map(Path, names)]
    patterns = {path.with_name(f"{re.split(r'[0-9]', path.stem)[0]}*{path.suffix}") for path in paths}
    if len(patterns) > 2:  # the names have no common beginning
        patterns = {path.with_name(f"*{path.suffix}") for path in paths}
    return [shlex.quote(str(pattern)) for pattern in sorted(patterns)]


def _is_recording(name: str) -> bool:
    return "://" in name or any(mark in name for mark in "*?[") or _is_recorded_file(name) or Path(name).exists()


def _is_recorded_file(name: str) -> bool:
    from track_range.foundation.files.images import IMAGE_SUFFIXES
    from track_range.recording.segments.segmented_video import VIDEO_SUFFIXES

    return Path(name).suffix.lower() in {*IMAGE_SUFFIXES, *VIDEO_SUFFIXES}
