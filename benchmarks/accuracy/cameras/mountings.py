"""Cameras that look ahead, aside and back, with a camera height that is right, wrong or not given.

Boxes: the roads of Argoverse 2 as cameras at any place of a vehicle would see them
(`benchmarks/boxes/road_view.py`), through the complete pipeline. Images: both cameras of PandaSet,
as `track-range run` processes them. Simulated: rendered drives, also whole runs. The calibration,
the speed of the vehicle and the mounting are given, but the height only where a case says so.
Distances are scored of objects at 5 to 100 m that the border of the image does not cut, and of which
at least half is visible; states and speeds also of cut ones.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq
from scipy.spatial.transform import Rotation

from benchmarks.boxes.cuboid_drive import CuboidDrive
from benchmarks.boxes.road_view import road_view
from benchmarks.boxes.view_run import run_view
from benchmarks.boxes.view_scores import METHODS, RunScores, ScoredRows
from benchmarks.harness import Figures, option, workload
from benchmarks.inputs.drives import REAL_DATA
from track_range.foundation.arrays import FloatArray
from track_range.ranging.truth.truth import Truth
from track_range.ranging.world.object_motion import MOTION_STATES
from track_range.results.rows.rows import Rows
from track_range.results.summary import matched_truth
from track_range.run.options.settings import RunSettings
from track_range.run.run import Run
from track_range.simulation.drive import write_drive
from track_range.simulation.settings import DriveOptions
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.scene import Scene
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.mounting import Mounting
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.rig_formats.rig_yaml import save_camera

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
# of PandaSet's cameras, whose places in the vehicle are not published
VIDEOS = {
    "front": Mounting(z_m=2.18),
    "front_right": Mounting(yaw_deg=-58.0, pitch_deg=2.4, z_m=2.03),
}
# scenario, seed and mounting of rendered drives; no test and no choice uses the seeds
DRIVES = {
    "front": ("city", 723, Mounting(pitch_deg=1.0, x_m=2.1, z_m=2.1)),
    "30 degrees right": ("city", 722, Mounting(yaw_deg=-30.0, pitch_deg=1.0, x_m=2.1, z_m=2.1)),
    "front right": (
        *("winding", 720),
        Mounting(yaw_deg=-58.0, pitch_deg=2.0, roll_deg=0.5, x_m=2.1, y_m=-0.4, z_m=2.05),
    ),
    "left": ("city", 721, Mounting(yaw_deg=90.0, pitch_deg=1.0, x_m=1.5, y_m=0.8, z_m=1.85)),
    "rear left": (
        "winding",
        721,
        Mounting(yaw_deg=120.0, pitch_deg=2.0, x_m=1.0, y_m=0.8, z_m=2.0),
    ),
    "rear": ("winding", 720, Mounting(yaw_deg=180.0, pitch_deg=2.0, z_m=2.0)),
}
SECONDS, FPS = 15.0, 10.0
SIMULATED_FOCAL_PX = 1000.0
STEP_S = 1e-3  # of a numerical derivative
_STATES = {state: float(number) for number, state in enumerate(MOTION_STATES)}
NO_MOUNTING = "no mounting"  # of whole runs of cameras that do not look ahead
SPEEDS = ("given", "measured")
PARTS = ("boxes", "images", "simulated")


@workload(
    option("--data", default=REAL_DATA, help="folder of the real data"),
    option("--parts", default=PARTS, choices=PARTS, help="what is measured"),
    option("--logs", default=LOGS, choices=LOGS, help="drives of the boxes"),
    option("--cameras", default=tuple(CAMERAS), choices=CAMERAS, help="cameras of the boxes"),
    option("--videos", default=tuple(VIDEOS), choices=VIDEOS, help="cameras of the images"),
    option("--drives", default=tuple(DRIVES), choices=DRIVES, help="cameras of simulated drives"),
    option("--heights", default=tuple(HEIGHTS), choices=HEIGHTS, help="given camera heights"),
    option("--speeds", default=SPEEDS, choices=SPEEDS, help="whether the speed is given"),
    option("--region", default="north-america", help="region of real roads, or unknown"),
)
def mountings(options: Namespace) -> Figures:
    figures: Figures = {}
    if "boxes" in options.parts:
        figures["boxes"] = _boxes(options)
    with TemporaryDirectory() as folder:
        if "images" in options.parts:
            drives = {name: _video(options, name, Path(folder)) for name in options.videos}
            figures["images"] = _whole_runs(drives, options)
        if "simulated" in options.parts:
            drives = {name: _simulated(name, Path(folder) / name) for name in options.drives}
            figures["simulated"] = _whole_runs(drives, options)
    return figures


def _boxes(options: Namespace) -> Figures:
    """Figures of each drive, and of each camera over all drives."""
    runs: dict[str, dict[str, RunScores]] = {}
    for log in options.logs:
        drive = CuboidDrive.read(options.data / "av2" / "annotations", log)
        for name in options.cameras:
            camera, mounting = CAMERAS[name]
            view = road_view(drive, camera, mounting, z_m=Z_M)
            for case, height, has_speed in _cases(options):
                known = _known(view.mounting, height, options.region)
                scores = run_view(view, has_speed=has_speed, **known)
                runs.setdefault(f"{name}, {case}", {})[log] = scores
    return {
        case: {"all": RunScores.joined(list(of_case.values())).figures()}
        | {log: scores.figures() for log, scores in of_case.items()}
        for case, of_case in runs.items()
    }


def _cases(options: Namespace) -> Iterator[tuple[str, str, bool]]:
    """Name, height, and whether the speed is given; without a speed, no height is given either."""
    for height in options.heights:
        if "given" in options.speeds:
            yield f"height {height}", height, True
    if "measured" in options.speeds:
        yield "no speed", "none", False


def _known(mounting: Mounting, height: str, region: str) -> dict[str, Any]:
    """The options of a run with a mounting at its true height."""
    known: dict[str, Any] = {"region": region}
    factor = HEIGHTS[height]
    if factor is not None and mounting.z_m is not None:
        known["camera_height_m"] = round(factor * mounting.z_m, 3)
    if mounting.yaw_deg != 0:
        known["mount"] = replace(mounting, z_m=None)
    return known


@dataclass(frozen=True, slots=True, kw_only=True)
class _Recorded:
    """A drive with images, and what is true of its T frames."""

    settings: dict[str, Any]  # of a run, without the mounting and the height
    mounting: Mounting
    region: str
    # velocity over ground along the vehicle's axis and to the left of it, by frame and identity
    velocity_mps: Mapping[tuple[int, int], Any]
    path_m: FloatArray  # (T, 2) of the camera in the frame `map`
    speed_mps: FloatArray  # (T,) of the vehicle


def _whole_runs(drives: Mapping[str, _Recorded], options: Namespace) -> Figures:
    figures: Figures = {}
    for name, drive in drives.items():
        cases = list(_cases(options))
        if drive.mounting.yaw_deg != 0 and "given" in options.speeds:
            cases.append((NO_MOUNTING, "none", True))
        for case, height, has_speed in cases:
            known = _known(drive.mounting, height, drive.region)
            if not has_speed:
                known["ego_speed"] = "auto"  # measured from the images
            if case == NO_MOUNTING:
                del known["mount"]
            run = Run(RunSettings(**{**drive.settings, **known}, overlay=False))
            results = list(run)
            truth = run.session.opened.truth
            if truth is None:
                raise ValueError(f"{name}: expected a truth")
            rows = run.session.rows.table.to_rows(is_rounded=False)
            scored = _scored(rows, truth, drive)
            ahead = drive.mounting.vehicle_from_camera[0, 2]
            scores = RunScores.of_run(
                scored,
                results,
                path_m=drive.path_m,
                ego_mps=ahead * drive.speed_mps,
                notes=run.notes,
            )
            figures[f"{name}, {case}"] = scores.figures()
    return figures


def _scored(rows: Rows, truth: Truth, drive: _Recorded) -> ScoredRows:
    """The rows of a run that match a label."""
    matched = matched_truth(rows, truth)
    track_id = np.asarray(matched.of_labels(truth.track_id, -1))
    return ScoredRows(
        track_id=track_id,
        class_name=rows["class"],
        true_m=matched.of_scored(matched.distance_m),
        has_motion=track_id >= 0,
        velocity_mps=np.array(
            [
                drive.velocity_mps.get(key, (np.nan, np.nan))
                for key in zip(rows["frame"].tolist(), track_id.tolist(), strict=True)
            ]
        ).reshape(-1, 2),
        ranges={method: rows.distance(method) for method in METHODS if f"{method}_m" in rows},
        speed_mps=rows["speed_mps"],
        speed_sigma_mps=rows["speed_sigma_mps"],
        state=np.array([_STATES.get(state, np.nan) for state in rows["state"].tolist()]),
    )


def _video(options: Namespace, name: str, folder: Path) -> _Recorded:
    """A camera of PandaSet."""
    data, mounting = options.data / "pandaset", VIDEOS[name]
    ego = _columns(data / "ego" / f"{name}.csv")
    speeds = {"time_s": ego["time_s"], "speed_mps": ego["speed_over_ground_mps"]}
    pa_csv.write_csv(pa.table(speeds), folder / f"{name}_speed.csv")
    attitude = Rotation.from_quat(np.stack([ego[key] for key in ("qx", "qy", "qz", "qw")], axis=1))
    axis_x, axis_y, _ = attitude.as_matrix()[:, :, 2].T
    axis_rad = np.arctan2(axis_y, axis_x)
    position_m = np.stack([ego["x_m"], ego["y_m"]], axis=1)
    heading_rad = axis_rad - np.radians(mounting.yaw_deg)
    objects = pq.read_table(data / "objects" / f"{name}.parquet").to_pylist()
    velocity = {
        (row["frame"], row["id"]): _turned(
            np.array([row["velocity_x_mps"], row["velocity_y_mps"]]), heading_rad[row["frame"]]
        )
        for row in objects
    }
    return _Recorded(
        settings={
            "mono": data / f"{name}.mp4",
            "rig": data / "calib" / f"{name}.txt",
            "truth": data / "truth" / f"{name}.csv",
            "ego_speed": str(folder / f"{name}_speed.csv"),
        },
        mounting=mounting,
        region=options.region,
        velocity_mps=velocity,
        path_m=_turned(position_m - position_m[0], axis_rad[0]),
        speed_mps=ego["speed_over_ground_mps"],
    )


def _simulated(name: str, folder: Path) -> _Recorded:
    """A rendered drive."""
    scenario, seed, mounting = DRIVES[name]
    camera = PinholeCamera.of_focal_length(SIMULATED_FOCAL_PX, (1280, 720))
    drive = write_drive(
        folder,
        scenario=scenario,
        seed=seed,
        seconds=SECONDS,
        fps=FPS,
        rig=StereoRig.rectified(camera, 0.5),
        options=DriveOptions(mount=mounting.parts),
    )
    # where no run finds them by itself: a mounting and a speed that it may not know
    (folder / "known").mkdir()
    save_camera(camera, folder / "known" / "camera.yaml")
    speed = drive.ego_speed.rename(folder / "known" / drive.ego_speed.name)
    drive.rig.unlink()
    scene = make_scenario(scenario, seed=seed, seconds=SECONDS)
    scene = replace(scene, mounting=mounting, camera_height_m=mounting.z_m or 0.0)
    times_s = (np.arange(round(SECONDS * FPS)) / FPS).tolist()
    poses = [scene.pose(time_s) for time_s in times_s]
    # x to the right and z forward, as x forward and y to the left
    camera_m = np.array([(pose.position_m[2], -pose.position_m[0]) for pose in poses])
    axis = poses[0].camera_from_world[2]
    velocity = {}
    for frame, (time_s, pose) in enumerate(zip(times_s, poses, strict=True)):
        before, after = (_on_ground_m(scene, time_s + step_s) for step_s in (-STEP_S, STEP_S))
        turned = _turned((after - before) / (2 * STEP_S), -pose.yaw_rad)
        for user, of_user in zip(scene.road_users, turned.tolist(), strict=True):
            velocity[frame, user.track_id] = tuple(of_user)
    return _Recorded(
        settings={
            "mono": drive.left,
            "rig": folder / "known" / "camera.yaml",
            "truth": drive.table,
            "ego_speed": str(speed),
        },
        mounting=mounting,
        region="europe",
        velocity_mps=velocity,
        path_m=_turned(camera_m - camera_m[0], np.arctan2(-axis[0], axis[2])),
        speed_mps=np.array([scene.speed_mps(time_s) for time_s in times_s]),
    )


def _on_ground_m(scene: Scene, time_s: float) -> FloatArray:
    """(N, 2) positions of the road users, forward and to the left in the axes of the world."""
    across_m, z_m = np.array([user.on_road_m(time_s) for user in scene.road_users]).T
    return np.stack([z_m, -scene.road.x_m(z_m, across_m)], axis=1)


def _turned(vectors: FloatArray, heading_rad: float) -> FloatArray:
    """(..., 2) vectors along a heading and to the left of it, of vectors along x and y."""
    x, y = np.moveaxis(vectors, -1, 0)
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    return np.stack([cos * x + sin * y, cos * y - sin * x], axis=-1)


def _columns(path: Path) -> dict[str, FloatArray]:
    table = pa_csv.read_csv(path)
    return {name: table[name].to_numpy().astype(np.float64) for name in table.schema.names}
