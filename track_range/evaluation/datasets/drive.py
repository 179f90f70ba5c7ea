"""LabelledDrive: images, poses and cuboids of a drive of any data set, as its reader returns it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation, Slerp

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.errors import UserError
from track_range.foundation.files.input_files import check_regular
from track_range.stereo.geometry.camera import PinholeCamera

POSE = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")
LENGTHS = ("length_m", "width_m", "height_m")
"""Names of columns of a pose and of the sizes of a cuboid."""


class DatasetError(UserError):
    """Files of a data set that cannot be used; the message names the file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelledDrive:
    """One camera of a drive with F frames, and N cuboids at their own times, in a fixed frame."""

    name: str
    camera: PinholeCamera  # with the lens of the images
    time_s: FloatArray  # (F,) of the images, by the clock of the data set
    pose: FloatArray  # (F, 4, 4) from the camera (right, down, forward) to the fixed frame
    images: Sequence[Path] = ()  # F files, or none
    track: npt.NDArray[Any]  # (N,) identity of the object
    kind: Sequence[str]  # (N,) class, in the words of the data set
    frame: IntArray  # (N,) index of the image that shows the cuboid
    cuboid_s: FloatArray  # (N,) time of the cuboid
    cuboid: FloatArray  # (N, 4, 4) to the fixed frame, from x along the length, y to the left, z up
    lwh_m: FloatArray  # (N, 3) length, width and height
    n_points: FloatArray  # (N,) lidar points in the cuboid; NaN = unknown
    min_points: int = 0  # of cuboids that become labels
    # by which cuboids are longer, wider and higher than the bodies in them
    padding_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


def read_columns(path: Path, names: Sequence[str]) -> dict[str, npt.NDArray[Any]]:
    """The named columns of a Feather, Parquet or CSV file; DatasetError if one is missing."""
    from pyarrow import ArrowException, csv, feather, parquet

    single = csv.ReadOptions(use_threads=False)
    check_regular(path, DatasetError, f"a table with the columns {', '.join(names)}")
    try:
        if path.suffix == ".csv":
            table = csv.read_csv(path, single)
        else:
            table = {".feather": feather, ".parquet": parquet}[path.suffix].read_table(path)
        return {name: table[name].to_numpy() for name in names}
    except (ArrowException, KeyError, OSError) as error:
        raise DatasetError(
            f"{path}: expected the columns {', '.join(names)}, found other content "
            f"({str(error).splitlines()[0]})."
        ) from error


def stacked(table: Mapping[str, npt.NDArray[Any]], names: Sequence[str]) -> FloatArray:
    """(N, K) numbers of K columns."""
    return np.column_stack([table[name].astype(np.float64) for name in names])


def poses_of(values: npt.ArrayLike) -> FloatArray:
    """(N, 4, 4) transforms from rows of a quaternion w x y z and a translation (N, 7)."""
    rows = np.asarray(values, np.float64).reshape(-1, 7)
    pose = np.tile(np.eye(4), (len(rows), 1, 1))
    pose[:, :3, :3] = Rotation.from_quat(rows[:, :4], scalar_first=True).as_matrix()
    pose[:, :3, 3] = rows[:, 4:]
    return pose


def poses_at(time_s: FloatArray, known_s: FloatArray, pose: FloatArray) -> FloatArray:
    """(N, 4, 4) poses at the times (N,), between the known ones (M, 4, 4) at increasing times."""
    inside_s = np.clip(time_s, known_s[0], known_s[-1])
    turn = Slerp(known_s, Rotation.from_matrix(pose[:, :3, :3]))(inside_s)
    place_m = np.column_stack([np.interp(inside_s, known_s, axis) for axis in pose[:, :3, 3].T])
    return poses_of(np.column_stack([turn.as_quat(scalar_first=True), place_m]))
