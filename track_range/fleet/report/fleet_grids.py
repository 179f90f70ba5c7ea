"""Tables of a fleet's figures, for the terminal, Markdown and the page."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from track_range.fleet.output.record import ERROR_FIGURES
from track_range.fleet.report.clip_figures import ALIGNMENT_FIGURES, MAX_GROUPS, MIN_H
from track_range.fleet.report.track_figures import Figures
from track_range.views import tables

_Link = Callable[[Figures], str]

DRIFT_TITLES = dict(
    zip(ALIGNMENT_FIGURES, ("Vertical offset", "Constant error of the disparities"), strict=True)
)
"""Titles of the tables of the calibration drift."""

_PER_HOUR: tables.ColumnSpec = ("per hour of video", "per_hour")
_CLASS_COLUMNS: tuple[tables.ColumnSpec, ...] = (
    ("tracks", "tracks", "{:.0f}"),
    _PER_HOUR,
    ("visible for s (mean)", "mean_visible_s"),
)
_KIND_COLUMNS: tuple[tables.ColumnSpec, ...] = (("events", "events", "{:.0f}"), _PER_HOUR)
_DRIFT_COLUMNS = ("clips", "from", "to", "median px", "first px", "last px", "change px")
_WORK_COLUMNS: tuple[tables.ColumnSpec, ...] = (
    ("frames/s per worker", "frames_per_worker_s"),
    ("video s per worker s", "video_s_per_worker_s", "{:.2f}"),
    ("overhead s per clip", "median_overhead_s", "{:.2f}"),
)
_MEMORY_COLUMNS: tuple[tables.ColumnSpec, ...] = (
    ("median MB", "median_memory_mb", "{:.0f}"),
    ("peak MB", "max_memory_mb", "{:.0f}"),
)

_Measure = tuple[str, str, str]  # heading, key and format of a column of a ranking

_EVENT_MEASURES: tuple[_Measure, ...] = (
    ("event", "kind", "{}"),
    ("track", "track_id", "{}"),
    ("class", "class", "{}"),
    ("contact %", "probability", "{:.0%}"),
    ("TTC s", "min_ttc_s", "{:.1f}"),
    ("distance m", "min_distance_m", "{:.1f}"),
    (f"{tables.SIGMA} m", "min_distance_sigma_m", "{:.2f}"),
    ("closing m/s", "closing_mps", "{:.1f}"),
)
_TRACK_MEASURES: tuple[_Measure, ...] = (("track", "track_id", "{}"), ("class", "road_class", "{}"))
_CLOSEST_MEASURES: tuple[_Measure, ...] = (
    *_TRACK_MEASURES,
    ("distance m", "distance_m", "{:.1f}"),
    (f"{tables.SIGMA} m", "sigma_m", "{:.2f}"),
    ("x m", "x_m", "{:+.1f}"),
)
_COLLISION_MEASURES: tuple[_Measure, ...] = (
    *_TRACK_MEASURES,
    ("TTC s", "ttc_s", "{:.1f}"),
    (f"{tables.SIGMA} s", "ttc_sigma_s", "{:.1f}"),
    *_CLOSEST_MEASURES[2:4],
    ("path offset m", "path_offset_m", "{:+.1f}"),
)


@dataclass(frozen=True, slots=True)
class Links:
    """Functions that give an address of a ranked row; "" = none.

    The addresses lead to the report of the row's clip, to the overlay at the row's moment, and to
    the video of an event (if there is none, to the overlay).
    """

    report: _Link = lambda _row: ""
    overlay: _Link = lambda _row: ""
    event: _Link = lambda _row: ""


@dataclass(frozen=True, slots=True)
class Section:
    """Tables about one subject: sentences above them, and the sentence that replaces them if none
    has a row.
    """

    anchor: str
    title: str
    text: str
    grids: tuple[tables.Grid, ...]
    absence: str


@dataclass(frozen=True, slots=True, kw_only=True)
class _Subject:
    """A section before it is filled."""

    anchor: str
    title: str
    text: str  # above the tables
    absence: str  # in their place if none has a row
    grids: Callable[[Figures, Links], list[tables.Grid]]


_SUBJECTS = (
    _Subject(
        anchor="road-users",
        title="Road users",
        text=(
            "Tracks by their most frequent class. The hour of the day is the hour (UTC) of the "
            "first frame of a track. Rates per hour are shown from 6 minutes of video on."
        ),
        absence="No clip has tracks.",
        grids=lambda figures, _: [
            _grid("Tracks by class", "class", figures["classes"], _CLASS_COLUMNS),
            _hour_grid(figures["hours"]),
        ],
    ),
    _Subject(
        anchor="coverage",
        title="Distance coverage",
        text=(
            "Fraction of the observed boxes with a distance of the method, by bands of the "
            "filtered fused distance."
        ),
        absence="No box has a distance.",
        grids=lambda figures, _: [_coverage_grid(figures["coverage"])],
    ),
    _Subject(
        anchor="events",
        title="Events",
        text=(
            "The most severe events of all clips: warnings first, then the largest probability of "
            "contact, the shortest time to collision, the smallest distance."
        ),
        absence="No clip has events.",
        grids=lambda figures, links: [
            _grid("Events by kind", "kind", figures["event_kinds"], _KIND_COLUMNS),
            _ranking(
                "Most severe events", figures["events"], _EVENT_MEASURES, links, is_event=True
            ),
        ],
    ),
    _Subject(
        anchor="closest",
        title="Closest approaches",
        text=(
            "Smallest filtered fused distance of a road user, with its standard deviation "
            f"{tables.SIGMA} of at most half the distance; one row per track. x is to the box "
            "centre, positive to the right of the camera."
        ),
        absence="No road user has a distance.",
        grids=lambda figures, links: [
            _ranking("Closest tracks", figures["closest"], _CLOSEST_MEASURES, links)
        ],
    ),
    _Subject(
        anchor="collisions",
        title="Shortest times to collision",
        text=(
            "Time to collision of the front with road users that are on the ego path at that "
            "moment, or will be on it with a probability of at least one half; the path may bend. "
            f"{tables.SIGMA} is at most half of the time; one row per track."
        ),
        absence="No road user on the ego path had a time to collision.",
        grids=lambda figures, links: [
            _ranking("Tracks on the ego path", figures["collisions"], _COLLISION_MEASURES, links)
        ],
    ),
    _Subject(
        anchor="errors",
        title="Errors",
        text="Clips with ground truth. Each figure is the median over the clips.",
        absence="No clip has ground truth (column truth of a manifest).",
        grids=lambda figures, _: [_error_grid(figures["errors"])],
    ),
    _Subject(
        anchor="drift",
        title="Calibration drift",
        text=(
            "Alignment of the two cameras, measured in each run. First and last are medians of up "
            f"to five clips. At most {MAX_GROUPS} rows with the largest changes are shown."
        ),
        absence="No clip has an alignment of two cameras.",
        grids=lambda figures, _: [
            _drift_grid(figures["drift"], name, figures["drift_by"]) for name in ALIGNMENT_FIGURES
        ],
    ),
    _Subject(
        anchor="failures",
        title="Failures",
        text="Failed clips by reason; the option --retry-failed repeats them.",
        absence="No clip failed.",
        grids=lambda figures, _: [
            _text_grid(
                "Failures by reason", figures["failures"], ("kind", "clips", "reason", "names")
            )
        ],
    ),
    _Subject(
        anchor="throughput",
        title="Throughput",
        text="A worker processes one clip at a time.",
        absence="No clip is complete.",
        grids=lambda figures, _: _work_grids(figures),
    ),
    _Subject(
        anchor="notes",
        title="Notes of the runs",
        text="The most frequent notes, with the range of numbers that differ between the clips.",
        absence="The runs have no notes.",
        grids=lambda figures, _: [
            _text_grid("Notes", figures["notes"], ("example", "clips", "note"))
        ],
    ),
)

# most severe events say more than these rankings
_WITHOUT_EVENTS = ("closest", "collisions")


def fleet_sections(figures: Figures, links: Links | None = None) -> list[Section]:
    """All tables of a fleet, by subject."""
    links = links or Links()
    sections = []
    for subject in _SUBJECTS:
        if subject.anchor in _WITHOUT_EVENTS and figures["events"]:
            continue
        grids = tuple(grid for grid in subject.grids(figures, links) if grid.rows)
        sections.append(
            Section(subject.anchor, subject.title, subject.text, grids, subject.absence)
        )
    return sections


def event_grid(title: str, rows: Sequence[Figures]) -> tables.Grid:
    """Table of events of a fleet, with the names of their copied videos if they have been."""
    video = [("video", "video", "{}")] if rows and "video" in rows[0] else []
    return _ranking(title, rows, [*_EVENT_MEASURES, *video], Links(), is_event=True)


def _grid(
    title: str, name: str, rows: Sequence[Figures], columns: Iterable[tables.ColumnSpec]
) -> tables.Grid:
    return tables.grid_of(
        title, name, [str(row[name]) for row in rows], tables.columns_of(rows, columns)
    )


def _hour_grid(rows: Sequence[Figures]) -> tables.Grid:
    rows = [row for row in rows if row["video_h"] >= MIN_H]
    names = [
        tables.NOTHING if row["hour_utc"] is None else f"{row['hour_utc']:02}:00" for row in rows
    ]
    columns = tables.columns_of(rows, [("video h", "video_h", "{:.2f}")])
    for name in rows[0]["tracks"] if rows else ():
        per_hour = [row["tracks"][name] / row["video_h"] for row in rows]
        columns.append(tables.Column(name, per_hour, "{:.0f}"))
    return tables.grid_of(
        "Tracks per hour of video, by hour of the day", "hour UTC", names, columns
    )


def _ranking(
    title: str,
    rows: Sequence[Figures],
    measures: Sequence[_Measure],
    links: Links,
    *,
    is_event: bool = False,
) -> tables.Grid:
    """Table of ranked rows: clip with a link, measures, time in the video with a link, UTC."""
    moment, video = ("peak_s", links.event) if is_event else ("time_s", links.overlay)
    cells = tuple(
        (
            tables.Cell(row["clip"], link=links.report(row)),
            *(tables.Cell(_text(row[key], pattern)) for _, key, pattern in measures),
            tables.Cell(f"{row[moment]:.1f}", link=video(row)),
            tables.Cell(utc_text(row["utc_s"])),
        )
        for row in rows
    )
    return tables.Grid(
        title,
        ("clip", *(heading for heading, _, _ in measures), "time in the clip s", "UTC"),
        cells,
    )


def _coverage_grid(rows: Sequence[Figures]) -> tables.Grid:
    bands = sorted(
        {(row["from_m"], row["to_m"]): row["boxes"] for row in rows}.items(),
        key=lambda band: band[0][0],
    )
    coverage = {(row["method"], row["from_m"]): row["coverage"] for row in rows}
    names = [
        f"{low:g} m and more" if high is None else f"{low:g}-{high:g} m" for (low, high), _ in bands
    ]
    columns = [tables.Column("boxes", [boxes for _, boxes in bands], "{:.0f}")]
    for method in dict.fromkeys(row["method"] for row in rows):
        columns.append(
            tables.Column(
                f"{method} %", [coverage[method, low] for (low, _), _ in bands], "{:.0f}", 100.0
            )
        )
    return tables.grid_of("Coverage by distance band", "distance", names, columns)


def _error_grid(rows: Sequence[Figures]) -> tables.Grid:
    specs = {spec[1]: spec for spec in tables.METHOD_COLUMNS}
    shown = [specs[key] for key in ("coverage", *ERROR_FIGURES) if key in specs]
    columns = (("clips", "clips", "{:.0f}"), *shown, ("worst clip %", "worst_pct"))
    grid = _grid("Distance error, median over the clips", "method", rows, columns)
    with_clip = tuple(
        (*cells, tables.Cell(row["worst_clip"])) for cells, row in zip(grid.rows, rows, strict=True)
    )
    return tables.Grid(grid.title, (*grid.columns, "worst clip"), with_clip)


def _drift_grid(rows: Sequence[Figures], name: str, group: str | None) -> tables.Grid:
    texts = [
        (
            str(row["group"]),
            str(row["clips"]),
            *(utc_text(row.get(key))[:10] for key in ("from_utc_s", "to_utc_s")),
            *(_text(row[name][key], "{:+.2f}") for key in ("median", "first", "last", "change")),
        )
        for row in rows
    ]
    return tables.Grid(
        DRIFT_TITLES[name],
        (group or "", *_DRIFT_COLUMNS),
        tuple(tuple(map(tables.Cell, row)) for row in texts),
    )


def _text_grid(title: str, rows: Sequence[Figures], headings: tuple[str, ...]) -> tables.Grid:
    """Table of reasons or notes, with the number of clips and, for reasons, the names of some
    clips.
    """
    cells = []
    for row in rows:
        texts = {**row, "clips": str(row["n"]), "example": row.get("clip", "")}
        if "names" in headings:
            texts["names"] = ", ".join(row["clips"]) + (
                ", ..." if row["n"] > len(row["clips"]) else ""
            )
        cells.append(tuple(tables.Cell(texts[heading]) for heading in headings))
    return tables.Grid(title, headings, tuple(cells), has_sentences=True)


def _work_grids(figures: Figures) -> list[tables.Grid]:
    work_columns = (*(_hours_column(name, figures) for name in ("video", "worker")), *_WORK_COLUMNS)
    work = tables.columns_of([figures], [("clips/h", "clips_per_hour", "{:.0f}"), *work_columns])
    node_columns = (("clips", "clips", "{:.0f}"), *work_columns, *_MEMORY_COLUMNS)
    stages_ms = figures["stages_ms"]
    speeds = [tables.Column("ms/frame", [*stages_ms.values()], "{:.2f}")]
    speeds.append(tables.Column("frames/s", [1000 / ms for ms in stages_ms.values()]))
    return [
        tables.grid_of("Work", "", ["all clips"], work)
        if figures["nodes"]
        else tables.Grid("Work", (), ()),
        _grid("Nodes, with the memory of a worker", "node", figures["nodes"], node_columns),
        tables.grid_of("Run time by stage (stages overlap)", "stage", list(stages_ms), speeds),
    ]


def _hours_column(name: str, figures: Figures) -> tables.ColumnSpec:
    unit, *form = ("s", "{:.1f}", 3600.0) if figures[f"{name}_h"] < MIN_H else ("h", "{:.2f}")
    return (f"{name} {unit}", f"{name}_h", *form)


def _text(value: Any, pattern: str) -> str:
    return tables.NOTHING if value is None else pattern.format(value)


def utc_text(utc_s: float | None) -> str:
    """A Unix time as "2026-05-04 08:10:02"; "-" = unknown."""
    if utc_s is None:
        return tables.NOTHING
    try:
        return datetime.fromtimestamp(utc_s, UTC).strftime("%Y-%m-%d %H:%M:%S")
    except (ValueError, OverflowError, OSError):
        return tables.NOTHING
