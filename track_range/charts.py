"""The report's charts as SVG text to be put into a page: distance over time, error against distance, time per stage.

The one door to matplotlib, through its Figure objects: no window, no pyplot, no state between charts. Ink (axes, text,
truth) is drawn in the page's own text colour, so that a chart is readable on a light and on a dark page; a method has
the same colour in every chart. Many points are put in as one picture, so that the page stays small.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from detection.detections import BoolArray, FloatArray
from track_range.written import write_bytes

Columns = Mapping[str, npt.NDArray[Any]]
"""tracks.csv by column: one row per track and frame, NaN = empty; a column may be missing."""

METHOD_COLOURS = {
    "mono": "#e08214",
    "lane": "#9467bd",
    "ground": "#a0714f",
    "stereo": "#1aa36b",
    "sgbm": "#8c96a0",
    "fused": "#2f7ed8",
}
"""Colour of a method and of its filtered twin (`_kf`, dashed); legible on white and on near black."""

INK = "#010203"
"""Stands for the page's text colour until the SVG is put together: no other mark has it."""

SCATTER_PATHS = 3000
"""A scatter of more points than this is put in as a picture."""

LINE_POINTS = 1200
"""A longer line is thinned to at most as many: a page shows about one per pixel."""

CHART_IN = (9.5, 3.4)
"""Width and height of a chart in inches of 72 SVG units; the page scales it to its own width."""


def method_style(method: str) -> dict[str, Any]:
    """Colour, stroke and order of a method's line."""
    name = method.removesuffix("_kf")
    style = {"color": METHOD_COLOURS.get(name, "#c44e9c"), "linewidth": 1.0, "zorder": 3.0}
    if name == "fused":
        style |= {"linewidth": 1.8, "zorder": 4.0}
    return style | ({"linestyle": (0, (4, 2)), "linewidth": 1.0} if name != method else {})


def methods_measured(columns: Columns) -> list[str]:
    """Names of the methods that have at least one distance, in the columns' order."""
    named = [name.removesuffix("_m") for name in columns if name.endswith("_m") and not name.endswith("_sigma_m")]
    return [name for name in named if name not in ("truth", "x", "y") and bool(np.isfinite(columns[f"{name}_m"]).any())]


def column(columns: Columns, name: str, rows: BoolArray | slice = slice(None)) -> FloatArray:
    """A column's rows, all NaN where the run has no such column."""
    if name in columns:
        return np.asarray(columns[name][rows], np.float64)
    return np.full(len(columns["time_s"][rows]), np.nan)


