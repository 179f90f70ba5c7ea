"""nuScenes: the root folder, with the tables of v1.0-mini, -trainval or -test, and images in
samples.

The labels are of key frames, 2 Hz; each scene is a drive.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from track_range.evaluation.datasets.drive import DatasetError, LabelledDrive, poses_of
from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import MAX_TABLE_BYTES
from track_range.foundation.files.structured_text import read_json
from track_range.stereo.geometry.camera import PinholeCamera

_TABLES = (
    *("scene", "sample", "sample_data", "calibrated_sensor", "sensor", "ego_pose"),
    *("sample_annotation", "instance", "category"),
)
_Rows = dict[str, dict[str, Any]]


def read(folder: Path, camera_name: str) -> Iterator[LabelledDrive]:
    """The drive of each scene; DatasetError if a table is missing or damaged."""
    place = next(iter(sorted(folder.glob("v1.0-*"))), folder)
    tables: dict[str, _Rows] = {}
    for name in _TABLES:
        listed = read_json(
            place / f"{name}.json", DatasetError, "a table of nuScenes", max_bytes=MAX_TABLE_BYTES
        )
        tables[name] = {row["token"]: row for row in listed}
    by_scene = defaultdict[str, list[dict[str, Any]]](list)
    for shot in tables["sample_data"].values():
        mount = tables["calibrated_sensor"][shot["calibrated_sensor_token"]]
        is_camera = tables["sensor"][mount["sensor_token"]]["channel"] == camera_name
        if shot["is_key_frame"] and is_camera:
            ego = tables["ego_pose"][shot["ego_pose_token"]]
            scene = tables["sample"][shot["sample_token"]]["scene_token"]
            by_scene[scene].append(shot | {"mount": mount, "ego": ego})
    labels = defaultdict[str, list[dict[str, Any]]](list)
    for row in tables["sample_annotation"].values():
        labels[row["sample_token"]].append(row)
    for scene, shots in by_scene.items():
        shots.sort(key=lambda shot: int(shot["timestamp"]))
        of_shots = [labels[shot["sample_token"]] for shot in shots]
        yield _drive(folder, str(tables["scene"][scene]["name"]), shots, of_shots, tables)


def _drive(
    folder: Path,
    name: str,
    shots: list[dict[str, Any]],
    of_shots: list[list[dict[str, Any]]],
    tables: dict[str, _Rows],
) -> LabelledDrive:
    """The drive of the images of one scene, and the labels of each."""
    labels = [row for rows in of_shots for row in rows]
    objects = [tables["instance"][row["instance_token"]] for row in labels]
    samples = [tables["sample"][row["sample_token"]] for row in labels]
    K = shots[0]["mount"]["camera_intrinsic"]
    size_px = int(shots[0]["width"]), int(shots[0]["height"])
    return LabelledDrive(
        name=name,
        camera=PinholeCamera(K[0][0], K[1][1], K[0][2], K[1][2], *size_px),
        time_s=np.array([shot["timestamp"] for shot in shots]) / 1e6,
        pose=_poses(shot["ego"] for shot in shots) @ _poses(shot["mount"] for shot in shots),
        images=[image for shot in shots if (image := folder / str(shot["filename"])).is_file()],
        track=np.array([row["instance_token"] for row in labels]),
        kind=[tables["category"][one["category_token"]]["name"] for one in objects],
        frame=np.repeat(np.arange(len(shots)), [len(rows) for rows in of_shots]),
        cuboid_s=np.array([sample["timestamp"] for sample in samples]) / 1e6,
        cuboid=_poses(labels),
        lwh_m=np.array([row["size"] for row in labels], np.float64).reshape(-1, 3)[:, [1, 0, 2]],
        n_points=np.array([row.get("num_lidar_pts", np.nan) for row in labels], np.float64),
    )


def _poses(rows: Iterable[dict[str, Any]]) -> FloatArray:
    """(N, 4, 4) transforms of rows with the keys rotation (w x y z) and translation."""
    return poses_of([[*row["rotation"], *row["translation"]] for row in rows])
