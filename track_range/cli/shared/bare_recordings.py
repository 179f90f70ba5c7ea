"""Recordings given without --mono or --stereo, and patterns of files that the shell has
expanded.
"""

import re
import shlex
from collections.abc import Sequence
from itertools import takewhile
from pathlib import Path

import typer

from track_range.foundation.errors import UsageError


def run_of_recordings(arguments: list[str], program: str) -> list[str]:
    """The arguments, with `run --mono` before a single recording, after printing the command.

    UsageError: several recordings, whose roles are unknown; the message has the possible commands.
    """
    names = _recordings(arguments)
    if not names:
        return arguments
    if len(names) == 1:
        typer.echo(f"{program} --mono {shlex.join(arguments)}", err=True)
        return ["run", "--mono", *arguments]
    refuse_expanded("--mono", names, most=2)
    parts = shlex.join(part for name in names for part in ("--mono", name))
    pair = (
        f"`{program} --stereo {shlex.join(names)}` for a left and a right camera, or "
        if len(names) == 2
        else ""
    )
    raise UsageError(
        f"expected --mono or --stereo before the recordings, found {len(names)} recordings without "
        f"either: use {pair}`{program} {parts}` for the parts of one recording."
    )


def refuse_bare(arguments: list[str], program: str, command: str) -> None:
    """Raise UsageError for recordings without --mono before them, in a program with a sub-command
    for recordings of drives.
    """
    if names := _recordings(arguments):
        raise UsageError(
            f"expected --mono or the command {command} before {names[0]}: use `{program} {command} "
            f"{shlex.join(names)}` for drives of one camera, or `{program} --mono {shlex.quote(names[0])}` for "
            "one drive, and with --board for images of a board."
        )


def _recordings(arguments: list[str]) -> list[str]:
    """The first arguments, if all up to the first option name recordings; else none."""
    names = [*takewhile(lambda argument: not argument.startswith("-"), arguments)]
    are_recorded = all(_is_recorded(name) or "://" in name or Path(name).exists() for name in names)
    return names if are_recorded else []


def refuse_expanded(option: str, names: Sequence[str], most: int) -> None:
    """Raise UsageError if there are more than `most` names, and all name recorded files."""
    if len(names) <= most or not all(map(_is_recorded, names)):
        return
    if most == 1 and len(names) == 2:
        first, second = map(shlex.quote, names)
        raise UsageError(
            f"{option}: expected one recording, found 2: give {option} {first} {option} {second} "
            f"for the parts of one recording, --stereo {first} {second} for two cameras, or quote "
            "the pattern that the shell has expanded."
        )
    paths = [*map(Path, names)]
    patterns = {
        path.with_name(f"{re.split(r'[0-9]', path.stem)[0]}*{path.suffix}") for path in paths
    }
    if len(patterns) > most:  # the names have no common beginning, or too many
        patterns = {path.with_name(f"*{path.suffix}") for path in paths}
    expected = "one recording" if most == 1 else "at most two recordings"
    raise UsageError(
        f"{option}: expected {expected}, found {len(names)} files, as after a pattern that the "
        f"shell has expanded; quote the pattern: {option} {shlex.join(map(str, sorted(patterns)))}"
    )


def _is_recorded(name: str) -> bool:
    """Whether a file name or pattern ends as names of images and videos do."""
    from track_range.foundation.files.images import IMAGE_SUFFIXES
    from track_range.recording.video.file_names import VIDEO_SUFFIXES

    return Path(name).suffix.lower() in {*IMAGE_SUFFIXES, *VIDEO_SUFFIXES}
