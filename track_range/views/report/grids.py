"""Tables shown only in the report: all tracking metrics, and errors by class."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from track_range.views.report import tables
from track_range.views.report.tables import Column, Grid, figure, grid_of

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
    ("ID switches", "idsw", "{:.0f}"),
    ("fragments", "frag", "{:.0f}"),
    ("false positives", "fp", "{:.0f}"),
    ("false negatives", "fn", "{:.0f}"),
    ("true boxes", "n_truth_boxes", "{:.0f}"),
    ("mostly tracked", "mt", "{:.0f}"),
    ("partly tracked", "pt", "{:.0f}"),
    ("mostly lost", "ml", "{:.0f}"),
)
"""Heading, key in the section `tracks` of the summary, and format; MOT metrics are in per cent already."""


def accuracy_grids(summary: Mapping[str, Any]) -> list[Grid]:
    """Distance errors of each method on its own coverage, on common coverage and by class; closing-speed errors."""
    methods, common = summary.get("methods") or {}, summary.get("common") or {}
    n_common = max((figure(row, "n") or 0 for row in common.values()), default=0)
    title = "Distance error of each method on its own coverage" if _has_errors(methods) else "Coverage of each method"
    grids = [
        tables.method_grid(title, methods),
        tables.method_grid(
            f"Distance error on common coverage ({n_common:.0f} track-frames measured by all methods)", common
        ),
        class_grid(methods),
        tables.closing_grid(summary.get("closing") or {}),
    ]
    return [grid for grid in grids if grid.rows]


def _has_errors(methods: Mapping[str, Mapping[str, Any]]) -> bool:
    return any(figure(row, "median_relative_error_pct") is not None for row in methods.values())


def class_grid(methods: Mapping[str, Mapping[str, Any]]) -> Grid:
    """Median error of each method by the class in the ground truth."""
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
    grid = grid_of("Median distance error by class", "method", list(methods), columns)
    return grid if len(grid.columns) > 1 else Grid(grid.title, (), ())


def mot_grid(tracks: Mapping[str, Any]) -> Grid:
    """One row per tracking metric that was measured."""
    known = [
        (name, pattern.format(value))
        for name, key, pattern in MOT_COLUMNS
        if (value := figure(tracks, key)) is not None
    ]
    rows = tuple((tables.Cell(name), tables.Cell(text)) for name, text in known)
    return Grid("Tracking metrics", ("metric", "value"), rows)


def speed_grids(summary: Mapping[str, Any]) -> list[Grid]:
    """Run time of the stages, and reported uncertainty and run time of the methods."""
    return [grid for grid in (tables.speed_grid(summary), tables.uncertainty_grid(summary)) if len(grid.columns) > 1]


def stage_bars(summary: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Run time of each stage in ms per frame, and in per cent of the longest stage."""
    stages_ms = summary.get("stages_ms") or {}
    ran = {name: ms for name in stages_ms if (ms := figure(stages_ms, name))}
    longest = max(ran.values(), default=1.0)
    return [
        {"name": name, "text": f"{ms:.1f}", "fraction_pct": round(100 * ms / longest, 1)} for name, ms in ran.items()
    ]
