"""Road data sets for distances of one camera: labelled boxes with true distances, camera height and region.

tusimple  clips of US highways: drawn boxes, truth = the nearest point of a vehicle
nuscenes  Boston, six cameras: boxes and truth from 3-D boxes; boxes that end at the border are left out
kitti     tracking labels of 13 sequences: exact boxes, boxes with a noise of 2 px, boxes of a detector (RRC)
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.ranging.evaluation.reference_distance import surface_distance_m
from track_range.ranging.fitting.labelled_boxes import BoxSet, box_set
from track_range.stereo.geometry.camera import PinholeCamera

KITTI = {"kitti": ("labels", 0.0), "kitti 2 px": ("labels", 2.0), "kitti rrc": ("rrc:{}", 0.0)}
SETS = ("tusimple", "nuscenes", *KITTI)
KITTI_HEIGHT_M = 1.65  # of the cameras above the road (Geiger et al., 2013)
BORDER_PX = 2.0  # distance from the image border within which a box counts as cut

NUSCENES_CLASSES = {"pedestrian": "person"} | {name: name for name in ("car", "truck", "bus", "bicycle", "motorcycle")}
"""Class in the results of the labelled classes; trailers, barriers and cones are not measured."""


@dataclass(frozen=True, slots=True)
class RoadSet:
    """Boxes of a data set with (N,) camera heights and (N,) identities of objects, and what is known of them."""

    boxes: BoxSet
    camera_height_m: FloatArray
    object_id: IntArray
    region: str
    train: BoxSet | None = None  # boxes without noise, for a cross-validation over sequences; None = packaged sizes
    box_sigma_px: float | None = None  # None = the noise model of a detector


def road_set(name: str, data: Path) -> RoadSet:
    """A data set of `SETS` in the folder of the real data."""
    if name == "tusimple":
        return _tusimple(json.loads((data / "tusimple" / "truth.json").read_text(encoding="utf-8")))
    if name == "nuscenes":
        return _nuscenes(json.loads((data / "nuscenes" / "mono3d.json").read_text(encoding="utf-8")))
    source, noise_px = KITTI[name]
    folder = data / "kitti_labels"
    exact = box_set(folder / "label_02", folder / "calib")
    boxes = box_set(
        folder / "label_02", folder / "calib", boxes=source.format(folder / "rrc"), noise_px=noise_px, seed=1
    )
    tracks = _identities(boxes.sequence, boxes.track_id)
    height_m = np.full(len(boxes), KITTI_HEIGHT_M)
    return RoadSet(boxes, height_m, tracks, "europe", exact, noise_px if source == "labels" else None)


def tusimple_camera(camera: Any) -> PinholeCamera:
    return PinholeCamera(*(camera[f"{name}_px"] for name in ("fx", "fy", "cx", "cy", "width", "height")))


def _tusimple(truth: Any) -> RoadSet:
    rows = [(clip["clip"], vehicle) for clip in truth["clips"] for vehicle in clip["vehicles"]]
    boxes = _boxes(
        "tusimple",
        np.array([clip for clip, _ in rows]),
        [("Car", "car")] * len(rows),
        np.array([[vehicle["bbox"][edge] for edge in ("left", "top", "right", "bottom")] for _, vehicle in rows]),
        [tusimple_camera(truth["camera"])] * len(rows),
        np.array([vehicle["position"][0] for _, vehicle in rows]),
    )
    height_m = np.full(len(rows), truth["camera"]["camera_height_m"])
    return RoadSet(boxes, height_m, np.arange(len(rows)), "north-america")


def _nuscenes(labels: Any) -> RoadSet:
    names = {category["id"]: category["name"] for category in labels["categories"]}
    images = {image["id"]: (number, image) for number, image in enumerate(labels["images"])}
    rows = [row for row in labels["annotations"] if names[row["category_id"]] in NUSCENES_CLASSES]
    image = [images[row["image_id"]][1] for row in rows]
    K = np.array([each["cam_intrinsic"] for each in image])
    x_m, y_m, z_m, length_m, height_m, width_m, yaw_rad = np.array([row["bbox_cam3d"] for row in rows]).T
    size_hwl_m = np.stack([height_m, width_m, length_m], axis=1)
    left, top, width, height = np.array([row["bbox"] for row in rows]).T
    rays = np.stack([left + width / 2, top + height / 2, np.ones(len(rows))], axis=1)
    rays = np.linalg.solve(K, rays[:, :, None])[:, :, 0]
    bottom_m = np.stack([x_m, y_m + height_m / 2, z_m], axis=1)  # the labels have the centre
    boxes = _boxes(
        "nuscenes",
        np.array([images[row["image_id"]][0] for row in rows]),
        [(names[row["category_id"]], NUSCENES_CLASSES[names[row["category_id"]]]) for row in rows],
        np.stack([left, top, left + width, top + height], axis=1),
        [
            PinholeCamera(k[0, 0], k[1, 1], k[0, 2], k[1, 2], i["width"], i["height"])
            for k, i in zip(K, image, strict=True)
        ],
        surface_distance_m(rays, bottom_m, size_hwl_m=size_hwl_m, rotation_y_rad=yaw_rad),
    )
    is_whole = (left > BORDER_PX) & (left + width < boxes.size_px[:, 0] - 1 - BORDER_PX) & np.isfinite(boxes.distance_m)
    camera_height_m = np.array([each["cam2ego_translation"][2] for each in image])
    identity = _identities(*size_hwl_m.round(3).T)  # the size of an object's 3-D box is the same in all images
    return RoadSet(boxes.select(is_whole), camera_height_m[is_whole], identity[is_whole], "north-america")


def _boxes(
    name: str,
    frame: IntArray,
    classes: list[tuple[str, str]],
    xyxy_px: FloatArray,
    cameras: list[PinholeCamera],
    distance_m: FloatArray,
) -> BoxSet:
    """Boxes of separate images; `classes` are those of the labels and of the results."""
    n = len(frame)
    return BoxSet.without_3d_boxes(
        sequence_names=(name,),
        sequence=np.zeros(n, np.int64),
        frame=frame,
        time_s=frame.astype(np.float64),
        track_id=np.full(n, -1),
        kitti_type=np.array([label for label, _ in classes], np.str_),
        class_name=np.array([road_class for _, road_class in classes], np.str_),
        xyxy_px=xyxy_px,
        fxycxy_px=np.array([(c.fx_px, c.fy_px, c.cx_px, c.cy_px) for c in cameras]),
        size_px=np.array([(c.width_px, c.height_px) for c in cameras]),
        distance_m=distance_m,
    )


def _identities(*columns: npt.NDArray[Any]) -> IntArray:
    """(N,) number of each different row of the columns."""
    return np.unique(np.stack(columns, axis=1), axis=0, return_inverse=True)[1].reshape(-1)
