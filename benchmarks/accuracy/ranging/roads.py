"""Distances of one camera on any road: error and sigma by data set, method, class, distance and
height of the box.

Boxes: every labelled box of `benchmarks.inputs.road_sets` at 5-100 m, each image alone (KITTI:
drives, with sizes that are cross-validated over its sequences). Runs: recordings with images, as
`track-range --mono VIDEO` processes them.
"""

from __future__ import annotations

import json
from argparse import Namespace
from collections.abc import Iterator, Mapping
from itertools import pairwise, product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.accuracy.cameras.horizon import finished
from benchmarks.harness import Figures, option, workload
from benchmarks.inputs.drives import REAL_DATA
from benchmarks.inputs.road_sets import KITTI_HEIGHT_M, SETS, RoadSet, road_set
from track_range.detection.catalogue.lookup import DEFAULT_MODEL
from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.ranging.evaluation.box_evaluation import distance_risk
from track_range.ranging.evaluation.box_methods import MethodOptions, measured_by
from track_range.ranging.truth.errors import MethodColumn, score_rows
from track_range.ranging.truth.truth import Truth
from track_range.results.rows.rows import Rows
from track_range.run.options.settings import RunSettings
from track_range.simulation.drive import write_drive

KNOWN = {
    "nothing": (),
    "region": ("region",),
    "height": ("camera_height_m",),
    "both": ("region", "camera_height_m"),
}
"""What is known besides the calibration of the camera: options of runs and of the evaluation of
boxes."""

NO_CALIBRATION = "no calibration"  # of runs, in which the focal length is estimated

METHODS = ("mono", "ground", "mono+ground")
RUN_METHODS = ("mono", "ground", "lane", "fused", "mono_kf", "fused_kf")
# edges of TuSimple's official bands, within those of `errors.BANDS_M`
BANDS_M = (5.0, 20.0, 45.0, 100.0)
HEIGHTS_PX = (0.0, 25.0, 50.0, np.inf)
ANSWERED_PCT = (100, 95, 80, 50)  # points of risk-coverage curves
# what is known and method, of the picture
DRAWN = (("nothing", "mono"), ("region", "mono"), ("both", "ground"))
N_BINS = 8  # of the stated sigma, with equal numbers of boxes

CLIP_NAME = "TuSimple clip"
CLIP = Truth(
    frame=np.array([39]),
    track_id=np.array([1]),
    kitti_type=np.array(["Car"]),
    class_id=np.array([ROAD_CLASSES.index("car")]),
    xyxy_px=np.array([(785.0, 337.0, 869.0, 398.0)]),
    distance_m=np.array([21.31]),
    closing_mps=np.array([np.nan]),
)
"""The labelled vehicle of TuSimple's clip, in its last frame; the box is a detector's, since the
label has none."""

DASHCAM_FOCAL_PX = 1158.0  # of the camera of `highway_two_cars`, by photographs of a board


@workload(
    option("--data", default=REAL_DATA, help="folder of the real data"),
    option("--sets", default=SETS, nargs="*", choices=SETS, help="data sets of boxes"),
    option(
        "--known", default=tuple(KNOWN), choices=KNOWN, help="what is known besides the calibration"
    ),
    option(
        "--detectors",
        default=(DEFAULT_MODEL,),
        nargs="*",
        metavar="FILE",
        help="detectors of runs; none = no runs",
    ),
    option(
        "--picture", type=Path, metavar="FILE", help="picture of the error against the stated sigma"
    ),
)
def roads(options: Namespace) -> Figures:
    figures: Figures = {}
    for name in options.sets:
        road = road_set(name, options.data)
        figures[name] = {known: _figures(road, _measured(road, known)) for known in options.known}
    if options.picture:
        draw(figures, options.picture)
    with TemporaryDirectory() as folder:
        runs = _runs(options, Path(folder)) if options.detectors else {}
    return {"boxes": figures, "runs": runs}


