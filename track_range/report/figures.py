"""Charts as pictures: how a training run went, and fitted size curves over the boxes they were fitted on.

The one door to matplotlib, through its Figure objects: no window, no pyplot, no state between charts. The report draws
its own charts, by a script in its page.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from track_range.foundation.arrays import FloatArray
from track_range.ranging.evaluation.curve_comparison import CurveFit
from track_range.results.output_files import write_bytes

SCATTER_PATHS = 3000
"""A scatter of more points than this is thinned."""


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


_STROKE = {"dia": ":", "hei": "--"}
"""Strokes of families of size curves, by the first letters of their names."""


def curve_picture(classes: Mapping[str, tuple[FloatArray, FloatArray, Sequence[CurveFit]]], path: Path) -> None:
    """Size curves over the boxes that they were fitted on, a panel per class, as a PNG.

    Args:
        classes: by class (N, 2) width and height over the focal length, (N,) true distance, and the curves.
        path: the picture.

    Raises:
        OutputError: it cannot be written.
    """
    figure = Figure(figsize=(9.5, 4.2 * len(classes)), layout="constrained")
    panels = figure.subplots(len(classes), 1, squeeze=False)[:, 0]
    for axes, (name, (wh_over_f, distance_m, fits)) in zip(panels, classes.items(), strict=True):
        height, every = wh_over_f[:, 1], slice(None, None, 1 + len(distance_m) // SCATTER_PATHS)
        axes.scatter(100 * height[every], distance_m[every], s=7, color="#6b747c", alpha=0.5, lw=0)
        grid = np.linspace(0.8 * height.min(), 1.3 * height.max(), 300)  # beyond the boxes, where polynomials turn
        like_most = np.stack([grid * np.median(wh_over_f[:, 0] / height), grid], axis=1)
        for fit in fits:
            fitted_m = fit.predict(like_most, np.zeros(len(grid)))
            axes.plot(100 * grid, fitted_m, linewidth=1.3, label=fit.curve, linestyle=_STROKE.get(fit.curve[:3], "-"))
        axes.set_ylim(-0.1 * float(distance_m.max()), 1.1 * float(distance_m.max()))
        axes.set_title(f"{name}: boxes, and curves for the most usual shape")
        axes.set_ylabel("distance, m")
        axes.set_xlabel("height of the box over the focal length, %")
        axes.grid(True, alpha=0.25)
        axes.legend(frameon=False, ncols=2)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110)
    write_bytes(path, stream.getvalue())
