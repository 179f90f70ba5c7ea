"""Tables of a run's summary, for the terminal and the report, and as Markdown.

A summary is the content of `summary.json`. Values without `_pct` are fractions 0..1 and are shown in per cent; MOT
metrics are in per cent already. None, NaN or a missing key means not measured, shown as "-". A column without any value
(such as errors of a run without ground truth) is omitted. The best value of a column is marked: the largest coverage,
the smallest error, the bias nearest 0, and the fraction within k sigma nearest to that of a normal distribution.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

NOTHING = "-"
"""Text of a value that was not measured."""

SIGMA = "\N{GREEK SMALL LETTER SIGMA}"

WITHIN_1_SIGMA, WITHIN_2_SIGMA = 0.6827, 0.9545
"""Fractions of a normal distribution within one and two standard deviations of the mean."""

WITHIN_1_HEADING, WITHIN_2_HEADING = (f"\N{LESS-THAN OR EQUAL TO}{k}{SIGMA} %" for k in (1, 2))
"""Headings of the percentage of errors within one and two sigma."""

Cost = Callable[[float], float]
"""Function of a value that is smallest for the best value of a column."""


@dataclass(frozen=True, slots=True)
class Cell:
    """One value as text; `best` marks the best value of its column, `link` is the address it leads to ("" = none)."""

    text: str
    best: bool = False
    link: str = ""


@dataclass(frozen=True, slots=True)
class Grid:
    """A table, independent of its rendering: rows of cells, the first of which names the row.

    Attributes:
        title: heading of the table.
        columns: headings of the columns.
        rows: cells of the rows.
        has_sentences: whether cells are sentences, which are wrapped.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    has_sentences: bool = False


@dataclass(frozen=True, slots=True)
class Column:
    """A column of values.

    Attributes:
        heading: text above the column.
        values: one per row; None = not measured.
        pattern: format of a value after scaling.
        scale: factor from the stored to the shown value.
        cost: function that is smallest for the best value; None = no value is marked.
    """

    heading: str
    values: Sequence[float | None]
    pattern: str = "{:.1f}"
    scale: float = 1.0
    cost: Cost | None = None

    def cells(self) -> list[Cell]:
        """One cell per value; all values whose text equals that of the best are marked."""
        texts = [NOTHING if value is None else self.pattern.format(self.scale * value) for value in self.values]
        known = [value for value in self.values if value is not None]
        if self.cost is None or len(known) < 2:
            return [Cell(text) for text in texts]
        best = texts[self.values.index(min(known, key=self.cost))]
        return [Cell(text, text == best) for text in texts]


def figure(section: Mapping[str, Any], key: str) -> float | None:
    """A number of a section of a summary; None where it is missing, null or NaN."""
    value = section.get(key)
    return None if value is None or math.isnan(value) else float(value)


def from_normal(expected: float) -> Cost:
    """Cost of an observed fraction: its distance from the expected one."""
    return lambda value: abs(value - expected)


METHOD_COLUMNS: tuple[tuple[str, str, str, float, Cost | None], ...] = (
    ("coverage %", "coverage", "{:.0f}", 100.0, lambda value: -value),
    ("n", "n", "{:.0f}", 1.0, None),
    ("mean %", "mean_relative_error_pct", "{:.1f}", 1.0, abs),
    ("median %", "median_relative_error_pct", "{:.1f}", 1.0, abs),
    ("bias %", "bias_pct", "{:+.1f}", 1.0, abs),
    (WITHIN_1_HEADING, "within_1_sigma", "{:.0f}", 100.0, from_normal(WITHIN_1_SIGMA)),
    (WITHIN_2_HEADING, "within_2_sigma", "{:.0f}", 100.0, from_normal(WITHIN_2_SIGMA)),
)
"""Heading, key in a method's row of the summary, format, scale and cost of each column."""


STAGE_OF = {"fused": "fuse"}
"""Stage that measures a method's run time, if their names differ; filtered methods are part of the fusion stage."""


def grids(summary: Mapping[str, Any]) -> list[Grid]:
    """Non-empty tables of a summary: methods, common coverage, closing speed, rig, sigma, run time, tracks."""
    methods, common = summary.get("methods") or {}, summary.get("common") or {}
    n_common = max((figure(row, "n") or 0 for row in common.values()), default=0)
    tables = [
        method_grid(
            "Distance error of each method on its own coverage" if common else "Coverage of each method", methods
        ),
        method_grid(f"Distance error on common coverage ({n_common:.0f} track-frames measured by all methods)", common),
        closing_grid(summary.get("closing") or {}),
        rig_grid((summary.get("alignment") or {}).get("health") or {}),
        uncertainty_grid(summary),
        speed_grid(summary),
        track_grid(summary.get("tracks") or {}),
    ]
    return [grid for grid in tables if grid.rows]


