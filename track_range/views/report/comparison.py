"""Comparison of runs: events that differ, a row per run with its results, and settings that differ.

Events of two runs match if they are of the same kind, if their times overlap within
`TIME_TOLERANCE_S`, and if the boxes of their tracks overlap in the frames that both tracks have
(median IoU), or if their distances are similar where no boxes are known. The pairs with the nearest
peaks are matched first.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from track_range.detection.boxes import iou
from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import counted
from track_range.pipeline.colours import OTHER_COLOURS, method_colours
from track_range.results.events.event import EVENT_KINDS, Event
from track_range.results.rows.rows import Rows
from track_range.views import tables
from track_range.views.report.content.errors import band_line
from track_range.views.report.content.events import (
    event_details,
    kind_words,
    object_words,
    time_words,
)
from track_range.views.report.paired_comparison import paired_grid
from track_range.views.report.sentences import address, flattened, run_name
from track_range.views.report.track_comparison import picture, track_differences, unmatched_names
from track_range.views.tables import (
    Cell,
    Column,
    ColumnSpec,
    Grid,
    columns_of,
    figure,
    grid_of,
)

TIME_TOLERANCE_S = 0.5  # largest gap in s between the times of matching events
MIN_IOU = 0.3  # smallest median IoU of the boxes of matching events
# largest differences of matching events without common frames
_DISTANCE_FRACTION, _DISTANCE_M = 0.2, 2.0
# differences that are listed: s, and in joint sigmas of distances
_CHANGED_S, _CHANGED_SIGMA = 0.2, 1.0
# relative difference of distances without a standard deviation that is listed
_CHANGED_FRACTION = 0.1
# of a pair of runs: road users that are in one run only, and with pictures
_MOST_NAMED, _MOST_PICTURES = 10, 6
_ARROW = "\N{RIGHTWARDS ARROW}"

_RUN_COLUMNS: tuple[ColumnSpec, ...] = (
    ("frames", "frames", "{:.0f}"),
    ("frames/s", "frames_per_s", "{:.1f}"),
)

_TRACK_COLUMNS: tuple[ColumnSpec, ...] = (
    ("tracks", "n", "{:.0f}"),
    ("HOTA %", "hota", "{:.1f}"),
    ("MOTA %", "mota", "{:.1f}"),
    ("IDF1 %", "idf1", "{:.1f}"),
    ("ID switches", "idsw", "{:.0f}"),
    ("true boxes", "n_truth_boxes", "{:.0f}"),
    ("true tracks", "n_truth_tracks", "{:.0f}"),
)

# no figure is marked as the best of several runs: whether it is more than noise shows in the errors
# on common boxes (`paired_comparison`)
_METHOD_GRIDS = (  # title, key in a method's row, format and scale
    ("Median distance error on own coverage, %", "median_relative_error_pct", "{:.2f}", 1.0),
    ("Mean distance error, %", "mean_relative_error_pct", "{:.2f}", 1.0),
    ("Distances within 25 %, %", "within_25_percent", "{:.1f}", 100.0),
    ("Bias, %", "bias_pct", "{:+.2f}", 1.0),
    ("Coverage, %", "coverage", "{:.1f}", 100.0),
    (f"Errors within one {tables.SIGMA}, % (expected: 68)", "within_1_sigma", "{:.0f}", 100.0),
)

_OMITTED = ("out", "overwrite", "versions")  # settings that do not affect the results


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparedRun:
    """A run of a comparison: a short and unique name, and the content of its folder."""

    name: str
    summary: Mapping[str, Any]
    settings: Mapping[str, Any]
    link: str | None = None  # address of its report relative to the page
    notes: tuple[str, ...] = ()  # messages about missing files
    events: tuple[Event, ...] | None = None  # None = unknown
    rows: Rows = field(default_factory=Rows)
    overlay: Path | None = None  # its video; None = it has none

    @property
    def video(self) -> str:
        """Name of the left or only video."""
        inputs = self.section("inputs")
        return run_name(
            {"inputs": {"left": inputs.get("left") or inputs.get("video") or inputs.get("mono")}}
        )

    def section(self, name: str) -> Mapping[str, Any]:
        """A section of the summary; empty if it is missing."""
        return self.summary.get(name) or {}


def comparison_grids(runs: Sequence[ComparedRun]) -> list[Grid]:
    """Tables with a row per run: main results, results of each method, run time of each stage."""
    names = [run.name for run in runs]
    columns = columns_of((run.summary for run in runs), _RUN_COLUMNS)
    columns += columns_of((run.section("tracks") for run in runs), _TRACK_COLUMNS)
    grids = [grid_of("Runs", "run", names, columns)]
    methods = [run.section("methods") for run in runs]
    for title, *spec in _METHOD_GRIDS:
        columns = [
            _method_column(name, [rows.get(name) or {} for rows in methods], spec)
            for name in _keys(methods)
        ]
        grids.append(grid_of(f"{title} (n)", "run", names, columns))
    grids.append(_stage_grid(runs, names))
    return [grid for grid in grids if grid.rows and len(grid.columns) > 1]


def _method_column(name: str, rows: Sequence[Mapping[str, Any]], spec: Sequence[Any]) -> Column:
    """A figure of a method in each run, with the number of boxes behind it."""
    key, pattern, scale = spec
    values, counts = [figure(row, key) for row in rows], [figure(row, "n") for row in rows]
    details = [
        "" if value is None or n is None else f" ({n:.0f})"
        for value, n in zip(values, counts, strict=True)
    ]
    return Column(name, values, pattern, scale, details=details)


def paired_grids(runs: Sequence[ComparedRun]) -> list[Grid]:
    """Errors of each further run on the boxes that it and the first run measured; none if their
    labels have other true distances.
    """
    first = runs[0]
    grids = [paired_grid((first.name, run.name), (first.rows, run.rows)) for run in runs[1:]]
    return [grid for grid in grids if grid.rows]


def _stage_grid(runs: Sequence[ComparedRun], names: Sequence[str]) -> Grid:
    stages = [run.section("stages_ms") for run in runs]
    columns = []
    for stage in _keys(stages):
        values = [figure(times, stage) or None for times in stages]
        columns.append(Column(stage, values))
    title = "Run time by stage in ms per frame (stages overlap)"
    return grid_of(title, "run", names, columns)


def _keys(sections: Iterable[Mapping[str, Any]]) -> list[str]:
    """The keys of all sections, in the order of their first appearance."""
    return list(dict.fromkeys(key for section in sections for key in section))


def settings_grid(runs: Sequence[ComparedRun]) -> Grid:
    """A row per setting that differs between runs."""
    settings = [dict(flattened(run.settings)) for run in runs]
    names = [
        name
        for name in dict.fromkeys(name for values in settings for name in values)
        if name not in _OMITTED
    ]
    rows = [[name, *(values.get(name, tables.NOTHING) for values in settings)] for name in names]
    different = [tuple(Cell(text) for text in row) for row in rows if len(set(row[1:])) > 1]
    return Grid("Settings that differ", ("setting", *(run.name for run in runs)), tuple(different))


def comparison_notes(runs: Sequence[ComparedRun]) -> list[str]:
    """Reasons why the results of the runs may not be comparable."""
    notes = []
    if len({run.video for run in runs}) > 1:
        notes.append(
            "The runs are of different videos, so their errors are not directly comparable."
        )
    if len({str(run.summary.get("truth")) for run in runs}) > 1:
        notes.append(
            "The runs were not evaluated against the same kind of ground truth, or some runs had "
            "no ground truth."
        )
    offsets_s = {figure(run.section("targets"), "offset_s") for run in runs}
    if len(offsets_s - {None}) > 1:
        notes.append(
            "The clock of the targets was shifted differently for the runs, so that they have no "
            "true distances in common; evaluate both with the same --truth-offset-s."
        )
    if len({run.summary.get("frames") for run in runs}) > 1:
        notes.append("The runs have different numbers of frames.")
    return notes


def error_lines(runs: Sequence[ComparedRun]) -> list[dict[str, Any]]:
    """Mean error of `fused` by distance band, one line per run with ground truth: name, colour, x
    in m, y in %.
    """
    palette = (*dict.fromkeys([*reversed(method_colours().values()), *OTHER_COLOURS]),)
    lines = []
    for i, run in enumerate(runs):
        known = band_line(run.section("methods").get("fused") or {})
        if known:
            x, y = zip(*known, strict=True)
            lines.append({"name": run.name, "colour": palette[i % len(palette)], "x": x, "y": y})
    return lines


# -- road users
# -------------------------------------------------------------------------------------------------------


def compared_tracks(runs: Sequence[ComparedRun]) -> list[dict[str, Any]]:
    """The road users of each further run on the first run's video, beside the road users of the
    first run.

    Keys: `grid`, `sentences`, and `pictures` of the largest disagreements: `text`, and `images`
    (name of the run, distance and data URI, "" = none, of each run).
    """
    return [_compared_pair(runs[0], run) for run in runs[1:] if run.video == runs[0].video]


_PAIR_HEADINGS = (
    "road user",
    f"largest difference {tables.SIGMA}",
    "distances",
    "time",
    "median %",
    "closing m/s",
    "frames",
)


def _compared_pair(first: ComparedRun, second: ComparedRun) -> dict[str, Any]:
    differences, matched = track_differences(first.rows, second.rows)
    large = [one for one in differences if one["sigmas"] >= _CHANGED_SIGMA]
    sentences = [f"{counted(len(differences), 'road user')} in both runs."]
    for run, ids in zip((first, second), matched, strict=True):
        only = [*unmatched_names(run.rows, ids)]
        more = f" and {len(only) - _MOST_NAMED} more" if len(only) > _MOST_NAMED else ""
        if only:
            sentences.append(f"Only in {run.name}: {', '.join(only[:_MOST_NAMED])}{more}.")
    title = f"Road users, the largest disagreement first: {first.name} and {second.name}"
    rows = tuple(_difference_row(one, first.link) for one in differences)
    return {
        "grid": Grid(title, _PAIR_HEADINGS, rows),
        "sentences": sentences,
        "pictures": [_pictured(one, (first, second)) for one in large[:_MOST_PICTURES]],
    }


def _difference_words(difference: Mapping[str, Any]) -> tuple[str, str]:
    """The names of a road user, and its two distances."""
    names = " / ".join(dict.fromkeys(difference["names"]))
    return names, f" {_ARROW} ".join(difference["words"])


def _difference_row(difference: Mapping[str, Any], link: str | None) -> tuple[Cell, ...]:
    """Cells for `_PAIR_HEADINGS`; the time leads to the first run's report with this link."""
    name, distances = _difference_words(difference)
    time_s, closing_mps = difference["time_s"], difference["closing_mps"]
    at = f"{address(link)}#t={time_s:.3f}" if link else ""
    return (
        Cell(name),
        Cell(f"{difference['sigmas']:.1f}"),
        Cell(distances),
        Cell(time_words(time_s), link=at),
        Cell(f"{difference['difference_pct']:+.1f}"),
        Cell(tables.NOTHING if math.isnan(closing_mps) else f"{closing_mps:+.1f}"),
        Cell(str(difference["frames"])),
    )


