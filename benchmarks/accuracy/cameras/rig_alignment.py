"""Alignment of pairs from drives, and rig files with errors on drives with a known rig.

Points of a drive are tracked once; for a rig file with an error, only their rectification changes.
Points of simulated drives can be stored in a folder, so that a second benchmark does not render
them.
"""

from __future__ import annotations

import math
import pickle
import time
from argparse import Namespace
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import product, repeat
from pathlib import Path
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
from scipy.stats import binomtest

from benchmarks.harness import Figures, option, workload
from benchmarks.inputs.drives import SimulatedDrive
from track_range.foundation.arrays import FloatArray
from track_range.recording.cameras.auto_alignment import PairAlignment
from track_range.simulation.camera.fault_options import Faults
from track_range.simulation.render.renderer import kitti_like_rig
from track_range.stereo.alignment.feature_tracks import FeatureTracks, PairPoints, TrackedFrame
from track_range.stereo.alignment.from_drive import DriveAlignment
from track_range.stereo.alignment.health import COLUMNS_U, MATTERS, REFERENCE_M, RigHealth
from track_range.stereo.alignment.right_view import RightView
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.frames import Frame, whole_image
from track_range.stereo.geometry.rectification import Rectifier
from track_range.stereo.geometry.rig import StereoRig

SCENARIOS = ("town", "highway", "city", "cut-in")

FIRST_SEED, N_DRIVES, DRIVE_S = 600, 50, 9.7
"""Seed of the first simulated drive (no test and no other benchmark uses these seeds), their number
and length."""

# default number of frames of a window: two segments of the estimate; a run uses up to three
WINDOW = 32
ANGLES_DEG = (0.02, 0.05, 0.1, 0.2, 0.5)  # sizes of the errors of an angle; the signs alternate
SCALE = 0.01  # relative error of focal lengths and of the baseline

ROW_M = 0.5  # height of the point at 30 m below the cameras, in m: the middle of a car
AFTER_PCT = 2.0  # largest error at 30 m of a corrected case


class Error(NamedTuple):
    """An error of a rig file: its kind, and its size in degrees or as a relative error."""

    fault: Fault
    size: float


ANGLES: tuple[Fault, ...] = ("yaw", "pitch", "roll")

ANGLE_ERRORS = [
    Error(axis, size * (-1) ** number)
    for number, (axis, size) in enumerate(product(ANGLES, ANGLES_DEG))
]
SCALE_ERRORS = [
    Error("focal_right", SCALE),
    Error("focal_right", -SCALE),
    Error("focal_both", SCALE),
]
# all errors; each window gets some of them in turn
ERRORS = (*ANGLE_ERRORS, *SCALE_ERRORS, Error("baseline", -SCALE))
UNSEEN = ("focal_both", "baseline")  # errors that images cannot show

OFFSETS_PX = (0.0, 0.3, -0.5, 0.8, 0.3, -0.5, 0.0, -0.2)
"""Disparity errors in px of the simulated pairs, by seed; positive = disparities are too large."""

SEEDS = tuple(range(240, 252))  # no test uses them
ALIGNMENT_S = 4.9  # length of a drive: the time that a run uses for the alignment

Fault = Literal["true", "yaw", "pitch", "roll", "focal_right", "focal_both", "baseline"]
"""Error of a rig file: rotation of the right camera about its centre, or a factor of focal lengths
or baseline."""


@dataclass(frozen=True, slots=True)
class TrackedDrive:
    """Points of a drive in pixels of rectified videos, and the true rig."""

    name: str
    rig: StereoRig
    frames: tuple[TrackedFrame, ...]

    def windows(self, n_frames: int, step: int | None = None) -> Iterator[TrackedDrive]:
        """Parts of `n_frames` frames that start every `step` frames; None = one after the other.

        A shorter rest of at least half as many frames is a part too, unless parts overlap.
        """
        min_frames = n_frames / 2 if step is None or step >= n_frames else n_frames
        for start in range(0, len(self.frames), step or n_frames):
            part = self.frames[start : start + n_frames]
            if len(part) >= min_frames:
                yield replace(self, name=f"{self.name}/{start}", frames=part)


def rig_with_error(rig: StereoRig, fault: Fault, size: float) -> StereoRig:
    """The rig file: angles in degrees, other errors as relative ones."""
    if fault in ("yaw", "pitch", "roll"):
        axis = ("pitch", "yaw", "roll").index(fault)
        rotation = np.eye(4)
        rotation[:3, :3] = cv2.Rodrigues(np.radians(size) * np.eye(3)[axis])[0]
        return replace(rig, right_from_left=rotation @ rig.right_from_left)
    if fault == "baseline":
        right_from_left = rig.right_from_left.copy()
        right_from_left[:3, 3] *= 1 + size
        return replace(rig, right_from_left=right_from_left)
    left, right = (
        replace(camera, fx_px=camera.fx_px * (1 + size), fy_px=camera.fy_px * (1 + size))
        if fault in faults
        else camera
        for camera, faults in (
            (rig.left, ("focal_both",)),
            (rig.right, ("focal_both", "focal_right")),
        )
    )
    return StereoRig(left, right, rig.right_from_left)


