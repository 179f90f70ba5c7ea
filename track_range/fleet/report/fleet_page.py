"""The page of a fleet: one self-contained HTML file with links to the reports and overlays of the
clips.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

from track_range.fleet.output.data_set import RUNS, partition
from track_range.fleet.output.state import duration_text
from track_range.fleet.report.fleet_figures import FleetFigures, event_video
from track_range.fleet.report.fleet_grids import DRIFT_TITLES, Links, fleet_sections, utc_text
from track_range.fleet.report.track_figures import Figures
from track_range.fleet.storage.location import Location
from track_range.pipeline.colours import FUSED_COLOUR, OTHER_COLOURS, method_colours
from track_range.views.report.content.series import thinned
from track_range.views.report.page import embedded, rendered
from track_range.views.report.sentences import address, card

_LEAD_S = 2.0  # time before the moment of a ranked track at which the overlay starts, s
_MAX_LINES, _MAX_POINTS = 10, 300  # largest number of lines in a chart, and of points of a line


def fleet_page(fleet: FleetFigures, out: Location, page: Location) -> str:
    """HTML of the page about the results `out`, with links that are relative to the location of the
    page.
    """
    figures = fleet.figures
    charts = drift_charts(figures["drift"])
    return rendered(
        "fleet.html.j2",
        title=f"Fleet {out.name or out}",
        subtitle=f"State on {figures['written_utc']} UTC: {figures['state']}.",
        cards=_cards(figures),
        problems=figures["problems"],
        sections=fleet_sections(figures, _links(fleet, out, page)),
        charts=charts,
        hidden_lines=max(0, len(figures["drift"]) - _MAX_LINES) if charts else 0,
        content=embedded({"charts": charts}),
    )


def _cards(figures: Figures) -> list[dict[str, str]]:
    clips, rate, speed = (
        figures[key] for key in ("clips", "clips_per_hour", "video_s_per_worker_s")
    )
    rest = f"{clips['left']} left" if clips["left"] else "" if clips["failed"] else "all"
    return [
        card("clips done", f"{clips['done']} of {clips['total']}", rest),
        card("clips failed", clips["failed"], ""),
        card("video", duration_text(3600 * figures["video_h"]), ""),
        card("tracks", figures["tracks"], f"{figures['rows']} rows"),
        card(
            "events",
            sum(row["events"] for row in figures["event_kinds"]),
            f"{figures['warnings']} with a warning",
        ),
        card("clips per hour", None if rate is None else f"{rate:.0f}", "in the last run"),
        card(
            "speed of a worker",
            None if speed is None else f"{speed:.2f}",
            "seconds of video per second",
        ),
    ]


def drift_charts(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Charts of the alignment over time, one per figure: id, x, y (labels), lines (name, colour, x
    in days, y in px).

    The groups with the largest change of a figure are shown.
    """
    palette = [*dict.fromkeys([FUSED_COLOUR, *OTHER_COLOURS, *method_colours().values()])]
    starts_s = [row["from_utc_s"] for row in rows if row.get("from_utc_s") is not None]
    if not starts_s:
        return []
    charts = []
    for name, title in DRIFT_TITLES.items():
        known = [row for row in rows if row[name]["points"]]
        shown = sorted(known, key=lambda row: -abs(row[name]["change"] or 0.0))
        lines = [
            {
                "name": row["group"],
                "colour": palette[i % len(palette)],
                **_line(row[name]["points"], min(starts_s)),
            }
            for i, row in enumerate(sorted(shown[:_MAX_LINES], key=lambda row: str(row["group"])))
        ]
        if lines:
            first_day = utc_text(min(starts_s))[:10]
            charts.append(
                {
                    "id": f"drift-{name}",
                    "x": f"days since {first_day}",
                    "y": f"{title}, px",
                    "lines": lines,
                }
            )
    return charts


def _line(points: Sequence[Sequence[float]], start_s: float) -> dict[str, list[float]]:
    shown = [points[i] for i in thinned(len(points), _MAX_POINTS).tolist()]
    return {
        "x": [round((utc_s - start_s) / 86400, 4) for utc_s, _ in shown],
        "y": [round(value, 4) for _, value in shown],
    }


def _links(fleet: FleetFigures, out: Location, page: Location) -> Links:
    folder = page.parent
    # parts of the path from the folder of the page to the results; None = no path
    base: list[str] | None = None
    if folder is not None and out.is_local and page.is_local:
        path = os.path.relpath(os.path.realpath(out.path), os.path.realpath(folder.path))
        base = [] if path == "." else path.split(os.sep)
    elif folder == out:
        base = []

    def link(row: Figures, name: str, fragment: str = "") -> str:
        if base is None or name not in fleet.files.get(row["clip"], ()):
            return ""
        return address("/".join([*base, RUNS, partition(row["clip"]), name])) + fragment

    def at_moment(row: Figures, moment_s: float) -> str:
        time_s = moment_s - fleet.starts_s.get(row["clip"], 0.0)
        return link(row, "overlay.mp4", f"#t={max(0.0, time_s - _LEAD_S):.1f}")

    def event(row: Figures) -> str:
        return link(row, event_video(row)) or at_moment(row, row["start_s"])

    return Links(
        report=lambda row: link(row, "report.html"),
        overlay=lambda row: at_moment(row, row["time_s"]),
        event=event,
    )
