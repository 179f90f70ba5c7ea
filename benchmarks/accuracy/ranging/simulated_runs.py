"""Distances of runs on simulated drives: while stereo fails, and with a fisheye lens."""

from __future__ import annotations

import tempfile
from argparse import Namespace
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.harness import Figures, option, workload
from benchmarks.inputs.drives import FPS
from track_range.cli.commands.run import run_and_print
from track_range.detection.lanes.nets import CLASSICAL
from track_range.foundation.arrays import BoolArray, IntArray
from track_range.ranging.truth.errors import MethodColumn, score_rows
from track_range.ranging.truth.truth import read_truth
from track_range.results.formats.csv_file import read_tracks_csv
from track_range.results.rows.rows import Rows
from track_range.results.summary import matched_truth, with_truth
from track_range.run.options.settings import RunSettings
from track_range.simulation.camera.drive_files import write_png
from track_range.simulation.camera.wide_lens import WideLens
from track_range.simulation.drive import Drive, write_drive
from track_range.simulation.render.renderer import kitti_like_rig
from track_range.simulation.settings import DriveOptions
from track_range.simulation.world.scenarios import SCENARIOS as ALL_SCENARIOS
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig

SCENARIOS = ("town", "highway", "city", "cut-in")
FUSION_SEED = 230  # no test uses it
SECONDS = 8.0
# intervals in s in which the right image is black, and grey noise
BLACK_S, NOISE_S = (3.0, 4.0), (5.5, 7.5)
FUSION_METHODS = ("mono", "stereo", "fused", "mono_kf", "stereo_kf", "fused_kf")
COMPARED = ("mono", "mono_kf", "fused", "fused_kf")  # methods that are compared on the same boxes

LENS_SEED = 250  # no test uses it

LENS = PinholeCamera(400.0, 400.0, 479.5, 239.5, 960, 480, (0.01, 0.0, 0.0, 0.0), "kannala-brandt")
"""The fisheye camera, with 136 x 69 degrees."""

BASELINE_M = 0.54  # KITTI's
_MAX_FRAMES = 100_000  # above the number of frames of a drive, for keys of frame and object
LENS_METHODS = ("mono", "ground", "stereo", "fused", "fused_kf")
STATISTICS = ("median", "mean")
OFF_AXIS_DEG = 30.0  # horizontal angle from the axis that divides the objects of the second table


@workload(
    option(
        "--scenarios",
        default=SCENARIOS,
        choices=tuple(ALL_SCENARIOS),
        metavar="NAME",
        help="scenarios",
    ),
    option("--seeds", default=(FUSION_SEED,), metavar="N", help="random seeds of the drives"),
    option(
        "--lanes",
        default=CLASSICAL,
        metavar="FILE",
        help="lane network, off, or the classical lane detection",
    ),
)
def fusion(options: Namespace) -> Figures:
    """Fusion while stereo fails: simulated drives with a right camera that is black, then grey
    noise, for 1 and 2 s.
    """
    by_scenario = {
        name: joined([_blind_run(name, seed, options.lanes) for seed in options.seeds])
        for name in options.scenarios
    }
    return {
        name: _scores(columns)
        for name, columns in {"all": joined(list(by_scenario.values())), **by_scenario}.items()
    }


def _blind_run(scenario: str, seed: int, lanes: str) -> Rows:
    return run_columns(
        scenario, seed, SECONDS, prepare=lambda drive: _blind(drive.right, seed), lanes=lanes
    )


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


def _scores(columns: Rows) -> Figures:
    """Scores by method with and without a right image ("blind"), and over the boxes that all of
    `COMPARED` measured.
    """
    is_blind = _is_within(columns["time_s"], BLACK_S) | _is_within(columns["time_s"], NOISE_S)
    is_true = np.isfinite(columns["scored_truth_m"])
    is_common = np.all([np.isfinite(columns[f"{name}_m"]) for name in COMPARED], axis=0)
    figures: Figures = {}
    for state, rows, names in (
        ("blind", is_blind, FUSION_METHODS),
        ("blind, same boxes", is_blind & is_common, COMPARED),
        ("normal", ~is_blind, FUSION_METHODS),
        ("normal, same boxes", ~is_blind & is_common, COMPARED),
    ):
        figures[state] = {}
        for name in names:
            column = MethodColumn(*columns.distance(name))
            figures[state][name] = score_rows(column, columns["scored_truth_m"], is_true & rows)
    return figures


