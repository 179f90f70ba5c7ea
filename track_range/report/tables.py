"""The side-by-side tables of a run's summary: plain grids for the terminal and the report, and as Markdown.

A summary is what `summary.json` holds. Figures without `_pct` are fractions 0..1, shown per cent here; MOT metrics are
per cent already; None (or a missing key, or NaN) was not measured and shows as "-". A column that nobody measured
(all errors, when a run has no truth) is left out. The best value of a column is marked: the largest coverage, the
smallest error, the bias nearest 0, and the share within k sigma nearest a normal distribution's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

NOTHING = "-"
SIGMA = "\N{GREEK SMALL LETTER SIGMA}"

WITHIN_1_SIGMA, WITHIN_2_SIGMA = 0.6827, 0.9545
"""Shares of a normal distribution."""

Cost = Callable[[float], float]


@dataclass(frozen=True, slots=True)
class Cell:
    """One figure as text; `best` marks the column's best."""

    text: str
    best: bool = False


@dataclass(frozen=True, slots=True)
class Grid:
    """A table without a medium: rows of cells; the first column names the row, the others are figures."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


@dataclass(frozen=True, slots=True)
class Column:
    """A column's heading, its values, how one is written, and what the best one has least of (None: no best)."""

    heading: str
    values: Sequence[float | None]
    pattern: str = "{:.1f}"
    scale: float = 1.0
    cost: Cost | None = None

    def cells(self) -> list[Cell]:
        """One cell per value; values that read the same as the best are marked with it."""
        texts = [NOTHING if value is None else self.pattern.format(self.scale * value) for value in self.values]
        known = [value for value in self.values if value is not None]
        if self.cost is None or len(known) < 2:
            return [Cell(text) for text in texts]
        best = texts[self.values.index(min(known, key=self.cost))]
        return [Cell(text, text == best) for text in texts]


def figure(found: Mapping[str, Any], key: str) -> float | None:
    """A number of a summary, None where it is missing, null or NaN."""
    value = found.get(key)
    return None if value is None or math.isnan(value) else float(value)


def from_normal(share: float) -> Cost:
    """Cost of a measured share: its distance from the one wanted."""
    return lambda value: abs(value - share)


METHOD_COLUMNS: tuple[tuple[str, str, str, float, Cost | None], ...] = (
    ("cover %", "coverage", "{:.0f}", 100.0, lambda value: -value),
    ("n", "n", "{:.0f}", 1.0, None),
    ("mean %", "mean_relative_error_pct", "{:.1f}", 1.0, abs),
    ("median %", "median_relative_error_pct", "{:.1f}", 1.0, abs),
    ("bias %", "bias_pct", "{:+.1f}", 1.0, abs),
    (f"in 1{SIGMA} %", "within_1_sigma", "{:.0f}", 100.0, from_normal(WITHIN_1_SIGMA)),
    (f"in 2{SIGMA} %", "within_2_sigma", "{:.0f}", 100.0, from_normal(WITHIN_2_SIGMA)),
)
"""Heading, key in the summary, format, factor and cost of each column of a method's row."""


STAGE_OF = {"fused": "fuse"}
"""Stages of methods that are called otherwise; filtered methods are timed with the fusion."""


def grids(summary: Mapping[str, Any]) -> list[Grid]:
    """The tables that a summary has something for: methods, the same on common coverage, speed, tracks."""
    methods, common = summary.get("methods") or {}, summary.get("common") or {}
    n_common = max((figure(found, "n") or 0 for found in common.values()), default=0)
    found = [
        method_grid("Distance error, each method where it measured" if common else "Coverage of each method", methods),
        method_grid(f"Distance error, on the {n_common:.0f} track-frames that all methods measured", common),
        closing_grid(summary.get("closing") or {}),
        claim_grid(summary),
        speed_grid(summary),
        track_grid(summary.get("tracks") or {}),
    ]
    return [grid for grid in found if grid.rows]


def method_grid(title: str, methods: Mapping[str, Mapping[str, Any]]) -> Grid:
    """One row per method: coverage, errors, calibration of sigma, error by band of distance."""
    rows = list(methods.values())
    columns = [
        Column(heading, [figure(row, key) for row in rows], pattern, scale, cost)
        for heading, key, pattern, scale, cost in METHOD_COLUMNS
    ]
    bands = {(band["from_m"], band["to_m"]): None for row in rows for band in row.get("bands") or []}
    for band in sorted(bands):
        columns.append(Column(f"{band[0]:g}-{band[1]:g} m", [band_error_pct(row, band) for row in rows], cost=abs))
    return grid_of(title, "method", list(methods), columns)


