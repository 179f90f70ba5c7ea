"""The command line in this process."""

from __future__ import annotations

import contextlib
import io
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from track_range.cli.app import main
from track_range.cli.shared.console import console

WIDTH = 200
"""Columns of the terminal that the program sees, so that lines and tables are not broken."""


class Finished(NamedTuple):
    """What a command left: its exit status and what it printed."""

    status: int
    stdout: str
    stderr: str


def run_command(*arguments: object, folder: Path | None = None, width: int = WIDTH) -> Finished:
    """Run `track-range ARGUMENTS` in this process, in `folder` if one is given."""
    out, err = io.StringIO(), io.StringIO()
    with (
        _replaced(["track-range", *map(str, arguments)], width),
        contextlib.chdir(folder or Path.cwd()),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            main()
            status = 0
        except SystemExit as ended:
            status = int(ended.code or 0)
    return Finished(status, out.getvalue(), err.getvalue())


@contextlib.contextmanager
def _replaced(argv: list[str], width: int) -> Iterator[None]:
    """sys.argv and the terminal's width; both are restored afterwards."""
    before = sys.argv, os.environ.get("COLUMNS"), console._width
    # The console has the width of the terminal in which it was made.
    sys.argv, os.environ["COLUMNS"], console._width = argv, str(width), width
    try:
        yield
    finally:
        sys.argv, columns, console._width = before
        if columns is None:
            del os.environ["COLUMNS"]
        else:
            os.environ["COLUMNS"] = columns
