"""Charts as files: training runs, fitted size curves over their boxes, risk-coverage curves,
reliability diagrams.

Uses matplotlib's Figure objects directly (no pyplot, hence no window and no global state). The
charts of the report are drawn by the script of its page.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.output_files import write_bytes
from track_range.ranging.fitting.fit import CurveFit

SCATTER_PATHS = 3000  # maximum number of points of a scatter plot; more are thinned
_MODELS_PER_ROW = 4  # maximum number of reliability diagrams beside each other
RELIABLE_BIN = 10  # minimum number of detections of a class in a bin that is drawn
# half width of the 95 % interval of a normal distribution, in standard deviations
_INTERVAL_Z = 1.96
# line style of a family of size curves, by the first letters of its name
_STROKE = {"dia": ":", "hei": "--"}


def training_chart(history: Sequence[Mapping[str, float]], path: Path) -> None:
    """Draw losses and average precision over the epochs of a training run as a PNG; no file without
    an epoch.

    `history`: rows of results.csv. OutputError if the file cannot be written, as for all charts.
    """
    if history:
        _write_chart(training_figure(history), path)


def training_figure(history: Sequence[Mapping[str, float]]) -> Figure:
    """The figure of `training_chart`: losses above, average precision in percent below."""
    keys = dict.fromkeys(key for row in history for key in row)
    figure = Figure(figsize=(9.5, 7.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    for axes, prefix, scale, label in (
        (upper, "loss_", 1.0, "loss per image"),
        (lower, "ap50", 100.0, "AP50, %"),
    ):
        for key in (key for key in keys if key.startswith(prefix)):
            rows = [
                (row["epoch"], scale * row[key])
                for row in history
                if np.isfinite(row.get(key, np.nan))
            ]
            epoch, value = np.array(rows, np.float64).reshape(-1, 2).T
            is_mean = key in ("ap50", "ap50_95")
            name = {"ap50": "mean", "ap50_95": "mean, AP50-95"}.get(key, key.removeprefix(prefix))
            text = name.strip("_").replace("_", " ")
            axes.plot(
                epoch,
                value,
                label=text,
                linewidth=2.2 if is_mean else 1.0,
                marker="." if len(rows) < 3 else None,
            )
        axes.set_ylabel(label)
        axes.set_ylim(bottom=0)
        axes.grid(True, alpha=0.25)
        if axes.lines:  # the first epochs may be without a validation
            axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    lower.set_xlabel("epoch")
    return figure


def curve_picture(
    classes: Mapping[str, tuple[FloatArray, FloatArray, Sequence[CurveFit]]], path: Path
) -> None:
    """Draw size curves over the boxes that they were fitted to as a PNG, one panel per class.

    `classes`: by class (N, 2) box width and height divided by the focal length, (N,) true distances
    in m, and curves.
    """
    figure = Figure(figsize=(9.5, 4.2 * len(classes)), layout="constrained")
    panels = figure.subplots(len(classes), 1, squeeze=False)[:, 0]
    for axes, (name, (wh_over_f, distance_m, fits)) in zip(panels, classes.items(), strict=True):
        height, step = wh_over_f[:, 1], 1 + len(distance_m) // SCATTER_PATHS
        axes.scatter(
            100 * height[::step], distance_m[::step], s=7, color="#6b747c", alpha=0.5, lw=0
        )
        # beyond the boxes, to show how polynomials extrapolate
        grid = np.linspace(0.8 * height.min(), 1.3 * height.max(), 300)
        median_shape = np.stack([grid * np.median(wh_over_f[:, 0] / height), grid], axis=1)
        for fit in fits:
            fitted_m = fit.predict(median_shape, np.zeros(len(grid)))
            axes.plot(
                100 * grid,
                fitted_m,
                linewidth=1.3,
                label=fit.curve,
                linestyle=_STROKE.get(fit.curve[:3], "-"),
            )
        axes.set_ylim(-0.1 * float(distance_m.max()), 1.1 * float(distance_m.max()))
        axes.set_title(f"{name}: boxes, and curves for the median aspect ratio")
        axes.set_ylabel("distance, m")
        axes.set_xlabel("box height / focal length, %")
        axes.grid(True, alpha=0.25)
        axes.legend(frameon=False, ncols=2)
    _write_chart(figure, path)


def risk_coverage_chart(curves: Mapping[str, Sequence[Mapping[str, Any]]], path: Path) -> None:
    """Draw errors of answered boxes over their fraction, from rows of `risk_coverage` by name, as
    SVG or PNG.
    """
    panels = (
        ("failures_pct", "failures, %"),
        ("mean_relative_error_pct", "mean error, %"),
        ("p95_relative_error_pct", "95th percentile of the error, %"),
    )
    figure = Figure(figsize=(10.5, 3.9), layout="constrained")
    for axes, (key, label) in zip(figure.subplots(1, 3), panels, strict=True):
        for name, rows in curves.items():
            points = [(row["answered_pct"], row[key]) for row in rows if row[key] is not None]
            if points:
                axes.plot(*zip(*points, strict=True), label=name, linewidth=1.5)
        axes.set_xlabel("measured boxes, %, most certain first")
        axes.set_ylabel(label)
        axes.set_xlim(0, 100)
        axes.set_ylim(bottom=0)
        axes.grid(True, alpha=0.25)
    figure.legend(
        *figure.axes[0].get_legend_handles_labels(),
        loc="outside lower center",
        frameon=False,
        ncols=6,
    )
    _write_chart(figure, path)


def _write_chart(figure: Figure, path: Path) -> None:
    """Write an SVG or PNG file, by the ending of its name."""
    stream = io.BytesIO()
    kind = path.suffix.lower().removeprefix(".")
    figure.savefig(stream, format=kind, dpi=110, metadata={"Date": None} if kind == "svg" else None)
    write_bytes(path, stream.getvalue())


def reliability_chart(calibrations: Mapping[str, Mapping[str, Any]], path: Path) -> None:
    """Draw the reliability diagram of each detector from its `ScoreCalibration.as_dict()`, as SVG
    or PNG.
    """
    _write_chart(reliability_figure(calibrations), path)


def reliability_figure(calibrations: Mapping[str, Mapping[str, Any]]) -> Figure:
    """The figure of `reliability_chart`: for each detector its precision over its score, numbers of
    detections below.

    The line of all classes has 95 % intervals (Wilson); thin lines are the classes, without bins of
    fewer than `RELIABLE_BIN` detections. Below the diagonal, scores are too high.
    """
    n_columns = min(len(calibrations), _MODELS_PER_ROW)
    n_rows = -(-len(calibrations) // n_columns)
    figure = Figure(figsize=(0.4 + 4.4 * n_columns, 0.6 + 5.4 * n_rows), layout="constrained")
    names = dict.fromkeys(
        name for calibration in calibrations.values() for name in calibration["classes"]
    )
    colours = {name: f"C{number}" for number, name in enumerate(names)}
    cells = figure.subfigures(n_rows, n_columns, squeeze=False).ravel()
    for cell, (name, calibration) in zip(cells, calibrations.items(), strict=False):
        diagram, histogram = cell.subplots(2, 1, sharex=True, height_ratios=(3, 1))
        _draw_reliability(diagram, calibration, colours)
        diagram.set_title(name)
        _draw_counts(histogram, calibration["all"])
    lines = {str(line.get_label()): line for axes in figure.axes for line in axes.lines}
    figure.legend(
        handles=lines.values(), loc="outside lower center", frameon=False, ncols=3 * n_columns
    )
    return figure


def _draw_reliability(
    axes: Axes, calibration: Mapping[str, Any], colours: Mapping[str, str]
) -> None:
    axes.plot([0, 1], [0, 1], color="#6b747c", linestyle="--", linewidth=1.0, label="calibrated")
    for name, row in calibration["classes"].items():
        bins = [one for one in row["bins"] if one["n"] >= RELIABLE_BIN]
        if bins:
            score, precision = _columns(bins, "mean_score", "precision")
            axes.plot(
                score,
                precision,
                color=colours[name],
                linewidth=0.9,
                alpha=0.7,
                marker=".",
                ms=4,
                label=name,
            )
    bins = [one for one in calibration["all"]["bins"] if one["n"]]
    score, precision = _columns(bins, "mean_score", "precision")
    low, high = _wilson_interval(*_columns(bins, "n_true", "n"))
    axes.vlines(score, low, high, color="black", linewidth=1.2)
    axes.plot(
        score, precision, color="black", linewidth=2.2, marker="o", ms=4.5, label="all classes"
    )
    ece, chance = calibration["all"]["ece"], calibration["all"]["ece_if_calibrated"]
    if ece is not None:
        text = f"ECE {100 * ece:.1f} %\n(by chance {100 * chance:.1f} %)"
        axes.text(0.03, 0.97, text, transform=axes.transAxes, va="top")
    axes.set(xlim=(0, 1), ylim=(0, 1.02), ylabel="precision at IoU 0.5")
    axes.grid(True, alpha=0.25)


def _draw_counts(axes: Axes, row: Mapping[str, Any]) -> None:
    low, high, n, n_true = _columns(row["bins"], "from", "to", "n", "n_true")
    for count, colour, label in ((n, "#c3cad0", "detections"), (n_true, "#5b7f9e", "true")):
        axes.bar(
            low, count, width=high - low, align="edge", color=colour, edgecolor="white", label=label
        )
    axes.set_yscale("symlog", linthresh=1.0)  # linear below 1, since bins can be empty
    axes.set(ylim=(0, 10 * max(n.max(), 1.0)), xlabel="score", ylabel="number")
    axes.legend(frameon=False, fontsize="small", ncols=2)
    axes.grid(True, axis="y", alpha=0.25)


def _columns(bins: Sequence[Mapping[str, Any]], *keys: str) -> FloatArray:
    """(K, M) values of K keys of M bins."""
    return np.array([[one[key] for one in bins] for key in keys], np.float64)


def _wilson_interval(n_true: FloatArray, n: FloatArray) -> FloatArray:
    """(2, M) limits of the 95 % intervals of fractions n_true / n (Wilson, J. Am. Stat. Assoc.
    1927).
    """
    z2 = _INTERVAL_Z**2
    centre = (n_true + z2 / 2) / (n + z2)
    half = _INTERVAL_Z / (n + z2) * np.sqrt(n_true * (n - n_true) / n + z2 / 4)
    return np.stack([centre - half, centre + half])
