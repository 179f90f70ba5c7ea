"""Cameras that look ahead, aside and back on real roads, with a camera height that is right, wrong
or not given.

Boxes: the roads of Argoverse 2 as cameras at any place of a vehicle would see them
(`benchmarks/boxes/road_view.py`), through the complete pipeline, with the speed of the vehicle.
Images: both cameras of PandaSet, as `track-range run` processes them. The mounting is given, but
not the height, unless the height is. Scored are objects at 5 to 100 m of which at least half is
visible and that the border of the image does not cut.
"""

from __future__ import annotations

import csv
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from scipy.spatial.transform import Rotation

from benchmarks.accuracy.ranging.horizon import finished
from benchmarks.boxes.cuboid_drive import CuboidDrive
from benchmarks.boxes.road_view import RoadView, road_view
from benchmarks.boxes.view_run import ViewResult, run_view
from benchmarks.boxes.view_scores import METHODS, ScoredRows
from benchmarks.harness import Figures, option, workload
from benchmarks.inputs.drives import REAL_DATA
from track_range.foundation.arrays import FloatArray
from track_range.ranging.world.object_motion import MOTION_STATES
from track_range.results.rows.rows import Rows
from track_range.results.summary import matched_truth
from track_range.run.options.settings import PipelineOptions, RunSettings
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.mounting import Mounting

LOGS = ("adcf7d18", "3b3570b4", "3bffdcff")
MIN_SHARE = 0.5  # visible share from which an object is scored, as in the truth of a run
# given height over the true one; None = not given
HEIGHTS = {"none": None, "right": 1.0, "+16 %": 1.16, "-16 %": 0.84}
_WIDE = PinholeCamera.of_focal_length(930.0, (1920, 1080))
Z_M = 1.396  # of the cameras of the boxes, above the rear axle: that of the recording's camera
CAMERAS = {
    "front": (PinholeCamera.of_focal_length(1683.5, (1550, 2048)), Mounting(x_m=1.63)),
    "front right": (_WIDE, Mounting(yaw_deg=-58.0, pitch_deg=2.0, x_m=1.5, y_m=-0.5)),
    "left": (_WIDE, Mounting(yaw_deg=90.0, pitch_deg=1.0, x_m=1.2, y_m=0.8)),
    "rear left": (_WIDE, Mounting(yaw_deg=120.0, pitch_deg=2.0, x_m=0.8, y_m=0.6)),
    "rear": (_WIDE, Mounting(yaw_deg=180.0, pitch_deg=2.0, x_m=0.6)),
}
# mountings and heights of PandaSet's cameras; their places in the vehicle are not published
VIDEOS = {
    "front": Mounting(z_m=2.18),
    "front_right": Mounting(yaw_deg=-58.0, pitch_deg=2.4, z_m=2.03),
}
PARTS = ("boxes", "images")


@workload(
    option("--data", default=REAL_DATA, help="folder of the real data"),
    option("--parts", default=PARTS, choices=PARTS, help="what is measured"),
    option("--logs", default=LOGS, choices=LOGS, help="drives of the boxes"),
    option("--cameras", default=tuple(CAMERAS), choices=CAMERAS, help="cameras of the boxes"),
    option("--videos", default=tuple(VIDEOS), choices=VIDEOS, help="videos with images"),
    option("--heights", default=tuple(HEIGHTS), choices=HEIGHTS, help="given camera heights"),
    option("--region", default="north-america", help="region that is given, or unknown"),
)
def mountings(options: Namespace) -> Figures:
    figures: Figures = {}
    if "boxes" in options.parts:
        figures["boxes"] = _boxes(options)
    if "images" in options.parts:
        figures["images"] = _images(options)
    return figures


def _boxes(options: Namespace) -> Figures:
    figures: Figures = {}
    for log in options.logs:
        drive = CuboidDrive.read(options.data / "av2" / "annotations", log)
        for name in options.cameras:
            camera, mounting = CAMERAS[name]
            view = road_view(drive, camera, mounting, z_m=Z_M)
            for height in options.heights:
                known = _known(view.mounting, height, options.region)
                figures[f"{log}, {name}, height {height}"] = _view_figures(
                    view, run_view(view, **known)
                )
    return figures


def _known(mounting: Mounting, height: str, region: str) -> dict[str, Any]:
    """The options of a run with a mounting at its true height."""
    known: dict[str, Any] = {"region": region}
    factor = HEIGHTS[height]
    if factor is not None and mounting.z_m is not None:
        known["camera_height_m"] = round(factor * mounting.z_m, 3)
    if "mount" in PipelineOptions.model_fields and mounting.yaw_deg != 0:
        known["mount"] = replace(mounting, z_m=None).parts
    return known


