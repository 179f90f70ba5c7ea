"""Health of rigs: true rig files and rig files with errors, on the same drives.

A case is a window of a drive (3.2 s by default) and a rig file: the true one, or one with a wrong angle of the right
camera (0.02 to 0.5 degrees of yaw, pitch or roll), or a focal length or baseline that is wrong by 1 %. The points of
the drive are tracked once and rectified by each rig file. The error of a case is the largest relative error of the
distance, over three columns of the image, of a point at 30 m, and follows from the true rig without any estimate.

    matters     error of at least 1 %: should be noticed
    corrected   error after the correction that a run applies
    halves      offsets of the two halves of a window, compared with their sigmas

Windows of KITTI count with the disparity errors that known distances show there (offset 0.45 px, curvature 1.5 px)
removed from the images, so that their rig files are true ones; drives without a reference count in `halves` only.
"""

from __future__ import annotations

import math
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import product, repeat
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console

from benchmarks.inputs.rig_drives import (
    Fault,
    TrackedDrive,
    recorded_drive,
    rectified_points,
    rig_with_error,
    shifted,
    simulated_drive,
)
from benchmarks.plain_tables import figure_text, plain_table
from track_range.foundation.arrays import FloatArray
from track_range.stereo.alignment.from_drive import DriveAlignment
from track_range.stereo.alignment.health import COLUMNS_U, MATTERS, REFERENCE_M, RigHealth
from track_range.stereo.alignment.model import Alignment
from track_range.stereo.alignment.right_view import RightView
from track_range.stereo.geometry.rectification import Rectifier
from track_range.stereo.geometry.rig import StereoRig

SCENARIOS = ("town", "highway", "city", "cut-in")
"""Scenarios of the drives, two seeds of each in turn."""

FIRST_SEED, N_DRIVES, SECONDS = 600, 50, 9.7
"""Seed of the first simulated drive (no test and no other benchmark uses these seeds), their number and length."""

WINDOW = 32
"""Default number of frames of a window: two segments of the estimate; a run uses up to three."""

ANGLES_DEG = (0.02, 0.05, 0.1, 0.2, 0.5)
"""Sizes of the errors of an angle; the signs alternate."""

SCALE = 0.01
"""Relative error of focal lengths and of the baseline."""

KITTI = {"0003": (0.45, 1.5, 0.0), "0005": (0.45, 1.5, 0.0)}
"""Offset, curvature and slope in px by known distances, of the drives that have them."""

ROW_M = 0.5
"""Height of the point at 30 m below the cameras, in m: the middle of a car."""

AFTER_PCT = 2.0
"""Largest error at 30 m of a corrected case."""


class Error(NamedTuple):
    """An error of a rig file: its kind, and its size in degrees or as a relative error."""

    fault: Fault
    size: float


ANGLES: tuple[Fault, ...] = ("yaw", "pitch", "roll")

ANGLE_ERRORS = [Error(axis, size * (-1) ** number) for number, (axis, size) in enumerate(product(ANGLES, ANGLES_DEG))]
SCALE_ERRORS = [Error("focal_right", SCALE), Error("focal_right", -SCALE), Error("focal_both", SCALE)]
ERRORS = (*ANGLE_ERRORS, *SCALE_ERRORS, Error("baseline", -SCALE))
"""All errors; each window gets some of them in turn."""

UNSEEN = ("focal_both", "baseline")
"""Errors that images cannot show."""


def add_options(parser: ArgumentParser) -> None:
    """Add the options of this workload."""
    parser.add_argument("--drives", type=int, default=N_DRIVES, metavar="N", help="number of simulated drives")
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED, metavar="N", help="seed of the first drive")
    parser.add_argument("--errors", type=int, default=3, metavar="N", help="rig files with errors per window")
    parser.add_argument(
        "--frames", type=int, default=WINDOW, metavar="N", help="frames per window: 16 = one segment of the estimate"
    )
    parser.add_argument(
        "--step", type=int, metavar="N", help="frames from one window to the next; default: as many as in a window"
    )
    parser.add_argument("--kitti", type=Path, nargs="*", default=[], metavar="DIR", help="drives of KITTI")
    parser.add_argument("--cache", type=Path, metavar="DIR", help="folder for the tracked points")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="number of processes")