def closing_grid(closing: Mapping[str, Any]) -> Grid:
    """One row: how far closing speeds are from the truth, in m/s, where it knows them."""
    columns = [
        Column("cover %", [figure(closing, "coverage")], "{:.0f}", 100.0),
        Column("n", [figure(closing, "n")], "{:.0f}"),
        Column("mean m/s", [figure(closing, "mean_error_mps")], "{:.2f}"),
        Column("median m/s", [figure(closing, "median_error_mps")], "{:.2f}"),
        Column("bias m/s", [figure(closing, "bias_mps")], "{:+.2f}"),
        Column(f"in 1{SIGMA} %", [figure(closing, "within_1_sigma")], "{:.0f}", 100.0),
        Column(f"in 2{SIGMA} %", [figure(closing, "within_2_sigma")], "{:.0f}", 100.0),
        Column(f"{SIGMA} m/s", [figure(closing, "median_sigma_mps")], "{:.2f}"),
    ]
    return grid_of("Error of the closing speed", "of", ["fused_kf"] if closing else [], columns)


def claim_grid(summary: Mapping[str, Any]) -> Grid:
    """One row per method: how sure it says it is (known without any truth, too), and what it costs."""
    methods, stages_ms = summary.get("methods") or {}, summary.get("stages_ms") or {}
    columns = [
        Column(f"{SIGMA} %", [figure(row, "median_sigma_pct") for row in methods.values()]),
        Column("ms/frame", [figure(stages_ms, STAGE_OF.get(name, name)) or None for name in methods], "{:.2f}"),
    ]
    return grid_of("What each method claims (median relative sigma) and costs", "method", list(methods), columns)


def band_error_pct(row: Mapping[str, Any], band: tuple[float, float]) -> float | None:
    """Mean relative error of one method in one band, None where it measured nothing there."""
    found = [each for each in row.get("bands") or [] if (each["from_m"], each["to_m"]) == band]
    return figure(found[0], "mean_relative_error_pct") if found else None


def speed_grid(summary: Mapping[str, Any]) -> Grid:
    """One row per stage that ran, and the whole run by the wall's clock.

    Stages overlap in threads; detection and background work are timed by the wall clock, the others by their processor
    time.
    """
    found = summary.get("stages_ms") or {}
    stages = {name: ms for name in found if (ms := figure(found, name))}
    fps = frames_per_s(summary)
    names = list(stages) + (["whole run"] if fps else [])
    values = [*stages.values(), 1000.0 / fps] if fps else list(stages.values())
    columns = [Column("ms/frame", values, "{:.2f}"), Column("frames/s", [1000.0 / ms for ms in values])]
    return grid_of("Speed, stages overlap", "stage", names, columns)


def frames_per_s(summary: Mapping[str, Any]) -> float | None:
    """Speed of the whole run, from its frames and its wall time where it is not said."""
    said, wall_s = figure(summary, "frames_per_s"), figure(summary, "wall_s")
    return said or (summary.get("frames", 0) / wall_s if wall_s and wall_s > 1e-6 else 0.0) or None


def track_grid(tracks: Mapping[str, Any]) -> Grid:
    """One row: how many tracks, and how well they follow the truth."""
    columns = [
        Column("n", [figure(tracks, "n")], "{:.0f}"),
        Column("MOTA %", [figure(tracks, "mota")]),
        Column("IDF1 %", [figure(tracks, "idf1")]),
        Column("id switches", [figure(tracks, "idsw")], "{:.0f}"),
    ]
    return grid_of("Tracks", "", ["all"] if tracks else [], columns)


def grid_of(title: str, corner: str, names: Sequence[str], columns: Sequence[Column]) -> Grid:
    """A grid of the columns that have at least one value."""
    kept = [column for column in columns if any(value is not None for value in column.values)]
    cells = [[Cell(name) for name in names], *(column.cells() for column in kept)]
    headings = (corner, *(column.heading for column in kept))
    return Grid(title, headings, tuple(zip(*cells, strict=True)) if kept else ())


def markdown(summary: Mapping[str, Any]) -> str:
    """The same tables as Markdown, the best figures bold, with what is the truth and the run's notes."""
    parts = [markdown_table(grid) for grid in grids(summary)]
    if summary.get("truth"):
        parts.append(f"Truth: {summary['truth']}")
    parts += ["\n".join(f"- {note}" for note in summary["notes"])] if summary.get("notes") else []
    return "\n\n".join(parts) + "\n" if parts else ""


def markdown_table(grid: Grid) -> str:
    """A grid as a pipe table under its title."""
    lines = [[escape_markdown(heading) for heading in grid.columns]]
    lines.append([":--"] + ["--:"] * (len(grid.columns) - 1))
    for row in grid.rows:
        texts = [escape_markdown(cell.text) for cell in row]
        lines.append([f"**{text}**" if cell.best else text for text, cell in zip(texts, row, strict=True)])
    return f"**{escape_markdown(grid.title)}**\n\n" + "\n".join("| " + " | ".join(line) + " |" for line in lines)


def escape_markdown(text: str) -> str:
    """Text that a pipe table shows as it is."""
    return text.replace("\\", "\\\\").replace("|", "\\|")
