"""Fusion while stereo fails: simulated drives with a right camera that is black, then grey noise, for 1 and 2 s.

Protocol: the `run` command with its defaults on the files of the drive (lossless images, recorded boxes, alignment from
the drive, no dense stereo). Errors against truth.csv at 5-100 m as with `--truth`, separately for frames without and
with a right image, over the boxes that each method measured (`coverage`: their fraction of the boxes with a true
distance); then per scenario over the boxes without a right image that mono, fused and their filters all measured.
"""

from __future__ import annotations

import tempfile
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.inputs.simulated_drives import FPS
from benchmarks.plain_tables import figure_text, plain_table
from track_range.cli.commands.run import run_and_print
from track_range.detection.lanes.nets import CLASSICAL
from track_range.foundation.arrays import BoolArray, Image
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
"""Default scenarios of the drives."""

SEED = 230
"""Default random seed, which no test uses."""

SECONDS = 8.0
"""Length of a drive in s."""

BLACK_S, NOISE_S = (3.0, 4.0), (5.5, 7.5)
"""Intervals in s in which the right image is black, and grey noise."""

METHODS = ("mono", "stereo", "fused", "mono_kf", "stereo_kf", "fused_kf")
"""Methods of the first table."""

COMPARED = ("mono", "mono_kf", "fused", "fused_kf")
"""Methods of the second table, compared on the same boxes."""

STATISTICS = ("median", "mean")
"""Statistics of the relative errors."""


def add_options(parser: ArgumentParser) -> None:
    """Add the options of this workload."""
    known = list(ALL_SCENARIOS)
    parser.add_argument("--scenarios", nargs="+", default=SCENARIOS, choices=known, metavar="NAME", help="scenarios")
    parser.add_argument("--seeds", type=int, nargs="+", default=[SEED], metavar="N", help="random seeds of the drives")
    parser.add_argument(
        "--lanes", default=CLASSICAL, metavar="FILE", help="lane network, or off (default: classical lane detection)"
    )


def measure(options: Namespace) -> dict[str, Any]:
    """Errors of each method with and without a right image, per scenario and in total; prints the tables."""
    by_scenario = {
        name: _concatenated([_run_on_drive(name, seed, options.lanes) for seed in options.seeds])
        for name in options.scenarios
    }
    total = _scores(_concatenated(list(by_scenario.values())))
    figures = {"all": total} | {name: _scores(columns) for name, columns in by_scenario.items()}
    _print_table(total)
    _print_scenarios(figures)
    return figures


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
            write_png(path, _in_colour(np.zeros(size, np.uint8)))
        elif _is_within(time_s, NOISE_S):
            write_png(path, _in_colour(rng.integers(0, 256, size, np.uint8)))


def _in_colour(grey: Image) -> Image:
    return np.repeat(grey, 3, axis=2)


def _is_within(time_s: Any, span_s: tuple[float, float]) -> BoolArray:
    return np.asarray((time_s > span_s[0] - 1e-6) & (time_s < span_s[1] - 1e-6))


def _concatenated(runs: Sequence[Columns]) -> Columns:
    return {name: np.concatenate([columns[name] for columns in runs]) for name in runs[0]}


def _scores(columns: Columns) -> dict[str, dict[str, Any]]:
    """Scores with and without a right image ("blind"), by method."""
    is_blind = _is_within(columns["time_s"], BLACK_S) | _is_within(columns["time_s"], NOISE_S)
    return {"blind": _scores_of(columns, is_blind), "normal": _scores_of(columns, ~is_blind)}


def _scores_of(columns: Columns, rows: BoolArray) -> dict[str, Any]:
    true_m = columns["scored_truth_m"][rows]
    methods = {name: MethodColumn(columns[f"{name}_m"][rows], columns[f"{name}_sigma_m"][rows]) for name in METHODS}
    same = np.isfinite(true_m) & np.all([np.isfinite(methods[name].distance_m) for name in COMPARED], axis=0)
    return {
        name: {
            **score_rows(column, true_m, np.isfinite(true_m)),
            "same": score_rows(column, true_m, same) if name in COMPARED else None,
        }
        for name, column in methods.items()
    }


def _print_table(figures: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> None:
    headings = ("n", "coverage %", "median %", "mean %", "bias %", "1 sigma %", "2 sigma %")
    table = plain_table("all drives", "right camera", "method", *headings, n_words=2)
    for state, methods in figures.items():
        for name, row in methods.items():
            keys = (*(f"{statistic}_relative_error_pct" for statistic in STATISTICS), "bias_pct")
            errors = (figure_text(row[key]) for key in keys)
            coverage, *fractions = (
                figure_text(row[key], digits=0, times=100) for key in ("coverage", "within_1_sigma", "within_2_sigma")
            )
            table.add_row(state, name, str(row["n"]), coverage, *errors, *fractions)
    Console().print(table)


def _print_scenarios(figures: Mapping[str, Mapping[str, Mapping[str, Mapping[str, Any]]]]) -> None:
    title = "right camera blind: median / mean error over the same boxes, %"
    table = plain_table(title, "drives", "n", *COMPARED)
    for scenario, by_state in figures.items():
        rows = [by_state["blind"][name]["same"] for name in COMPARED]
        errors = (
            " / ".join(figure_text(row[f"{statistic}_relative_error_pct"], digits=1) for statistic in STATISTICS)
            for row in rows
        )
        table.add_row(scenario, str(rows[0]["n"]), *errors)
    Console().print(table)