def measure(options: Namespace) -> dict[str, Any]:
    """Figures of all cases; prints the tables."""
    windows = list(_windows(options))
    with ProcessPoolExecutor(options.jobs) as pool:
        found = pool.map(_cases, windows, range(len(windows)), repeat(options.errors))
        cases = [case for window_cases in found for case in window_cases]
    figures = _figures(cases)
    _print_tables(figures)
    return {"cases": cases, "all": figures}


def _windows(options: Namespace) -> Iterator[TrackedDrive]:
    for number in range(options.drives):
        scenario, seed = SCENARIOS[number // 2 % len(SCENARIOS)], options.first_seed + number
        drive = simulated_drive(scenario, seed=seed, seconds=SECONDS, cache=options.cache)
        yield from drive.windows(options.frames, options.step)
    for folder in options.kitti:
        drive = recorded_drive(folder, fps=10.0)
        known = KITTI.get(folder.name)
        yield from (drive if known is None else shifted(drive, np.array(known))).windows(options.frames, options.step)


def _cases(window: TrackedDrive, number: int, n_errors: int) -> list[dict[str, Any]]:
    errors = [ERRORS[(number * n_errors + k) % len(ERRORS)] for k in range(n_errors)]
    return [_case(window, error) for error in (Error("true", 0.0), *errors)]


def _case(window: TrackedDrive, error: Error) -> dict[str, Any]:
    rig = rig_with_error(window.rig, *error)
    rectifier = Rectifier(rig)
    start_s = time.process_time()
    drive = DriveAlignment(rectifier.rig)
    for frame in rectified_points(window.frames, rectifier):
        drive.add_points(frame)
    measured = drive.estimate()
    windows = drive.windows()
    health = RigHealth(rectifier.rig, measured, measured.if_clear(), windows)
    before, after = (_errors_pct(window.rig, rectifier, alignment) for alignment in (Alignment(), health.applied))
    halves = (windows[0], windows[-1]) if len(windows) > 1 else None
    return {
        "window": window.name,
        "has_truth": not window.name.startswith("gray"),
        "fault": error.fault,
        "size": error.size,
        "is_measured": measured.is_measured,
        "before_pct": float(np.abs(before).max()),
        "after_pct": float(np.abs(after).max()),
        "before_middle_pct": float(before[1]),
        "after_middle_pct": float(after[1]),
        "after_sigma_pct": health.after_pct(REFERENCE_M),
        "offset_px": measured.offset_px,
        "offset_sigma_px": measured.offset_sigma_px,
        "curvature_px": measured.curvature_px,
        "slope_px": measured.slope_px,
        "row_offset_px": measured.row_offset_px,
        "roll_deg": measured.roll_deg,
        "focal_ratio": measured.focal_ratio,
        "is_noticed": health.is_noticed,
        "is_applied": measured.is_clear,
        "has_moved": health.move is not None,
        "halves_sigmas": None if halves is None else _sigmas(*halves),
        "estimate_s": time.process_time() - start_s,
    }


def _sigmas(first: Any, last: Any) -> float:
    return float(abs(first.offset_px - last.offset_px) / math.hypot(first.sigma_px, last.sigma_px))


def _errors_pct(rig: StereoRig, rectifier: Rectifier, alignment: Alignment) -> FloatArray:
    """(3,) relative errors in per cent at 30 m and `COLUMNS_U`: points of the true rig, measured with the rig file."""
    camera = rig.left
    x_m = COLUMNS_U * camera.width_px / 2 / camera.fx_px * REFERENCE_M
    points_m = np.column_stack([x_m, np.full(3, ROW_M), np.full(3, REFERENCE_M)])
    right_m = points_m @ rig.right_from_left[:3, :3].T + rig.right_from_left[:3, 3]
    left_px, right_px = rectifier.points(camera.project(points_m), rig.right.project(right_m))
    rectified = rectifier.rig
    right_px = RightView.of(alignment).if_needed(rectified.left).corrected(right_px, rectified.left)
    disparity_px, _ = alignment.corrected(
        left_px[:, 0] - right_px[:, 0], np.zeros(3), x_px=left_px[:, 0], camera=rectified.left
    )
    return 100 * (np.nan_to_num(rectified.distance_m(disparity_px), nan=1e3) / REFERENCE_M - 1)


def _figures(cases: Sequence[dict[str, Any]]) -> dict[str, Any]:
    known = [case for case in cases if case["has_truth"]]
    true = [case for case in known if case["fault"] == "true"]
    wrong = [case for case in known if case["fault"] != "true"]
    matters = [case for case in wrong if case["before_pct"] >= 100 * MATTERS and case["fault"] not in UNSEEN]
    unseen = [case for case in wrong if case["fault"] in UNSEEN]
    measured = [case for case in matters if case["is_measured"]]
    sigmas = [case["halves_sigmas"] for case in cases if case["halves_sigmas"] is not None]
    by_fault = {}
    for fault in dict.fromkeys(case["fault"] for case in wrong):
        for size in sorted({abs(case["size"]) for case in wrong if case["fault"] == fault}):
            rows = [case for case in wrong if case["fault"] == fault and abs(case["size"]) == size]
            by_fault[f"{fault} {size:g}"] = {
                "cases": len(rows),
                "before_pct": float(np.median([row["before_pct"] for row in rows])),
                "noticed": fraction(row["is_noticed"] for row in rows),
                "after_median_pct": float(np.median([row["after_pct"] for row in rows])),
                "after_95_pct": float(np.percentile([row["after_pct"] for row in rows], 95)),
                "corrected": fraction(row["after_pct"] <= AFTER_PCT for row in rows),
            }
    return {
        "true": len(true),
        "wrong": len(wrong),
        "measured": fraction(case["is_measured"] for case in known),
        "false_alarms": fraction(case["is_noticed"] for case in true),
        "true_moved": fraction(case["has_moved"] for case in true),
        "noticed": fraction(case["is_noticed"] for case in matters),
        "noticed_if_measured": fraction(case["is_noticed"] for case in measured),
        "corrected": fraction(case["after_pct"] <= AFTER_PCT for case in matters),
        "corrected_if_measured": fraction(case["after_pct"] <= AFTER_PCT for case in measured),
        "corrected_middle_if_measured": fraction(abs(case["after_middle_pct"]) <= AFTER_PCT for case in measured),
        "unseen_noticed": fraction(case["is_noticed"] for case in unseen),
        "halves_within_2_sigma": fraction(sigma <= 2 for sigma in sigmas),
        "halves_within_1_sigma": fraction(sigma <= 1 for sigma in sigmas),
        "estimate_s": float(np.median([case["estimate_s"] for case in cases])),
        "by_fault": by_fault,
    }


def fraction(values: Any) -> dict[str, float | None]:
    """Fraction of true values with Wilson's 95 % interval, and their number."""
    flags = [bool(value) for value in values]
    n, z = len(flags), 1.96
    if not n:
        return {"n": 0, "share": None, "low": None, "high": None}
    p = sum(flags) / n
    centre = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * math.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    return {"n": n, "share": p, "low": max(centre - half, 0.0), "high": min(centre + half, 1.0)}


def _print_tables(figures: dict[str, Any]) -> None:
    summary = plain_table("cases, %", "", "n", "share", "95 % interval", n_words=1)
    names = {
        "measured": "disparities measured",
        "false_alarms": "true rigs: false alarms",
        "true_moved": "true rigs: moved during the drive",
        "noticed": "errors of 1 % or more: noticed",
        "noticed_if_measured": "... of the measured ones",
        "corrected": "errors of 1 % or more: at most 2 % after",
        "corrected_if_measured": "... of the measured ones",
        "corrected_middle_if_measured": "... in the middle of the image",
        "unseen_noticed": "both focal lengths or baseline: noticed",
        "halves_within_1_sigma": "halves within 1 sigma",
        "halves_within_2_sigma": "halves within 2 sigma",
    }
    for key, name in names.items():
        figure = figures[key]
        interval = "-" if figure["share"] is None else f"{100 * figure['low']:.1f} - {100 * figure['high']:.1f}"
        summary.add_row(name, str(figure["n"]), figure_text(figure["share"], digits=1, times=100), interval)
    table = plain_table(
        "errors at 30 m, %", "rig file", "cases", "before", "noticed", "after, median", "after, 95 %", "up to 2 %"
    )
    for name, row in figures["by_fault"].items():
        noticed, corrected = (figure_text(row[key]["share"], digits=0, times=100) for key in ("noticed", "corrected"))
        pcts = [figure_text(row[key], digits=2) for key in ("before_pct", "after_median_pct", "after_95_pct")]
        table.add_row(name, str(row["cases"]), pcts[0], noticed, *pcts[1:], corrected)
    Console().print(summary, table, f"{figures['true']} true and {figures['wrong']} wrong rig files")
