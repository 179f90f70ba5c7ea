"""`track-range evaluate events`: warnings against contacts, or events against labelled events."""

from __future__ import annotations

from collections.abc import Mapping
from statistics import median
from typing import Any

from track_range.cli.commands.evaluate.result_files import JsonField, check_result_files, write_json
from track_range.cli.console import console, print_grid, print_notes
from track_range.cli.parameters import command
from track_range.evaluation.events.evaluate import evaluate_events
from track_range.evaluation.events.settings import EventEvaluationSettings
from track_range.views.report.tables import Cell, Column, Grid, figure, grid_of


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
    sections = {"all": figures["overall"], **{k: row for k, row in figures["by_kind"].items() if _has_counts(row)}}
    rows = list(sections.values())
    leads_s = [row["lead_s"] for row in rows]
    columns = [
        Column("hits", [row["hits"] for row in rows], "{:.0f}"),
        Column("misses", [row["misses"] for row in rows], "{:.0f}"),
        Column("false alarms", [row["false_alarms"] for row in rows], "{:.0f}"),
        Column("per hour", [row["false_alarms_per_hour"] for row in rows], "{:.2f}"),
        Column("median lead s", [median(leads) if leads else None for leads in leads_s], "{:.2f}"),
        Column("shortest s", [min(leads, default=None) for leads in leads_s], "{:.2f}"),
    ]
    hours = figures["overall"]["hours"]
    duration = "" if hours is None else f", {hours:.2f} h" if hours >= 1 else f", {3600 * hours:.0f} s"
    return grid_of(f"Warnings{duration}" if "contacts" in figures else f"Events{duration}", "", list(sections), columns)


def _has_counts(row: Mapping[str, Any]) -> bool:
    return bool(row["hits"] or row["misses"] or row["false_alarms"])


def _contact_grid(figures: Mapping[str, Any]) -> Grid:
    rows = figures.get("contacts", [])
    cells = tuple(
        (
            Cell(str(row["object_id"])),
            Cell(row["class"]),
            Cell(f"{row['contact_s']:.2f}"),
            Cell("hit" if row["is_hit"] else "miss"),
            Cell("-" if row["lead_s"] is None else f"{row['lead_s']:.2f}"),
        )
        for row in rows
    )
    return Grid("Contacts", ("object", "class", "at s", "", "lead s"), cells)


def _closing_grid(figures: Mapping[str, Any]) -> Grid:
    sections = figures.get("closing", {})
    rows = list(sections.values())
    columns = [
        Column("n", [row["n"] for row in rows], "{:.0f}"),
        Column("median m/s", [figure(row, "median_error_mps") for row in rows], "{:.2f}", cost=abs),
        Column("mean m/s", [figure(row, "mean_error_mps") for row in rows], "{:.2f}", cost=abs),
        Column("bias m/s", [figure(row, "bias_mps") for row in rows], "{:+.2f}", cost=abs),
    ]
    return grid_of("Error of the closing speed at 10-40 m", "class", list(sections), columns)


app = command(EventsOptions, _events)
