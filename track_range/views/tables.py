"""Tables of a run's summary, for the terminal and the report, and as Markdown.

A summary is the content of `summary.json`. Values without `_pct` are fractions 0..1 and are shown
in per cent; MOT metrics are in per cent already. None, NaN or a missing key means not measured,
shown as "-". A column without any value (such as errors of a run without ground truth) is omitted.
The best value of a column is marked: the largest coverage, the smallest error, the bias nearest 0,
and the fraction within k sigma nearest to the fraction of a normal distribution.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from track_range.foundation.bootstrap import CI95

NOTHING = "-"  # text of a value that was not measured
NOT_FUSED = " (not fused)"  # after the names of methods that are only shown
SIGMA = "\N{GREEK SMALL LETTER SIGMA}"
WITHIN_1_SIGMA, WITHIN_2_SIGMA = 0.6827, 0.9545  # of a normal distribution

# function of a value that is smallest for the best value of a column
Cost = Callable[[float], float]
Summary = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Cell:
    """One value as text; `best` marks the best value of its column, `link` is the address it leads
    to ("" = none).
    """

    text: str
    best: bool = False
    link: str = ""


@dataclass(frozen=True, slots=True)
class Grid:
    """A table, independent of its rendering: headings of columns, and rows of cells, each named by
    its first cell.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    has_sentences: bool = False  # whether cells are sentences, which are wrapped


@dataclass(frozen=True, slots=True)
class Column:
    """A column of values, one per row; None = not measured."""

    heading: str
    values: Sequence[float | None]
    pattern: str = "{:.1f}"  # format of a value after scaling
    scale: float = 1.0  # factor from the stored to the shown value
    # function that is smallest for the best value; None = no value is marked
    cost: Cost | None = None
    details: Sequence[str] = ()  # text behind each value, such as its interval

    def intervals(self, ends: Iterable[Sequence[float] | None]) -> list[str]:
        """The details of 95 % intervals, None = none, in the format of the values."""
        texts = []
        for pair in ends:
            limits = [self.pattern.format(self.scale * end) for end in pair or ()]
            texts.append(f" ({' to '.join(limits)})" if limits else "")
        return texts

    def cells(self) -> list[Cell]:
        """One cell per value; all values whose text equals the best value's are marked."""
        texts = [
            NOTHING if value is None else self.pattern.format(self.scale * value)
            for value in self.values
        ]
        for row, detail in enumerate(self.details):
            texts[row] += detail
        known = [value for value in self.values if value is not None]
        if self.cost is None or len(known) < 2:
            return [Cell(text) for text in texts]
        best = texts[self.values.index(min(known, key=self.cost))]
        return [Cell(text, text == best) for text in texts]


# heading, key, then `pattern`, `scale`, `cost` of `Column`, which may be left out; a heading that
# ends with `INTERVAL` shows 95 % intervals, of rows that have them
INTERVAL = " (95 %)"
ColumnSpec = tuple[Any, ...]


def columns_of(rows: Iterable[Mapping[str, Any]], specs: Iterable[ColumnSpec]) -> list[Column]:
    """Columns of the figures of some rows."""
    rows = list(rows)
    columns = []
    for heading, key, *rest in specs:
        column = Column(heading.removesuffix(INTERVAL), [figure(row, key) for row in rows], *rest)
        ends = [row.get(key + CI95) for row in rows]
        if heading.endswith(INTERVAL) and any(ends):
            column = replace(column, heading=heading, details=column.intervals(ends))
        columns.append(column)
    return columns


def grid_of(title: str, corner: str, names: Sequence[str], columns: Sequence[Column]) -> Grid:
    """A grid with a row per name, of the columns that have values; `corner` is the heading above
    the names.
    """
    kept = [column for column in columns if any(value is not None for value in column.values)]
    cells = [[Cell(name) for name in names], *(column.cells() for column in kept)]
    headings = (corner, *(column.heading for column in kept))
    return Grid(title, headings, tuple(zip(*cells, strict=True)) if kept else ())


def figure(section: Mapping[str, Any], key: str) -> float | None:
    """A number of a section of a summary; None where it is missing, null or NaN."""
    value = section.get(key)
    return None if value is None or math.isnan(value) else float(value)


def largest(value: float) -> float:
    """Cost of a column whose largest value is the best."""
    return -value


def from_normal(expected: float) -> Cost:
    """Cost of an observed fraction: its distance from the expected fraction."""
    return lambda value: abs(value - expected)


