"""Files of a drive of the scenario `fixed`: what a user would measure, and what is true on the road.

ground_points.txt     options of `track-range calibrate ground`: five points of the road in px, and in metres
lines.txt             options of a run: the lines near and far across the road
speeds.csv            every labelled road user in every frame: frame,time_s,id,class,x_m,y_m,speed_mps
crossings_truth.csv   crossings of the lines by middles of footprints: line,id,class,crossing_s,speed_mps,direction

x counts along the road from the pole, y to the left of the middle of the right lane; z = 0 is the road.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from track_range.detection.classes import road_class_of
from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.output_files import write_text
from track_range.simulation.world.scene import STEP_S, Scene
from track_range.stereo.geometry.camera import PinholeCamera

LINES_M = {"near": 22.0, "far": 45.0}  # distances of the lines along the road
_ACROSS_M = (8.9, -4.4)  # ends of the lines to the left: both pavements are outside
_POINTS_M = ((16.0, 1.75), (16.0, -1.75), (40.0, 1.75), (40.0, -1.75), (24.0, 5.25))
_STEP_S = 0.01  # of the search for crossings
_OF_LINES = ("Car", "Van", "Truck", "Bus", "Motorcycle", "Cyclist", "Pedestrian")


def road_pixels(
    scene: Scene, camera: PinholeCamera, xy_m: Sequence[tuple[float, float]]
) -> FloatArray:
    """(N, 2) pixels of points of the road, x along it and y to the left."""
    places = np.array([(-y, 0.0, x) for x, y in xy_m])
    pose = scene.pose(0.0)
    return camera.project((places - pose.position_m) @ pose.camera_from_world.T)


def line_texts(scene: Scene, camera: PinholeCamera) -> list[str]:
    """The lines as texts of --count-line; ends are moved into the image along the line."""
    texts = []
    for name, x_m in LINES_M.items():
        ends = [(x_m, y) for y in np.linspace(*_ACROSS_M, 200)]
        pixels = road_pixels(scene, camera, ends)
        inside = pixels[((pixels >= 0) & (pixels < camera.size_px)).all(axis=1)]
        (x1, y1), (x2, y2) = inside[[0, -1]].round(1).tolist()
        texts.append(f"{name}={x1},{y1},{x2},{y2}")
    return texts


def point_texts(
    scene: Scene, camera: PinholeCamera, rng: np.random.Generator, click_px: float = 1.5
) -> list[str]:
    """The points as texts of --known-point, with errors of clicks."""
    pixels = road_pixels(scene, camera, _POINTS_M)
    pixels = pixels + rng.normal(0.0, click_px, pixels.shape)
    return [
        f"{u:.1f},{v:.1f}={x:g},{y:g}"
        for (u, v), (x, y) in zip(pixels.tolist(), _POINTS_M, strict=True)
        if 0 <= u < camera.width_px and 0 <= v < camera.height_px
    ]


def crossings(scene: Scene, seconds: float) -> list[tuple[str, int, str, float, float, str]]:
    """Line, id, class, time, speed and direction of each crossing, up = away from the camera."""
    times_s = np.arange(0.0, seconds, _STEP_S)
    rows = []
    for user in scene.road_users:
        if user.kitti_type not in _OF_LINES:
            continue
        across, along = user.on_road_m(times_s)
        for name, x_m in LINES_M.items():
            is_beyond = along > x_m
            for i in np.flatnonzero(is_beyond[1:] != is_beyond[:-1]).tolist():
                if not _ACROSS_M[1] < -across[i] < _ACROSS_M[0]:
                    continue
                share = (x_m - along[i]) / (along[i + 1] - along[i])
                speed_mps = abs(along[i + 1] - along[i]) / _STEP_S
                row = (road_class_of(user.kitti_type) or "", times_s[i] + share * _STEP_S)
                rows.append(
                    (name, user.track_id, *row, speed_mps, "up" if is_beyond[i + 1] else "down")
                )
    return rows


def write_fixed_files(
    folder: Path, scene: Scene, camera: PinholeCamera, times_s: Sequence[float]
) -> None:
    """Write the files; OutputError if one cannot be written."""
    rng = np.random.default_rng([scene.seed, 19])
    points = " ".join(f"--known-point {text}" for text in point_texts(scene, camera, rng))
    lines = " ".join(f"--count-line {text}" for text in line_texts(scene, camera))
    write_text(folder / "ground_points.txt", points + "\n")
    write_text(folder / "lines.txt", lines + "\n")
    rows = ["frame,time_s,id,class,x_m,y_m,speed_mps"]
    for frame, time_s in enumerate(times_s):
        for user in scene.road_users:
            (x0, z0), (x1, z1), (x, z) = (
                user.on_road_m(time_s + step_s) for step_s in (-STEP_S, STEP_S, 0.0)
            )
            speed_mps = float(np.hypot(x1 - x0, z1 - z0)) / (2 * STEP_S)
            name = road_class_of(user.kitti_type)
            rows.append(
                f"{frame},{time_s:.6f},{user.track_id},{name},{z:.3f},{-x:.3f},{speed_mps:.4f}"
            )
    write_text(folder / "speeds.csv", "\n".join(rows) + "\n")
    rows = ["line,id,class,crossing_s,speed_mps,direction"]
    for line, track_id, name, time_s, speed_mps, direction in crossings(scene, times_s[-1]):
        rows.append(f"{line},{track_id},{name},{time_s:.4f},{speed_mps:.4f},{direction}")
    write_text(folder / "crossings_truth.csv", "\n".join(rows) + "\n")
