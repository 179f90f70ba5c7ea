"""Horizon: distances of one camera at a known height, on simulated drives with changed car sizes and on KITTI.

Protocol: the `run` command on the left video with its rig file, lanes as by default. Simulated drives: wobble, hills
and curves of the scenario, the camera pitched by `--pitch`, all cars `--car-size` times as large, boxes of the playback
detector. Known are the camera height (height), the ego speed (speed), both, or nothing (none). Errors against truth.csv
at 10-50 m, over the track-frames that mono, ground and fused all measured; cover: fraction of the boxes that a method
measured; within: share within 1 and 2 sigma. `bias`: median of the signed errors of a drive at 10-50 m from a time on;
its magnitude is the mean over the drives. Seeds 0-2 are for settings, 300-302 for judgement. KITTI 0003 and 0005:
YOLOv5n's boxes, truth from the labels, camera height 1.65 m, errors at 5-100 m.
"""

from __future__ import annotations

import os
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.inputs.drives import REAL_DATA
from benchmarks.plain_tables import figure_text, plain_table
from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.ranging.evaluation.errors import MethodColumn, score_rows
from track_range.ranging.evaluation.truth import read_truth
from track_range.results.columns import Columns
from track_range.results.summary import matched_truth, with_truth
from track_range.run.run import Run
from track_range.run.settings import RunSettings
from track_range.simulation.drive import Drive, write_drive
from track_range.simulation.settings import SCENARIO_NAMES, DriveOptions

METHODS = ("mono", "ground", "fused")
"""Methods of the tables."""

KNOWN = ("height", "speed", "both", "none")
"""What is known besides the calibration of the camera."""

SPAN_M, KITTI_SPAN_M = (10.0, 50.0), (5.0, 100.0)
"""True distances of the errors on simulated drives and on KITTI."""

BANDS_M = (10.0, 20.0, 30.0, 50.0)
"""Edges of the distance bands."""

BIAS_FROM_S = (0.0, 5.0, 10.0)
"""Times from which the bias of a drive is measured."""

HEIGHT_M = 1.65
"""Height of KITTI's and of the simulated cameras above the road."""

FPS = 10.0
"""Frame rate of the simulated drives."""


def add_options(parser: ArgumentParser) -> None:
    """Add the options of this workload."""
    parser.add_argument(
        "--scenarios", nargs="+", default=["city", "highway", "cut-in", "crossing"], choices=SCENARIO_NAMES
    )
    parser.add_argument("--seeds", type=int, nargs="+", default=[300, 301, 302], help="seeds of the simulated drives")
    parser.add_argument("--seconds", type=float, default=14.0, help="length of the simulated drives")
    parser.add_argument("--car-size", type=float, default=1.1, help="size of the cars relative to the scenario's")
    parser.add_argument("--pitch", type=float, default=-1.0, help="pitch of the camera in degrees, positive = up")
    parser.add_argument("--known", nargs="+", default=["height", "none"], choices=KNOWN)
    parser.add_argument("--cache", type=Path, help="folder in which simulated drives are kept")
    parser.add_argument("--kitti", action="store_true", help="only KITTI's drives")
    parser.add_argument("--data", type=Path, default=REAL_DATA, help="folder with kitti_stereo and models")
    parser.add_argument("--detector", type=Path, help="detector of KITTI's drives (default: YOLOv5n)")


def measure(options: Namespace) -> dict[str, Any]:
    """Errors by method for all kinds of knowledge; prints the tables."""
    figures: dict[str, Any] = {}
    with TemporaryDirectory() as name:
        cache = options.cache or Path(name)
        for known in options.known:
            if not options.kitti:
                drives = {
                    f"{scenario} {seed}": _simulated(options, cache, scenario, seed, known)
                    for scenario in options.scenarios
                    for seed in options.seeds
                }
                figures[known] = _figures(drives, f"simulated drives, known: {known}", SPAN_M)
        for known in options.known:
            drives = {}
            for folder in (options.data / "kitti_stereo" / number for number in ("0003", "0005")):
                if folder.is_dir():
                    detector = options.detector or options.data / "models" / "yolov5n_coco_640.onnx"
                    drives[f"KITTI {folder.name}"] = _kitti(folder, detector, known)
            if drives:
                figures[f"KITTI {known}"] = _figures(drives, f"KITTI, known: {known}", KITTI_SPAN_M)
    return figures


def _simulated(options: Namespace, cache: Path, scenario: str, seed: int, known: str) -> Columns:
    """Result columns of a run on a simulated drive, which is rendered if the cache does not have it."""
    folder = cache / f"{scenario}-{seed}-{options.seconds:g}-{options.car_size:g}-{options.pitch:g}"
    drive = Drive.in_folder(folder)
    speed = folder / "speed" / drive.ego_speed.name
    if not speed.exists():
        drive_options = DriveOptions(car_size=options.car_size, camera_pitch_deg=options.pitch)
        write_drive(folder, scenario=scenario, seed=seed, seconds=options.seconds, fps=FPS, options=drive_options)
        speed.parent.mkdir()
        os.replace(drive.ego_speed, speed)  # not beside the video, where a run would find it
    settings = RunSettings(
        mono=drive.left,
        rig=drive.rig,
        detections=drive.detections,
        overlay=False,
        camera_height_m=HEIGHT_M if known in ("height", "both") else None,
        ego_speed=str(speed) if known in ("speed", "both") else "auto",
    )
    return _columns(settings, drive.table)


