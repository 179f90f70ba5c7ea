"""Road data sets for distances of one camera: labelled boxes with true distances, camera height and region.

tusimple  clips of US highways: drawn boxes, truth = the nearest point of a vehicle
nuscenes  Boston, six cameras: boxes and truth from 3-D boxes; boxes that end at the border are left out
kitti     tracking labels of 13 sequences: exact boxes, boxes with a noise of 2 px, boxes of a detector (RRC)
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from track_range.evaluation.motion.nuscenes import read_mono3d
from track_range.evaluation.motion.tusimple import vehicle_boxes, vehicle_columns
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.ranging.truth.labelled_boxes import BoxSet, box_set

KITTI = {"kitti": ("labels", 0.0), "kitti 2 px": ("labels", 2.0), "kitti rrc": ("rrc:{}", 0.0)}
SETS = ("tusimple", "nuscenes", *KITTI)
KITTI_HEIGHT_M = 1.65  # of the cameras above the road (Geiger et al., 2013)


@dataclass(frozen=True, slots=True)
class RoadSet:
    """Boxes of a data set with (N,) camera heights and (N,) identities of objects, and what is
    known of them.
    """

    boxes: BoxSet
    camera_height_m: FloatArray
    object_id: IntArray
    region: str
    # boxes without noise, for a cross-validation over sequences; None = packaged sizes
    train: BoxSet | None = None
    box_sigma_px: float | None = None  # None = the noise model of a detector


def road_set(name: str, data: Path) -> RoadSet:
    """A data set of `SETS` in the folder of the real data."""
    if name == "tusimple":
        return _tusimple(json.loads((data / "tusimple" / "truth.json").read_text(encoding="utf-8")))
    if name == "nuscenes":
        return _nuscenes(data / "nuscenes" / "mono3d.json")
    source, noise_px = KITTI[name]
    folder = data / "kitti_labels"
    exact = box_set(folder / "label_02", folder / "calib")
    boxes = box_set(
        folder / "label_02",
        folder / "calib",
        boxes=source.format(folder / "rrc"),
        noise_px=noise_px,
        seed=1,
    )
    tracks = _identities(boxes.sequence, boxes.track_id)
    height_m = np.full(len(boxes), KITTI_HEIGHT_M)
    return RoadSet(
        boxes, height_m, tracks, "europe", exact, noise_px if source == "labels" else None
    )


def _tusimple(truth: Any) -> RoadSet:
    clip = np.array([clip["clip"] for clip in truth["clips"] for _ in clip["vehicles"]])
    boxes = vehicle_boxes(
        vehicle_columns([vehicle for clip in truth["clips"] for vehicle in clip["vehicles"]]), clip
    )
    height_m = np.full(len(boxes), truth["camera"]["camera_height_m"])
    return RoadSet(boxes, height_m, np.arange(len(boxes)), "north-america")


def _nuscenes(path: Path) -> RoadSet:
    labels = read_mono3d(path)
    boxes, n = labels.boxes, len(labels.boxes)
    image = np.unique([boxes.sequence, boxes.frame], axis=1, return_inverse=True)[1].reshape(-1)
    separate = replace(
        boxes,
        sequence_names=("nuscenes",),
        sequence=np.zeros(n, np.int64),
        frame=image,
        track_id=np.full(n, -1),
    )
    return RoadSet(separate, labels.camera_height_m, boxes.track_id, "north-america")


def _identities(*columns: npt.NDArray[Any]) -> IntArray:
    """(N,) number of each different row of the columns."""
    return np.unique(np.stack(columns, axis=1), axis=0, return_inverse=True)[1].reshape(-1)