def _pictured(difference: Mapping[str, Any], runs: Sequence[ComparedRun]) -> dict[str, Any]:
    """Text and pictures of a difference: name of the run, distance and data URI of each run."""
    name, distances = _difference_words(difference)
    time_s = difference["time_s"]
    images = []
    for run, words, box in zip(runs, difference["words"], difference["boxes"], strict=True):
        start_s = figure(run.summary, "starts_s") or 0.0
        images.append((run.name, words, picture(run.overlay, time_s - start_s, box)))
    apart = f"{difference['sigmas']:.1f} {tables.SIGMA} apart"
    return {"text": f"{name} at {time_words(time_s)}: {distances}, {apart}", "images": images}


# -- events
# -----------------------------------------------------------------------------------------------------------


def event_grids(runs: Sequence[ComparedRun]) -> list[Grid]:
    """Events of each further run that differ from the first run, then the number of events by kind.

    Runs of different videos and runs without events are not compared; equal events have no table.
    """
    grids = [_difference_grid(runs[0], other) for other in _comparable(runs)] + [_count_grid(runs)]
    return [grid for grid in grids if grid.rows]


def _comparable(runs: Sequence[ComparedRun]) -> list[ComparedRun]:
    """Runs with events on the same video as the first."""
    first = runs[0]
    if first.events is None:
        return []
    return [run for run in runs[1:] if run.events is not None and run.video == first.video]