def _kitti(folder: Path, detector: Path, known: str) -> Columns:
    oxts = folder / "oxts"
    settings = RunSettings(
        mono=folder / "left.mp4",
        rig=folder / "calib.txt",
        detector=str(detector),
        overlay=False,
        camera_height_m=HEIGHT_M if known in ("height", "both") else None,
        ego_speed=str(oxts) if known in ("speed", "both") and oxts.is_dir() else "auto",
    )
    return _columns(settings, folder / "label.txt")


def _columns(settings: RunSettings, truth_file: Path) -> Columns:
    """Result columns of a run, with the true distances."""
    run = Run(settings)
    for _ in run:
        pass
    camera = run.camera
    rows = run.session.rows.table.to_columns(is_rounded=False)
    truth = read_truth(truth_file, camera, np.zeros(3))
    return with_truth(rows, matched_truth(rows, truth))


def _figures(drives: Mapping[str, Columns], title: str, span_m: tuple[float, float]) -> dict[str, Any]:
    """Figures over all drives and by drive, which are printed."""
    figures: dict[str, Any] = {
        "all": _scores(_concatenated(list(drives.values())), span_m),
        "drives": {name: _scores(columns, span_m) for name, columns in drives.items()},
        "bias": {name: _biases(columns, span_m) for name, columns in drives.items()},
    }
    _print_errors(figures, title)
    _print_biases(figures["bias"])
    return figures


def _concatenated(runs: Sequence[Columns]) -> Columns:
    return {name: np.concatenate([columns[name] for columns in runs]) for name in _USED}


_USED = ("time_s", "truth_m", *(f"{name}{unit}" for name in METHODS for unit in ("_m", "_sigma_m")))
"""Columns of the scores."""


def _scores(columns: Columns, span_m: tuple[float, float]) -> dict[str, dict[str, Any]]:
    true_m = columns["truth_m"]
    methods = {name: MethodColumn(columns[f"{name}_m"], columns[f"{name}_sigma_m"]) for name in METHODS}
    common = np.all([np.isfinite(method.distance_m) for method in methods.values()], axis=0)
    scores = {}
    for name, method in methods.items():
        score = score_rows(method, true_m, _is_between(true_m, span_m) & common)
        score["bands"] = [
            score_rows(method, true_m, _is_between(true_m, band) & common)["median_relative_error_pct"]
            for band in pairwise(BANDS_M)
        ]
        score["coverage"] = score_rows(method, true_m, _is_between(true_m, span_m))["coverage"]
        scores[name] = score
    return scores


def _is_between(true_m: FloatArray, span_m: tuple[float, float]) -> BoolArray:
    return np.asarray((true_m >= span_m[0]) & (true_m < span_m[1]))


def _biases(columns: Columns, span_m: tuple[float, float]) -> dict[str, list[float | None]]:
    """Median of the signed errors in per cent from each time on, by method."""
    true_m, in_span = columns["truth_m"], _is_between(columns["truth_m"], span_m)
    biases: dict[str, list[float | None]] = {}
    for name in METHODS:
        error = columns[f"{name}_m"] / true_m - 1
        use = in_span & np.isfinite(error)
        parts = [error[use & (columns["time_s"] >= start_s)] for start_s in BIAS_FROM_S]
        biases[name] = [100 * float(np.median(part)) if len(part) else None for part in parts]
    return biases


def _print_errors(figures: Mapping[str, Any], title: str) -> None:
    bands = [f"{low:g}-{high:g} m" for low, high in pairwise(BANDS_M)]
    table = plain_table(
        f"{title}: median error, %", "drive", "method", "n", "cover", "all", *bands, "mean", "within", n_words=2
    )
    for drive, methods in {**figures["drives"], "all": figures["all"]}.items():
        for name, row in methods.items():
            fractions = "/".join(
                figure_text(row[key], digits=0, times=100) for key in ("within_1_sigma", "within_2_sigma")
            )
            errors = (row["median_relative_error_pct"], *row["bands"], row["mean_relative_error_pct"])
            cover = figure_text(row["coverage"], digits=0, times=100)
            table.add_row(
                drive, name, str(row["n"]), cover, *(figure_text(value, digits=1) for value in errors), fractions
            )
    Console().print(table)


def _print_biases(biases: Mapping[str, Mapping[str, Sequence[float | None]]]) -> None:
    headings = [f"{name} {start_s:g} s" for name in METHODS for start_s in BIAS_FROM_S]
    table = plain_table("bias of each drive from a time on, %", "drive", *headings)
    for drive, by_method in biases.items():
        values = [value for name in METHODS for value in by_method[name]]
        table.add_row(drive, *(figure_text(value, digits=1) for value in values))
    columns = zip(*([v for name in METHODS for v in by_method[name]] for by_method in biases.values()), strict=True)
    means = [[abs(value) for value in column if value is not None] for column in columns]
    table.add_row("magnitude", *(figure_text(float(np.mean(m)) if m else None, digits=1) for m in means))
    Console().print(table)
