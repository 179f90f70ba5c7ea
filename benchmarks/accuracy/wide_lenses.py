"""Distances with a fisheye lens and with a pinhole of the same angular resolution, on the same simulated drives.

Protocol: each drive is rendered twice, with a Kannala-Brandt lens of 136 degrees (`LENS`, 960 x 480 px) and with the
virtual pinhole of 120 degrees to which a run undistorts its images (1386 x 534 px, as many pixels per radian on the
axis). Both are processed with the defaults of a run, without dense stereo: with recorded boxes, the same ones in pixels
of either video, or with `--detector` with the boxes of a network. Errors against truth.csv at 5-100 m over the objects
and frames that both runs measured with the method; the ratio is that of the fisheye's error to the pinhole's.
"""

from __future__ import annotations

import tempfile
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.harness import (
    Figures,
    option,
    workload,
)
from benchmarks.inputs.drives import FPS
from track_range.cli.commands.run import run_and_print
from track_range.foundation.arrays import IntArray
from track_range.ranging.evaluation.errors import MethodColumn, score_rows
from track_range.ranging.evaluation.truth import read_truth
from track_range.results.columns import Columns
from track_range.results.formats.csv_file import read_tracks_csv
from track_range.results.summary import matched_truth, with_truth
from track_range.run.settings import RunSettings
from track_range.simulation.camera.wide_lens import WideLens
from track_range.simulation.drive import write_drive
from track_range.simulation.settings import DriveOptions
from track_range.simulation.world.scenarios import SCENARIOS as ALL_SCENARIOS
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig

SCENARIOS = ("town", "highway", "city", "cut-in")
SEED = 250  # no test uses it

LENS = PinholeCamera(400.0, 400.0, 479.5, 239.5, 960, 480, (0.01, 0.0, 0.0, 0.0), "kannala-brandt")
"""The fisheye camera, with 136 x 69 degrees."""

BASELINE_M = 0.54  # KITTI's
_MAX_FRAMES = 100_000  # above the number of frames of a drive, for keys of frame and object
METHODS = ("mono", "ground", "stereo", "fused", "fused_kf")
STATISTICS = ("median", "mean")

OFF_AXIS_DEG = 30.0
"""Horizontal angle from the axis that divides the objects of the second table."""


@workload(
    option("--scenarios", default=SCENARIOS, choices=tuple(ALL_SCENARIOS), metavar="NAME", help="scenarios"),
    option("--seeds", default=(SEED,), metavar="N", help="random seeds of the drives"),
    option("--seconds", default=6.0, metavar="S", help="length of a drive"),
    option("--detector", metavar="FILE", help="network for the boxes (default: recorded boxes)"),
)
def wide_lenses(options: Namespace) -> Figures:
    rows = [
        _common_rows(*_both_runs(scenario, seed, options)) for scenario in options.scenarios for seed in options.seeds
    ]
    columns = [_concatenated([pair[side] for pair in rows]) for side in (0, 1)]
    angle_deg = np.degrees(np.arctan2(np.abs(columns[0]["x_m"]), columns[0]["scored_truth_m"]))
    parts = {
        "all": np.full(len(angle_deg), True),
        f"up to {OFF_AXIS_DEG:.0f} deg": angle_deg <= OFF_AXIS_DEG,
        "farther out": angle_deg > OFF_AXIS_DEG,
    }
    return {
        part: {method: _compared(method, columns, np.flatnonzero(chosen)) for method in METHODS}
        for part, chosen in parts.items()
    }


def _both_runs(scenario: str, seed: int, options: Namespace) -> tuple[Columns, Columns]:
    """The result columns with the pinhole and with the fisheye, with the true distances."""
    wide = StereoRig.rectified(LENS, BASELINE_M)
    pinholes = WideLens.of(wide).pinholes
    pinhole, fisheye = (_run(rig, pinholes.left, scenario, seed, options) for rig in (pinholes, wide))
    return pinhole, fisheye


def _run(rig: StereoRig, shown: PinholeCamera, scenario: str, seed: int, options: Namespace) -> Columns:
    """Result columns of a run on a drive with this rig; `shown` is the left camera of the rectified images."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        drive = write_drive(
            folder / "drive",
            scenario=scenario,
            seed=seed,
            seconds=options.seconds,
            fps=FPS,
            rig=rig,
            options=DriveOptions(lossless=True),
        )
        boxes = {"detections": drive.detections} if options.detector is None else {"detector": options.detector}
        settings = RunSettings(
            stereo=(drive.left, drive.right),
            rig=drive.rig,
            out=folder / "run",
            overlay=False,
            sgbm=False,
            folder_fps=FPS,
            **boxes,
        )
        out = run_and_print(settings, Console(quiet=True))
        truth = read_truth(drive.table, shown, np.zeros(3))
        columns = read_tracks_csv(out / "tracks.csv")
        matched = matched_truth(columns, truth)
        return {**with_truth(columns, matched), "true_id": matched.of_labels(truth.track_id, -1)}


def _common_rows(pinhole: Columns, fisheye: Columns) -> tuple[Columns, Columns]:
    """The rows of both runs with the same frame and true object."""
    keys, rows = zip(*(_keys(columns) for columns in (pinhole, fisheye)), strict=True)
    _, first, second = np.intersect1d(keys[0], keys[1], return_indices=True)
    kept = [
        {name: values[run_rows[common]] for name, values in columns.items()}
        for columns, run_rows, common in ((pinhole, rows[0], first), (fisheye, rows[1], second))
    ]
    return kept[0], kept[1]


def _keys(columns: Columns) -> tuple[IntArray, IntArray]:
    """Numbers of frame and true object, and the rows, of those with a true distance."""
    rows = np.flatnonzero(np.isfinite(columns["scored_truth_m"]))
    return (columns["true_id"][rows] * _MAX_FRAMES + columns["frame"][rows]).astype(np.int64), rows


def _concatenated(runs: Sequence[Columns]) -> Columns:
    names = set.intersection(*(set(columns) for columns in runs))
    return {name: np.concatenate([columns[name] for columns in runs]) for name in names}


def _compared(method: str, columns: Sequence[Columns], rows: IntArray) -> dict[str, Any]:
    """Scores of a method with pinhole and fisheye over the rows that both measured, and the ratios of the errors."""
    both = np.all([np.isfinite(part[f"{method}_m"]) for part in columns], axis=0)
    rows = rows[both[rows]]
    true_m = columns[0]["scored_truth_m"][rows]
    scores = {
        name: score_rows(
            MethodColumn(part[f"{method}_m"][rows], part[f"{method}_sigma_m"][rows]), true_m, np.full(len(rows), True)
        )
        for name, part in zip(("pinhole", "fisheye"), columns, strict=True)
    }
    keys = [f"{statistic}_relative_error_pct" for statistic in STATISTICS]
    ratios = {
        statistic: scores["fisheye"][key] / scores["pinhole"][key] if len(rows) and scores["pinhole"][key] else None
        for statistic, key in zip(STATISTICS, keys, strict=True)
    }
    return {**scores, "ratios": ratios}