def event_sentence(runs: Sequence[ComparedRun]) -> str:
    """Why there is no table of events that differ; "" if there is one."""
    if runs[0].events is None:
        return "The events of the first run are unknown."
    others = _comparable(runs)
    if not others:
        return "The events were not compared: no other run is of the same video and has events."
    if any(
        event_differences(runs[0].events, runs[0].rows, run.events or (), run.rows)
        for run in others
    ):
        return ""
    return (
        "The runs have the same events."
        if any(run.events for run in others)
        else "The runs have no events."
    )


def _difference_grid(first: ComparedRun, second: ComparedRun) -> Grid:
    """One row per differing event: time, with a link to that moment in the report of its run, kind,
    and difference.
    """
    rows = []
    for difference in event_differences(
        first.events or (), first.rows, second.events or (), second.rows
    ):
        event, run = difference.event, first if difference.first else second
        time = Cell(
            time_words(event.start_s),
            link=f"{address(run.link)}#t={event.start_s:.3f}" if run.link else "",
        )
        objects = dict.fromkeys(
            object_words(one) for one in (difference.first, difference.second) if one
        )
        state = "changed" if difference.changes else f"only in {run.name}"
        details = "; ".join(difference.changes) or event_details(event)
        texts = (state, kind_words(event.kind), " / ".join(objects), details)
        rows.append((time, *map(Cell, texts)))
    columns = ("time", "difference", "event", "object", "details")
    return Grid(
        f"Events that differ: {first.name} and {second.name}",
        columns,
        tuple(rows),
        has_sentences=True,
    )


