"""Cameras without a calibration: focal length, distortion and distances of whole runs, and the time
that the estimate takes.

Rendered drives differ in field of view, format, principal point, pitch, baseline and the mean size
of their cars (`inputs/camera_drives.py`), and runs get nothing but the videos and recorded boxes; a
focal length is the one that a run states at its end, with its sigma.
"""

from __future__ import annotations

import math
import tempfile
import time
from argparse import Namespace
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import track_range as tr
from benchmarks.accuracy.cameras.colmap import colmap_camera
from benchmarks.accuracy.cameras.focal_boxes import BOX_OPTIONS, box_figures
from benchmarks.accuracy.cameras.pre_pass_time import pre_pass_times
from benchmarks.accuracy.ranging.row_scores import RowScores, median, pooled
from benchmarks.harness import Figures, StoredResults, option, workload
from benchmarks.inputs.camera_drives import SECONDS, CameraDrive
from benchmarks.inputs.drives import CACHE_OPTION, REAL_DATA, decoded
from track_range.foundation.arrays import Image
from track_range.ranging.truth.truth import read_truth
from track_range.stereo.geometry.camera import PinholeCamera

PARTS = ("boxes", "mono", "stereo", "lens", "real", "colmap", "time")
TURNING, STRAIGHT = tuple(range(720, 730)), ("town 720", "highway 721", "town 722", "highway 723")
LENS_SEEDS = (730, 731)
RenderedDrive = tuple[str, int]  # scenario and seed
MONO_STEP = 2  # every second frame of a run with one camera; the estimate reads what it wants
COLMAP_STEP = 2  # COLMAP gets 5 images per second


@workload(
    option("--parts", default=PARTS, choices=PARTS, help="tables"),
    *BOX_OPTIONS,
    option("--turning", default=TURNING, metavar="N", help="seeds of rendered drives with a turn"),
    option("--straight", default=STRAIGHT, metavar="NAME", help="rendered drives without one"),
    option(
        "--lens-seeds", default=LENS_SEEDS, metavar="N", help="seeds of drives with a wide lens"
    ),
    option("--real", default=(), nargs="*", metavar="NAME", help="recordings; default: all"),
    option("--results", type=Path, metavar="FILE", help="JSON lines to continue from"),
    CACHE_OPTION,
)
def self_calibration(options: Namespace) -> Figures:
    """Cameras without a calibration: focal length, distortion, distances, and time."""
    stored = StoredResults(options.results)
    turning: list[RenderedDrive] = [("winding", seed) for seed in options.turning]
    straight: list[RenderedDrive] = [
        (name, int(seed)) for name, seed in map(str.split, options.straight)
    ]
    figures: Figures = {}
    if "boxes" in options.parts:
        figures["boxes"] = box_figures(options)
    if "mono" in options.parts:
        figures |= _groups(options, stored, "mono, with a turn", turning)
        figures |= _groups(options, stored, "mono, straight", straight)
    if "stereo" in options.parts:
        figures |= _groups(options, stored, "stereo, with a turn", turning)
    if "lens" in options.parts:
        wide = [(str(options.cache), seed) for seed in options.lens_seeds]
        figures["lens"] = _by_drive(stored.mapped("lens", _lens, wide, 1))
    if "real" in options.parts:
        names = [name for name in options.real or REAL if REAL[name].exists]
        figures["real"] = _by_drive(stored.mapped("real", _real, names, 1))
    if "colmap" in options.parts:
        reconstructed = [*((str(options.cache), *drive) for drive in turning), ("", "gray51", 0)]
        found = _by_drive(stored.mapped("colmap", _colmap, reconstructed, 1))
        figures["colmap"] = {name: row for name, row in found.items() if "s" in row}
    if "time" in options.parts:
        timed = [(str(options.cache), *drive) for drive in (*turning, *straight)]
        figures["time"] = _by_drive(stored.mapped("time", _time, timed, 1))
    return figures


def _groups(
    options: Namespace, stored: StoredResults, title: str, drives: Sequence[RenderedDrive]
) -> Figures:
    """Figures of runs on a group of drives, without and with a given speed, and of each drive."""
    make = _stereo if title.startswith("stereo") else _mono
    figures: Figures = {}
    for has_speed in (False, True):
        name = f"{title}, speed given" if has_speed else title
        cases = [(str(options.cache), *drive, has_speed) for drive in drives]
        if rows := list(stored.mapped(name, make, cases, 1)):
            figures |= {name: _summed(rows), f"{name}, drives": _by_drive(map(_shown, rows))}
    return figures


