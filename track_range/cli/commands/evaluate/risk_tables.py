"""Columns of metrics, and tables and chart of risk-coverage curves, for `evaluate stereo` and `evaluate ranges`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from track_range.views.report import tables

ColumnSpec = tuple[str, str, str, float, tables.Cost | None]
"""Heading, key in a row of metrics, format, scale and cost of a column, as in `tables.METHOD_COLUMNS`."""

ANSWERED_PCT = (100, 95, 90, 80, 50)
"""Answered fractions of the boxes in the risk-coverage tables, per cent."""

_Curves = Mapping[str, Mapping[str, Any]]


def metric_columns(rows: _Curves, specs: Sequence[ColumnSpec]) -> list[tables.Column]:
    """Columns of rows of metrics by name."""
    return [
        tables.Column(heading, [tables.figure(row, key) for row in rows.values()], pattern, scale, cost)
        for heading, key, pattern, scale, cost in specs
    ]


def draw_risk(curves: _Curves, path: Path) -> None:
    """Draw curves by name."""
    from track_range.views.report.figures import risk_coverage_chart  # imports matplotlib: a third of a second

    risk_coverage_chart({name: curve["curve"] for name, curve in curves.items()}, path)


def risk_grids(curves: _Curves) -> list[tables.Grid]:
    """Failures, mean and 95th percentile of the error among the most certain boxes, by the share that is answered."""
    grids = []
    for title, key, area in (
        ("Failures (%) when only the most certain boxes are answered", "failures_pct", "area_failures_pct"),
        ("Mean error (%) of the answered boxes", "mean_relative_error_pct", "area_error_pct"),
        ("95th percentile of the error (%) of the answered boxes", "p95_relative_error_pct", None),
    ):
        columns = []
        for fraction_pct in ANSWERED_PCT:
            values = [_at(curve, fraction_pct, key) for curve in curves.values()]
            columns.append(tables.Column(f"{fraction_pct} %", values, "{:.2f}", cost=abs))
        if area is not None:
            columns.append(
                tables.Column("area", [tables.figure(row, area) for row in curves.values()], "{:.2f}", cost=abs)
            )
        grids.append(tables.grid_of(title, "answered", list(curves), columns))
    return grids


def _at(curve: Mapping[str, Any], answered_pct: int, key: str) -> float | None:
    row = next(row for row in curve["curve"] if row["answered_pct"] == answered_pct)
    return tables.figure(row, key)