def _measured(road: RoadSet, known: str) -> dict[str, MethodColumn]:
    """Columns of `METHODS`; a camera height is given to the boxes of each camera separately."""
    given: dict[str, Any] = {
        "box_sigma_px": road.box_sigma_px,
        "is_cross_validated": road.train is not None,
    }
    if "region" in KNOWN[known]:
        given["region"] = road.region
    n = len(road.boxes)
    columns = {name: MethodColumn(*np.full((2, n), np.nan)) for name in METHODS}
    heights_m = np.unique(road.camera_height_m) if "camera_height_m" in KNOWN[known] else [None]
    for height_m in heights_m:
        rows = np.flatnonzero(
            np.ones(n, np.bool_) if height_m is None else road.camera_height_m == height_m
        )
        boxes = road.boxes.select(rows)
        options = MethodOptions(**given, camera_height_m=height_m)
        for name, part in measured_by(METHODS, boxes, road.train or boxes, options).items():
            columns[name].distance_m[rows], columns[name].sigma_m[rows] = (
                part.distance_m,
                part.sigma_m,
            )
    return columns


def _figures(road: RoadSet, columns: Mapping[str, MethodColumn]) -> Figures:
    rows = {
        f"{method}, {name}": _row(column, road.boxes.distance_m, group, road.object_id)
        for name, group in _groups(road)
        for method, column in columns.items()
    }
    figures: Figures = {name: row for name, row in rows.items() if row["n"]}
    figures["risk"] = {
        f"{method}, {name}": {
            f"{row['answered_pct']} %": row["mean_relative_error_pct"]
            for row in risk["curve"]
            if row["answered_pct"] in ANSWERED_PCT
        }
        | {"area": risk["area_error_pct"]}
        for method, column in columns.items()
        for name, risk in distance_risk(road.boxes, column).items()
    }
    figures["sigma"] = {
        method: reliability(column, road.boxes.distance_m) for method, column in columns.items()
    }
    return figures


def _groups(road: RoadSet) -> Iterator[tuple[str, BoolArray]]:
    """Names and masks: classes, and within them distances and heights."""
    boxes, height_px = road.boxes, road.boxes.xyxy_px[:, 3] - road.boxes.xyxy_px[:, 1]
    in_span = (boxes.distance_m >= BANDS_M[0]) & (boxes.distance_m <= BANDS_M[-1])
    for name in np.unique(boxes.class_name).tolist():
        rows = in_span & (boxes.class_name == name)
        yield name, rows
        for low, high in pairwise(BANDS_M):
            yield (
                f"{name} {low:g}-{high:g} m",
                rows & (boxes.distance_m >= low) & (boxes.distance_m < high),
            )
        for low, high in pairwise(HEIGHTS_PX):
            yield f"{name} {low:g}-{high:g} px", rows & (height_px >= low) & (height_px < high)


def _row(column: MethodColumn, true_m: FloatArray, rows: BoolArray, identity: Any) -> Figures:
    """Errors in per cent (bias: median of the signed ones), fractions within one and two sigma,
    median sigma.
    """
    score = score_rows(column, true_m, rows)
    return {
        "n": score["n"],
        "objects": len(np.unique(identity[rows & np.isfinite(column.distance_m)])),
        "mean_pct": score["mean_relative_error_pct"],
        "median_pct": score["median_relative_error_pct"],
        "bias_pct": score["bias_pct"],
        "sigma_pct": score["median_sigma_pct"],
        "within_1": score["within_1_sigma"],
        "within_2": score["within_2_sigma"],
        "coverage": score["coverage"],
    }


def _runs(options: Namespace, folder: Path) -> Figures:
    """Errors of recordings by what is known, and the estimated focal lengths of those without a
    calibration.
    """
    figures: Figures = {}
    focal: Figures = {}
    for (name, source, given, facts), detector in product(
        _recordings(options.data, folder), options.detectors
    ):
        case, truth = f"{name}, {Path(detector).stem}", CLIP if name == CLIP_NAME else None
        video = folder / f"{case}{source.suffix}"
        video.symlink_to(source)  # a run without a calibration would find one beside the video
        for known in (*options.known, NO_CALIBRATION):
            if truth is None and known in options.known[1:]:
                continue
            settings = {**given, "mono": video, "detector": str(detector), "overlay": False}
            settings |= {key: facts[key] for key in KNOWN.get(known, ())}
            # truth: that of KITTI is a depth in the calibrated camera's frame
            if known == NO_CALIBRATION:
                settings |= {"rig": None, "focal_px": None, "truth": None}
            run, columns = finished(RunSettings(**settings), truth)
            truth = truth or run.session.opened.truth
            if known == NO_CALIBRATION:
                focal[case] |= {
                    "estimate_px": run.camera.fx_px,
                    "sigma": run.summary["focal_sigma"],
                }
            else:
                focal[case] = {"true_px": run.camera.fx_px}
            if "scored_truth_m" in columns:
                figures.setdefault(case, {})[known] = _run_rows(columns)
    return {"focal lengths": focal, **figures}


