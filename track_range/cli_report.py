"""The command `report` as the command line shows it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from track_range.commands.report import report as write_reports

_console = Console()


def report(
    folders: Annotated[list[Path], typer.Argument(metavar="DIR...", help="Folders of runs.")],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="The page to write (default: report.html in the run's folder; of several runs comparison.html here).",
        ),
    ] = None,
) -> None:
    """Write a run's report.html anew from its folder; with several folders compare the runs side by side."""
    write_reports(folders, out, _console)
