"""Accuracy of stereo matching: errors on simulated drives with exact ground truth, repeatability on real drives.

Simulated drives: KITTI's geometry (`track_range.simulation`, encoded videos), labels at 15-25 m that are not truncated
and at most partly occluded, boxes of the labels, priors from the previous frame as in a run. The true distance is that
of the label's visible surface on the ray through the box centre. Goal: median error at most 0.3 %. Repeatability:
labelled tracks of real drives with at least 8 measured frames; standard deviation of the disparity about a quadratic in
time (three degrees of freedom). Goal: at most 0.08 px. The row `labels` is the same for the disparities of the labels:
the disparity of a near car that passes is not quadratic in time.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from benchmarks.inputs.drives import REAL_DATA
from track_range.calibration.drive_pairs import read_drive
from track_range.evaluation.expected_disparities import expected_disparities
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.simulation.drive import write_drive
from track_range.stereo.evaluation.disparity_errors import MatcherColumn, figures
from track_range.stereo.evaluation.kitti_2015 import StereoPair
from track_range.stereo.matching.box_matchers import MatcherResults, measure_pairs

FROM_M, TO_M = 15.0, 25.0
"""Distance range in m on simulated drives."""

MIN_FRAMES = 8
"""Smallest number of measured frames of a track for its repeatability."""

MATCHERS = ("patch", "sgbm")
"""Names of the compared matchers."""


def add_accuracy_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the accuracy part."""
    parser.add_argument("--seeds", type=int, default=3, help="number of simulated drives")
    parser.add_argument("--fps", type=float, default=2.5, help="frame rate of the simulated drives, of 6 s each")
    drives = [REAL_DATA / "kitti_stereo" / name for name in ("0003", "0005")]
    parser.add_argument("--drives", type=Path, nargs="*", default=drives, help="real drives with labels")


def measure_accuracy(options: argparse.Namespace) -> dict[str, Any]:
    """Figures on simulated and on real drives; prints the tables."""
    simulated = _simulated(options.seeds, options.fps) if options.seeds else {}
    repeated = {drive.name: _repeatability(drive) for drive in options.drives if drive.is_dir()}
    _print(simulated, repeated)
    return {"simulated": simulated, "repeatability": repeated}


def _simulated(n_drives: int, fps: float) -> dict[str, Any]:
    """Figures of each matcher on all drives together."""
    with tempfile.TemporaryDirectory() as name:
        measured = measure_pairs(_drives(Path(name), n_drives, fps), MATCHERS, expected=expected_disparities)
    objects = measured.objects
    near = (objects.distance_m >= FROM_M) & (objects.distance_m <= TO_M)
    return {
        matcher: figures(MatcherColumn(column.disparity_px[near], column.sigma_px[near]), objects.true_px[near])
        for matcher, column in measured.columns.items()
    }


def _drives(folder: Path, n_drives: int, fps: float) -> Iterator[StereoPair]:
    for seed in range(n_drives):
        write_drive(folder / str(seed), seed=seed, fps=fps)
        yield from read_drive(folder / str(seed))


def _repeatability(drive: Path) -> dict[str, Any]:
    """Standard deviations per track, with their median and maximum, by matcher and for the labels."""
    measured = measure_pairs(read_drive(drive), MATCHERS, expected=expected_disparities)
    truth = MatcherColumn(measured.objects.true_px, np.zeros(len(measured.objects)))
    return {name: _repeated(measured, column) for name, column in {**measured.columns, "labels": truth}.items()}


def _repeated(measured: MatcherResults, column: MatcherColumn) -> dict[str, Any]:
    objects = measured.objects
    tracks = scatter_px(objects.group, objects.pair, column.disparity_px)
    values = np.array(list(tracks.values()))
    return {
        "tracks_px": {str(track): round(value, 4) for track, value in tracks.items()},
        "median_px": float(np.median(values)) if len(values) else None,
        "worst_px": float(values.max()) if len(values) else None,
    }


def scatter_px(track_id: IntArray, frame: IntArray, disparity_px: FloatArray) -> dict[int, float]:
    """Standard deviation of each track's disparities about a quadratic in the frame number.

    Tracks of fewer than `MIN_FRAMES` measured frames are not included. All arrays are (N,); NaN = not measured.
    """
    scatter = {}
    for track in np.unique(track_id).tolist():
        rows = (track_id == track) & np.isfinite(disparity_px)
        if rows.sum() >= MIN_FRAMES:
            curve = np.polynomial.Polynomial.fit(frame[rows], disparity_px[rows], 2)
            residual_px = disparity_px[rows] - curve(frame[rows])
            scatter[track] = float(np.sqrt((residual_px**2).sum() / (len(residual_px) - 3)))
    return scatter


def _print(simulated: dict[str, Any], repeated: dict[str, Any]) -> None:
    title = f"Simulated drives, {FROM_M:.0f}-{TO_M:.0f} m"
    table = Table(title=title, box=box.SIMPLE_HEAD, padding=0, title_justify="left")
    for heading in ("matcher", "n", "coverage %", "median %", "95 %", "bias %", "error px"):
        table.add_column(heading, justify="left" if heading == "matcher" else "right")
    for name, row in simulated.items():
        keys = ("median_relative_error_pct", "p95_relative_error_pct", "bias_pct", "median_abs_error_px")
        table.add_row(name, str(row["n"]), f"{100 * row['coverage']:.1f}", *(f"{row[key]:.3f}" for key in keys))
    Console().print(table)
    table = Table(title="Repeatability, px", box=box.SIMPLE_HEAD, padding=0, title_justify="left")
    for heading in ("drive", "matcher", "tracks", "median", "worst"):
        table.add_column(heading, justify="right" if heading in ("tracks", "median", "worst") else "left")
    for drive, by_matcher in repeated.items():
        for name, row in by_matcher.items():
            numbers = ("-" if row[key] is None else f"{row[key]:.3f}" for key in ("median_px", "worst_px"))
            table.add_row(drive, name, str(len(row["tracks_px"])), *numbers)
    Console().print(table)
