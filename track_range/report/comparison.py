"""Runs side by side: a row per run and a column per figure, whether they can be compared, and how they were made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from track_range.overlay.colours import OTHER_COLOURS, method_colours
from track_range.report import tables
from track_range.report.errors import band_line
from track_range.report.sentences import flattened, run_name
from track_range.report.tables import Cell, Column, Cost, Grid, figure, grid_of

_RUN_COLUMNS: tuple[tuple[str, str, str, str, Cost | None], ...] = (
    ("frames", "", "frames", "{:.0f}", None),
    ("frames/s", "", "frames_per_s", "{:.1f}", lambda value: -value),
    ("tracks", "tracks", "n", "{:.0f}", None),
    ("HOTA %", "tracks", "hota", "{:.1f}", lambda value: -value),
    ("MOTA %", "tracks", "mota", "{:.1f}", lambda value: -value),
    ("IDF1 %", "tracks", "idf1", "{:.1f}", lambda value: -value),
    ("id switches", "tracks", "idsw", "{:.0f}", lambda value: value),
)
"""Heading, section of the summary ("" = its top), key, format and cost."""

_MethodFigure = tuple[str, str, str, float, Cost]

_METHOD_GRIDS: tuple[_MethodFigure, ...] = (
    ("Median distance error, %, each method where it measured", "median_relative_error_pct", "{:.2f}", 1.0, abs),
    ("Mean distance error, %", "mean_relative_error_pct", "{:.2f}", 1.0, abs),
    ("Bias, %", "bias_pct", "{:+.2f}", 1.0, abs),
    ("Coverage, %", "coverage", "{:.1f}", 100.0, lambda value: -value),
    (
        f"Errors within one {tables.SIGMA}, % (68 is right)",
        "within_1_sigma",
        "{:.0f}",
        100.0,
        tables.from_normal(tables.WITHIN_1_SIGMA),
    ),
)
"""Title, key in a method's row, format, factor and cost."""

_NEVER_TOLD = ("out", "versions")
"""Settings that differ between any two runs, or say nothing of the figures."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparedRun:
    """A run among others.

    Attributes:
        name: short, and unlike the others'.
        summary: what its summary.json holds.
        settings: the section `run` of its settings.yaml.
        link: its own report, as an address relative to the page; None = it has none.
        notes: what is missing of it.
    """

    name: str
    summary: Mapping[str, Any]
    settings: Mapping[str, Any]
    link: str | None = None
    notes: tuple[str, ...] = ()


def comparison_grids(runs: Sequence[ComparedRun]) -> list[Grid]:
    """Tables with a row per run: figures of the whole, of each method, of speed."""
    found = [_run_grid(runs), *(_method_grid(runs, each) for each in _METHOD_GRIDS), _stage_grid(runs)]
    return [grid for grid in found if grid.rows and len(grid.columns) > 1]


def _run_grid(runs: Sequence[ComparedRun]) -> Grid:
    columns = [
        Column(heading, [figure(_section(run, part), key) for run in runs], pattern, cost=cost)
        for heading, part, key, pattern, cost in _RUN_COLUMNS
    ]
    return grid_of("Runs", "run", [run.name for run in runs], columns)


def _section(run: ComparedRun, name: str) -> Mapping[str, Any]:
    return (run.summary.get(name) or {}) if name else run.summary


def _method_grid(runs: Sequence[ComparedRun], told: _MethodFigure) -> Grid:
    title, key, pattern, scale, cost = told
    methods = [_section(run, "methods") for run in runs]
    columns = [
        Column(name, [figure(of_run.get(name) or {}, key) for of_run in methods], pattern, scale, cost)
        for name in dict.fromkeys(name for of_run in methods for name in of_run)
    ]
    return grid_of(title, "run", [run.name for run in runs], columns)


def _stage_grid(runs: Sequence[ComparedRun]) -> Grid:
    stages = [_section(run, "stages_ms") for run in runs]
    columns = [
        Column(name, [figure(of_run, name) or None for of_run in stages], "{:.1f}", cost=abs)
        for name in dict.fromkeys(name for of_run in stages for name in of_run)
    ]
    return grid_of("Milliseconds per frame, stages overlap", "run", [run.name for run in runs], columns)


def settings_grid(runs: Sequence[ComparedRun]) -> Grid:
    """A row per setting that is not the same in all runs."""
    told = [dict(flattened(run.settings)) for run in runs]
    names = [name for name in dict.fromkeys(name for each in told for name in each) if name not in _NEVER_TOLD]
    rows = [[name, *(each.get(name, tables.NOTHING) for each in told)] for name in names]
    different = [tuple(Cell(text) for text in row) for row in rows if len(set(row[1:])) > 1]
    return Grid("Settings that differ", ("setting", *(run.name for run in runs)), tuple(different))


def comparison_notes(runs: Sequence[ComparedRun]) -> list[str]:
    """Why figures of these runs may not be comparable."""
    found = []
    if len({run_name(run.summary) for run in runs}) > 1:
        found.append("The runs are of different videos: their errors tell of the videos, too.")
    truths = {str(run.summary.get("truth")) for run in runs}
    if len(truths) > 1:
        found.append("The runs were not measured against the same kind of truth, or some against none.")
    if len({run.summary.get("frames") for run in runs}) > 1:
        found.append("The runs have different numbers of frames.")
    return found


def error_lines(runs: Sequence[ComparedRun]) -> list[dict[str, Any]]:
    """Mean error of `fused` by middle of the band of distance, a line per run that was measured against a truth."""
    palette = (*dict.fromkeys([*reversed(method_colours().values()), *OTHER_COLOURS]),)
    found = []
    for i, run in enumerate(runs):
        known = band_line(_section(run, "methods").get("fused") or {})
        if known:
            x, y = zip(*known, strict=True)
            found.append({"name": run.name, "colour": palette[i % len(palette)], "x": x, "y": y})
    return found
