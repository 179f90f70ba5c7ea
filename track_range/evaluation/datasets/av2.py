"""Argoverse 2: folders of logs of the sensor data set.

The labels are of the lidar's times, 10 Hz; each is shown in the nearest image. A log without images
has its labels in a camera at the lidar's times. Labels with fewer than 10 lidar points are left out.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from track_range.evaluation.datasets.drive import (
    LENGTHS,
    POSE,
    DatasetError,
    LabelledDrive,
    poses_at,
    poses_of,
    read_columns,
    stacked,
)
from track_range.stereo.geometry.camera import PinholeCamera

_LENS = ("fx_px", "fy_px", "cx_px", "cy_px", "width_px", "height_px", "k1", "k2", "k3")
_LABEL = ("timestamp_ns", "track_uuid", "category", *LENGTHS, *POSE, "num_interior_pts")
_MIN_POINTS = 10


def read(folder: Path, camera_name: str) -> Iterator[LabelledDrive]:
    """The drive of one log; DatasetError if a file is missing or damaged."""
    labels = read_columns(folder / "annotations.feather", _LABEL)
    sweep_ns = np.unique(labels["timestamp_ns"])
    ego = read_columns(folder / "city_SE3_egovehicle.feather", ("timestamp_ns", *POSE))
    lens = read_columns(folder / "calibration/intrinsics.feather", ("sensor_name", *_LENS))
    mounts = read_columns(
        folder / "calibration/egovehicle_SE3_sensor.feather", ("sensor_name", *POSE)
    )
    rows = [np.flatnonzero(table["sensor_name"] == camera_name) for table in (lens, mounts)]
    if not all(map(len, rows)):
        raise DatasetError(
            f"{folder}: expected the camera {camera_name}, found {', '.join(lens['sensor_name'])}; "
            "give one of them with --camera."
        )
    fx, fy, cx, cy, width, height, k1, k2, k3 = stacked(lens, _LENS)[rows[0][0]].tolist()
    images = sorted((folder / "sensors/cameras" / camera_name).glob("*.jpg"))
    frame_ns = sweep_ns
    if images:
        image_ns = np.array([int(image.stem) for image in images])
        shown = np.abs(np.subtract.outer(sweep_ns, image_ns)).argmin(axis=1)
        images, frame_ns = [images[index] for index in shown], image_ns[shown]
    start_ns, order = sweep_ns[0], np.argsort(ego["timestamp_ns"])
    ego_s, frame_s, label_s = (  # from the first sweep: nanoseconds since 1970 are no float64
        (ns - start_ns) / 1e9
        for ns in (ego["timestamp_ns"][order], frame_ns, labels["timestamp_ns"])
    )
    ego_pose = poses_of(stacked(ego, POSE)[order])
    yield LabelledDrive(
        name=folder.name,
        camera=PinholeCamera(fx, fy, cx, cy, int(width), int(height), (k1, k2, 0.0, 0.0, k3)),
        time_s=frame_s + start_ns / 1e9,
        pose=poses_at(frame_s, ego_s, ego_pose) @ poses_of(stacked(mounts, POSE)[rows[1][0]]),
        images=images,
        track=labels["track_uuid"],
        kind=labels["category"].tolist(),
        frame=np.searchsorted(sweep_ns, labels["timestamp_ns"]),
        cuboid_s=label_s + start_ns / 1e9,
        cuboid=poses_at(label_s, ego_s, ego_pose) @ poses_of(stacked(labels, POSE)),
        lwh_m=stacked(labels, LENGTHS),
        n_points=labels["num_interior_pts"].astype(np.float64),
        min_points=_MIN_POINTS,
    )