def rig_grid(health: Mapping[str, Any]) -> Grid:
    """Expected distance errors of a rig, by distance, before and after its alignment, from `RigHealth.to_dict()`."""
    rows = health.get("distances") or []
    columns = [
        Column("calibrated middle %", [figure(row, "before_pct") for row in rows], "{:+.1f}"),
        Column(f"{SIGMA} %", [figure(row, "before_sigma_pct") for row in rows], "{:.1f}"),
        Column("calibrated left %", [figure(row, "before_left_pct") for row in rows], "{:+.1f}"),
        Column("calibrated right %", [figure(row, "before_right_pct") for row in rows], "{:+.1f}"),
        Column(f"corrected {SIGMA} %", [figure(row, "after_sigma_pct") for row in rows], "{:.1f}"),
    ]
    names = [f"{figure(row, 'distance_m') or 0:.0f} m" for row in rows]
    return grid_of("Expected distance error of the rig", "distance", names, columns)


def method_grid(title: str, methods: Mapping[str, Mapping[str, Any]]) -> Grid:
    """One row per method: coverage, errors, calibration of sigma, mean error by distance band."""
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
    """One row: errors of the closing speeds against ground truth that contains them, in m/s."""
    columns = [
        Column("coverage %", [figure(closing, "coverage")], "{:.0f}", 100.0),
        Column("n", [figure(closing, "n")], "{:.0f}"),
        Column("mean m/s", [figure(closing, "mean_error_mps")], "{:.2f}"),
        Column("median m/s", [figure(closing, "median_error_mps")], "{:.2f}"),
        Column("bias m/s", [figure(closing, "bias_mps")], "{:+.2f}"),
        Column(WITHIN_1_HEADING, [figure(closing, "within_1_sigma")], "{:.0f}", 100.0),
        Column(WITHIN_2_HEADING, [figure(closing, "within_2_sigma")], "{:.0f}", 100.0),
        Column(f"{SIGMA} m/s", [figure(closing, "median_sigma_mps")], "{:.2f}"),
    ]
    return grid_of("Error of the closing speed", "method", ["fused_kf"] if closing else [], columns)


def uncertainty_grid(summary: Mapping[str, Any]) -> Grid:
    """One row per method: median relative sigma (known without ground truth) and run time."""
    methods, stages_ms = summary.get("methods") or {}, summary.get("stages_ms") or {}
    columns = [
        Column(f"{SIGMA} %", [figure(row, "median_sigma_pct") for row in methods.values()]),
        Column("ms/frame", [figure(stages_ms, STAGE_OF.get(name, name)) or None for name in methods], "{:.2f}"),
    ]
    return grid_of("Reported uncertainty (median relative sigma) and run time", "method", list(methods), columns)


def band_error_pct(row: Mapping[str, Any], band: tuple[float, float]) -> float | None:
    """Mean relative error of a method in one distance band, in per cent; None where it measured nothing."""
    sections = [section for section in row.get("bands") or [] if (section["from_m"], section["to_m"]) == band]
    return figure(sections[0], "mean_relative_error_pct") if sections else None


def speed_grid(summary: Mapping[str, Any]) -> Grid:
    """One row per stage that ran, and one for the whole run (wall clock).

    Stages overlap in threads; detection and background work are measured in wall-clock time, the others in processor
    time.
    """
    stages_ms = summary.get("stages_ms") or {}
    stages = {name: ms for name in stages_ms if (ms := figure(stages_ms, name))}
    fps = frames_per_s(summary)
    names = list(stages) + (["whole run"] if fps else [])
    values = [*stages.values(), 1000.0 / fps] if fps else list(stages.values())
    columns = [Column("ms/frame", values, "{:.2f}"), Column("frames/s", [1000.0 / ms for ms in values])]
    return grid_of("Run time by stage (stages overlap)", "stage", names, columns)


def frames_per_s(summary: Mapping[str, Any]) -> float | None:
    """Frame rate of the whole run; computed from frames and wall time where the summary lacks it."""
    stored, wall_s = figure(summary, "frames_per_s"), figure(summary, "wall_s")
    return stored or (summary.get("frames", 0) / wall_s if wall_s and wall_s > 1e-6 else 0.0) or None


def track_grid(tracks: Mapping[str, Any]) -> Grid:
    """One row: number of tracks and MOT metrics."""
    columns = [
        Column("n", [figure(tracks, "n")], "{:.0f}"),
        Column("MOTA %", [figure(tracks, "mota")]),
        Column("IDF1 %", [figure(tracks, "idf1")]),
        Column("ID switches", [figure(tracks, "idsw")], "{:.0f}"),
    ]
    return grid_of("Tracks", "", ["all"] if tracks else [], columns)


def grid_of(title: str, corner: str, names: Sequence[str], columns: Sequence[Column]) -> Grid:
    """A grid with a row per name, of the columns that have values; `corner` is the heading above the names."""
    kept = [column for column in columns if any(value is not None for value in column.values)]
    cells = [[Cell(name) for name in names], *(column.cells() for column in kept)]
    headings = (corner, *(column.heading for column in kept))
    return Grid(title, headings, tuple(zip(*cells, strict=True)) if kept else ())


def markdown(summary: Mapping[str, Any]) -> str:
    """The tables of a summary as Markdown, best values in bold, with the source of the ground truth and the notes."""
    parts = [markdown_table(grid) for grid in grids(summary)]
    if summary.get("truth"):
        parts.append(f"Ground truth: {summary['truth']}")
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
    """Text escaped for a pipe table."""
    return text.replace("\\", "\\\\").replace("|", "\\|")