# the fraction of distances that are not grossly wrong, which a mean error hides, as published
# evaluations define it
DELTA_1: ColumnSpec = ("delta 1 %", "delta_1_25", "{:.1f}", 100.0, largest)
# percentages of errors within 1, 2 and 3 sigma, of which a table shows those that it has
WITHIN_SIGMAS: tuple[ColumnSpec, ...] = tuple(
    (f"\N{LESS-THAN OR EQUAL TO}{k}{SIGMA} %", f"within_{k}_sigma", "{:.0f}", 100.0)
    for k in (1, 2, 3)
)
# the first two of methods that are compared: the best ones are nearest to a normal distribution
NEAR_NORMAL: tuple[ColumnSpec, ...] = (
    (*WITHIN_SIGMAS[0], from_normal(WITHIN_1_SIGMA)),
    (*WITHIN_SIGMAS[1], from_normal(WITHIN_2_SIGMA)),
)
METHOD_COLUMNS: tuple[ColumnSpec, ...] = (
    ("coverage %", "coverage", "{:.0f}", 100.0, largest),
    ("n", "n", "{:.0f}"),
    ("tracks", "n_tracks", "{:.0f}"),
    (f"mean %{INTERVAL}", "mean_relative_error_pct", "{:.1f}", 1.0, abs),
    DELTA_1,
    (f"median %{INTERVAL}", "median_relative_error_pct", "{:.1f}", 1.0, abs),
    ("bias %", "bias_pct", "{:+.1f}", 1.0, abs),
    *NEAR_NORMAL,
)

_CLOSING_COLUMNS: tuple[ColumnSpec, ...] = (
    ("coverage %", "coverage", "{:.0f}", 100.0),
    ("n", "n", "{:.0f}"),
    ("mean m/s", "mean_error_mps", "{:.2f}"),
    (f"median m/s{INTERVAL}", "median_error_mps", "{:.2f}"),
    ("bias m/s", "bias_mps", "{:+.2f}"),
    *WITHIN_SIGMAS,
    (f"{SIGMA} m/s", "median_sigma_mps", "{:.2f}"),
)

_UNITS = {"pct": "%"}  # of the ends of keys; others are written as they are
_CUBOIDS: tuple[ColumnSpec, ...] = (
    ("n", "n", "{:.0f}"),
    ("coverage %", "coverage", "{:.0f}", 100.0),
    ("front stated %", "front_known", "{:.0f}", 100.0),
    ("of these right %", "front_right", "{:.0f}", 100.0),
)
_CUBOID_ERRORS: tuple[ColumnSpec, ...] = (
    ("n", "n", "{:.0f}"),
    (f"median{INTERVAL}", "median", "{:.2f}"),
    ("90 %", "p90", "{:.2f}"),
    ("bias", "bias", "{:+.2f}"),
    *WITHIN_SIGMAS,
)

_RIG_COLUMNS: tuple[ColumnSpec, ...] = (
    ("calibrated middle %", "before_pct", "{:+.1f}"),
    (f"{SIGMA} %", "before_sigma_pct"),
    ("calibrated left %", "before_left_pct", "{:+.1f}"),
    ("calibrated right %", "before_right_pct", "{:+.1f}"),
    (f"corrected {SIGMA} %", "after_sigma_pct"),
)

_TRACK_COLUMNS: tuple[ColumnSpec, ...] = (
    ("n", "n", "{:.0f}"),
    ("MOTA %", "mota"),
    ("IDF1 %", "idf1"),
    ("ID switches", "idsw", "{:.0f}"),
)
# heading and key in the section `tracks` of the summary; MOT metrics are in per cent already
_MOT_FIGURES = (
    *(
        ("HOTA %", "hota"),
        ("DetA %", "deta"),
        ("AssA %", "assa"),
        ("LocA %", "loca"),
        ("MOTA %", "mota"),
    ),
    *(("MOTP %", "motp"), ("IDF1 %", "idf1"), ("ID precision %", "idp"), ("ID recall %", "idr")),
    ("ID switches", "idsw"),
    *(
        ("fragments", "frag"),
        ("false positives", "fp"),
        ("false negatives", "fn"),
        ("true boxes", "n_truth_boxes"),
        ("true tracks", "n_truth_tracks"),
    ),
    *(("mostly tracked", "mt"), ("partly tracked", "pt"), ("mostly lost", "ml")),
)
# stage that measures a method's run time; filtered methods are part of fusion
STAGE_OF = {"fused": "fuse"}


def grids(summary: Summary) -> list[Grid]:
    """Non-empty tables of a summary: methods, common coverage, closing speed, rig, sigma, run time,
    tracks.
    """
    tables = [
        *_distance_grids(summary, has_errors=bool(summary.get("common"))),
        closing_grid(summary.get("closing") or {}),
        rig_grid((summary.get("alignment") or {}).get("health") or {}),
        uncertainty_grid(summary),
        speed_grid(summary),
        track_grid(summary.get("tracks") or {}),
    ]
    return [grid for grid in tables if grid.rows]


