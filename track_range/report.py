"""The report: one self-contained page of a run, from its summary and its tracks; it needs no network and no script.

The overlay video stays a file beside the page. Everything that a user or a model could have named (files, classes,
notes) is escaped; only the charts, which hold numbers and our own words, go in as they are.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

import jinja2
import numpy as np
import numpy.typing as npt

from track_range import charts, tables
from track_range.charts import Columns
from track_range.written import write_text

CHARTED_TRACKS = 12
"""Tracks with a chart of their own, the longest ones; a page of thousands would open slowly and be read by nobody."""

SETTINGS_GROUPS = {"inputs": "Inputs", "settings": "Settings", "versions": "Versions"}
"""Parts of a summary that are shown as they are, with their headings."""


def write_report(path: Path, summary: Mapping[str, Any], columns: Columns) -> None:
    """Write the page of a run; the file appears whole or not at all.

    Args:
        path: the file to write, usually report.html beside overlay.mp4.
        summary: what summary.json holds.
        columns: tracks.csv by column, NaN = empty; zero rows when nothing was tracked.

    Raises:
        OutputError: the file cannot be written.
    """
    # A file name need not be text: what UTF-8 cannot hold becomes a question mark.
    write_text(path, report_page(summary, columns).encode("utf-8", "replace").decode("utf-8"))


def report_page(summary: Mapping[str, Any], columns: Columns) -> str:
    """The page's HTML."""
    # Autoescape is on by name: the usual choice by file ending does not know `.j2`.
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("track_range", ""),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("report.html.j2").render(
        title=run_name(summary),
        cards=list(cards(summary)),
        notes=summary.get("notes") or [],
        video=video_link(summary),
        truth=summary.get("truth"),
        grids=tables.grids(summary),
        charts=list(run_charts(summary, columns)),
        tracks=list(track_charts(columns)),
        n_tracks=len(np.unique(columns["track_id"])),
        settings=list(settings_groups(summary)),
    )


def run_name(summary: Mapping[str, Any]) -> str:
    """The inputs' names: what a reader calls the run."""
    inputs = summary.get("inputs") or {}
    named = [str(inputs[key]) for key in ("left", "right", "video", "mono") if inputs.get(key)]
    return " + ".join(named) or "A run"


def cards(summary: Mapping[str, Any]) -> Iterator[dict[str, str]]:
    """The figures to see first: frames, speed, tracks, the best method."""
    wall_s, fps = tables.figure(summary, "wall_s"), tables.frames_per_s(summary)
    yield card("frames", summary.get("frames"), f"in {wall_s:.1f} s" if wall_s else "")
    yield card("frames per second", None if fps is None else f"{fps:.1f}", "all stages, wall clock")
    yield card("tracks", (summary.get("tracks") or {}).get("n"), "confirmed road users")
    best = best_method(summary)
    if best:
        name, error_pct, where = best
        yield card("median distance error", f"{error_pct:.1f} %", f"{name}, the best {where}")


def card(name: str, value: object, detail: str) -> dict[str, str]:
    """One card; a value that is None was not measured."""
    return {"name": name, "value": tables.NOTHING if value is None else str(value), "detail": detail}


def best_method(summary: Mapping[str, Any]) -> tuple[str, float, str] | None:
    """Name and median relative error of the best method and where it is best, None without truth.

    Common coverage decides where there is one: elsewhere a method may win by refusing the hard ones.
    """
    for part, where in (("common", "on common coverage"), ("methods", "where it measured")):
        found = {
            name: error
            for name, row in (summary.get(part) or {}).items()
            if (error := tables.figure(row, "median_relative_error_pct")) is not None
        }
        if found:
            name = min(found, key=lambda each: found[each])
            return name, found[name], where
    return None


def video_link(summary: Mapping[str, Any]) -> str | None:
    """Address of the overlay video relative to the page, None when the run wrote none."""
    name = (summary.get("files") or {}).get("overlay")
    return quote(Path(name).name) if name else None


def run_charts(summary: Mapping[str, Any], columns: Columns) -> Iterator[dict[str, str]]:
    """The charts of the whole run that its columns and summary allow."""
    error = charts.error_chart(columns)
    if error:
        yield {"name": "Error against distance", "svg": error}
    stages = charts.stage_chart(summary.get("stages_ms") or {})
    if stages:
        yield {"name": "Time per stage", "svg": stages}


def track_charts(columns: Columns) -> Iterator[dict[str, str]]:
    """Distance over time of the longest tracks, the longest first."""
    ids, n_rows = np.unique(columns["track_id"], return_counts=True)
    for track_id in ids[np.argsort(-n_rows, kind="stable")][:CHARTED_TRACKS].tolist():
        rows = columns["track_id"] == track_id
        svg = charts.distance_chart(columns, track_id)
        name = f"{columns['class'][rows][0]} {track_id:.0f}"
        yield {"name": name, "detail": track_detail(columns, rows), "svg": svg}


def track_detail(columns: Columns, rows: npt.NDArray[np.bool_]) -> str:
    """When a track was there, how near it came and how urgent it was, in one line."""
    time_s = charts.column(columns, "time_s", rows)
    n = int(np.sum(rows))
    words = [f"{n} frame{'s' if n > 1 else ''}, {time_s.min():.1f} to {time_s.max():.1f} s"]
    for name, pattern in (("fused_m", "nearest {:.1f} m"), ("ttc_s", "shortest time to collision {:.1f} s")):
        values = charts.column(columns, name, rows)
        words += [pattern.format(np.nanmin(values))] if np.isfinite(values).any() else []
    return " · ".join(words)


def settings_groups(summary: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """What is needed to repeat the run, as rows of dotted names and values."""
    for key, name in SETTINGS_GROUPS.items():
        rows = list(flattened(summary.get(key) or {}))
        if rows:
            yield {"name": name, "rows": rows}


def flattened(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Leaves of nested mappings as (dotted name, text)."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from flattened(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", tables.NOTHING if value is None else str(value)