def _count_grid(runs: Sequence[ComparedRun]) -> Grid:
    """One row per run: number of events of each kind that occurs in a run, and of warnings; empty =
    unknown.
    """
    counts: list[dict[str, float] | None] = [
        None
        if run.events is None
        else {kind: sum(event.kind == kind for event in run.events) for kind in EVENT_KINDS}
        | {"warnings": sum(math.isfinite(event.warning_s) for event in run.events)}
        for run in runs
    ]
    kinds = [kind for kind in EVENT_KINDS if any(count and count[kind] for count in counts)]
    if not kinds:
        return Grid("Number of events", (), ())
    columns = columns_of(
        (count or {} for count in counts),
        [
            *((kind_words(kind), kind, "{:.0f}") for kind in kinds),
            ("with a warning", "warnings", "{:.0f}"),
        ],
    )
    return grid_of("Number of events", "run", [run.name for run in runs], columns)


@dataclass(frozen=True, slots=True)
class EventDifference:
    """Events of two runs that differ; None = the event is only in the other run. `changes`: their
    differences.
    """

    first: Event | None
    second: Event | None
    changes: tuple[str, ...] = ()

    @property
    def event(self) -> Event:
        """The event of the first run, else of the second run."""
        event = self.first or self.second
        if event is None:
            raise ValueError("a difference without events")
        return event


