"""Text files of a drive: truth.csv, truth.txt, contacts.csv and ego_speed.csv.

truth.csv         exact ground truth of every labelled object in every frame, with the boxes of truth.txt:
                      frame,time_s,id,class,x1,y1,x2,y2,visible_share,distance_m,closing_mps,lane
                  `distance_m` is the z, in the left camera's frame, at which the ray through the box centre meets the
                  drawn body (KITTI's 3-D box is accurate to about 10 cm only); `closing_mps` is the rate at which z of
                  the object's location decreases; `lane` counts from the ego lane, 1 = the next lane to the right,
                  empty = outside all lanes.
truth.txt         rows of KITTI's tracking format
contacts.csv      one row per contact of the ego vehicle, earliest first: object_id,class,contact_s
                  `object_id` is the id of truth.csv; `contact_s` is the time since the first frame. `world/contacts.py`
                  defines which contacts count.
ego_speed.csv     the camera's speed along the road at the times of the left frames: time_s,speed_mps
"""

from collections.abc import Iterable

import numpy as np

from track_range.detection.classes import road_class_of
from track_range.detection.formats.video_labels.kitti import KittiLabels
from track_range.simulation.render.renderer import Renderer
from track_range.simulation.render.surface import centre_depth_m
from track_range.simulation.world.contacts import EgoContact
from track_range.simulation.world.scene import STEP_S, Scene
from track_range.simulation.world.surroundings import SURROUNDINGS
from track_range.simulation.world.truth import VisibleObjects

TRUTH_HEADER = "frame,time_s,id,class,x1,y1,x2,y2,visible_share,distance_m,closing_mps,lane\n"


def truth_rows(renderer: Renderer, time_s: float, visible: VisibleObjects) -> str:
    """The rows of truth.csv for one frame."""
    scene, camera, labels = renderer.scene, renderer.rig.left, visible.labels
    location_m, rotations = scene.location_m(time_s), scene.rotations(time_s)
    closing_mps = (scene.location_m(time_s - STEP_S) - scene.location_m(time_s + STEP_S))[:, 2] / (
        2 * STEP_S
    )
    lines = []
    for number in np.flatnonzero(labels.track_id >= 0).tolist():
        row, box = int(visible.row[number]), labels.xyxy_px[number]
        body = renderer.surface(row).transformed(rotations[row], location_m[row])
        user = scene.road_users[row]
        lane = (
            None
            if user.raised_m > 0
            else SURROUNDINGS[scene.surroundings].lane_of(user.on_road_m(time_s)[0])
        )
        cells = [
            f"{labels.frame[number]},{time_s:.6f},{labels.track_id[number]}",
            road_class_of(labels.kitti_type[number]) or "",
            *(f"{edge:.3f}" for edge in box.tolist()),
            f"{visible.visible_share[number]:.3f}",
            f"{centre_depth_m(body, camera, box):.4f}",
            f"{closing_mps[row]:.4f}",
            "" if lane is None else str(lane),
        ]
        lines.append(",".join(cells) + "\n")
    return "".join(lines)


def kitti_text(labels: KittiLabels) -> str:
    """Rows of KITTI's tracking format, with a score if there is one; alpha = rotation_y - bearing,
    in [-pi, pi).
    """
    bearing_rad = np.arctan2(labels.location_m[:, 0], labels.location_m[:, 2])
    alpha_rad = (labels.rotation_y_rad - bearing_rad + np.pi) % (2 * np.pi) - np.pi
    alpha_rad = np.where(labels.has_3d_box, alpha_rad, -10.0)
    lines = []
    for row in range(len(labels)):
        numbers = [
            alpha_rad[row],
            *labels.xyxy_px[row],
            *labels.size_hwl_m[row],
            *labels.location_m[row],
        ]
        words = [
            f"{labels.frame[row]} {labels.track_id[row]} {labels.kitti_type[row]}",
            f"{labels.truncated[row]:.0f} {labels.occluded[row]}",
            *(
                f"{number:.6f}".rstrip("0").rstrip(".")
                for number in (*numbers, labels.rotation_y_rad[row])
            ),
        ]
        if np.isfinite(labels.score[row]):
            words.append(f"{labels.score[row]:.6f}")
        lines.append(" ".join(words) + "\n")
    return "".join(lines)


def contacts_text(contacts: Iterable[EgoContact]) -> str:
    """Content of contacts.csv, with its header also without contacts."""
    rows = (
        f"{row.track_id},{road_class_of(row.kitti_type)},{row.contact_s:.4f}\n" for row in contacts
    )
    return "object_id,class,contact_s\n" + "".join(rows)


def ego_speed_text(scene: Scene, times_s: Iterable[float]) -> str:
    """Content of ego_speed.csv for the times of the left frames."""
    return "time_s,speed_mps\n" + "".join(
        f"{time_s:.6f},{scene.speed_mps(time_s):.4f}\n" for time_s in times_s
    )
