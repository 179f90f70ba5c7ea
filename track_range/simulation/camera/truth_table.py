"""truth.csv, the exact ground truth of every labelled object in every frame, and ego_speed.csv.

    frame,time_s,id,class,x1,y1,x2,y2,visible_share,distance_m,closing_mps,lane

Boxes are those of truth.txt. `distance_m` is the z, in the left camera's frame, at which the ray through the box centre
meets the drawn body (KITTI's 3-D box is accurate to about 10 cm only); `closing_mps` is the rate at which z of the
object's location decreases; `lane` counts from the ego lane, 1 = the next one to the right, empty = outside all lanes.
"""

from __future__ import annotations

import numpy as np

from track_range.detection.classes import ROAD_CLASS_OF
from track_range.simulation.render.renderer import Renderer
from track_range.simulation.render.surface import centre_depth_m
from track_range.simulation.world.scene import STEP_S, Scene
from track_range.simulation.world.surroundings import SURROUNDINGS
from track_range.simulation.world.truth import VisibleObjects

HEADER = "frame,time_s,id,class,x1,y1,x2,y2,visible_share,distance_m,closing_mps,lane\n"


def truth_rows(renderer: Renderer, time_s: float, visible: VisibleObjects) -> str:
    """The rows of truth.csv for one frame."""
    scene, camera, labels = renderer.scene, renderer.rig.left, visible.labels
    location_m, rotations = scene.location_m(time_s), scene.rotations(time_s)
    closing_mps = (scene.location_m(time_s - STEP_S) - scene.location_m(time_s + STEP_S))[:, 2] / (2 * STEP_S)
    lines = []
    for number in np.flatnonzero(labels.track_id >= 0).tolist():
        row, box = int(visible.row[number]), labels.xyxy_px[number]
        body = renderer.surface(row).transformed(rotations[row], location_m[row])
        cells = [
            f"{labels.frame[number]},{time_s:.6f},{labels.track_id[number]}",
            ROAD_CLASS_OF[str(labels.kitti_type[number]).lower()],
            *(f"{edge:.3f}" for edge in box.tolist()),
            f"{visible.visible_share[number]:.3f}",
            f"{centre_depth_m(body, camera, box):.4f}",
            f"{closing_mps[row]:.4f}",
            _lane(scene, row, time_s),
        ]
        lines.append(",".join(cells) + "\n")
    return "".join(lines)


def ego_speed_text(scene: Scene, times_s: list[float]) -> str:
    """Content of ego_speed.csv: the camera's speed along the road at the times of the left frames."""
    return "time_s,speed_mps\n" + "".join(f"{time_s:.6f},{scene.speed_mps(time_s):.4f}\n" for time_s in times_s)


def _lane(scene: Scene, row: int, time_s: float) -> str:
    user = scene.road_users[row]
    if user.raised_m > 0:
        return ""
    lane = SURROUNDINGS[scene.surroundings].lane_of(user.on_road_m(time_s)[0])
    return "" if lane is None else str(lane)