def distance_chart(columns: Columns, track_id: int) -> str:
    """Distance over time of one track: every method, the band of fused's sigma, the truth."""
    rows = np.flatnonzero(columns["track_id"] == track_id)
    rows = rows[:: 1 + (len(rows) - 1) // LINE_POINTS]
    track = {name: values[rows] for name, values in columns.items()}
    time_s, fused_m, sigma_m = (column(track, name) for name in ("time_s", "fused_m", "fused_sigma_m"))
    figure, axes = blank_chart("time, s", "distance, m")
    axes.fill_between(time_s, fused_m - sigma_m, fused_m + sigma_m, color=METHOD_COLOURS["fused"], alpha=0.25, lw=0)
    for method in methods_measured(track):
        # Points too where they are few: a line shows nothing of a single frame between two gaps.
        marker = "o" if len(rows) <= 60 and (not method.endswith("_kf") or len(rows) == 1) else None
        axes.plot(time_s, column(track, f"{method}_m"), marker=marker, ms=2.5, label=method, **method_style(method))
    truth_m = column(track, "truth_m")
    if np.isfinite(truth_m).any():
        axes.plot(time_s, truth_m, color=INK, linestyle=":", linewidth=1.6, label="truth", zorder=5)
    predicted = column(track, "observed") == 0
    if predicted.any():
        axes.plot(
            time_s[predicted], fused_m[predicted], "o", mfc="none", mec=INK, ms=5, label="predicted box", zorder=6
        )
    return svg(figure, axes, f"Distance over time of track {track_id}")


def error_chart(columns: Columns) -> str | None:
    """Relative error against true distance: points, and a line of medians per method; None without truth."""
    truth_m = column(columns, "truth_m")
    truth_m = np.where(truth_m > 0, truth_m, np.nan)
    methods = [name for name in methods_measured(columns) if np.isfinite(column(columns, f"{name}_m") - truth_m).any()]
    if not methods:
        return None
    figure, axes = blank_chart("true distance, m", "error, %")
    axes.axhline(0.0, color=INK, linewidth=0.8, alpha=0.6)
    pictured = len(truth_m) * len(methods) > SCATTER_PATHS
    shown_pct = []
    for method in methods:
        style = method_style(method)
        error_pct = 100.0 * (column(columns, f"{method}_m") / truth_m - 1.0)
        if not method.endswith("_kf"):
            axes.scatter(truth_m, error_pct, s=5, color=style["color"], alpha=0.35, lw=0, rasterized=pictured)
        axes.plot(*median_by_distance(truth_m, error_pct), label=method, **style)
        shown_pct.append(np.nanpercentile(np.abs(error_pct), 98))
    # One wild measurement must not flatten the rest: the axis ends where all but 2 % of the worst method's lie.
    limit = float(np.clip(1.2 * max(shown_pct), 5.0, 100.0))
    axes.set_ylim(-limit, limit)
    return svg(figure, axes, "Relative error against distance, by method")


def median_by_distance(distance_m: FloatArray, error_pct: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Middles of ten-metre bands and the median error in each that has at least three errors."""
    known = np.isfinite(distance_m) & np.isfinite(error_pct)
    band = np.floor(distance_m[known] / 10.0)
    found = [(10.0 * b + 5.0, np.median(error_pct[known][band == b])) for b in np.unique(band) if np.sum(band == b) > 2]
    middles_m, medians = np.array(found, np.float64).reshape(-1, 2).T
    return middles_m, medians


def stage_chart(stages_ms: Mapping[str, float | None]) -> str | None:
    """Milliseconds per frame of each stage that ran, as bars; None when none did."""
    ran = {name: float(ms) for name, ms in stages_ms.items() if ms}
    if not ran:
        return None
    figure, axes = blank_chart("ms per frame", "")
    bars = axes.barh(list(ran), list(ran.values()), color=METHOD_COLOURS["fused"])
    axes.bar_label(bars, labels=[f"{ms:.1f}" for ms in ran.values()], padding=3, color=INK)
    axes.margins(x=0.12)
    axes.invert_yaxis()
    axes.grid(False, axis="y")
    return svg(figure, axes, "Milliseconds per frame by stage")


def training_chart(history: Sequence[Mapping[str, float]], path: Path) -> None:
    """Losses and average precision over the epochs of a training run, as a PNG; nothing without an epoch.

    Args:
        history: rows of results.csv.
        path: the picture.

    Raises:
        OutputError: it cannot be written.
    """
    if not history:
        return
    keys = dict.fromkeys(key for row in history for key in row)
    figure = Figure(figsize=(9.5, 7.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    for axes, prefix, scale, label in ((upper, "loss_", 1.0, "loss per image"), (lower, "ap50", 100.0, "AP50, %")):
        for key in (key for key in keys if key.startswith(prefix)):
            rows = [(row["epoch"], scale * row[key]) for row in history if np.isfinite(row.get(key, np.nan))]
            epoch, value = np.array(rows, np.float64).reshape(-1, 2).T
            is_mean = key in ("ap50", "ap50_95")
            name = {"ap50": "mean", "ap50_95": "mean, AP50-95"}.get(key, key.removeprefix(prefix))
            text = name.strip("_").replace("_", " ")
            axes.plot(
                epoch, value, label=text, linewidth=2.2 if is_mean else 1.0, marker="." if len(rows) < 3 else None
            )
        axes.set_ylabel(label)
        axes.set_ylim(bottom=0)
        axes.grid(True, alpha=0.25)
        if axes.lines:  # nothing is validated in the first epochs, where it is not done in each
            axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    lower.set_xlabel("epoch")
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110)
    write_bytes(path, stream.getvalue())


def blank_chart(x_label: str, y_label: str) -> tuple[Figure, Axes]:
    """A figure with one pair of axes, all in ink."""
    figure = Figure(figsize=CHART_IN, layout="constrained")
    axes = figure.add_subplot()
    axes.set_xlabel(x_label, color=INK)
    axes.set_ylabel(y_label, color=INK)
    axes.tick_params(colors=INK)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(INK)
    axes.grid(True, color=INK, alpha=0.12, linewidth=0.6)
    return figure, axes


def svg(figure: Figure, axes: Axes, title: str) -> str:
    """The figure as an `<svg>` element with a name for screen readers and no reference to anything outside."""
    if axes.get_legend_handles_labels()[1]:
        figure.legend(loc="outside right upper", frameon=False, labelcolor=INK, handlelength=1.6)
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": title, "path.simplify_threshold": 0.5}):
        stream = io.StringIO()
        figure.savefig(stream, format="svg", transparent=True, dpi=110, metadata={"Date": None})
    return inline_svg(stream.getvalue(), title)


def inline_svg(document: str, title: str) -> str:
    """An SVG document of matplotlib's as an element of a page.

    Left out: prologue, metadata and name spaces (a page needs none), size (the page sets it), the style sheet (it would
    hold for the whole page; it only rounds joins) and the names of groups, which are the same in every chart. Names
    that something refers to are hashes with the title as their salt.
    """
    found = re.sub(r"<(metadata|style)\b.*?</\1>", "", document[document.index("<svg") :], flags=re.DOTALL)
    found = re.sub(r'<g id="[^"]*"', "<g", found)
    opening, rest = found.split(">", 1)
    view = re.search(r'viewBox="[^"]*"', opening)
    if view is None:
        raise ValueError("an SVG without a viewBox")
    name = f'role="img" aria-label="{escape(title)}"'
    return f'<svg {name} {view.group()} stroke-linejoin="round">{rest}'.replace(INK, "currentColor")
