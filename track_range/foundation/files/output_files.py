"""Output files: atomic writing, checks before the work begins, and errors as one sentence."""

import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from track_range.foundation.errors import UserError
from track_range.foundation.files import atomic_files
from track_range.foundation.files.atomic_files import describe, writable
from track_range.foundation.files.folder_lock import locked_folder


class OutputError(UserError):
    """Results cannot be written; the message names the file and the reason."""


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically, in UTF-8; raises OutputError if it cannot be written."""
    write_bytes(path, text.encode("utf-8"))


def write_json(path: Path | None, content: Mapping[str, Any], *, allow_nan: bool = False) -> None:
    """Write a JSON file, if one is given, as `write_text` does; raises ValueError for NaN, which is
    not valid JSON.
    """
    if path is not None:
        write_text(path, json.dumps(content, indent=2, allow_nan=allow_nan) + "\n")


def write_bytes(path: Path, content: bytes) -> None:
    """Write a binary file atomically; raises OutputError if it cannot be written."""
    with writable(path, OutputError):
        atomic_files.write_bytes(path, content)


def make_folder(folder: Path) -> None:
    """Create a folder with its parents, and check it; raises OutputError if files cannot be written
    to it.
    """
    if folder.exists() and not folder.is_dir():
        raise OutputError(
            f"{folder}: expected a folder for the results, found a file; choose another name."
        )
    probe = folder / ".writable"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise OutputError(
            f"{folder}: results cannot be written to this folder ({describe(error)}); choose "
            "another folder."
        ) from error


@contextmanager
def locked_output(folder: Path) -> Iterator[None]:
    """Context in which this process alone writes to a folder, created if needed; FolderLockError,
    OutputError.
    """
    make_folder(folder)
    with locked_folder(folder):
        yield


def check_outputs(outputs: Sequence[Path], inputs: Iterable[Path]) -> None:
    """Create the folders of outputs; raises OutputError if one is a folder, unwritable, given
    twice, or an input.
    """
    read, written = {os.path.realpath(path) for path in inputs}, set[str]()
    for file in outputs:
        place = os.path.realpath(file)
        if file.is_dir():
            raise OutputError(
                f"{file}: expected a file, found a folder; give the path of a file in it."
            )
        if place in read:
            raise OutputError(
                f"{file}: this input or result would be overwritten; choose another file."
            )
        if place in written:
            raise OutputError(
                f"{file}: given for two outputs; choose another file for one of them."
            )
        written.add(place)
        make_folder(file.parent)


def clear_results(folder: Path, names: Sequence[str], *, except_for: Iterable[Path]) -> None:
    """Remove the files of an earlier run; raises OutputError if one is an input (`except_for`) or
    cannot be removed.
    """
    inputs, files = (
        {os.path.realpath(path) for path in except_for},
        [folder / name for name in names],
    )
    for file in files:
        if os.path.realpath(file) in inputs:
            raise OutputError(
                f"{file}: this input would be overwritten; choose another --out folder."
            )
    try:
        for file in files:
            if not file.is_dir():
                file.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(
            f"{folder}: files of an earlier run cannot be removed ({describe(error)}); choose "
            "another --out folder."
        ) from error
