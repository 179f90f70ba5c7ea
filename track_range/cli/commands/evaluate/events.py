"""`track-range evaluate events`: warnings against contacts or what happens, or events against
labelled events.
"""

from collections.abc import Iterator, Mapping, Sequence
from statistics import median
from typing import Any

from track_range.cli.commands.evaluate.result_files import JsonField, check_result_files
from track_range.cli.shared.console import console, print_grid, print_line, print_notes
from track_range.cli.shared.parameters import command
from track_range.evaluation.events.evaluate import evaluate_events
from track_range.evaluation.events.settings import EventEvaluationSettings
from track_range.foundation.files.output_files import write_json
from track_range.results.events.event import WARNING_KINDS
from track_range.views.tables import (
    NOTHING,
    Cell,
    Column,
    ColumnSpec,
    Grid,
    columns_of,
    grid_of,
)

_CLOSING_COLUMNS: tuple[ColumnSpec, ...] = (
    ("n", "n", "{:.0f}"),
    ("median m/s", "median_error_mps", "{:.2f}", 1.0, abs),
    ("mean m/s", "mean_error_mps", "{:.2f}", 1.0, abs),
    ("bias m/s", "bias_mps", "{:+.2f}", 1.0, abs),
)


# columns of the rows of contacts, and of what happens
_CONTACT = ("object_id", "class", "contact_s")
_OCCURRENCE = ("class", "first_visible_s", "conflict_s", "nearest_s", "warning", "outcome")


class EventsOptions(EventEvaluationSettings):
    """Options of `track-range evaluate events`."""

    json_file: JsonField = None


def _events(options: EventsOptions) -> None:
    check_result_files(options)
    figures = evaluate_events(options)
    print_notes(console, figures["notes"])
    print_grid(console, _score_grid(figures))
    for drive in figures.get("drives", [figures]):
        grids = [grid for grid in _drive_grids(drive) if grid.rows]
        if drive is not figures and grids:
            print_line(console, drive["events"])
        print_grid(console, *grids)
    write_json(options.json_file, figures)


def _score_grid(figures: Mapping[str, Any]) -> Grid:
    counts = ("hits", "misses", "false_alarms")
    by_kind = {
        kind: row for kind, row in figures["by_kind"].items() if any(row[name] for name in counts)
    }
    sections = {"all": figures["overall"], **by_kind}
    rows = list(sections.values())
    leads_s = [row["lead_s"] for row in rows]
    limits = [row["false_alarms_per_hour_95"] or (None, None) for row in rows]
    columns = [
        *(Column(name.replace("_", " "), [row[name] for row in rows], "{:.0f}") for name in counts),
        Column("per hour", [row["false_alarms_per_hour"] for row in rows], "{:.2f}"),
        Column("95 % from", [low for low, _ in limits], "{:.2f}"),
        Column("to", [high for _, high in limits], "{:.2f}"),
        Column("median lead s", [median(leads) if leads else None for leads in leads_s], "{:.2f}"),
        Column("shortest s", [min(leads, default=None) for leads in leads_s], "{:.2f}"),
    ]
    hours = figures["overall"]["hours"]
    duration = (
        "" if hours is None else f", {hours:.2f} h" if hours >= 1 else f", {3600 * hours:.0f} s"
    )
    title = "Warnings" if list(figures["by_kind"]) == list(WARNING_KINDS) else "Events"
    return grid_of(f"{title}{duration}", "", list(sections), columns)


def _drive_grids(figures: Mapping[str, Any]) -> Iterator[Grid]:
    contacts = [
        (*map(row.get, _CONTACT), "hit" if row["is_hit"] else "miss", row["lead_s"])
        for row in figures.get("contacts", [])
    ]
    yield _grid("Contacts", ("object", "class", "at time s", "", "lead s"), contacts)
    happens = [
        (number, *map(row.get, _OCCURRENCE), next(iter(row["warnings_s"]), None), row["lead_s"])
        for number, row in enumerate(figures.get("occurrences", []), 1)
    ]
    happens += [  # these have a class and an outcome alone
        (None, *map(row.get, _OCCURRENCE), row["warning_s"], None)
        for row in figures.get("warnings", [])
        if row["row"] is None
    ]
    moments = ("seen s", "conflict s", "nearest s")
    columns = ("row", "class", *moments, "warning is", "outcome", "warned s", "lead s")
    yield _grid("What happens, and warnings on nothing of it", columns, happens)
    sections = figures.get("closing", {})
    closing = columns_of(sections.values(), _CLOSING_COLUMNS)
    yield grid_of("Error of the closing speed at 10-40 m", "class", list(sections), closing)


def _grid(title: str, columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> Grid:
    return Grid(title, tuple(columns), tuple(tuple(map(_cell, row)) for row in rows))


def _cell(value: Any) -> Cell:
    """A value; seconds have two decimals, and None or "" is shown as missing."""
    if value is None or value == "":
        return Cell(NOTHING)
    return Cell(f"{value:.2f}" if isinstance(value, float) else str(value))


app = command(EventsOptions, _events)
