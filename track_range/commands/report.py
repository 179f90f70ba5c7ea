"""`track-range report DIR...`: pages of runs made anew from their folders, and several runs side by side."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from track_range.report.comparison import ComparedRun, comparison_grids, comparison_notes, settings_grid
from track_range.report.page import write_comparison, write_report
from track_range.results.folder import RunFolder, read_run_folder
from track_range.results.output_files import check_outputs
from track_range.results.writers import result_names
from track_range.run.progress import say
from track_range.terminal_tables import tell_grid


def report(folders: Sequence[Path], out: Path | None, console: Console) -> Path:
    """Write report.html into each folder and, of several, one page that compares them; returns the last page.

    Args:
        folders: of runs; one that is given twice counts once.
        out: where the page of one run goes in place of its folder, or that of several (None = comparison.html here).
        console: where to tell.

    Raises:
        OutputError: a folder is no run's, or a page cannot be written, or would overwrite what it is made from.
    """
    runs = [read_run_folder(folder) for folder in {each.resolve(): each for each in folders}.values()]
    pages = [run.folder / "report.html" for run in runs] if len(runs) > 1 else []
    if out is not None:
        inputs = (run.folder / name for run in runs for name in result_names() if name != "report.html")
        check_outputs([*pages, out], inputs)
    for run in runs:
        for sentence in run.missing:
            say(console, f"{run.folder}: {sentence}")
    if len(runs) == 1:
        path = out or runs[0].folder / "report.html"
        _write(path, runs[0])
        say(console, f"Open {path} in a browser.")
        return path
    return _compare(runs, out or Path("comparison.html"), console)


def _write(path: Path, run: RunFolder) -> None:
    files = run.summary["files"]
    if path.parent.resolve() != run.folder.resolve():  # the overlay stays where it is: a page elsewhere points there
        files = {key: _relative(run.folder / str(name), path.parent) for key, name in files.items()}
    write_report(path, {**run.summary, "files": files}, run.columns)


def _relative(path: Path, start: Path) -> str:
    return Path(os.path.relpath(path.resolve(), start.resolve())).as_posix()


def _compare(runs: Sequence[RunFolder], path: Path, console: Console) -> Path:
    for run in runs:
        _write(run.folder / "report.html", run)
    compared = [
        ComparedRun(
            name=name,
            summary=run.summary,
            settings=run.settings,
            link=_relative(run.folder / "report.html", path.parent),
            notes=run.missing,
        )
        for name, run in zip(short_names([run.folder for run in runs]), runs, strict=True)
    ]
    write_comparison(path, compared)
    for grid in [*comparison_grids(compared), settings_grid(compared)]:
        if grid.rows:
            tell_grid(console, grid)
    for note in comparison_notes(compared):
        say(console, f"- {note}")
    say(console, f"Open {path} in a browser; each run's own report.html was written anew.")
    return path


def short_names(folders: Sequence[Path]) -> list[str]:
    """The last parts of each path, as many as make all of them different."""
    parts = [folder.resolve().parts for folder in folders]
    for n in range(1, max(map(len, parts)) + 1):
        names = ["/".join(each[-n:]) for each in parts]
        if len(set(names)) == len(names):
            return names
    return [str(folder) for folder in folders]
