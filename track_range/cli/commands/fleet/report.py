"""`track-range fleet report` and `status`: figures of all clips of a fleet, and its progress, from
its output.
"""

from pathlib import Path
from typing import Annotated

from track_range.cli.shared.console import console, print_grid, print_line, print_notes
from track_range.cli.shared.parameters import command
from track_range.foundation.schemas.options import Options, option


class FleetStatusOptions(Options):
    """Options of `track-range fleet status`."""

    out: Annotated[
        str,
        option(
            "Folder of the results, as given to fleet run --out.", metavar="OUT", is_argument=True
        ),
    ]


class FleetReportOptions(FleetStatusOptions):
    """Options of `track-range fleet report`."""

    html: Annotated[
        str | None,
        option(
            "Page to write; its links lead to the files of the clips in OUT.",
            metavar="FILE.html|URI",
        ),
    ] = None
    table: Annotated[Path | None, option("Markdown file for the tables.", metavar="FILE.md")] = None
    json_file: Annotated[
        Path | None, option("JSON file for the figures.", flag="--json", metavar="FILE")
    ] = None
    by: Annotated[
        str | None,
        option(
            "Column of clips.parquet that groups the calibration drift (default: vehicle, camera "
            "or rig, if there is one).",
            metavar="COLUMN",
        ),
    ] = None


def _fleet_status(options: FleetStatusOptions) -> None:
    from track_range.fleet.output.state import status_lines
    from track_range.fleet.storage.location import Location
    from track_range.foundation.files.input_files import printable

    print_line(console, *map(printable, status_lines(Location.of(options.out))))


def _fleet_report(options: FleetReportOptions) -> None:
    from track_range.fleet.output.data_set import CLIPS_FILE
    from track_range.fleet.output.state import STATE_FILE, duration_text
    from track_range.fleet.report.fleet_figures import fleet_figures
    from track_range.fleet.report.fleet_grids import fleet_sections
    from track_range.fleet.report.fleet_page import fleet_page
    from track_range.fleet.storage.location import Location
    from track_range.foundation.files.input_files import printable
    from track_range.foundation.files.output_files import check_outputs, write_json, write_text
    from track_range.run.progress import step_progress
    from track_range.views.tables import markdown_table

    out = Location.of(options.out)
    page = None if options.html is None else Location.of(options.html)
    files = [file for file in (options.table, options.json_file) if file is not None]
    files += [page.path] if page is not None and page.is_local else []
    check_outputs(
        files, [out.path / name for name in (CLIPS_FILE, STATE_FILE)] if out.is_local else []
    )
    with step_progress(console, "reading clips") as progress:
        fleet = fleet_figures(out, options.by, progress)
    figures = fleet.figures
    grids = [grid for section in fleet_sections(figures) for grid in section.grids]
    clips, video = figures["clips"], duration_text(3600 * figures["video_h"])
    done = (
        f"{clips['done']} of {clips['total']} clips done, {clips['failed']} failed, {video} of "
        "video"
    )
    print_line(console, printable(figures["state"]), done)
    print_notes(console, figures["problems"])
    console.print()
    print_grid(console, *grids)
    write_json(options.json_file, figures)
    if options.table is not None:
        notes = "\n".join(f"- {note}" for note in figures["problems"])
        write_text(
            options.table,
            "\n\n".join([*map(markdown_table, grids), *([notes] if notes else [])]) + "\n",
        )
    if page is not None:
        page.write_bytes(fleet_page(fleet, out, page).encode("utf-8", "replace"))
        print_line(console, f"Open {page} in a browser.")


app = command(FleetReportOptions, _fleet_report)
status_app = command(FleetStatusOptions, _fleet_status)
