"""Fusion while stereo fails: simulated drives with a right camera that is black, then grey noise, for 1 and 2 s.

Protocol: the `run` command with its defaults on the files of the drive (lossless images, recorded boxes, alignment from
the drive, no dense stereo). Errors against truth.csv at 5-100 m as with `--truth`, separately for frames without and
with a right image, over the boxes that each method measured (`coverage`: their fraction of the boxes with a true
distance); then per scenario over the boxes without a right image that mono, fused and their filters all measured.
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
from track_range.detection.lanes.nets import CLASSICAL
from track_range.foundation.arrays import BoolArray
from track_range.ranging.evaluation.errors import MethodColumn, score_rows
from track_range.ranging.evaluation.truth import read_truth
from track_range.results.columns import Columns
from track_range.results.formats.csv_file import read_tracks_csv
from track_range.results.summary import matched_truth, with_truth
from track_range.run.settings import RunSettings
from track_range.simulation.camera.drive_files import write_png
from track_range.simulation.drive import write_drive
from track_range.simulation.render.renderer import kitti_like_rig
from track_range.simulation.settings import DriveOptions
from track_range.simulation.world.scenarios import SCENARIOS as ALL_SCENARIOS

SCENARIOS = ("town", "highway", "city", "cut-in")
SEED = 230  # no test uses it
SECONDS = 8.0

BLACK_S, NOISE_S = (3.0, 4.0), (5.5, 7.5)
"""Intervals in s in which the right image is black, and grey noise."""

METHODS = ("mono", "stereo", "fused", "mono_kf", "stereo_kf", "fused_kf")

COMPARED = ("mono", "mono_kf", "fused", "fused_kf")
"""Methods that are compared on the same boxes."""


@workload(
    option("--scenarios", default=SCENARIOS, choices=tuple(ALL_SCENARIOS), metavar="NAME", help="scenarios"),
    option("--seeds", default=(SEED,), metavar="N", help="random seeds of the drives"),
    option("--lanes", default=CLASSICAL, metavar="FILE", help="lane network, off, or the classical lane detection"),
)
def fusion(options: Namespace) -> Figures:
    by_scenario = {
        name: _concatenated([_run_on_drive(name, seed, options.lanes) for seed in options.seeds])
        for name in options.scenarios
    }
    return {
        name: _scores(columns)
        for name, columns in {"all": _concatenated(list(by_scenario.values())), **by_scenario}.items()
    }


def _run_on_drive(scenario: str, seed: int, lanes: str) -> Columns:
    """The result columns of a run on a drive, with the true distances."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        options = DriveOptions(lossless=True)
        drive = write_drive(folder / "drive", scenario=scenario, seed=seed, seconds=SECONDS, fps=FPS, options=options)
        _blind(drive.right, seed)
        settings = RunSettings(
            stereo=(drive.left, drive.right),
            rig=drive.rig,
            detections=drive.detections,
            out=folder / "run",
            overlay=False,
            sgbm=False,
            lanes=lanes,
            folder_fps=FPS,
        )
        out = run_and_print(settings, Console(quiet=True))
        truth = read_truth(drive.table, kitti_like_rig().left, np.zeros(3))
        columns = read_tracks_csv(out / "tracks.csv")
        return with_truth(columns, matched_truth(columns, truth))


def _blind(folder: Path, seed: int) -> None:
    """Replace the images in `BLACK_S` and `NOISE_S`; files are named after their frame."""
    rng = np.random.default_rng([seed, 21])
    camera = kitti_like_rig().left
    size = (camera.height_px, camera.width_px, 1)
    for path in sorted(folder.glob("*.png")):
        time_s = np.array(int(path.stem) / FPS)
        if _is_within(time_s, BLACK_S):
            write_png(path, np.zeros((*size[:2], 3), np.uint8))
        elif _is_within(time_s, NOISE_S):
            write_png(path, np.repeat(rng.integers(0, 256, size, np.uint8), 3, axis=2))


def _is_within(time_s: Any, span_s: tuple[float, float]) -> BoolArray:
    return np.asarray((time_s > span_s[0] - 1e-6) & (time_s < span_s[1] - 1e-6))


def _concatenated(runs: Sequence[Columns]) -> Columns:
    return {name: np.concatenate([columns[name] for columns in runs]) for name in runs[0]}


def _scores(columns: Columns) -> Figures:
    """Scores by method with and without a right image ("blind"), and over the boxes that all of `COMPARED` measured."""
    is_blind = _is_within(columns["time_s"], BLACK_S) | _is_within(columns["time_s"], NOISE_S)
    is_true = np.isfinite(columns["scored_truth_m"])
    is_common = np.all([np.isfinite(columns[f"{name}_m"]) for name in COMPARED], axis=0)
    figures: Figures = {}
    for state, rows, names in (
        ("blind", is_blind, METHODS),
        ("blind, same boxes", is_blind & is_common, COMPARED),
        ("normal", ~is_blind, METHODS),
        ("normal, same boxes", ~is_blind & is_common, COMPARED),
    ):
        figures[state] = {}
        for name in names:
            column = MethodColumn(columns[f"{name}_m"], columns[f"{name}_sigma_m"])
            figures[state][name] = score_rows(column, columns["scored_truth_m"], is_true & rows)
    return figures