def _by_drive(rows: Iterable[Figures]) -> Figures:
    return {
        row["drive"]: {key: value for key, value in row.items() if key != "drive"} for row in rows
    }


# ---------------------------------------------------------------------------------- rendered drives


@contextmanager
def _bare(*videos: Path) -> Iterator[list[Path]]:
    """Links to videos in a folder without calibration, speed and other files beside them."""
    with tempfile.TemporaryDirectory() as folder:
        links = [Path(folder) / video.name for video in videos]
        for video, link in zip(videos, links, strict=True):
            link.symlink_to(video.resolve())
        yield links


def _mono(case: tuple[str, str, int, bool]) -> Figures:
    return _run(case, is_stereo=False)


def _stereo(case: tuple[str, str, int, bool]) -> Figures:
    return _run(case, is_stereo=True)


def _run(case: tuple[str, str, int, bool], *, is_stereo: bool) -> Figures:
    """Figures of a run on a drive without its calibration."""
    cache, scenario, seed, has_speed = case
    drive = CameraDrive.drawn(scenario, seed)
    files = drive.files(Path(cache))
    options: dict[str, Any] = {"detections": files.detections, "sgbm": False}
    if has_speed:
        options["ego_speed"] = files.ego_speed
    truth = read_truth(files.table, drive.rig.left, np.zeros(3))
    speed = np.loadtxt(files.ego_speed, delimiter=",", skiprows=1)
    scores = RowScores(truth, speed[:, 1])
    with _bare(files.left, files.right) as (left, right):
        run = (
            tr.Run.stereo(left, right, **options)
            if is_stereo
            else tr.Run.mono(left, every=MONO_STEP, **options)
        )
        began_s = time.process_time()
        with run:
            run.open()
            open_s = time.process_time() - began_s
            for result in run:
                scores.add(result)
        summary = run.summary
    return {
        "drive": drive.name,
        "turn_deg": drive.turn_deg,
        **_focal(summary, drive.rig.left.fx_px),
        "open_s": open_s,
        **scores.scores(0.0, SECONDS),
        "notes": list(run.notes),
    }


def _focal(summary: Figures, true_px: float | None) -> Figures:
    """The focal length that a run states, and its error."""
    focal_px, sigma = float(summary["focal_px"]), float(summary["focal_sigma"])
    error = math.nan if true_px is None else math.log(focal_px / true_px)
    return {"true_px": true_px, "focal_px": focal_px, "sigma": sigma, "log_error": error}


def _shown(row: Figures) -> Figures:
    """The figures of a drive for the table."""
    return {
        "drive": row["drive"],
        "turn_deg": round(row["turn_deg"], 1),
        "true_px": row["true_px"],
        "focal_px": row["focal_px"],
        "error_pct": 100 * row["log_error"],
        "sigma_pct": 100 * row["sigma"],
        "distance_median_pct": row["fused_median_pct"],
        "distance_sigma_pct": row["fused_sigma_pct"],
        "open_s": row["open_s"],
    }


def _summed(rows: Sequence[Figures]) -> Figures:
    """Figures of a group of drives."""
    error = np.abs([row["log_error"] for row in rows])
    sigma = np.array([row["sigma"] for row in rows])
    return {
        "drives": len(rows),
        "focal_median_pct": 100 * float(np.median(error)),
        "focal_p90_pct": 100 * float(np.quantile(error, 0.9)),
        "focal_bias_pct": 100 * float(np.median([row["log_error"] for row in rows])),
        "focal_sigma_pct": 100 * float(np.median(sigma)),
        "focal_within_1_sigma": float(np.mean(error < sigma)),
        "focal_within_2_sigma": float(np.mean(error < 2 * sigma)),
        "open_s": median([row["open_s"] for row in rows]),
        **pooled(rows),
    }


def _time(case: tuple[str, str, int]) -> Figures:
    """Time of the pre-pass of a drive."""
    cache, scenario, seed = case
    drive = CameraDrive.drawn(scenario, seed)
    files = drive.files(Path(cache))
    with _bare(files.left) as (left,):
        return {"drive": drive.name, **pre_pass_times(left, files.detections)}


