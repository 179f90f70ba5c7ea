"""`track-range fleet events`: the events of a fleet that meet a condition, and their videos."""

from pathlib import Path
from typing import Annotated

from track_range.cli.commands.fleet.report import FleetStatusOptions
from track_range.cli.shared.console import console, print_grid, print_line, print_notes
from track_range.cli.shared.parameters import command
from track_range.foundation.errors import UsageError
from track_range.foundation.schemas.options import option

_N_SHOWN = 50  # events in the table


class FleetEventsOptions(FleetStatusOptions):
    """Options of `track-range fleet events`."""

    condition: Annotated[
        str,
        option(
            "Condition on columns of the events, such as 'kind == \"cut-in\" and min_ttc_s < 2' "
            "(default: all events).",
            metavar="CONDITION",
            is_argument=True,
        ),
    ] = ""
    clips: Annotated[
        Path | None,
        option(
            "Folder for copies of the videos of these events, as CLIP-NUMBER-KIND-TRACK.mp4; a "
            "fleet writes them with --overlay --clips.",
            metavar="DIR",
        ),
    ] = None
    json_file: Annotated[
        Path | None,
        option("JSON file for the events, with all columns.", flag="--json", metavar="FILE"),
    ] = None


def _fleet_events(options: FleetEventsOptions) -> None:
    from track_range.fleet.report.fleet_events import copied_videos, fleet_events
    from track_range.fleet.report.fleet_grids import event_grid
    from track_range.fleet.storage.location import Location
    from track_range.foundation.files.input_files import counted, quoted, shortened
    from track_range.foundation.files.output_files import write_json
    from track_range.run.progress import step_progress

    folder, condition = options.out, options.condition
    is_folder = Path(folder).exists()
    if condition and Path(condition).is_dir() and not is_folder:  # given in the other order
        folder, condition = condition, folder
    elif not condition and not is_folder and "://" not in folder and set("<>=!") & set(folder):
        raise UsageError(
            f"{quoted(shortened(folder, 80))}: expected the folder of the results before the "
            "condition: track-range fleet events OUT CONDITION."
        )
    out = Location.of(folder)
    with step_progress(console, "reading events") as progress:
        listed = fleet_events(out, condition, progress)
    rows = list(listed.rows)
    if options.clips is not None:
        videos = copied_videos(out, rows, options.clips)
        rows = [{**row, "video": video} for row, video in zip(rows, videos, strict=True)]
    if rows:
        print_grid(console, event_grid("", rows[:_N_SHOWN]))
    more = f", the first {_N_SHOWN} above" if len(rows) > _N_SHOWN else ""
    print_line(console, f"{len(rows)} of {counted(listed.n_all, 'event')}{more}")
    print_notes(console, listed.problems)
    if options.clips is not None:
        n_copied = sum(row["video"] is not None for row in rows)
        print_line(console, f"{counted(n_copied, 'video')} copied to {options.clips}")
        if n_copied < len(rows):
            note = "without a video: `fleet run ... --overlay --clips` writes them"
            print_notes(console, [f"{counted(len(rows) - n_copied, 'event')} {note}."])
    write_json(
        options.json_file,
        {"condition": condition, "events": rows, "problems": list(listed.problems)},
    )


app = command(FleetEventsOptions, _fleet_events)
