"""truth.csv: what is exactly true of every labelled object in every frame; and ego_speed.csv.

    frame,time_s,id,class,x1,y1,x2,y2,visible_share,distance_m,closing_mps,lane

Boxes are those of truth.txt. `distance_m` is the z, in the left camera's frame, at which the ray through the box's
centre meets the drawn body (KITTI's 3-D box tells it to a hand's breadth only); `closing_mps` is how fast the object's
place comes nearer along that z; `lane` counts from the ego lane, 1 = the next to the right, empty = on none.
"""

from __future__ import annotations

import numpy as np

from track_range.detection.classes import ROAD_CLASS_OF
from track_range.simulation.render.renderer import Renderer
from track_range.simulation.render.surface import centre_depth_m
from track_range.simulation.world.scene import STEP_S, Scene
from track_range.simulation.world.surroundings import SURROUNDINGS
from track_range.simulation.world.truth import SeenObjects

HEADER = "frame,time_s,id,class,x1,y1,x2,y2,visible_share,distance_m,closing_mps,lane\n"


def truth_rows(renderer: Renderer, time_s: float, seen: SeenObjects) -> str:
    """The rows of one frame."""
    scene, camera = renderer.scene, renderer.rig.left
    location_m, turns = scene.location_m(time_s), scene.turns(time_s)
    closing_mps = (scene.location_m(time_s - STEP_S) - scene.location_m(time_s + STEP_S))[:, 2] / (2 * STEP_S)
    lines = []
    for number in np.flatnonzero(seen.labels.track_id >= 0).tolist():
        row, box = int(seen.row[number]), seen.labels.xyxy_px[number]
        body = renderer.surface(row).placed(turns[row], location_m[row])
        words = [
            f"{seen.labels.frame[number]},{time_s:.6f},{seen.labels.track_id[number]}",
            ROAD_CLASS_OF[str(seen.labels.kitti_type[number]).lower()],
            *(f"{edge:.3f}" for edge in box.tolist()),
            f"{seen.visible_share[number]:.3f}",
            f"{centre_depth_m(body, camera, box):.4f}",
            f"{closing_mps[row]:.4f}",
            _lane(scene, row, time_s),
        ]
        lines.append(",".join(words) + "\n")
    return "".join(lines)


def ego_speed_text(scene: Scene, times_s: list[float]) -> str:
    """ego_speed.csv: the camera's speed along its road at each frame of the left eye."""
    return "time_s,speed_mps\n" + "".join(f"{at_s:.6f},{scene.speed_mps(at_s):.4f}\n" for at_s in times_s)


def _lane(scene: Scene, row: int, time_s: float) -> str:
    user = scene.road_users[row]
    if user.raised_m > 0:
        return ""
    lane = SURROUNDINGS[scene.surroundings].lane_of(user.on_road_m(time_s)[0])
    return "" if lane is None else str(lane)
