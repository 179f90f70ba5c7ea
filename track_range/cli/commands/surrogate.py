"""`track-range surrogate`: surrogate measures of safety of a run or a fleet, by class and road
user.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from track_range.cli.shared.console import console, print_grid, print_line
from track_range.cli.shared.parameters import command
from track_range.foundation.schemas.options import Options, option
from track_range.results.surrogate import by_class, surrogate_rows, write_rows
from track_range.views.tables import ColumnSpec, Grid, columns_of, grid_of

_N_SHOWN = 20  # road users in the table

_MEASURES: tuple[ColumnSpec, ...] = (
    ("gap m", "min_gap_m"),
    ("headway s", "min_headway_s"),
    ("TTC s", "min_ttc_front_s"),
    ("TET s", "tet_s"),
    ("TIT s\N{SUPERSCRIPT TWO}", "tit_s2"),
    ("DRAC m/s\N{SUPERSCRIPT TWO}", "max_drac_mps2"),
    ("MDRAC m/s\N{SUPERSCRIPT TWO}", "max_mdrac_mps2"),
    ("PET s", "pet_s"),
    ("lead s", "lead_s"),
)


class SurrogateOptions(Options):
    """Options of `track-range surrogate`."""

    source: Annotated[
        Path,
        option(
            "Result folder of a run, or local folder of a fleet.",
            metavar="RUN|FLEET",
            is_argument=True,
        ),
    ]
    csv: Annotated[
        Path | None, option("CSV file to write, one row per road user.", metavar="FILE")
    ] = None
    parquet: Annotated[
        Path | None, option("Parquet file with the same rows, in full precision.", metavar="FILE")
    ] = None


def _grid(
    title: str,
    corner: str,
    names: Sequence[str],
    rows: Sequence[Mapping[str, Any]],
    *more: ColumnSpec,
) -> Grid:
    return grid_of(title, corner, names, columns_of(rows, (*more, *_MEASURES)))


def _surrogate(options: SurrogateOptions) -> None:
    rows = surrogate_rows(options.source)
    classes = by_class(rows)
    counts = ("road users", "n", "{:.0f}"), ("with TET", "n_exposed", "{:.0f}")
    print_grid(
        console,
        _grid(
            "Extremes and sums by class",
            "class",
            [row["class"] for row in classes],
            classes,
            *counts,
        ),
    )
    exposed = sorted(
        (row for row in rows if row["min_ttc_front_s"] is not None),
        key=lambda row: row["min_ttc_front_s"],
    )
    shown = exposed[:_N_SHOWN]
    names = [
        " ".join(filter(None, (row["clip"], row["class"], str(row["track_id"])))) for row in shown
    ]
    title = f"Road users with a TTC, shortest first ({len(shown)} of {len(exposed)})"
    print_grid(
        console, _grid(title, "road user", names, shown, ("at time s", "min_ttc_front_s_at_s"))
    )
    print_line(
        console,
        "All distances are from the front of the ego vehicle. The gap covers all road users, all "
        "other measures only road users on the path. TTC: time to collision. TET: time with a TTC "
        "below 3 s. TIT: integral of 3 s - TTC over that time. DRAC: smallest deceleration that "
        "avoids a collision; MDRAC: the same after 1 s of reaction. PET: time between the passages "
        "of the place where two paths cross. lead: time as the next vehicle ahead.",
    )
    for path, is_parquet in ((options.csv, False), (options.parquet, True)):
        if path is not None:
            write_rows(path, rows, is_parquet=is_parquet)
            print_line(console, f"Written: {path}, {len(rows)} road users")


app = command(SurrogateOptions, _surrogate)
