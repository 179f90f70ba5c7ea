"""Figures of the benchmark of collision warnings, and the curve for the report."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

COLOURS = {"mono": "#cf7410", "stereo": "#1f77b4", "fused": "#2a8c3c"}
"""Colour of each method."""

TITLES = {"mono": "one camera", "stereo": "two cameras, stereo only", "fused": "two cameras"}
"""Name of each method for users."""

_GREY = "#7a7f87"
"""Colour of text and axes: readable on light and dark pages."""


def curve_points(figures: dict[str, Any]) -> dict[str, list[list[float]]]:
    """[false alarms per hour, median lead in s, fraction warned in time] by method, at rising thresholds."""
    return {
        methods: [
            [row["false_alarms_per_hour"], row["median_lead_s"], row["fraction_with_2_1_s"]] for row in part["points"]
        ]
        for methods, part in figures.items()
    }


def write_curve(path: Path, figures: dict[str, Any], protocol: str) -> None:
    """Write the curve for the report as JSON."""
    curve = {
        "protocol": protocol,
        "date": datetime.now(UTC).date().isoformat(),
        "columns": ["false_alarms_per_hour", "median_lead_s", "fraction_warned_2_1_s"],
        "methods": curve_points(figures),
        "default": {
            methods: [
                part["default"][name] for name in ("false_alarms_per_hour", "median_lead_s", "fraction_with_2_1_s")
            ]
            for methods, part in figures.items()
        },
    }
    path.write_text(json.dumps(curve, indent=1) + "\n", encoding="utf-8")


def draw_curve(figures: dict[str, Any], path: Path, *, lead_s: float) -> None:
    """Draw lead times and the fraction warned in time against false alarms per hour, as SVG without background.

    Each point is a threshold; a circle marks the default one.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.4, 3.9), layout="constrained")
    left, right = figure.subplots(1, 2)
    points = curve_points(figures)
    for axes, column, factor in ((left, 1, 1.0), (right, 2, 100.0)):
        for methods, rows in points.items():
            axes.plot(
                [row[0] for row in rows],
                [factor * row[column] for row in rows],
                "o-",
                ms=3.5,
                lw=1.8,
                color=COLOURS[methods],
                label=TITLES[methods],
            )
            row = figures[methods]["default"]
            value = row[("median_lead_s", "fraction_with_2_1_s")[column - 1]]
            axes.plot(
                [row["false_alarms_per_hour"]], [factor * value], "o", ms=9, mfc="none", mew=1.8, color=COLOURS[methods]
            )
        axes.set_xscale("symlog", linthresh=1, linscale=0.6)
        axes.set_xlim(left=0)
        axes.set_ylim(bottom=0)
        axes.set_xlabel("false alarms per hour (circle: default threshold)")
        _in_grey(axes)
    left.set_ylim(0, max(left.get_ylim()[1], 1.2 * lead_s))
    left.axhline(lead_s, color=_GREY, linestyle=":", lw=1)
    left.set_title("Median lead before the contact, s", loc="left", fontsize=10, color=_GREY)
    right.set_title(f"Contacts warned at least {lead_s:g} s before, %", loc="left", fontsize=10, color=_GREY)
    right.set_ylim(0, 100)
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=3, frameon=False, labelcolor=_GREY, fontsize=10)
    _save(figure, path)


def draw_reliability(figures: dict[str, Any], path: Path) -> None:
    """Draw the observed fraction of contacts against the predicted probability, as SVG without background."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.4, 3.9), layout="constrained")
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], ":", color=_GREY, lw=1)
    for methods, part in figures.items():
        bins = part["reliability"]["bins"]
        axes.plot(
            [row["predicted"] for row in bins],
            [row["observed"] for row in bins],
            "o-",
            ms=3.5,
            lw=1.8,
            color=COLOURS[methods],
            label=TITLES[methods],
        )
    axes.set_xlabel("probability of contact")
    axes.set_title("Observed fraction of contacts", loc="left", fontsize=10, color=_GREY)
    _in_grey(axes)
    axes.legend(frameon=False, labelcolor=_GREY, fontsize=9)
    _save(figure, path)


def _in_grey(axes: Any) -> None:
    axes.grid(color=_GREY, alpha=0.3, lw=0.6)
    axes.tick_params(colors=_GREY)
    axes.xaxis.label.set_color(_GREY)
    axes.xaxis.set_major_formatter("{x:g}")
    for spine in axes.spines.values():
        spine.set_visible(False)


def _save(figure: Any, path: Path) -> None:
    figure.savefig(path, transparent=True, metadata={"Date": None} if path.suffix == ".svg" else None)
