"""`track-range report`: rewrites reports from the folders of runs, and compares several runs."""

from pathlib import Path
from typing import Annotated

from track_range.cli.shared.console import console, print_grid, print_line, print_notes
from track_range.cli.shared.parameters import command
from track_range.foundation.schemas.options import Options, option
from track_range.views.report.run_folders import report


class ReportOptions(Options):
    """Options of `track-range report`."""

    folders: Annotated[
        tuple[Path, ...],
        option(
            "Result folder of a run; several folders are compared.",
            metavar="DIR...",
            is_argument=True,
            is_repeated=True,
        ),
    ]
    out: Annotated[
        Path | None,
        option(
            "Page to write (default: report.html in the folder of a single run, comparison.html in "
            "the current folder for several runs).",
            metavar="FILE",
        ),
    ] = None
    clips: Annotated[
        bool,
        option(
            "Short video of each event, cut from overlay.mp4 into the folder clips of each run."
        ),
    ] = False


def _report(options: ReportOptions) -> None:
    written = report(options.folders, options.out, has_clips=options.clips)
    print_line(console, *written.missing)
    print_grid(console, *written.grids)
    print_notes(console, written.notes)
    others = "; the report.html of each run was rewritten" if len(set(options.folders)) > 1 else ""
    if options.clips:
        print_line(console, f"Clips of events: {len(written.clips)}")
    print_line(console, f"Open {written.page} in a browser{others}.")


app = command(ReportOptions, _report)
