"""`track-range evaluate events`: warnings against contacts, or events against labelled events."""

from collections.abc import Mapping
from statistics import median
from typing import Any

from track_range.cli.commands.evaluate.result_files import JsonField, check_result_files
from track_range.cli.shared.console import console, print_grid, print_notes
from track_range.cli.shared.parameters import command
from track_range.evaluation.events.evaluate import evaluate_events
from track_range.evaluation.events.settings import EventEvaluationSettings
from track_range.foundation.files.output_files import write_json
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


class EventsOptions(EventEvaluationSettings):
    """Options of `track-range evaluate events`."""

    json_file: JsonField = None


def _events(options: EventsOptions) -> None:
    check_result_files(options)
    figures = evaluate_events(options)
    print_notes(console, figures["notes"])
    grids = (_score_grid(figures), _contact_grid(figures), _closing_grid(figures))
    print_grid(console, *(grid for grid in grids if grid.rows))
    write_json(options.json_file, figures)


def _score_grid(figures: Mapping[str, Any]) -> Grid:
    counts = ("hits", "misses", "false_alarms")
    by_kind = {
        kind: row for kind, row in figures["by_kind"].items() if any(row[name] for name in counts)
    }
    sections = {"all": figures["overall"], **by_kind}
    rows = list(sections.values())
    leads_s = [row["lead_s"] for row in rows]
    columns = [
        *(Column(name.replace("_", " "), [row[name] for row in rows], "{:.0f}") for name in counts),
        Column("per hour", [row["false_alarms_per_hour"] for row in rows], "{:.2f}"),
        Column("median lead s", [median(leads) if leads else None for leads in leads_s], "{:.2f}"),
        Column("shortest s", [min(leads, default=None) for leads in leads_s], "{:.2f}"),
    ]
    hours = figures["overall"]["hours"]
    duration = (
        "" if hours is None else f", {hours:.2f} h" if hours >= 1 else f", {3600 * hours:.0f} s"
    )
    return grid_of(
        f"Warnings{duration}" if "contacts" in figures else f"Events{duration}",
        "",
        list(sections),
        columns,
    )


def _contact_grid(figures: Mapping[str, Any]) -> Grid:
    lines = []
    for row in figures.get("contacts", []):
        lead = NOTHING if row["lead_s"] is None else f"{row['lead_s']:.2f}"
        outcome = "hit" if row["is_hit"] else "miss"
        texts = (str(row["object_id"]), row["class"], f"{row['contact_s']:.2f}", outcome, lead)
        lines.append(tuple(map(Cell, texts)))
    return Grid("Contacts", ("object", "class", "at s", "", "lead s"), tuple(lines))


def _closing_grid(figures: Mapping[str, Any]) -> Grid:
    sections = figures.get("closing", {})
    columns = columns_of(sections.values(), _CLOSING_COLUMNS)
    return grid_of("Error of the closing speed at 10-40 m", "class", list(sections), columns)


app = command(EventsOptions, _events)
