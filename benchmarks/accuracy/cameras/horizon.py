"""Distances of one camera at a known height or speed, on simulated drives with changed car
sizes.
"""

from __future__ import annotations

import os
from argparse import Namespace
from collections.abc import Mapping
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.accuracy.ranging.simulated_runs import joined
from benchmarks.harness import Figures, median_or_none, option, workload
from benchmarks.inputs.drives import FPS
from track_range.ranging.truth.errors import MethodColumn, score_rows
from track_range.ranging.truth.truth import Truth
from track_range.results.rows.rows import Rows
from track_range.results.summary import matched_truth, with_truth
from track_range.run.options.settings import RunSettings
from track_range.run.run import Run
from track_range.simulation.drive import Drive, write_drive
from track_range.simulation.settings import SCENARIO_NAMES, DriveOptions

METHODS = ("mono", "ground", "fused")
KNOWN = ("height", "speed", "both", "none")
SPAN_M = (10.0, 50.0)  # true distances of the errors
BIAS_FROM_S = (0.0, 5.0, 10.0)  # times from which the bias of a drive is measured
HEIGHT_M = 1.65  # height of the simulated cameras above the road


@workload(
    option(
        "--scenarios",
        default=("city", "highway", "cut-in", "crossing"),
        choices=SCENARIO_NAMES,
        help="simulated drives",
    ),
    option("--seeds", default=(300, 301, 302), help="seeds of the simulated drives"),
    option("--seconds", default=14.0, help="length of the simulated drives"),
    option("--car-size", default=1.1, help="size of the cars relative to the scenario's"),
    option("--pitch", default=-1.0, help="pitch of the camera in degrees, positive = up"),
    option(
        "--known",
        default=("height", "none"),
        choices=KNOWN,
        help="what is known besides the calibration",
    ),
    option("--cache", type=Path, help="folder in which simulated drives are kept"),
)
def horizon(options: Namespace) -> Figures:
    figures: Figures = {}
    with TemporaryDirectory() as name:
        cache = options.cache or Path(name)
        for known in options.known:
            drives = {
                f"{scenario} {seed}": _simulated(options, cache, scenario, seed, known)
                for scenario in options.scenarios
                for seed in options.seeds
            }
            figures[known] = _figures(drives)
    return figures


def _simulated(options: Namespace, cache: Path, scenario: str, seed: int, known: str) -> Rows:
    folder = cache / f"{scenario}-{seed}-{options.seconds:g}-{options.car_size:g}-{options.pitch:g}"
    drive = Drive.in_folder(folder)
    speed = folder / "speed" / drive.ego_speed.name
    if not speed.exists():
        drive_options = DriveOptions(car_size=options.car_size, camera_pitch_deg=options.pitch)
        write_drive(
            folder,
            scenario=scenario,
            seed=seed,
            seconds=options.seconds,
            fps=FPS,
            options=drive_options,
        )
        speed.parent.mkdir()
        os.replace(drive.ego_speed, speed)  # not beside the video, where a run would find it
    settings = RunSettings(
        mono=drive.left,
        rig=drive.rig,
        detections=drive.detections,
        truth=drive.table,
        overlay=False,
        camera_height_m=HEIGHT_M if known in ("height", "both") else None,
        ego_speed=str(speed) if known in ("speed", "both") else "auto",
    )
    return finished(settings)[1]


def finished(settings: RunSettings, truth: Truth | None = None) -> tuple[Run, Rows]:
    """A finished run, which writes nothing, and its columns with the truth: `truth`, or that of the
    settings.
    """
    run = Run(settings)
    for _ in run:
        pass
    rows = run.session.rows.table.to_rows(is_rounded=False)
    truth = truth or run.session.opened.truth
    return run, rows if truth is None else with_truth(rows, matched_truth(rows, truth))


def _figures(drives: Mapping[str, Rows]) -> Figures:
    """Errors over all drives and by drive, and biases; the magnitude of a bias is its mean over the
    drives.
    """
    bias = {name: _biases(columns) for name, columns in drives.items()}
    known = {
        key: [value for row in bias.values() if (value := row[key]) is not None]
        for key in next(iter(bias.values()))
    }
    magnitude = {
        key: float(np.mean(np.abs(values))) if values else None for key, values in known.items()
    }
    return {
        "all": _scores(joined(list(drives.values()))),
        "drives": {name: _scores(columns) for name, columns in drives.items()},
        "bias_pct": {**bias, "magnitude": magnitude},
    }


def _scores(columns: Rows) -> Figures:
    """Scores over the rows that all methods measured, with the coverage of each method."""
    columns_of = {name: MethodColumn(*columns.distance(name)) for name in METHODS}
    true_m, common = (
        columns["truth_m"],
        np.all([np.isfinite(each.distance_m) for each in columns_of.values()], axis=0),
    )
    in_span = (true_m >= SPAN_M[0]) & (true_m < SPAN_M[1])
    coverage = {
        name: score_rows(each, true_m, in_span)["coverage"] for name, each in columns_of.items()
    }
    return {
        name: {**score_rows(each, true_m, in_span & common), "coverage": coverage[name]}
        for name, each in columns_of.items()
    }


def _biases(columns: Rows) -> dict[str, float | None]:
    """Median of the signed errors in per cent, by method and time from which on they count."""
    true_m, time_s = columns["truth_m"], columns["time_s"]
    in_span = (true_m >= SPAN_M[0]) & (true_m < SPAN_M[1])
    biases: dict[str, float | None] = {}
    for name, start_s in product(METHODS, BIAS_FROM_S):
        error = (columns[f"{name}_m"] / true_m - 1)[in_span & (time_s >= start_s)]
        biases[f"{name} {start_s:g} s"] = median_or_none(error[np.isfinite(error)], 100)
    return biases
