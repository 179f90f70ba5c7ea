"""The report's tables beyond those of the terminal: metrics of tracking in full, and errors by kind of road user."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from track_range.report import tables
from track_range.report.tables import Column, Grid, figure, grid_of

MOT_COLUMNS: tuple[tuple[str, str, str], ...] = (
    ("HOTA %", "hota", "{:.1f}"),
    ("DetA %", "deta", "{:.1f}"),
    ("AssA %", "assa", "{:.1f}"),
    ("LocA %", "loca", "{:.1f}"),
    ("MOTA %", "mota", "{:.1f}"),
    ("MOTP %", "motp", "{:.1f}"),
    ("IDF1 %", "idf1", "{:.1f}"),
    ("ID precision %", "idp", "{:.1f}"),
    ("ID recall %", "idr", "{:.1f}"),
    ("id switches", "idsw", "{:.0f}"),
    ("fragments", "frag", "{:.0f}"),
    ("false boxes", "fp", "{:.0f}"),
    ("missed boxes", "fn", "{:.0f}"),
    ("true boxes", "n_truth_boxes", "{:.0f}"),
    ("mostly tracked", "mt", "{:.0f}"),
    ("partly", "pt", "{:.0f}"),
    ("mostly lost", "ml", "{:.0f}"),
)
"""Heading, key in the summary's `tracks`, and format; MOT metrics are per cent already."""


def accuracy_grids(summary: Mapping[str, Any]) -> list[Grid]:
    """Distance errors: each method where it measured, on common coverage, and by kind of road user."""
    methods, common = summary.get("methods") or {}, summary.get("common") or {}
    n_common = max((figure(found, "n") or 0 for found in common.values()), default=0)
    measured = "Distance error, each method where it measured" if _has_errors(methods) else "Coverage of each method"
    found = [
        tables.method_grid(measured, methods),
        tables.method_grid(f"Distance error, on the {n_common:.0f} track-frames that all methods measured", common),
        class_grid(methods),
        tables.closing_grid(summary.get("closing") or {}),
    ]
    return [grid for grid in found if grid.rows]


def _has_errors(methods: Mapping[str, Mapping[str, Any]]) -> bool:
    return any(figure(row, "median_relative_error_pct") is not None for row in methods.values())


def class_grid(methods: Mapping[str, Mapping[str, Any]]) -> Grid:
    """Median error of each method by the label's own word for the road user."""
    kinds = sorted({kind for row in methods.values() for kind in row.get("by_class") or {}})
    columns = [
        Column(
            f"{kind} %",
            [
                figure((row.get("by_class") or {}).get(kind) or {}, "median_relative_error_pct")
                for row in methods.values()
            ],
            cost=abs,
        )
        for kind in kinds
    ]
    grid = grid_of("Median distance error by kind of road user", "method", list(methods), columns)
    return grid if len(grid.columns) > 1 else Grid(grid.title, (), ())


def mot_grid(tracks: Mapping[str, Any]) -> Grid:
    """One row per metric of tracking that was measured."""
    known = [
        (name, pattern.format(value))
        for name, key, pattern in MOT_COLUMNS
        if (value := figure(tracks, key)) is not None
    ]
    rows = tuple((tables.Cell(name), tables.Cell(text)) for name, text in known)
    return Grid("Metrics of tracking", ("metric", "value"), rows)


def speed_grids(summary: Mapping[str, Any]) -> list[Grid]:
    """What stages take, and what each method costs beside how sure it says it is."""
    return [grid for grid in (tables.speed_grid(summary), tables.claim_grid(summary)) if len(grid.columns) > 1]


def stage_bars(summary: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Milliseconds per frame of each stage that ran, and its share of the longest."""
    found = summary.get("stages_ms") or {}
    ran = {name: ms for name in found if (ms := figure(found, name))}
    longest = max(ran.values(), default=1.0)
    return [{"name": name, "text": f"{ms:.1f}", "share_pct": round(100 * ms / longest, 1)} for name, ms in ran.items()]
