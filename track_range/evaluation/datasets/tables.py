"""A layout of plain tables, into which other data sets, such as Waymo's Open Dataset, are brought
with a few lines.

    rig.yaml      the camera, in any calibration format that --rig reads
    frames.csv    time_s, qw, qx, qy, qz, tx_m, ty_m, tz_m of the camera (right, down, forward) in a
                  fixed frame with z up, and image, the path of its image from the folder (empty =
                  none)
    cuboids.csv   frame (row of frames.csv, from 0), time_s (of the lidar), track, class, length_m,
                  width_m, height_m, qw, qx, qy, qz, tx_m, ty_m, tz_m of the middle in the same frame
                  (x along the length), and points, the lidar points in it (-1 = unknown)

Both tables may be Parquet or Feather instead, with the same columns.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from track_range.evaluation.datasets.drive import (
    LENGTHS,
    POSE,
    DatasetError,
    LabelledDrive,
    poses_of,
    read_columns,
    stacked,
)
from track_range.stereo.rig_formats.reading import load_camera

_CUBOID = ("frame", "time_s", "track", "class", *LENGTHS, *POSE, "points")


def read(folder: Path, _camera_name: str) -> Iterator[LabelledDrive]:
    """The drive of one folder; DatasetError if a file is missing or damaged."""
    camera, _ = load_camera(folder / "rig.yaml", size_px=None)
    files = [
        next(iter(sorted(folder.glob(f"{name}.*"))), folder / f"{name}.csv")
        for name in ("frames", "cuboids")
    ]
    frames = read_columns(files[0], ("time_s", *POSE, "image"))
    table = read_columns(files[1], _CUBOID)
    time_s, frame = stacked(frames, ["time_s"])[:, 0], table["frame"].astype(np.int64)
    if ((frame < 0) | (frame >= len(time_s))).any():
        raise DatasetError(f"{files[1]}: expected rows of {files[0].name} as frame, found others.")
    yield LabelledDrive(
        name=folder.name,
        camera=camera,
        time_s=time_s,
        pose=poses_of(stacked(frames, POSE)),
        images=[folder / str(name) for name in frames["image"] if name],
        track=table["track"].astype(np.str_),
        kind=table["class"].tolist(),
        frame=frame,
        cuboid_s=stacked(table, ["time_s"])[:, 0],
        cuboid=poses_of(stacked(table, POSE)),
        lwh_m=stacked(table, LENGTHS),
        n_points=np.where(table["points"] < 0, np.nan, table["points"]),
    )
