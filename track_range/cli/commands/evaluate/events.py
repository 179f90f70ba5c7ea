"""`track-range evaluate events`: warnings against contacts, or events against labelled events."""

from __future__ import annotations

from collections.abc import Mapping
from statistics import median
from typing import Any

from track_range.cli.commands.evaluate.result_files import (
    ColumnSpec,
    JsonField,
    check_result_files,
    metric_columns,
    write_json,
)
from track_range.cli.console import console, print_grid, print_notes
from track_range.cli.parameters import command
from track_range.evaluation.events.evaluate import evaluate_events
from track_range.evaluation.events.settings import EventEvaluationSettings
from track_range.views.report.tables import Cell, Column, Grid, grid_of

_CLOSING_COLUMNS: tuple[ColumnSpec, ...] = (
    ("n", "n", "{:.0f}", 1.0, None),
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
    for grid in (_score_grid(figures), _contact_grid(figures), _closing_grid(figures)):
        if grid.rows:
            print_grid(console, grid)
    write_json(figures, options.json_file)


def _score_grid(figures: Mapping[str, Any]) -> Grid:
    counts = ("hits", "misses", "false_alarms")
    by_kind = {kind: row for kind, row in figures["by_kind"].items() if any(row[name] for name in counts)}
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
    duration = "" if hours is None else f", {hours:.2f} h" if hours >= 1 else f", {3600 * hours:.0f} s"
    return grid_of(f"Warnings{duration}" if "contacts" in figures else f"Events{duration}", "", list(sections), columns)


def _contact_grid(figures: Mapping[str, Any]) -> Grid:
    rows = figures.get("contacts", [])
    lines = []
    for row in rows:
        lead = "-" if row["lead_s"] is None else f"{row['lead_s']:.2f}"
        texts = (
            str(row["object_id"]),
            row["class"],
            f"{row['contact_s']:.2f}",
            "hit" if row["is_hit"] else "miss",
            lead,
        )
        lines.append(tuple(map(Cell, texts)))
    return Grid("Contacts", ("object", "class", "at s", "", "lead s"), tuple(lines))


def _closing_grid(figures: Mapping[str, Any]) -> Grid:
    sections = figures.get("closing", {})
    columns = metric_columns(sections, _CLOSING_COLUMNS)
    return grid_of("Error of the closing speed at 10-40 m", "class", list(sections), columns)


app = command(EventsOptions, _events)