def event_differences(
    first: Sequence[Event], first_rows: Rows, second: Sequence[Event], second_rows: Rows
) -> list[EventDifference]:
    """Events of two runs that differ, in the order of time; the rows of the runs give the
    places.
    """
    first_boxes, second_boxes = _boxes_by_track(first_rows), _boxes_by_track(second_rows)
    candidates = sorted(
        (abs(a.peak_s - b.peak_s), i, j)
        for i, a in enumerate(first)
        for j, b in enumerate(second)
        if a.kind == b.kind
        and a.start_s <= b.end_s + TIME_TOLERANCE_S
        and b.start_s <= a.end_s + TIME_TOLERANCE_S
        and _is_same_place(a, first_boxes.get(a.track_id, {}), b, second_boxes.get(b.track_id, {}))
    )
    pairs: dict[int, int] = {}
    matched: set[int] = set()
    for _, i, j in candidates:
        if i not in pairs and j not in matched:
            pairs[i] = j
            matched.add(j)
    differences = [EventDifference(event, None) for i, event in enumerate(first) if i not in pairs]
    differences += [
        EventDifference(None, event) for j, event in enumerate(second) if j not in matched
    ]
    for i, j in pairs.items():
        changes = tuple(_changes(first[i], second[j]))
        differences += [EventDifference(first[i], second[j], changes)] if changes else []
    return sorted(differences, key=lambda difference: difference.event.start_s)


_BoxByFrame = dict[int, FloatArray]


def _boxes_by_track(rows: Rows) -> dict[int, _BoxByFrame]:
    boxes: dict[int, _BoxByFrame] = {}
    keys = rows["track_id"].tolist(), rows["frame"].tolist()
    for track_id, frame, box in zip(*keys, rows.boxes_px, strict=True):
        boxes.setdefault(track_id, {})[frame] = box
    return boxes


def _is_same_place(a: Event, a_boxes: _BoxByFrame, b: Event, b_boxes: _BoxByFrame) -> bool:
    low, high = sorted((a.frame, b.frame))
    margin = max(10, high - low)
    frames = [
        frame for frame in a_boxes if frame in b_boxes and low - margin <= frame <= high + margin
    ]
    if frames:
        overlaps = [
            float(iou(a_boxes[frame][None], b_boxes[frame][None])[0, 0]) for frame in frames
        ]
        return float(np.median(overlaps)) >= MIN_IOU
    difference_m = abs(a.min_distance_m - b.min_distance_m)  # NaN = unknown
    largest_m = max(_DISTANCE_M, _DISTANCE_FRACTION * max(a.min_distance_m, b.min_distance_m))
    return not difference_m > largest_m


def _changes(a: Event, b: Event) -> Iterator[str]:
    if a.class_name != b.class_name:
        yield f"class {a.class_name} {_ARROW} {b.class_name}"
    yield from _changed_time("warning", a.warning_s, b.warning_s)
    yield from _changed_time("start", a.start_s, b.start_s)
    yield from _changed_time("end", a.end_s, b.end_s)
    tolerance_m = _CHANGED_SIGMA * math.hypot(a.min_distance_sigma_m, b.min_distance_sigma_m)
    if not math.isfinite(tolerance_m):
        tolerance_m = _CHANGED_FRACTION * max(a.min_distance_m, b.min_distance_m)
    if abs(a.min_distance_m - b.min_distance_m) > tolerance_m:
        yield f"smallest distance {a.min_distance_m:.1f} {_ARROW} {b.min_distance_m:.1f} m"
    yield from _changed_time("time to collision", a.min_ttc_s, b.min_ttc_s, is_duration=True)


def _changed_time(name: str, a_s: float, b_s: float, *, is_duration: bool = False) -> Iterator[str]:
    if math.isnan(a_s) != math.isnan(b_s):
        first, second = ("none" if math.isnan(value) else time_words(value) for value in (a_s, b_s))
        yield f"{name} {first} {_ARROW} {second}"
    elif abs(a_s - b_s) > _CHANGED_S and not is_duration:
        yield f"{name} {abs(a_s - b_s):.1f} s {'later' if b_s > a_s else 'earlier'}"
    elif abs(a_s - b_s) > _CHANGED_S:
        yield f"{name} {a_s:.1f} {_ARROW} {b_s:.1f} s"