def accuracy_grids(summary: Summary) -> list[Grid]:
    """Distance errors of each method on its own coverage, on common coverage and by class;
    closing-speed errors.
    """
    methods = summary.get("methods") or {}
    has_errors = any(
        figure(row, "median_relative_error_pct") is not None for row in methods.values()
    )
    tables = [
        *_distance_grids(summary, has_errors=has_errors),
        class_grid(_by_shown_name(summary)),
        closing_grid(summary.get("closing") or {}),
        lateral_grid(summary.get("lateral") or {}),
    ]
    return [grid for grid in tables if grid.rows]


def _distance_grids(summary: Summary, *, has_errors: bool) -> tuple[Grid, Grid]:
    title = (
        "Distance error of each method on its own coverage"
        if has_errors
        else "Coverage of each method"
    )
    common = _by_shown_name(summary, "common")
    n = max((figure(row, "n") or 0 for row in common.values()), default=0)
    common_title = (
        f"Distance error on common coverage ({n:.0f} track-frames measured by all methods)"
    )
    return method_grid(title, _by_shown_name(summary)), method_grid(common_title, common)


def _by_shown_name(summary: Summary, section: str = "methods") -> dict[str, Mapping[str, Any]]:
    """The methods of a section by the names that tables have."""
    return {shown_name(summary, name): row for name, row in (summary.get(section) or {}).items()}


def shown_name(summary: Summary, name: str) -> str:
    """Name of a distance, with a mark if the run only shows it and does not fuse it."""
    is_shown_only = name.removesuffix("_kf") in (summary.get("shown_only") or ())
    return f"{name}{NOT_FUSED}" if is_shown_only else name


def method_grid(
    title: str,
    methods: Mapping[str, Mapping[str, Any]],
    specs: Sequence[ColumnSpec] = METHOD_COLUMNS,
) -> Grid:
    """One row per method: the columns `specs`, and the mean error in each distance band that a
    method has.
    """
    rows = list(methods.values())
    columns = columns_of(rows, specs)
    bands = [
        {(band["from_m"], band["to_m"]): band for band in row.get("bands") or []} for row in rows
    ]
    for low_m, high_m in sorted({limits_m for by_limits in bands for limits_m in by_limits}):
        errors_pct = [
            figure(one.get((low_m, high_m), {}), "mean_relative_error_pct") for one in bands
        ]
        columns.append(Column(f"{low_m:g}-{high_m:g} m", errors_pct, cost=abs))
    return grid_of(title, "method", list(methods), columns)


def class_grid(methods: Mapping[str, Mapping[str, Any]]) -> Grid:
    """Median error of each method by the class in the ground truth."""
    scores = [row.get("by_class") or {} for row in methods.values()]
    columns = [
        Column(
            f"{name} %",
            [figure(row.get(name) or {}, "median_relative_error_pct") for row in scores],
            cost=abs,
        )
        for name in sorted({name for row in scores for name in row})
    ]
    return grid_of("Median distance error by class", "method", list(methods), columns)


def closing_grid(closing: Mapping[str, Any]) -> Grid:
    """One row: errors of the closing speeds against ground truth that contains them, in m/s."""
    columns = columns_of([closing], _CLOSING_COLUMNS)
    return grid_of("Error of the closing speed", "method", ["fused_kf"] if closing else [], columns)


def lateral_grid(lateral: Mapping[str, Any]) -> Grid:
    """One row: errors of the offsets to the side against targets that have them, in m."""
    specs = [
        (heading.replace("m/s", "m"), key.replace("_mps", "_m"), *rest)
        for heading, key, *rest in _CLOSING_COLUMNS
    ]
    names = ["fused"] if lateral else []
    return grid_of("Error of the offset to the side", "method", names, columns_of([lateral], specs))


def delta_1_grid(by_method: Mapping[str, Mapping[str, Any]]) -> Grid:
    """The fraction of distances of all classes within 25 % of the true ones, by method."""
    columns = columns_of(by_method.values(), [("n", "n", "{:.0f}"), DELTA_1])
    return grid_of("Within 25 % (delta 1), all classes", "method", list(by_method), columns)


