"""`track-range run`, the main command: options of `RunSettings`, live view, and printing of the
results.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, nullcontext, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from track_range.cli.shared.parameters import PairCommand, command_of, given_values, parameters
from track_range.foundation.errors import UsageError
from track_range.foundation.files.input_files import counted
from track_range.foundation.processes import tuned_process
from track_range.foundation.schemas.options import Options, option
from track_range.run.options.precedence import settings_from
from track_range.run.options.settings import RunSettings

if TYPE_CHECKING:
    from rich.console import Console

    from track_range.run.run import Run
    from track_range.views.live_view.view import LiveView


class RunView(Options):
    """Options of a run that do not affect its results."""

    settings: Annotated[
        Path | None,
        option(
            "Settings of an earlier run (settings.yaml); other options override them.",
            panel="Input",
        ),
    ] = None
    views: Annotated[
        str | None,
        option(
            "With --mono, several runs on one video of a wide lens, in these directions in degrees "
            "to the right of its axis, in subfolders of the output folder; views.csv in the output "
            "folder has the tracks of all runs.",
            metavar="DEG,DEG,...",
            panel="Input",
        ),
    ] = None
    verbose: Annotated[
        bool,
        option(
            "Coverage, uncertainty and run time of each method, printed at the end.", panel="Output"
        ),
    ] = False
    show: Annotated[
        bool, option("The overlay is shown in a browser while the run goes on.", panel="Output")
    ] = False
    serve: Annotated[
        str | None,
        option(
            "Address of the live view: a port on this machine, or HOST:PORT to make the view "
            "reachable from other machines.",
            metavar="PORT|HOST:PORT",
            panel="Output",
        ),
    ] = None
    viewers: Annotated[
        int,
        option(
            "Largest number of viewers of the live view at a time (default: 16).",
            metavar="N",
            panel="Output",
            ge=1,
            le=1000,
        ),
    ] = 16


def _run(**values: Any) -> None:
    from track_range.cli.shared.console import console, print_line
    from track_range.views.live_view.view import open_view

    options = RunView.of(given_values(RunView, values))
    printed = partial(_print_tables, is_verbose=options.verbose)
    settings = settings_from(_with_sources(given_values(RunSettings, values)), options.settings)
    if options.views is None:
        with (
            open_view(show=options.show, serve=options.serve, n_viewers=options.viewers)
            or nullcontext() as view
        ):
            run_and_print(settings, console, view, print_results=printed)
        return
    from track_range.run.views import directions_deg, run_views

    if options.show or options.serve is not None:
        raise UsageError(
            "--views makes several runs: it cannot be combined with --show or --serve."
        )
    views_deg = directions_deg(options.views, settings)
    path = run_views(
        settings, views_deg, lambda one: run_and_print(one, console, print_results=printed)
    )
    print_line(console, f"The tracks of all views are in {path}.")


def run_and_print(
    settings: RunSettings,
    console: Console,
    view: LiveView | None = None,
    *,
    print_results: Callable[[Run, Console], None],
) -> Path:
    """Process a whole run, print its notes and results, and return its output folder.

    A run that is interrupted (RunStoppedError), or in which an input fails, finishes its files
    first.
    """
    from track_range.foundation.errors import RunStoppedError
    from track_range.run.interrupts import stop_on_interrupt
    from track_range.run.run import Run

    run = Run(settings.model_copy(update={"out": settings.out_dir}), progress=console)
    with stop_on_interrupt():
        try:
            with run:
                _process(run, console, view, print_results)
        except KeyboardInterrupt:
            state = (
                "; all results until then were written."
                if run.is_finished
                else " before any frame was processed."
            )
            raise RunStoppedError(f"stopped by the user{state}") from None
    return settings.out_dir


def _process(
    run: Run, console: Console, view: LiveView | None, print_results: Callable[[Run, Console], None]
) -> None:
    from track_range.cli.shared.console import print_notes

    of_camera = run.camera_notes  # printed at the end
    opening_notes = [note for note in run.notes if note not in of_camera]
    replaced = f"The results of an earlier run in {run.settings.out} are replaced."
    with _ignore_broken_pipe():
        print_notes(console, [*([replaced] if run.replaces_results else []), *opening_notes])
    if view is not None:
        print_notes(console, [view.begin(run.draw, video=run.uncalibrated_video)])
    try:
        with tuned_process(has_dense_stereo=run.settings.sgbm), closing(iter(run)) as frames:
            for frame in frames:
                if view is not None:
                    view.offer(frame)
    finally:
        if run.is_finished:
            with _ignore_broken_pipe():
                printed = {*opening_notes, *of_camera}
                print_notes(console, [note for note in run.notes if note not in printed])
            with _ignore_broken_pipe():
                print_results(run, console)
            with _ignore_broken_pipe():
                print_notes(console, of_camera)


def _print_tables(run: Run, console: Console, *, is_verbose: bool) -> None:
    from track_range.cli.shared.console import print_line, print_summary
    from track_range.views.tables import frames_per_s

    with _ignore_broken_pipe():
        if is_verbose:
            print_summary(console, run.summary)
        print_outcome(run, console)
        files = {file.name: file for file in run.files}
        if "report.html" in files:
            print_line(console, f"Report of the run: {files['report.html']}")
        rate = frames_per_s(run.summary)
        print_line(
            console,
            counted(run.summary["frames"], "frame")
            + (f", {rate:.1f} per second." if rate else "."),
        )
    if run.files:
        names = ", ".join(file.name for file in run.files)
        print_line(console, f"Results in {run.files[0].parent}: {names}")


def print_outcome(run: Run, console: Console) -> None:
    """Print what happened: the extremes of each class, the events, and the accuracy."""
    from track_range.cli.shared.console import print_grid, print_line
    from track_range.foundation.files.input_files import printable
    from track_range.views.report.content.counts import (
        is_fixed,
        line_grid,
        speed_grid,
        zone_grid,
    )
    from track_range.views.report.outcome import accuracy_lines, class_grid, event_lines

    if is_fixed(run.summary):
        grids = (line_grid(run.summary), zone_grid(run.summary), speed_grid(run.summary))
        print_grid(console, *(grid for grid in grids if grid.rows))
        print_line(console, *(accuracy_lines(run.summary) if run.summary["truth"] else ()))
        return
    users = run.summary["closest_approaches"]
    print_grid(console, *([class_grid(users)] if users else []))
    accuracy = accuracy_lines(run.summary) if run.summary["truth"] else ()
    lines = event_lines(run.events, len(users), run.summary.get("visibility"))
    print_line(console, *map(printable, lines), *accuracy)


@contextmanager
def _ignore_broken_pipe() -> Iterator[None]:
    """Context in which a closed pipe, a full disk or a terminal without sigma ends the printing,
    but not the run.
    """
    with suppress(OSError, UnicodeError, SystemExit):  # Rich raises SystemExit for a closed pipe
        yield


def _with_sources(given: dict[str, Any]) -> dict[str, Any]:
    """Options with the values of repeated `--mono` and `--stereo` as one recording."""
    sources = dict(given)
    if files := given.get("mono"):
        sources["mono"] = files[0] if len(files) == 1 else files
    if sides := given.get("stereo"):
        left, right = sides[0::2], [side for side in sides[1::2] if side]
        if len(left) > 1 and 0 < len(right) < len(left):
            raise UsageError(
                "--stereo: expected LEFT and RIGHT for each option, found a single value."
            )
        pair = (left, right) if right else (left,)
        sources["stereo"] = tuple(side[0] if len(side) == 1 else side for side in pair)
    return sources


app = command_of(
    _run, [*parameters(RunSettings, is_only_given=True), *parameters(RunView)], PairCommand
)
