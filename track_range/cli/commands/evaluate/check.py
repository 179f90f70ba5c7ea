"""`track-range check`: limits of the figures of finished runs, for continuous integration."""

import typer

from track_range.cli.commands.evaluate.result_files import JsonField, check_result_files
from track_range.cli.shared.console import console, print_line
from track_range.cli.shared.parameters import command
from track_range.evaluation.limits import CheckSettings, check
from track_range.foundation.files.output_files import write_json


class CheckOptions(CheckSettings):
    """Options of `track-range check`."""

    json_file: JsonField = None


def _check(options: CheckOptions) -> None:
    check_result_files(options)
    figures = check(options)
    for row in figures["limits"]:
        state = "holds " if row["holds"] else "BROKEN"
        run = f"{row['run']}: " if len({one["run"] for one in figures["limits"]}) > 1 else ""
        print_line(console, f"{state} {run}{row['limit']}: {row['sentence']}")
    n_broken = sum(not row["holds"] for row in figures["limits"])
    print_line(console, f"{n_broken} of {len(figures['limits'])} limits broken.")
    write_json(options.json_file, figures)
    raise typer.Exit(0 if figures["holds"] else 1)


app = command(CheckOptions, _check)