def _lens(case: tuple[str, int]) -> Figures:
    """Edge error of the estimated camera of a 110 degree lens."""
    cache, seed = case
    drive = CameraDrive.wide(seed)
    files = drive.files(Path(cache))
    with _bare(files.left) as (left,), tr.Run.mono(left, detections=files.detections) as run:
        next(iter(run))
    summary = run.summary
    estimate = summary["camera_estimate"] or {}
    focal_px = float(estimate.get("focal_px") or summary["focal_px"])
    found = PinholeCamera.of_focal_length(focal_px, drive.rig.left.size_px)
    bent = replace(found, distortion=tuple(estimate.get("distortion") or ()))
    return {
        "drive": drive.name,
        **_focal(summary, drive.rig.left.fx_px),
        "k1": estimate.get("k1"),
        "k1_sigma": estimate.get("k1_sigma"),
        "edge_error_px": edge_error_px(drive.rig.left, bent),
        "edge_error_undistorted_px": edge_error_px(drive.rig.left, found),
    }


def edge_error_px(true: PinholeCamera, found: PinholeCamera) -> float:
    """Median distance between the pixels of the left and right edges and where a camera that was
    found sees their rays, px.
    """
    v = np.linspace(0, true.height_px - 1, 21)
    edges = [np.column_stack([np.full_like(v, u), v]) for u in (0.0, true.width_px - 1.0)]
    pixels = np.concatenate(edges)
    return float(np.median(np.hypot(*(found.recorded_px(true.recorded_rays(pixels)) - pixels).T)))


# -------------------------------------------------------------------------------------- recordings


@dataclass(frozen=True, slots=True)
class Recorded:
    """A recording; a folder of images has `fps`."""

    path: str  # below the folder of the real data
    true_px: float | None  # focal length; None = unknown, or doubtful
    fps: float | None = None

    @property
    def exists(self) -> bool:
        """Whether it is there."""
        return (REAL_DATA / self.path).exists()


REAL = {
    "gray51": Recorded("kitti_odometry/gray51/left.mp4", 707.09),
    "pandaset front": Recorded("pandaset/front.mp4", 1970.0),
    "pandaset front_right": Recorded("pandaset/front_right.mp4", 930.0),
    "tusimple": Recorded("tusimple/clip", 714.15, fps=20.0),
    "dashcam": Recorded("dashcam/highway_two_cars.mp4", 1157.8),
    "dashcam lanes": Recorded("dashcam/solid_white_right.mp4", None),
    **{
        f"crash {name}": Recorded(f"crashes/{name}.mp4", None)
        for name in ("000478", "000512", "000540", "000556", "000597", "video3")
    },
}


def _real(name: str) -> Figures:
    """The focal length that a run of a recording starts with."""
    recorded = REAL[name]
    path = REAL_DATA / recorded.path
    options: dict[str, Any] = {} if recorded.fps is None else {"folder_fps": recorded.fps}
    began_s = time.process_time()
    with _bare(path) as (link,), tr.Run.mono(link, **options) as run:
        next(iter(run))
    figures = _focal(run.summary, recorded.true_px)
    error = figures.pop("log_error")
    return {
        "drive": name,
        **figures,
        "error_pct": 100 * error if math.isfinite(error) else None,
        "s": time.process_time() - began_s,
        "said": next((note for note in run.notes if "ocal length" in note), ""),
    }


def _colmap(case: tuple[str, str, int]) -> Figures:
    """COLMAP's focal length of a drive."""
    cache, scenario, seed = case
    if scenario == "gray51":
        name, true_px = scenario, float(REAL[scenario].true_px or math.nan)
        images: list[Image] = (
            decoded(REAL_DATA / REAL[scenario].path) if REAL[scenario].exists else []
        )
    else:
        drive = CameraDrive.drawn(scenario, seed)
        name, true_px = drive.name, drive.rig.left.fx_px
        images = decoded(drive.files(Path(cache)).left)[::COLMAP_STEP]
    result = colmap_camera(images) if images else None
    if result is None:
        return {"drive": name}
    return {
        "drive": name,
        "true_px": true_px,
        "focal_px": result.focal_px,
        "error_pct": 100 * math.log(result.focal_px / true_px),
        "k1": result.k1,
        "images": len(images),
        "registered": result.n_registered,
        "s": result.seconds,
    }
