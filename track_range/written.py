"""Files that appear whole or not at all."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path


class OutputError(Exception):
    """Results that cannot be written; the message says where and why."""


def write_text(path: Path, text: str) -> None:
    """Write a text file under a temporary name and rename it into place.

    Raises:
        OutputError: the folder cannot be written to.
    """
    partial = path.with_name(path.name + ".part")
    try:
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)
    except OSError as error:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        raise OutputError(f"{path}: cannot be written ({error.strerror or error}).") from error


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
        raise OutputError(f"{folder}: no results can be written there ({error.strerror or error}).") from error
