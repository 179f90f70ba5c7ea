"""Tables of a fleet's figures, for the terminal, Markdown and the page."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

from track_range.fleet.output.record import ERROR_FIGURES
from track_range.fleet.report.clip_figures import ALIGNMENT_FIGURES, MAX_GROUPS
from track_range.fleet.report.track_figures import Figures
from track_range.views.report import tables
from track_range.views.report.tables import NOTHING, SIGMA, Cell, Column, Grid, figure, grid_of

_Link = Callable[[Figures], str]


@dataclass(frozen=True, slots=True)
class Links:
    """Functions of a ranked row; "" = no address.

    They give the address of the report of its clip, of the overlay at its moment, and of the video of an event (without
    one, of the overlay).
    """

    report: _Link = lambda _row: ""
    overlay: _Link = lambda _row: ""
    event: _Link = lambda _row: ""


@dataclass(frozen=True, slots=True)
class Section:
    """Tables about one subject: sentences above them, and the sentence that replaces them if none has a row."""

    anchor: str
    title: str
    text: str
    grids: tuple[Grid, ...]
    absence: str


def fleet_sections(figures: Figures, links: Links | None = None) -> list[Section]:
    """All tables of a fleet, by subject."""
    links = links or Links()
    per_hour, visible = ("per hour of video", "per_hour", "{:.1f}"), ("mean s visible", "mean_visible_s", "{:.1f}")
    kinds = ("Events by kind", figures["event_kinds"], "kind", ("events", "events", "{:.0f}"), per_hour)
    sections = [
        Section(
            "road-users",
            "Road users",
            "Tracks by their most frequent class. Hours of the day are those of the first frame of a track, in UTC.",
            (
                _grid(
                    "Tracks by class", figures["classes"], "class", ("tracks", "tracks", "{:.0f}"), per_hour, visible
                ),
                _hour_grid(figures["hours"]),
            ),
            "No clip has tracks.",
        ),
        Section(
            "coverage",
            "Distance coverage",
            "Share of the observed boxes with a distance of the method. Bands of the filtered fused distance.",
            (_coverage_grid(figures["coverage"]),),
            "No box has a distance.",
        ),
        Section(
            "events",
            "Events",
            "The most severe events of all clips: warnings first, then the largest probability of contact, the "
            "shortest time to collision, the smallest distance.",
            (_grid(*kinds), _event_grid(figures["events"], links)),
            "No clip has events.",
        ),
        Section(
            "closest",
            "Closest approaches",
            f"Smallest filtered fused distance of a road user, with its standard deviation {SIGMA} of at most half the "
            "distance; one row per track.",
            (_ranking("Closest tracks", figures["closest"], links),),
            "No road user has a distance.",
        ),
        Section(
            "collisions",
            "Shortest times to collision",
            "Road users that have been on a collision course for 0.5 s: predicted lateral offset at most 2 m at the "
            f"time of collision. {SIGMA} at most half of the time; one row per track.",
            (_ranking("Tracks on a collision course", figures["collisions"], links, is_collision=True),),
            "No road user was on a collision course.",
        ),
        Section(
            "errors",
            "Errors",
            "Clips with ground truth. Each figure is the median over the clips.",
            (_error_grid(figures["errors"]),),
            "No clip has ground truth (column truth of a manifest).",
        ),
        Section(
            "drift",
            "Calibration drift",
            "Alignment of the two cameras, measured in each run. First and last: medians of up to five clips. "
            f"Of more than {MAX_GROUPS} rows, those with the largest change.",
            tuple(_drift_grid(figures["drift"], name, figures["drift_by"]) for name in ALIGNMENT_FIGURES),
            "No clip has an alignment of two cameras.",
        ),
        Section(
            "failures",
            "Failures",
            "Failed clips by reason; the option --retry-failed repeats them.",
            (
                _text_grid(
                    "Failures by reason",
                    ("kind", "clips", "reason", "names"),
                    ((row["kind"], str(row["n"]), row["reason"], _names(row)) for row in figures["failures"]),
                ),
            ),
            "No clip failed.",
        ),
        Section(
            "throughput",
            "Throughput",
            "A worker processes one clip at a time.",
            (_work_grid(figures), _node_grid(figures["nodes"]), _stage_grid(figures["stages_ms"])),
            "No clip is complete.",
        ),
        Section(
            "notes",
            "Notes of the runs",
            "The most frequent ones, with one of the clips.",
            (
                _text_grid(
                    "Notes",
                    ("clip", "clips", "note"),
                    ((row["clip"], str(row["n"]), row["note"]) for row in figures["notes"]),
                ),
            ),
            "The runs have no notes.",
        ),
    ]
    replaced = ("closest", "collisions") if figures["events"] else ()
    return [
        replace(section, grids=tuple(grid for grid in section.grids if grid.rows))
        for section in sections
        if section.anchor not in replaced
    ]


_Column = tuple[str, str, str]
"""Heading, key and format of a column."""


def _grid(title: str, rows: Sequence[Figures], name: str, *columns: _Column) -> Grid:
    """Table of the rows, whose names are the values of the key `name`."""
    cells = [Column(heading, [figure(row, key) for row in rows], pattern) for heading, key, pattern in columns]
    return grid_of(title, name, [str(row[name]) for row in rows], cells)


def _hour_grid(rows: Sequence[Figures]) -> Grid:
    names = [NOTHING if row["hour_utc"] is None else f"{row['hour_utc']:02}:00" for row in rows]
    columns = [Column("video h", [figure(row, "video_h") for row in rows], "{:.2f}")]
    for name in rows[0]["tracks"] if rows else ():
        per_hour = [row["tracks"][name] / row["video_h"] if row["video_h"] > 0 else None for row in rows]
        columns.append(Column(name, per_hour, "{:.0f}"))
    return grid_of("Tracks per hour of video, by hour of the day", "hour UTC", names, columns)


def _event_grid(rows: Sequence[Figures], links: Links) -> Grid:
    measures = (
        ("contact %", "probability", "{:.0%}"),
        ("TTC s", "min_ttc_s", "{:.1f}"),
        ("distance m", "min_distance_m", "{:.1f}"),
        (f"{SIGMA} m", "min_distance_sigma_m", "{:.2f}"),
        ("closing m/s", "closing_mps", "{:.1f}"),
    )
    keys = (("event", "kind"), ("track", "track_id"), ("class", "class"))
    return _ranked_grid("Most severe events", rows, links.report, keys, measures, "peak_s", links.event)


def _ranking(title: str, rows: Sequence[Figures], links: Links, *, is_collision: bool = False) -> Grid:
    distance = (("distance m", "distance_m", "{:.1f}"), (f"{SIGMA} m", "sigma_m", "{:.2f}"), ("x m", "x_m", "{:+.1f}"))
    ttc = (("TTC s", "ttc_s", "{:.1f}"), (f"{SIGMA} s", "ttc_sigma_s", "{:.1f}"))
    keys = (("track", "track_id"), ("class", "road_class"))
    measures = (*ttc, *distance) if is_collision else distance
    return _ranked_grid(title, rows, links.report, keys, measures, "time_s", links.overlay)


def _ranked_grid(
    title: str,
    rows: Sequence[Figures],
    report: _Link,
    keys: Sequence[tuple[str, str]],
    measures: Sequence[_Column],
    moment: str,
    video: _Link,
) -> Grid:
    """Table of ranked rows: clip with a link, texts, measures, time in the video with a link, UTC."""
    headings = ("clip", *(heading for heading, _ in keys), *(heading for heading, _, _ in measures), "at s", "UTC")
    cells = tuple(
        (
            Cell(row["clip"], link=report(row)),
            *(Cell(str(row[key])) for _, key in keys),
            *(Cell(_text(row[key], pattern)) for _, key, pattern in measures),
            Cell(f"{row[moment]:.1f}", link=video(row)),
            Cell(utc_text(row["utc_s"])),
        )
        for row in rows
    )
    return Grid(title, headings, cells)


def _coverage_grid(rows: Sequence[Figures]) -> Grid:
    methods = [*dict.fromkeys(row["method"] for row in rows)]
    by_band: dict[tuple[float, float | None], dict[str, Figures]] = {}
    for row in rows:
        by_band.setdefault((row["from_m"], row["to_m"]), {})[row["method"]] = row
    bands = sorted(by_band, key=lambda band: band[0])
    names = [f"{low:g} m and more" if high is None else f"{low:g}-{high:g} m" for low, high in bands]
    columns = [Column("boxes", [next(iter(by_band[band].values()))["boxes"] for band in bands], "{:.0f}")]
    columns += [
        Column(f"{method} %", [by_band[band][method]["coverage"] for band in bands], "{:.0f}", 100.0)
        for method in methods
    ]
    return grid_of("Coverage by distance band", "distance", names, columns)


def _error_grid(rows: Sequence[Figures]) -> Grid:
    patterns = {key: (heading, pattern, scale, cost) for heading, key, pattern, scale, cost in tables.METHOD_COLUMNS}
    columns = [Column("clips", [figure(row, "clips") for row in rows], "{:.0f}")]
    for key in ("coverage", *ERROR_FIGURES):
        heading, pattern, scale, cost = patterns[key]
        columns.append(Column(heading, [figure(row, key) for row in rows], pattern, scale, cost))
    columns.append(Column("worst clip %", [figure(row, "worst_pct") for row in rows]))
    grid = grid_of("Distance error, median over the clips", "method", [row["method"] for row in rows], columns)
    worst = (Cell(row["worst_clip"]) for row in rows)
    with_clip = tuple((*cells, cell) for cells, cell in zip(grid.rows, worst, strict=True))
    return Grid(grid.title, (*grid.columns, "worst clip"), with_clip)


DRIFT_TITLES = dict(zip(ALIGNMENT_FIGURES, ("Vertical offset", "Constant error of the disparities"), strict=True))
"""Titles of the tables of the calibration drift."""


def _drift_grid(rows: Sequence[Figures], name: str, group: str | None) -> Grid:
    headings = ("clips", "from", "to", "median px", "first px", "last px", "change px")
    cells = (
        (
            str(row["group"]),
            str(row["clips"]),
            *(utc_text(row.get(key))[:10] for key in ("from_utc_s", "to_utc_s")),
            *(_text(row[name][key], "{:+.2f}") for key in ("median", "first", "last", "change")),
        )
        for row in rows
    )
    rows_of_text = tuple(tuple(map(Cell, texts)) for texts in cells)
    return Grid(DRIFT_TITLES[name], (group or "", *headings), rows_of_text)


def _names(failure: Figures) -> str:
    return ", ".join(failure["clips"]) + (", ..." if failure["n"] > len(failure["clips"]) else "")


def _text_grid(title: str, headings: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> Grid:
    return Grid(title, headings, tuple(tuple(map(Cell, row)) for row in rows), has_sentences=True)


_WORK: tuple[_Column, ...] = (
    ("clips/h", "clips_per_hour", "{:.0f}"),
    ("video h", "video_h", "{:.2f}"),
    ("worker h", "worker_h", "{:.2f}"),
    ("frames/s per worker", "frames_per_worker_s", "{:.1f}"),
    ("video s per worker s", "video_s_per_worker_s", "{:.2f}"),
    ("overhead s per clip", "median_overhead_s", "{:.2f}"),
)


def _work_grid(figures: Figures) -> Grid:
    columns = [Column(heading, [figure(figures, key)], pattern) for heading, key, pattern in _WORK]
    return grid_of("Work", "", ["all clips"] if figures["nodes"] else [], columns)


def _node_grid(rows: Sequence[Figures]) -> Grid:
    memory = (("median MB", "median_memory_mb", "{:.0f}"), ("peak MB", "max_memory_mb", "{:.0f}"))
    columns = (("clips", "clips", "{:.0f}"), *_WORK[1:], *memory)
    return _grid("Nodes, with the memory of a worker", rows, "node", *columns)


def _stage_grid(stages_ms: dict[str, float]) -> Grid:
    values = list(stages_ms.values())
    columns = [Column("ms/frame", values, "{:.2f}"), Column("frames/s", [1000 / ms for ms in values])]
    return grid_of("Run time by stage (stages overlap)", "stage", list(stages_ms), columns)


def _text(value: Any, pattern: str) -> str:
    return NOTHING if value is None else pattern.format(value)


def utc_text(utc_s: float | None) -> str:
    """A Unix time as "2026-05-04 08:10:02"; "-" = unknown."""
    if utc_s is None:
        return NOTHING
    try:
        return datetime.fromtimestamp(utc_s, UTC).strftime("%Y-%m-%d %H:%M:%S")
    except (ValueError, OverflowError, OSError):
        return NOTHING
