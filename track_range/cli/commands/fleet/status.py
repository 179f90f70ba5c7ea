"""`track-range fleet status`: progress of a fleet, from its output."""

from __future__ import annotations

from typing import Annotated

import typer

from track_range.cli.lazy import single_app


def _status(
    out: Annotated[str, typer.Argument(metavar="OUT", help="Folder of the results, as given to fleet run --out.")],
) -> None:
    from track_range.cli.console import console, print_line
    from track_range.fleet.output.state import status_lines
    from track_range.fleet.storage.location import Location
    from track_range.foundation.files.input_files import printable

    for line in status_lines(Location.of(out)):
        print_line(console, printable(line))


app = single_app(_status)
