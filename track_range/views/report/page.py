"""The report: one self-contained HTML page of a run, or of several runs; it works offline.

The overlay video is a separate file. All text from outside (names of files and classes, notes) is
escaped, in the markup and in the embedded data. Script and style are embedded, and a content
security policy with the checksum of the script blocks all other scripts.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import numpy.typing as npt
from scipy.special import expit

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import real_path
from track_range.foundation.files.output_files import write_text
from track_range.pipeline.colours import colour_of_each
from track_range.ranging.warning.sequential_test import threshold
from track_range.ranging.warning.settings import WarningSettings
from track_range.results.approaches import closest_approaches
from track_range.results.events.event import Event, is_clip_name
from track_range.results.formats.poses_file import Poses
from track_range.results.rows.rows import Rows
from track_range.views import tables
from track_range.views.report import comparison, sentences
from track_range.views.report.content.camera import camera_picture
from track_range.views.report.content.counts import (
    fixed_headlines,
    is_fixed,
    line_grid,
    speed_grid,
    speed_histogram,
    zone_grid,
)
from track_range.views.report.content.drive_map import drive_map
from track_range.views.report.content.errors import calibration_curves, error_curves
from track_range.views.report.content.events import (
    clips_of,
    event_records,
    hidden_events_note,
    shown_events,
)
from track_range.views.report.content.road import (
    box_columns,
    camera_of_rows,
    road_columns,
    uncalibrated_video,
)
from track_range.views.report.content.series import timeline, track_records
from track_range.views.tables import accuracy_grids, mot_grid, speed_grids

_SCRIPTS = (  # in the order of their execution
    *("elements", "theme_and_tables", "drawing", "tracks", "birds_eye"),
    *("timeline", "event_probability", "playback", "drive_map", "known_distances"),
    *("run_charts", "start"),
)


def write_report(
    path: Path,
    summary: Mapping[str, Any],
    columns: Rows | Mapping[str, npt.NDArray[Any]],
    events: Sequence[Event] | None = None,
    *,
    clips: Path | None = None,
    poses: Poses | None = None,
) -> None:
    """Write the report of a run atomically, usually beside overlay.mp4; OutputError if the file
    cannot be written.

    `columns` are the rows of tracks.csv, or its columns by name, NaN = empty, with the ground truth
    (`results.summary`) where there is one; zero rows without tracks. `events` are in the order of
    events.csv; None = unknown, the page is then without them. `clips` is the folder of their clips,
    to which the page links; it may be missing. None = no links. `poses` are the camera's, for the
    map of the drive; None = no map.
    """
    addresses = {}
    with suppress(OSError):  # the folder of the clips is missing
        if clips is not None:
            names = [entry.name for entry in clips.iterdir() if is_clip_name(entry.name)]
            start = Path(os.path.relpath(real_path(clips), real_path(path.parent))).as_posix()
            addresses = {name: sentences.address(f"{start}/{name}") for name in names}
    _write_page(path, report_page(summary, columns, events, clips=addresses, poses=poses))


def write_comparison(
    path: Path, runs: Sequence[comparison.ComparedRun], tracks: Sequence[Mapping[str, Any]]
) -> None:
    """Write `comparison_page`, atomically; OutputError if the file cannot be written."""
    _write_page(path, comparison_page(runs, tracks))


def _write_page(path: Path, page: str) -> None:
    # File names may contain bytes that are not UTF-8; they are replaced by question marks.
    write_text(path, page.encode("utf-8", "replace").decode("utf-8"))


def report_page(
    summary: Mapping[str, Any],
    columns: Rows | Mapping[str, npt.NDArray[Any]],
    events: Sequence[Event] | None = None,
    *,
    clips: Mapping[str, str] | None = None,
    poses: Poses | None = None,
) -> str:
    """HTML of the report of a run; `columns`, `events` and `poses`: see `write_report`; `clips`:
    addresses by file name.
    """
    rows = columns if isinstance(columns, Rows) else Rows(columns)
    rows = rows.with_columns(
        {
            **road_columns(rows),
            **box_columns(rows, summary),
            "alarm_threshold": _alarm_threshold(rows, _alarm_thresholds(summary)),
        }
    )
    tracks, users = summary.get("tracks") or {}, closest_approaches(rows)
    overlay = (summary.get("files") or {}).get("overlay")
    shown = None if events is None else shown_events(events)
    content = {**run_content(summary, rows, shown or ()), "map": drive_map(rows, poses)}
    accuracy, mot = accuracy_grids(summary), mot_grid(tracks)
    speed, geometry = speed_grids(summary), sentences.geometry_sentences(summary)
    is_static = is_fixed(summary)
    sections = {
        "overview": "Overview",
        "counts": "Counts and speeds" if is_static else "",
        "map": "Map" if content["map"] else "",
        "tracks": "Distance over time",
        "accuracy": "Accuracy" if content["errors"] else "Coverage",
        "errors": "Errors by distance" if content["errors"] else "",
        "sigma": "Uncertainty" if content["calibration"] else "",
        "tracking": "Tracking" if len(mot.rows) > 1 else "",
        "speed": "Speed",
        "geometry": "Calibration" if geometry else "",
        "settings": "Settings",
    }
    span_s = content["timeline"]["to_s"] - content["timeline"]["from_s"]
    return rendered(
        "report.html.j2",
        title=sentences.run_name(summary),
        subtitle=sentences.run_line(summary, len(users), span_s),
        sections={anchor: name for anchor, name in sections.items() if name},
        headlines=fixed_headlines(summary)
        if is_static
        else sentences.headlines(rows, users, events, summary.get("visibility")),
        counts=[grid for grid in _count_grids(summary) if grid.rows] if is_static else [],
        histogram=speed_histogram(summary) if is_static else None,
        events=None
        if shown is None or is_static
        else event_records(shown, clips_of(events or (), shown, clips or {})),
        events_note=hidden_events_note(events or (), shown or ()),
        has_road=any("x" in track for track in content["tracks"]),
        notes=summary.get("notes") or [],
        video=sentences.address(str(overlay)) if overlay else None,
        has_known_distances=content["known_distances"] is not None and bool(content["tracks"]),
        truth=summary.get("truth"),
        accuracy=accuracy,
        speed=speed,
        mot=mot,
        mot_classes=tracks.get("classes") or [],
        mot_rule=tracks.get("rule"),
        sigma_sentences=sentences.sigma_sentences(summary),
        geometry=geometry,
        camera=camera_picture(summary),
        rig=tables.rig_grid((summary.get("alignment") or {}).get("health") or {}),
        n_tracks=len(np.unique(rows["track_id"])),
        settings=list(sentences.settings_groups(summary)),
        content=embedded(content),
    )


def _count_grids(summary: Mapping[str, Any]) -> tuple[tables.Grid, ...]:
    return line_grid(summary), zone_grid(summary), speed_grid(summary)


def comparison_page(
    runs: Sequence[comparison.ComparedRun], tracks: Sequence[Mapping[str, Any]]
) -> str:
    """HTML of the page that compares several runs; `tracks` are their `compared_tracks`."""
    lines = comparison.error_lines(runs)
    return rendered(
        "comparison.html.j2",
        title=f"Comparison of {len(runs)} runs",
        runs=[
            {
                "name": run.name,
                "link": sentences.address(run.link) if run.link else None,
                "notes": run.notes,
            }
            for run in runs
        ],
        notes=comparison.comparison_notes(runs),
        tracks=tracks,
        event_grids=comparison.event_grids(runs),
        event_sentence=comparison.event_sentence(runs),
        paired=comparison.paired_grids(runs),
        grids=comparison.comparison_grids(runs),
        settings=comparison.settings_grid(runs),
        has_errors=bool(lines),
        content=embedded({"lines": lines}),
    )


def run_content(
    summary: Mapping[str, Any], rows: Rows, events: Sequence[Event] = ()
) -> dict[str, Any]:
    """Data for the script of the page; rows with `road_columns` where they are known."""
    errors, calibration = error_curves(rows, summary), calibration_curves(rows, summary)
    names = [*dict.fromkeys([*rows.methods_measured, *errors, *calibration])]
    colours = colour_of_each(names)
    camera = camera_of_rows(rows)
    view = None  # focal length in px, and slopes x / z of the left and the right edge of the image
    if camera is not None:
        left, right = (
            round((edge_px - camera.cx_px) / camera.fx_px, 4)
            for edge_px in (0, camera.width_px - 1)
        )
        view = {"focal_px": round(camera.fx_px, 1), "left": left, "right": right}
    return {
        # filtered methods are hidden at first where the unfiltered method is shown
        "methods": [
            {
                "name": name,
                "label": tables.shown_name(summary, name),
                "colour": colours[name],
                "shown": not (name.endswith("_kf") and name[:-3] in names),
            }
            for name in names
        ],
        "tracks": list(track_records(rows)),
        "errors": errors,
        "signed": any(curve["points"][0] for curve in errors.values()),
        "calibration": calibration,
        # time of the overlay's first frame
        "starts_s": round(tables.figure(summary, "starts_s") or 0.0, 6),
        "timeline": timeline(rows, summary),
        "events": event_records(events),
        "camera": view,
        "known_distances": uncalibrated_video(summary),
        "alarm": _alarm_thresholds(summary),
        "has_warnings": bool(np.isfinite(rows["contact_probability"]).any()),
    }


def _alarm_thresholds(summary: Mapping[str, Any]) -> dict[str, float]:
    """Probabilities of contact from which an alarm starts where hard braking is needed, and below
    which it ends.
    """
    given = (summary.get("settings") or {}).get("warning_options") or {}
    chosen = {**asdict(WarningSettings()), **given}
    return {key: chosen[f"{key}_probability"] for key in ("on", "person", "off")}


def _alarm_threshold(rows: Rows, limits: Mapping[str, float]) -> FloatArray:
    """(N,) probability of contact from which an alarm starts, by the deceleration that is needed
    after the reaction time if the object keeps its speed; where it brakes, the alarm needs less.
    NaN = that is unknown, as beside the path.
    """
    is_person = np.asarray(rows["class"]) == "person"
    on = np.where(is_person, limits["person"], limits["on"])
    return np.asarray(expit(threshold(on, rows["mdrac_mps2"])))


def embedded(content: Mapping[str, Any]) -> str:
    """JSON for embedding in an HTML element: characters that could begin markup or a comment are
    escaped.
    """
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def rendered(template: str, **values: Any) -> str:
    """HTML of a template in assets/, with the values and the script and style of all pages."""
    script, style = packaged_script(), _packaged("report.css")
    checksum = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return (
        _templates()
        .get_template(template)
        .render(script=script, style=style, script_checksum=checksum, **values)
    )


@cache
def _templates() -> jinja2.Environment:
    # Autoescape is set explicitly: jinja2's choice by file suffix does not cover `.j2`.
    return jinja2.Environment(
        loader=jinja2.PackageLoader("track_range.views.report", "assets"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def packaged_script() -> str:
    """The script of all pages: its parts in one scope."""
    parts = "\n".join(_packaged(f"script/{name}.js") for name in _SCRIPTS)
    return f'"use strict";\n(() => {{\n{parts}}})();\n'


def _packaged(name: str) -> str:
    return (files("track_range.views.report") / "assets" / name).read_text(encoding="utf-8")
