"""Comparison of runs: events that differ, a row per run with its results, and settings that differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from track_range.pipeline.colours import OTHER_COLOURS, method_colours
from track_range.results.columns import Columns
from track_range.results.events.event import Event
from track_range.views.report import tables
from track_range.views.report.content.errors import band_line
from track_range.views.report.event_comparison import count_grid, difference_grid, event_differences
from track_range.views.report.sentences import address, flattened, run_name
from track_range.views.report.tables import Cell, Column, Cost, Grid, figure, grid_of

_RUN_COLUMNS: tuple[tuple[str, str, str, str, Cost | None], ...] = (
    ("frames", "", "frames", "{:.0f}", None),
    ("frames/s", "", "frames_per_s", "{:.1f}", lambda value: -value),
    ("tracks", "tracks", "n", "{:.0f}", None),
    ("HOTA %", "tracks", "hota", "{:.1f}", lambda value: -value),
    ("MOTA %", "tracks", "mota", "{:.1f}", lambda value: -value),
    ("IDF1 %", "tracks", "idf1", "{:.1f}", lambda value: -value),
    ("ID switches", "tracks", "idsw", "{:.0f}", lambda value: value),
)
"""Heading, section of the summary ("" = top level), key, format and cost of each column."""

_MethodFigure = tuple[str, str, str, float, Cost]

_METHOD_GRIDS: tuple[_MethodFigure, ...] = (
    ("Median distance error on own coverage, %", "median_relative_error_pct", "{:.2f}", 1.0, abs),
    ("Mean distance error, %", "mean_relative_error_pct", "{:.2f}", 1.0, abs),
    ("Bias, %", "bias_pct", "{:+.2f}", 1.0, abs),
    ("Coverage, %", "coverage", "{:.1f}", 100.0, lambda value: -value),
    (
        f"Errors within one {tables.SIGMA}, % (expected: 68)",
        "within_1_sigma",
        "{:.0f}",
        100.0,
        tables.from_normal(tables.WITHIN_1_SIGMA),
    ),
)
"""Title, key in a method's row, format, scale and cost of each table of methods."""

_OMITTED = ("out", "versions")
"""Settings that do not affect the results."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparedRun:
    """A run of a comparison.

    Attributes:
        name: short and unique.
        summary: content of its summary.json.
        settings: section `run` of its settings.yaml.
        link: address of its report relative to the page; None = no report.
        notes: messages about missing files.
        events: its events; None = unknown.
        rows: its rows by column, for the places of its events.
    """

    name: str
    summary: Mapping[str, Any]
    settings: Mapping[str, Any]
    link: str | None = None
    notes: tuple[str, ...] = ()
    events: tuple[Event, ...] | None = None
    rows: Columns = field(default_factory=dict)


def event_grids(runs: Sequence[ComparedRun]) -> list[Grid]:
    """Events of each further run that differ from those of the first, then the number of events by kind.

    Runs of different videos, and those without events, are not compared; equal events have no table.
    """
    first, grids = runs[0], []
    for other in _comparable(runs):
        differences = event_differences(first.events or (), first.rows, other.events or (), other.rows)
        links = (_address(first.link), _address(other.link))
        grids.append(difference_grid(differences, (first.name, other.name), links))
    grids.append(count_grid([run.name for run in runs], [run.events for run in runs]))
    return [grid for grid in grids if grid.rows]


def _comparable(runs: Sequence[ComparedRun]) -> list[ComparedRun]:
    """Runs with events on the same video as the first."""
    first = runs[0]
    if first.events is None:
        return []
    return [run for run in runs[1:] if run.events is not None and run_name(run.summary) == run_name(first.summary)]


def _address(path: str | None) -> str | None:
    return None if path is None else address(path)


def event_sentence(runs: Sequence[ComparedRun]) -> str:
    """Why there is no table of events that differ; "" if there is one."""
    if runs[0].events is None:
        return "The events of the first run are unknown."
    others = _comparable(runs)
    if not others:
        return "The events were not compared: no other run is of the same video and has events."
    if any(event_differences(runs[0].events, runs[0].rows, run.events or (), run.rows) for run in others):
        return ""
    return "The runs have the same events." if any(run.events for run in others) else "The runs have no events."


def comparison_grids(runs: Sequence[ComparedRun]) -> list[Grid]:
    """Tables with a row per run: main results, results of each method, run time of each stage."""
    grids = [_run_grid(runs), *(_method_grid(runs, spec) for spec in _METHOD_GRIDS), _stage_grid(runs)]
    return [grid for grid in grids if grid.rows and len(grid.columns) > 1]


def _run_grid(runs: Sequence[ComparedRun]) -> Grid:
    columns = [
        Column(heading, [figure(_section(run, part), key) for run in runs], pattern, cost=cost)
        for heading, part, key, pattern, cost in _RUN_COLUMNS
    ]
    return grid_of("Runs", "run", [run.name for run in runs], columns)


def _section(run: ComparedRun, name: str) -> Mapping[str, Any]:
    return (run.summary.get(name) or {}) if name else run.summary


def _method_grid(runs: Sequence[ComparedRun], spec: _MethodFigure) -> Grid:
    title, key, pattern, scale, cost = spec
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
    return grid_of("Run time by stage in ms per frame (stages overlap)", "run", [run.name for run in runs], columns)


def settings_grid(runs: Sequence[ComparedRun]) -> Grid:
    """A row per setting that differs between runs."""
    settings = [dict(flattened(run.settings)) for run in runs]
    names = [name for name in dict.fromkeys(name for values in settings for name in values) if name not in _OMITTED]
    rows = [[name, *(values.get(name, tables.NOTHING) for values in settings)] for name in names]
    different = [tuple(Cell(text) for text in row) for row in rows if len(set(row[1:])) > 1]
    return Grid("Settings that differ", ("setting", *(run.name for run in runs)), tuple(different))


def comparison_notes(runs: Sequence[ComparedRun]) -> list[str]:
    """Reasons why the results of the runs may not be comparable."""
    notes = []
    if len({run_name(run.summary) for run in runs}) > 1:
        notes.append("The runs are of different videos, so their errors are not directly comparable.")
    truths = {str(run.summary.get("truth")) for run in runs}
    if len(truths) > 1:
        notes.append("The runs were not evaluated against the same kind of ground truth, or some had none.")
    if len({run.summary.get("frames") for run in runs}) > 1:
        notes.append("The runs have different numbers of frames.")
    return notes


def error_lines(runs: Sequence[ComparedRun]) -> list[dict[str, Any]]:
    """Mean error of `fused` by distance band, one line per run with ground truth: name, colour, x in m, y in %."""
    palette = (*dict.fromkeys([*reversed(method_colours().values()), *OTHER_COLOURS]),)
    lines = []
    for i, run in enumerate(runs):
        known = band_line(_section(run, "methods").get("fused") or {})
        if known:
            x, y = zip(*known, strict=True)
            lines.append({"name": run.name, "colour": palette[i % len(palette)], "x": x, "y": y})
    return lines