def _view_figures(view: RoadView, result: ViewResult) -> Figures:
    rows = view.rows
    is_scored = (rows.visible_share >= MIN_SHARE) & ~rows.is_cut
    scored = ScoredRows(
        track_id=rows.track_id,
        class_name=rows.class_name,
        true_m=np.where(is_scored, rows.true_m, np.nan),
        has_motion=rows.visible_share >= MIN_SHARE,
        velocity_mps=rows.velocity_mps,
        ranges=result.ranges,
        speed_mps=result.speed_mps,
        speed_sigma_mps=result.speed_sigma_mps,
        state=result.state,
    )
    last = int(np.flatnonzero(np.isfinite(result.path_m[:, 0])).max(initial=0))
    return {
        **scored.figures(),
        "doubt": result.doubt,
        "notes": list(result.notes),
        "alarms": result.alarms,
        "path_error_m": float(np.hypot(*(result.path_m - view.path_m)[last])),
        "path_sigma_m": float(result.path_sigma_m[last]),
        "path_length_m": float(np.hypot(*np.diff(view.path_m, axis=0).T).sum()),
    }


def _images(options: Namespace) -> Figures:
    figures: Figures = {}
    folder = options.data / "pandaset"
    with TemporaryDirectory() as written:
        for name in options.videos:
            speeds = Path(written) / f"{name}.csv"
            _write_speeds(folder / "ego" / f"{name}.csv", speeds)
            for height in options.heights:
                known = _known(VIDEOS[name], height, options.region)
                run, rows = finished(
                    RunSettings(
                        mono=folder / f"{name}.mp4",
                        rig=folder / "calib" / f"{name}.txt",
                        truth=folder / "truth" / f"{name}.csv",
                        ego_speed=str(speeds),
                        overlay=False,
                        **known,
                    )
                )
                doubt = run.summary.get("scale_doubt") or {}
                figures[f"{name}, height {height}"] = {
                    **_scored(rows, run.session.opened.truth, folder, name).figures(),
                    "doubt": doubt.get("factor", 1.0),
                    "notes": list(run.notes),
                }
    return figures


def _write_speeds(ego: Path, path: Path) -> None:
    """The speed of the vehicle, whatever the direction of the camera."""
    with ego.open(encoding="utf-8", newline="") as file:
        rows = [(row["time_s"], row["speed_over_ground_mps"]) for row in csv.DictReader(file)]
    lines = ["time_s,speed_mps", *(",".join(row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _scored(rows: Rows, truth: Any, folder: Path, name: str) -> ScoredRows:
    """The rows of a run, with the velocities of their objects."""
    matched = matched_truth(rows, truth)
    table = pq.read_table(folder / "objects" / f"{name}.parquet").to_pylist()
    velocity = {
        (row["frame"], row["id"]): (row["velocity_x_mps"], row["velocity_y_mps"]) for row in table
    }
    track_id = matched.of_labels(truth.track_id, -1)
    keys = zip(rows["frame"].tolist(), track_id.tolist(), strict=True)
    world_mps = np.array([velocity.get(key, (np.nan, np.nan)) for key in keys]).reshape(-1, 2)
    heading_rad = _headings_rad(folder / "ego" / f"{name}.csv", VIDEOS[name])[rows["frame"]]
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    x_mps, y_mps = world_mps.T
    states = {state: float(number) for number, state in enumerate(MOTION_STATES)}
    return ScoredRows(
        track_id=track_id,
        class_name=rows["class"],
        true_m=matched.of_scored(matched.distance_m),
        has_motion=track_id >= 0,
        velocity_mps=np.stack([cos * x_mps + sin * y_mps, cos * y_mps - sin * x_mps], axis=1),
        ranges={method: rows.distance(method) for method in METHODS if f"{method}_m" in rows},
        speed_mps=rows["speed_mps"],
        speed_sigma_mps=rows["speed_sigma_mps"],
        state=np.array([states.get(state, np.nan) for state in rows["state"].tolist()]),
    )


def _headings_rad(ego: Path, mounting: Mounting) -> FloatArray:
    """(T,) headings of the vehicle in the world, from the attitudes of its camera."""
    with ego.open(encoding="utf-8", newline="") as file:
        quaternions = [
            [float(row[key]) for key in ("qx", "qy", "qz", "qw")] for row in csv.DictReader(file)
        ]
    axis = Rotation.from_quat(quaternions).as_matrix()[:, :, 2]
    return np.asarray(np.arctan2(axis[:, 1], axis[:, 0]) - np.radians(mounting.yaw_deg))
