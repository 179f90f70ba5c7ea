"""Fusion where stereo goes blind: simulated drives whose right eye is black, then grey noise, for a second or two.

The ordinary command on the drive's files (lossless pictures, its recorded boxes, alignment from the drive, no dense
stereo), at its defaults; errors against truth.csv at 5-100 m as `--truth` counts them, in the frames without a right
eye and in all others, over what each method measured (`covered`: of the boxes with a truth); then, drive by drive, over
the blind frames' boxes that all of mono, fused and their filters measured.
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
from track_range.cli.run import run_and_print
from track_range.detection.lanes.nets import CLASSICAL
from track_range.foundation.arrays import BoolArray, Image
from track_range.ranging.evaluation.errors import MethodColumn, score_rows
from track_range.ranging.evaluation.truth import read_truth
from track_range.results.columns import Columns
from track_range.results.csv_file import read_tracks_csv
from track_range.results.truth import matched_truth, with_truth
from track_range.run.settings import RunSettings
from track_range.simulation.camera.drive_files import write_png
from track_range.simulation.drive import DriveOptions, write_drive
from track_range.simulation.render.renderer import kitti_like_rig
from track_range.simulation.world.scenarios import SCENARIOS as KNOWN

SCENARIOS = ("town", "highway", "city", "cut-in")
SEED = 230
SECONDS = 8.0
BLACK_S, NOISE_S = (3.0, 4.0), (5.5, 7.5)
"""When the right eye sees nothing."""

METHODS = ("mono", "stereo", "fused", "mono_kf", "stereo_kf", "fused_kf")
COMPARED = ("mono", "mono_kf", "fused", "fused_kf")
"""On the same boxes."""

KINDS = ("median", "mean")


def add_options(parser: ArgumentParser) -> None:
    """Options of the workload."""
    parser.add_argument("--scenarios", nargs="+", default=SCENARIOS, choices=list(KNOWN), metavar="NAME")
    parser.add_argument("--seeds", type=int, nargs="+", default=[SEED], metavar="N")
    parser.add_argument("--lanes", default=CLASSICAL, metavar="FILE", help="a lane network, or off; else by edges")


def measure(options: Namespace) -> dict[str, Any]:
    """Errors of every method in blinded and other frames, of each scenario and of all together."""
    by_scenario = {
        name: _joined([_driven(name, seed, options.lanes) for seed in options.seeds]) for name in options.scenarios
    }
    every = _scores(_joined(list(by_scenario.values())))
    figures = {"all": every} | {name: _scores(columns) for name, columns in by_scenario.items()}
    _tell(every)
    _tell_scenarios(figures)
    return figures


def _driven(scenario: str, seed: int, lanes: str) -> Columns:
    """The rows of a run on a drive, with their truth."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        options = DriveOptions(scenario=scenario, is_lossless=True)
        drive = write_drive(folder / "drive", seed=seed, seconds=SECONDS, fps=FPS, options=options)
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
    """Put black and noise in the place of pictures; each file is named after its frame."""
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


def _joined(runs: Sequence[Columns]) -> Columns:
    return {name: np.concatenate([columns[name] for columns in runs]) for name in runs[0]}


def _scores(columns: Columns) -> dict[str, dict[str, Any]]:
    """By kind of frame, then by method."""
    is_blind = _is_within(columns["time_s"], BLACK_S) | _is_within(columns["time_s"], NOISE_S)
    return {"blind": _scores_of(columns, is_blind), "seeing": _scores_of(columns, ~is_blind)}


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


def _tell(figures: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> None:
    headings = ("n", "covered %", "median %", "mean %", "bias %", "1 sigma %", "2 sigma %")
    table = plain_table("all drives", "right eye", "method", *headings, n_words=2)
    for eye, methods in figures.items():
        for name, row in methods.items():
            keys = (*(f"{kind}_relative_error_pct" for kind in KINDS), "bias_pct")
            errors = (figure_text(row[key]) for key in keys)
            coverage, *shares = (
                figure_text(row[key], digits=0, times=100) for key in ("coverage", "within_1_sigma", "within_2_sigma")
            )
            table.add_row(eye, name, str(row["n"]), coverage, *errors, *shares)
    Console().print(table)


def _tell_scenarios(figures: Mapping[str, Mapping[str, Mapping[str, Mapping[str, Any]]]]) -> None:
    title = "blind, median / mean error over the same boxes, %"
    table = plain_table(title, "drives", "n", *COMPARED)
    for scenario, eyes in figures.items():
        rows = [eyes["blind"][name]["same"] for name in COMPARED]
        errors = (
            " / ".join(figure_text(row[f"{kind}_relative_error_pct"], digits=1) for kind in KINDS) for row in rows
        )
        table.add_row(scenario, str(rows[0]["n"]), *errors)
    Console().print(table)