def _run_rows(columns: Rows) -> Figures:
    true_m = columns["scored_truth_m"]
    rows = {name: MethodColumn(*columns.distance(name)) for name in RUN_METHODS}
    return {
        name: _row(column, true_m, np.isfinite(true_m), columns["track_id"])
        for name, column in rows.items()
    }


def _recordings(
    data: Path, folder: Path
) -> Iterator[tuple[str, Path, dict[str, Any], dict[str, Any]]]:
    """Name, video, settings and facts that may be known of each recording."""
    europe = {"region": "europe", "camera_height_m": KITTI_HEIGHT_M}
    # that of `track-range demo`
    drive = write_drive(folder / "drive", seed=0, seconds=6.0, scenario="crossing")
    yield "demo", drive.left, {"rig": drive.rig, "truth": drive.table}, europe
    for path in (data / "kitti_stereo" / "0003", data / "kitti_stereo" / "0005"):
        yield (
            f"KITTI {path.name}",
            path / "left.mp4",
            {"rig": path / "calib.txt", "truth": path / "label.txt"},
            europe,
        )
    camera = json.loads((data / "tusimple" / "truth.json").read_text(encoding="utf-8"))["camera"]
    left = {key: value for key, value in camera.items() if key.endswith("_px")} | {"distortion": []}
    rig = folder / "tusimple.yaml"
    rig.write_text(f"track_range_rig: 1\nleft: {json.dumps(left)}\n", encoding="utf-8")
    america = {"region": "north-america", "camera_height_m": camera["camera_height_m"]}
    yield CLIP_NAME, data / "tusimple" / "clip", {"rig": rig, "folder_fps": 20.0}, america
    grey = data / "kitti_odometry" / "gray51"
    yield "KITTI grey", grey / "left.mp4", {"rig": grey / "calib.txt"}, europe
    dashcam = data / "dashcam" / "highway_two_cars.mp4"
    yield (
        "dash camera",
        dashcam,
        {"focal_px": DASHCAM_FOCAL_PX},
        {"region": "north-america", "camera_height_m": 1.4},
    )


def reliability(column: MethodColumn, true_m: FloatArray) -> Figures:
    """Root mean squares of the stated sigmas and of the errors in bins of equal numbers of boxes,
    per cent.
    """
    known = np.isfinite(column.distance_m) & np.isfinite(column.sigma_m) & np.isfinite(true_m)
    sigma, error = (
        (column.sigma_m / column.distance_m)[known],
        (column.distance_m / true_m - 1)[known],
    )
    bins = np.array_split(np.argsort(sigma), N_BINS)
    rms = {"sigma_pct": sigma, "error_pct": error}
    return {
        name: [100 * float(np.sqrt((values[part] ** 2).mean())) for part in bins]
        for name, values in rms.items()
    }


def draw(figures: Figures, path: Path) -> None:
    """Draw the error against the stated sigma of each data set, by method and what is known."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import FixedLocator, NullLocator

    figure = Figure(figsize=(2.5 * len(figures) + 0.5, 3.1), layout="constrained")
    every = figure.subplots(1, len(figures), sharex=True, sharey=True, squeeze=False)[0]
    for axes, (name, by_known) in zip(every, figures.items(), strict=True):
        axes.plot([3, 50], [3, 50], ":", color="#7a7f87", lw=1)
        for known, method in DRAWN:
            if known in by_known:
                bins = by_known[known]["sigma"][method]
                axes.plot(
                    bins["sigma_pct"],
                    bins["error_pct"],
                    "o-",
                    ms=3.5,
                    lw=1.4,
                    label=f"{method}, {known}",
                )
        axes.set(title=name, xscale="log", yscale="log", xlabel="stated sigma, %", aspect="equal")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(FixedLocator((5, 10, 20, 50)))
            axis.set_minor_locator(NullLocator())
            axis.set_major_formatter("{x:g}")
        axes.grid(alpha=0.3, lw=0.6)
    every[0].set_ylabel("RMS error, %")
    every[-1].legend(frameon=False, fontsize=8, loc="lower right")
    figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)
