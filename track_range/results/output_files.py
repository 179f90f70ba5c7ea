"""Files that a user asked for: written whole or not at all, with errors as one sentence; checks before the work."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from track_range.foundation import atomic_files
from track_range.foundation.atomic_files import describe
from track_range.foundation.errors import UserError


class OutputError(UserError):
    """Results that cannot be written; the message says where and why."""


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically, in UTF-8 (see `foundation.atomic_files`).

    Raises:
        OutputError: it cannot be written.
    """
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: Path, content: bytes) -> None:
    """Write a binary file atomically (see `foundation.atomic_files`).

    Raises:
        OutputError: it cannot be written.
    """
    try:
        atomic_files.write_bytes(path, content)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({describe(error)}).") from error


def make_folder(folder: Path) -> None:
    """Create the folder, with its parents, and make sure that files can be written there.

    Raises:
        OutputError: it is a file, or cannot be created or written to.
    """
    probe = folder / ".writable"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise OutputError(f"{folder}: no results can be written there ({describe(error)}).") from error


def check_outputs(outputs: Sequence[Path], inputs: Iterable[Path]) -> None:
    """Refuse files that cannot be written before the work that they are to hold, not after it; folders are made.

    Raises:
        OutputError: one is a folder, cannot be written, is named twice, or is among the inputs.
    """
    read = {path.resolve() for path in inputs}
    for number, file in enumerate(outputs):
        if file.is_dir():
            raise OutputError(f"{file}: it is a folder; name a file in it.")
        if file.resolve() in read:
            raise OutputError(f"{file} is an input or a result and would be overwritten: choose another file.")
        if file.resolve() in {other.resolve() for other in outputs[:number]}:
            raise OutputError(f"{file} is to be written twice: choose another file for one of them.")
        make_folder(file.parent)


def clear_results(folder: Path, names: Sequence[str], *, keep: Iterable[Path]) -> None:
    """Remove the files of an earlier run, so that all files in the folder are of one run; folders are left.

    Args:
        folder: of the results.
        names: of the files to remove.
        keep: inputs of this run.

    Raises:
        OutputError: one of the files is an input, or cannot be removed.
    """
    inputs = {path.resolve() for path in keep}
    for name in names:
        file = folder / name
        if file.resolve() in inputs:
            raise OutputError(f"{file} is an input of this run and would be overwritten: choose another --out folder.")
    try:
        for name in names:
            if not (folder / name).is_dir():
                (folder / name).unlink(missing_ok=True)
    except OSError as error:
        reason = describe(error)
        raise OutputError(f"{folder}: an earlier run's files cannot be removed ({reason}).") from error