def rectified_points(
    frames: Iterable[TrackedFrame], rectifier: Rectifier
) -> Iterator[TrackedFrame]:
    """The frames with their points in pixels of the rectified images; points outside of them are
    omitted.
    """
    camera = rectifier.rig.left
    size = np.array([camera.width_px, camera.height_px])
    for frame in frames:
        left_px, right_px = rectifier.points(frame.points.left_px, frame.points.right_px)
        is_inside = ((left_px > 0) & (left_px < size) & (right_px > 0) & (right_px < size)).all(
            axis=1
        )
        points = PairPoints(frame.points.number[is_inside], left_px[is_inside], right_px[is_inside])
        yield frame._replace(points=points)


def tracked(frames: Iterable[Frame]) -> Iterator[TrackedFrame]:
    """The points of frames with right images."""
    tracks = FeatureTracks()
    for frame in frames:
        if frame.right is not None:
            yield tracks.add(frame.left, whole_image(frame.right), frame.time_s)


def simulated_drive(
    scenario: str, *, seed: int, seconds: float, cache: Path | None
) -> TrackedDrive:
    """A simulated drive, from the folder `cache` if it is there."""
    path = None if cache is None else cache / f"{scenario}-{seed}-{seconds:g}.pickle"
    if path is not None and path.exists():
        frames = pickle.loads(path.read_bytes())  # noqa: S301 - written by the lines below
    else:
        frames = tuple(
            tracked(SimulatedDrive.of(scenario, seed=seed, seconds=seconds).iter_frames())
        )
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(pickle.dumps(frames))
    return TrackedDrive(f"{scenario}/{seed}", kitti_like_rig(), frames)


@workload(option("--seeds", default=SEEDS, metavar="N", help="random seeds, one per drive"))
def alignment(options: Namespace) -> Figures:
    """Estimated disparity corrections of simulated pairs with a known disparity error, px."""
    drives = {f"seed {seed}": _drive(seed) for seed in options.seeds}
    measured = [row for row in drives.values() if row["is_measured"]]
    summary = {
        "axis": _sigma_figures(measured, "error_px", "sigma_px"),
        "image": _sigma_figures(measured, "remaining_px", "residual_px"),
    }
    return {"n": len(drives), "measured": len(measured), "all": summary, "drives": drives}


def _drive(seed: int) -> Figures:
    scenario, offset_px = SCENARIOS[seed % len(SCENARIOS)], OFFSETS_PX[seed % len(OFFSETS_PX)]
    drive = SimulatedDrive.of(
        scenario, seed=seed, seconds=ALIGNMENT_S, faults=Faults(disparity_offset_px=offset_px)
    )
    frames = drive.frames()
    start_s = time.process_time()
    estimated = DriveAlignment(drive.renderer.rig)
    for frame in frames:
        estimated.add(frame)
    estimate = PairAlignment.of_drive(estimated, drive.renderer.rig).measured
    alignment_s = time.process_time() - start_s
    u = np.linspace(-1.0, 1.0, 101)
    remaining_px = offset_px + estimate.error_px(u)
    return {
        "seed": seed,
        "scenario": scenario,
        "offset_px": offset_px,
        "is_measured": estimate.is_measured,
        "estimate_px": -estimate.offset_px,
        "curvature_px": -estimate.curvature_px,
        "error_px": -(offset_px + estimate.offset_px),
        "sigma_px": estimate.offset_sigma_px,
        "remaining_px": float(np.sqrt((remaining_px**2).mean())),
        "residual_px": estimate.residual_px,
        "alignment_s": alignment_s,
    }


def _sigma_figures(rows: Sequence[Figures], error: str, sigma: str) -> Figures:
    """Figures of the errors and sigmas under two keys of the rows; empty without rows."""
    if not rows:
        return {}
    errors_px, sigmas_px = (np.array([row[key] for row in rows]) for key in (error, sigma))
    in_sigmas = np.abs(errors_px) / sigmas_px
    return {
        "median_px": float(np.median(np.abs(errors_px))),
        "worst_px": float(np.abs(errors_px).max()),
        "bias_px": float(errors_px.mean()),
        "median_sigma_px": float(np.median(sigmas_px)),
        "within_1_sigma": float((in_sigmas <= 1).mean()),
        "within_2_sigma": float((in_sigmas <= 2).mean()),
    }


@workload(
    option("--drives", default=N_DRIVES, metavar="N", help="number of simulated drives"),
    option(
        "--first-seed", "--seed", default=FIRST_SEED, metavar="N", help="seed of the first drive"
    ),
    option("--errors", default=3, metavar="N", help="rig files with errors per window"),
    option(
        "--frames",
        default=WINDOW,
        metavar="N",
        help="frames per window: 16 = one segment of the estimate",
    ),
    option(
        "--step",
        type=int,
        metavar="N",
        help="frames between starts of windows (default: as many as in a window)",
    ),
    option("--cache", type=Path, metavar="DIR", help="folder for the tracked points"),
    option("--jobs", default=1, metavar="N", help="number of processes"),
)
def rig_health(options: Namespace) -> Figures:
    """True rig files and rig files with errors, on the same drives: which are noticed, and
    corrected.
    """
    windows = list(_windows(options))
    with ProcessPoolExecutor(options.jobs) as pool:
        found = pool.map(_cases, windows, range(len(windows)), repeat(options.errors))
        cases = [case for window_cases in found for case in window_cases]
    return _case_figures(cases)