def run_columns(
    scenario: str,
    seed: int,
    seconds: float,
    *,
    rig: StereoRig | None = None,
    shown: PinholeCamera | None = None,
    prepare: Callable[[Drive], None] = lambda drive: None,
    **settings: Any,
) -> Rows:
    """Columns of the command `run` without dense stereo on a drive with lossless images.

    `shown` is the left camera of the rectified images, `prepare` changes the drive's files; the
    boxes are the recorded ones unless the settings have a detector. `true_id` is the identity of
    the object; -1 = none.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        options = DriveOptions(lossless=True)
        drive = write_drive(
            folder / "drive",
            scenario=scenario,
            seed=seed,
            seconds=seconds,
            fps=FPS,
            rig=rig,
            options=options,
        )
        prepare(drive)
        if "detector" not in settings:
            settings["detections"] = drive.detections
        pair = (drive.left, drive.right)
        given: dict[str, Any] = {
            "rig": drive.rig,
            "out": folder / "run",
            "overlay": False,
            "sgbm": False,
            "folder_fps": FPS,
        }
        chosen = RunSettings(stereo=pair, region="europe", **given, **settings)
        out = run_and_print(chosen, Console(quiet=True), print_results=lambda _, __: None)
        truth = read_truth(drive.table, shown or kitti_like_rig().left, np.zeros(3))
        rows = Rows(read_tracks_csv(out / "tracks.csv"))
        matched = matched_truth(rows, truth)
        true_id = matched.of_labels(truth.track_id, -1)
        return with_truth(rows, matched).with_columns({"true_id": true_id})


def joined(runs: Sequence[Rows]) -> Rows:
    """The columns that all runs have, one run after the other."""
    names = set.intersection(*(set(run.columns) for run in runs))
    return Rows({name: np.concatenate([run[name] for run in runs]) for name in names})


@workload(
    option(
        "--scenarios",
        default=SCENARIOS,
        choices=tuple(ALL_SCENARIOS),
        metavar="NAME",
        help="scenarios",
    ),
    option("--seeds", default=(LENS_SEED,), metavar="N", help="random seeds of the drives"),
    option("--seconds", default=6.0, metavar="S", help="length of a drive"),
    option("--detector", metavar="FILE", help="network for the boxes (default: recorded boxes)"),
)
def wide_lenses(options: Namespace) -> Figures:
    """Distances with a fisheye lens and with a pinhole of the same angular resolution, on the same
    simulated drives.
    """
    rows = [
        _common_rows(*_both_runs(scenario, seed, options))
        for scenario in options.scenarios
        for seed in options.seeds
    ]
    columns = [joined([pair[side] for pair in rows]) for side in (0, 1)]
    angle_deg = np.degrees(np.arctan2(np.abs(columns[0]["x_m"]), columns[0]["scored_truth_m"]))
    parts = {
        "all": np.full(len(angle_deg), True),
        f"up to {OFF_AXIS_DEG:.0f} deg": angle_deg <= OFF_AXIS_DEG,
        "farther out": angle_deg > OFF_AXIS_DEG,
    }
    return {
        part: {
            method: _compared(method, columns, np.flatnonzero(chosen)) for method in LENS_METHODS
        }
        for part, chosen in parts.items()
    }


def _both_runs(scenario: str, seed: int, options: Namespace) -> tuple[Rows, Rows]:
    wide = StereoRig.rectified(LENS, BASELINE_M)
    pinholes = WideLens.of(wide).pinholes
    boxes = {} if options.detector is None else {"detector": options.detector}
    pinhole, fisheye = (
        run_columns(scenario, seed, options.seconds, rig=rig, shown=pinholes.left, **boxes)
        for rig in (pinholes, wide)
    )
    return pinhole, fisheye


def _common_rows(pinhole: Rows, fisheye: Rows) -> tuple[Rows, Rows]:
    """The rows of both runs with the same frame and true object."""
    keys, rows = zip(*(_keys(columns) for columns in (pinhole, fisheye)), strict=True)
    _, first, second = np.intersect1d(keys[0], keys[1], return_indices=True)
    return pinhole.select(rows[0][first]), fisheye.select(rows[1][second])


def _keys(columns: Rows) -> tuple[IntArray, IntArray]:
    """Numbers of frame and true object, and the rows, of those with a true distance."""
    rows = np.flatnonzero(np.isfinite(columns["scored_truth_m"]))
    return (columns["true_id"][rows] * _MAX_FRAMES + columns["frame"][rows]).astype(np.int64), rows


def _compared(method: str, columns: Sequence[Rows], rows: IntArray) -> dict[str, Any]:
    """Scores of a method with pinhole and fisheye over the rows that both measured, and the ratios
    of the errors.
    """
    both = np.all([np.isfinite(part[f"{method}_m"]) for part in columns], axis=0)
    rows = rows[both[rows]]
    true_m = columns[0]["scored_truth_m"][rows]
    scores = {
        name: score_rows(
            MethodColumn(part[f"{method}_m"][rows], part[f"{method}_sigma_m"][rows]),
            true_m,
            np.full(len(rows), True),
        )
        for name, part in zip(("pinhole", "fisheye"), columns, strict=True)
    }
    keys = [f"{statistic}_relative_error_pct" for statistic in STATISTICS]
    ratios = {
        statistic: scores["fisheye"][key] / scores["pinhole"][key]
        if len(rows) and scores["pinhole"][key]
        else None
        for statistic, key in zip(STATISTICS, keys, strict=True)
    }
    return {**scores, "ratios": ratios}
