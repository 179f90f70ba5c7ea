"""PandaSet: folders of sequences. Its cuboids are pickles, which can run any code when they are
read: they are read from CSV files beside them, which pandas writes (`_ADVICE`).

An object that both lidars see is labelled twice; the cuboid of the spinning lidar counts. Cuboids
have the times of the lidar's sweeps.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from track_range.evaluation.datasets.drive import (
    DatasetError,
    LabelledDrive,
    poses_of,
    read_columns,
    stacked,
)
from track_range.foundation.files.structured_text import read_json
from track_range.stereo.geometry.camera import PinholeCamera

_SIZE_PX = (1920, 1080)
# both ends are 0.1 m, both sides 0.08 m and the top 0.06 m before the first points of the lidar
_PADDING_M = (0.2, 0.16, 0.06)
_PLACE, _SIZE = (
    tuple(f"{name}.{axis}" for axis in axes)
    for name, axes in (("position", "xyz"), ("dimensions", "yxz"))
)
_SENSOR, _SIBLING = "cuboids.sensor_id", "cuboids.sibling_id"
_ADVICE = (
    "python -c \"import glob, pandas; [pandas.read_pickle(f).to_csv(f[:-7] + '.csv', index=False) "
    "for f in glob.glob('annotations/cuboids/*.pkl.gz')]\""
)


def read(folder: Path, camera_name: str) -> Iterator[LabelledDrive]:
    """The drive of one sequence; DatasetError if a file is missing or damaged."""
    of_camera = folder / "camera" / camera_name
    lens, poses, times, sweeps = (
        read_json(file, DatasetError, "a file of PandaSet")
        for file in (
            *(of_camera / f"{name}.json" for name in ("intrinsics", "poses", "timestamps")),
            folder / "meta/timestamps.json",
        )
    )
    files = sorted((folder / "annotations/cuboids").glob("*.csv"))
    if len(files) != len(times):
        raise DatasetError(
            f"{folder}/annotations/cuboids: expected a CSV file for each of {len(times)} images, "
            f"found {len(files)}; pickles can run any code and are not read: if you trust them, run "
            f"this in the folder of the sequence: {_ADVICE}"
        )
    names = ("uuid", "label", "yaw", *_PLACE, *_SIZE, _SENSOR, _SIBLING)
    tables = [read_columns(file, names) for file in files]
    table = {name: np.concatenate([one[name] for one in tables]) for name in names}
    table["frame"] = np.repeat(np.arange(len(files)), [len(one["uuid"]) for one in tables])
    of_spinning = table["uuid"][table[_SENSOR] == 0]
    is_twice = (table[_SENSOR] == 1) & np.isin(table[_SIBLING].astype(str), of_spinning.astype(str))
    table = {name: values[~is_twice] for name, values in table.items()}
    # the yaw is that of the axis to the right; the length is along y
    turn = Rotation.from_euler("z", table["yaw"][:, None] + np.pi / 2).as_quat(scalar_first=True)
    yield LabelledDrive(
        name=folder.name,
        camera=PinholeCamera(lens["fx"], lens["fy"], lens["cx"], lens["cy"], *_SIZE_PX),
        time_s=np.array(times, np.float64),
        pose=poses_of(
            [
                [one["heading"][k] for k in "wxyz"] + [one["position"][k] for k in "xyz"]
                for one in poses
            ]
        ),
        images=sorted(of_camera.glob("*.jpg")),
        track=table["uuid"],
        kind=table["label"].tolist(),
        frame=table["frame"],
        cuboid_s=np.array(sweeps, np.float64)[table["frame"]],
        cuboid=poses_of(np.column_stack([turn, stacked(table, _PLACE)])),
        lwh_m=stacked(table, _SIZE),
        n_points=np.full(len(turn), np.nan),
        padding_m=_PADDING_M,
    )