def _windows(options: Namespace) -> Iterator[TrackedDrive]:
    for number in range(options.drives):
        scenario, seed = SCENARIOS[number // 2 % len(SCENARIOS)], options.first_seed + number
        drive = simulated_drive(scenario, seed=seed, seconds=DRIVE_S, cache=options.cache)
        yield from drive.windows(options.frames, options.step)


def _cases(window: TrackedDrive, number: int, n_errors: int) -> list[Figures]:
    errors = [ERRORS[(number * n_errors + k) % len(ERRORS)] for k in range(n_errors)]
    return [_case(window, error) for error in (Error("true", 0.0), *errors)]


def _case(window: TrackedDrive, error: Error) -> Figures:
    rig = rig_with_error(window.rig, *error)
    rectifier = Rectifier(rig)
    start_s = time.process_time()
    drive = DriveAlignment(rectifier.rig)
    for frame in rectified_points(window.frames, rectifier):
        drive.add_points(frame)
    measured = drive.estimate()
    windows = drive.windows()
    health = RigHealth(rectifier.rig, measured, measured.if_clear(), windows)
    before, after = (
        _errors_pct(window.rig, rectifier, alignment) for alignment in (Alignment(), health.applied)
    )
    halves = (windows[0], windows[-1]) if len(windows) > 1 else None
    return {
        "fault": error.fault,
        "size": error.size,
        "is_measured": measured.is_measured,
        "before_pct": float(np.abs(before).max()),
        "after_pct": float(np.abs(after).max()),
        "is_noticed": health.is_noticed,
        "has_moved": health.move is not None,
        "halves_sigmas": None if halves is None else _sigmas(*halves),
        "estimate_s": time.process_time() - start_s,
    }


def _sigmas(first: Any, last: Any) -> float:
    return float(abs(first.offset_px - last.offset_px) / math.hypot(first.sigma_px, last.sigma_px))


def _errors_pct(rig: StereoRig, rectifier: Rectifier, alignment: Alignment) -> FloatArray:
    """(3,) relative errors in per cent at 30 m and `COLUMNS_U`: points of the true rig, measured
    with the rig file.
    """
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


def _case_figures(cases: Sequence[Figures]) -> Figures:
    true = [case for case in cases if case["fault"] == "true"]
    wrong = [case for case in cases if case["fault"] != "true"]
    matters = [
        case
        for case in wrong
        if case["before_pct"] >= 100 * MATTERS and case["fault"] not in UNSEEN
    ]
    unseen = [case for case in wrong if case["fault"] in UNSEEN]
    sigmas = [case["halves_sigmas"] for case in cases if case["halves_sigmas"] is not None]
    by_fault = {}
    for fault in dict.fromkeys(case["fault"] for case in wrong):
        for size in sorted({abs(case["size"]) for case in wrong if case["fault"] == fault}):
            rows = [case for case in wrong if case["fault"] == fault and abs(case["size"]) == size]
            by_fault[f"{fault} {size:g}"] = {
                "cases": len(rows),
                "before_pct": float(np.median([row["before_pct"] for row in rows])),
                "noticed": float(np.mean([row["is_noticed"] for row in rows])),
                "after_median_pct": float(np.median([row["after_pct"] for row in rows])),
                "after_95_pct": float(np.percentile([row["after_pct"] for row in rows], 95)),
                "corrected": float(np.mean([row["after_pct"] <= AFTER_PCT for row in rows])),
            }
    return {
        "estimate_s": float(np.median([case["estimate_s"] for case in cases])),
        "cases": {
            "disparities measured": fraction(case["is_measured"] for case in cases),
            "true rig files, false alarms": fraction(case["is_noticed"] for case in true),
            "true rig files, moved during the drive": fraction(case["has_moved"] for case in true),
            "errors of 1 % or more, noticed": fraction(case["is_noticed"] for case in matters),
            "errors of 1 % or more, corrected": fraction(
                case["after_pct"] <= AFTER_PCT for case in matters
            ),
            "both focal lengths or baseline, noticed": fraction(
                case["is_noticed"] for case in unseen
            ),
            "halves within 1 sigma": fraction(sigma <= 1 for sigma in sigmas),
            "halves within 2 sigma": fraction(sigma <= 2 for sigma in sigmas),
        },
        "by_fault": by_fault,
    }


def fraction(values: Any) -> dict[str, float | None]:
    """Fraction of true values with Wilson's 95 % interval, and their number."""
    flags = [bool(value) for value in values]
    if not flags:
        return {"n": 0, "fraction": None, "low": None, "high": None}
    interval = binomtest(sum(flags), len(flags)).proportion_ci(method="wilson")
    return {
        "n": len(flags),
        "fraction": float(np.mean(flags)),
        "low": interval.low,
        "high": interval.high,
    }