def cuboid_grids(cuboids: Mapping[str, Any]) -> list[Grid]:
    """The numbers of boxes by cell, and a table of errors of each quantity."""
    cells = {name: row for name, row in cuboids["counts"].items() if row["n"]}
    grids = [grid_of("Cuboids", "objects", list(cells), columns_of(cells.values(), _CUBOIDS))]
    for quantity, rows in cuboids.items():
        if quantity != "counts":
            *words, unit = quantity.split("_")
            title = f"{' '.join(words).capitalize()}, {_UNITS.get(unit, unit)}"
            columns = columns_of([rows[name] for name in cells], _CUBOID_ERRORS)
            grids.append(grid_of(title, "objects", list(cells), columns))
    return grids


def rig_grid(health: Mapping[str, Any]) -> Grid:
    """Expected distance errors of a rig, by distance, before and after its alignment, from
    `RigHealth.to_dict()`.
    """
    rows = health.get("distances") or []
    names = [f"{figure(row, 'distance_m') or 0:.0f} m" for row in rows]
    return grid_of(
        "Expected distance error of the rig", "distance", names, columns_of(rows, _RIG_COLUMNS)
    )


def uncertainty_grid(summary: Summary) -> Grid:
    """One row per method: median relative sigma (known without ground truth) and run time."""
    methods, stages_ms = summary.get("methods") or {}, summary.get("stages_ms") or {}
    columns = [
        Column(f"{SIGMA} %", [figure(row, "median_sigma_pct") for row in methods.values()]),
        Column(
            "ms/frame",
            [figure(stages_ms, STAGE_OF.get(name, name)) or None for name in methods],
            "{:.2f}",
        ),
    ]
    return grid_of(
        "Reported uncertainty (median relative sigma) and run time",
        "method",
        [shown_name(summary, name) for name in methods],
        columns,
    )


def speed_grids(summary: Summary) -> list[Grid]:
    """Run time of the stages, and reported uncertainty and run time of the methods."""
    return [
        grid for grid in (speed_grid(summary), uncertainty_grid(summary)) if len(grid.columns) > 1
    ]


def speed_grid(summary: Summary) -> Grid:
    """Rows of stages that ran, in processor time (detection and background in wall-clock time), and
    of the run.
    """
    stages_ms = summary.get("stages_ms") or {}
    stages = {name: ms for name in stages_ms if (ms := figure(stages_ms, name))}
    fps = frames_per_s(summary)
    if fps:
        stages["whole run"] = 1000.0 / fps
    columns = [
        Column("ms/frame", list(stages.values()), "{:.2f}"),
        Column("frames/s", [1000.0 / ms for ms in stages.values()]),
    ]
    return grid_of("Run time by stage (stages overlap)", "stage", list(stages), columns)


def frames_per_s(summary: Summary) -> float | None:
    """Frame rate of the whole run; computed from frames and wall time where the summary lacks
    it.
    """
    stored, wall_s = figure(summary, "frames_per_s"), figure(summary, "wall_s")
    return (
        stored or (summary.get("frames", 0) / wall_s if wall_s and wall_s > 1e-6 else 0.0) or None
    )


def track_grid(tracks: Mapping[str, Any]) -> Grid:
    """One row: number of tracks and MOT metrics."""
    return grid_of("Tracks", "", ["all"] if tracks else [], columns_of([tracks], _TRACK_COLUMNS))


def mot_grid(tracks: Mapping[str, Any]) -> Grid:
    """One row per tracking metric that was measured."""
    rows = [
        (Cell(name), Cell(f"{value:.1f}" if name.endswith("%") else f"{value:.0f}"))
        for name, key in _MOT_FIGURES
        if (value := figure(tracks, key)) is not None
    ]
    return Grid("Tracking metrics", ("metric", "value"), tuple(rows))


def markdown(summary: Summary) -> str:
    """The tables of a summary as Markdown, best values in bold, with the source of the ground truth
    and the notes.
    """
    parts = [markdown_table(grid) for grid in grids(summary)]
    if summary.get("truth"):
        parts.append(f"Ground truth: {summary['truth']}")
    parts += ["\n".join(f"- {note}" for note in summary["notes"])] if summary.get("notes") else []
    return "\n\n".join(parts) + "\n" if parts else ""


def markdown_table(grid: Grid) -> str:
    """A grid as a pipe table under its title."""
    others = ":--" if grid.has_sentences else "--:"
    lines = [
        [_escaped(heading) for heading in grid.columns],
        [":--"] + [others] * (len(grid.columns) - 1),
    ]
    lines += [
        [f"**{_escaped(cell.text)}**" if cell.best else _escaped(cell.text) for cell in row]
        for row in grid.rows
    ]
    return f"**{_escaped(grid.title)}**\n\n" + "\n".join(
        "| " + " | ".join(line) + " |" for line in lines
    )


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace("|", "\\|")
