r"""Reference distances of labelled objects by the definitions of published evaluations.

    surface   z at which the ray through the middle of the box meets the 3-D box: the distance of this project
    centre    z of the centre of the 3-D box, as in KITTI's labels (Vajgl et al., Dist-YOLO, Applied Sciences 2022)
    lidar     depth of the (0.1 n)-th nearest of the n lidar points in the 3-D box (Zhu and Fang, Learning
              object-specific distance from a monocular image, ICCV 2019; Panariello et al., DistFormer, CVIU 2025)

All are depths in the frame of the left camera. The methods measure the surface; `centre_offset_m` of the evaluation
converts their distances for the reference `centre`.

        z                 Box in KITTI's convention: bottom centre (X, Y, Z), height h along -y, length l along the x
ray   / |____             axis and width w along the z axis of the box, rotated by rotation_y about the camera's y
 \   / /    /|            axis. In the axes of the box, the intersection is a slab test (Kay and Kajiya 1986).
  \ / /____/ |
   o x the ray meets the front face first: distance_m is the z of that point
"""

from pathlib import Path
from typing import Literal

import numpy as np

from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.video_labels.kitti import KittiLabels
from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import read_text

ReferenceName = Literal["surface", "centre", "lidar"]  # names of the definitions
# fraction of the lidar points of an object that are nearer than the reference distance
_LIDAR_FRACTION = 0.1
_MARGIN_M = 0.05  # margin of 3-D boxes within which lidar points belong to the object
# of object and tracking files
_ROWS = {"R": ("R0_rect", "R_rect"), "T": ("Tr_velo_to_cam", "Tr_velo_cam")}


def surface_distance_m(
    rays: FloatArray, location_m: FloatArray, *, size_hwl_m: FloatArray, rotation_y_rad: FloatArray
) -> FloatArray:
    """(N,) z at which each ray from the camera first meets its box; NaN = it misses the box, or
    starts inside it.

    The rays (N, 3) have z = 1, so that their parameter is the depth. Boxes: bottom centre (N, 3) in
    the camera's frame, height, width and length (N, 3), yaw (N,).
    """
    origin = _in_box_axes(-location_m, rotation_y_rad)
    direction = _in_box_axes(rays, rotation_y_rad)
    height, width, length = size_hwl_m.T
    low = np.stack([-length / 2, -height, -width / 2], axis=1)
    high = np.stack([length / 2, np.zeros_like(height), width / 2], axis=1)
    # no division by 0 for rays parallel to a face
    safe = np.where(np.abs(direction) < 1e-12, 1e-12, direction)
    first, second = (low - origin) / safe, (high - origin) / safe
    enters = np.minimum(first, second).max(axis=1)
    leaves = np.maximum(first, second).min(axis=1)
    return np.where((enters <= leaves) & (enters > 0), enters, np.nan)


def _in_box_axes(vectors: FloatArray, rotation_y_rad: FloatArray) -> FloatArray:
    """(N, 3) vectors rotated from the camera's axes to the axes of each box, by -rotation_y about
    y.
    """
    cos, sin = np.cos(rotation_y_rad), np.sin(rotation_y_rad)
    x, y, z = vectors.T
    return np.stack([cos * x - sin * z, y, sin * x + cos * z], axis=1)


def centre_distance_m(labels: KittiLabels, left_from_reference_m: FloatArray) -> FloatArray:
    """(N,) z of the centres of the 3-D boxes in the frame of the left camera."""
    return np.asarray(labels.location_m[:, 2] + left_from_reference_m[2])


def lidar_distance_m(
    labels: KittiLabels, points_m: FloatArray, left_from_reference_m: FloatArray
) -> FloatArray:
    """(N,) depth of the (0.1 n)-th nearest of the n lidar points in each 3-D box of an image; NaN =
    no point.

    `points_m` (M, 3) are in the frame of the reference camera, the result is in the frame of the
    left camera.
    """
    distance_m = np.full(len(labels), np.nan)
    for row in np.flatnonzero(labels.has_3d_box).tolist():
        height, width, length = labels.size_hwl_m[row]
        cos, sin = np.cos(labels.rotation_y_rad[row]), np.sin(labels.rotation_y_rad[row])
        x, y, z = (points_m - labels.location_m[row]).T
        is_inside = (np.abs(cos * x - sin * z) <= length / 2 + _MARGIN_M) & (
            np.abs(sin * x + cos * z) <= width / 2 + _MARGIN_M
        )
        is_inside &= (y <= _MARGIN_M) & (y >= -height - _MARGIN_M)
        depth_m = np.sort(points_m[is_inside, 2])
        if len(depth_m):
            distance_m[row] = (
                depth_m[int(_LIDAR_FRACTION * len(depth_m))] + left_from_reference_m[2]
            )
    return distance_m


def read_lidar(path: Path, calib: Path) -> FloatArray:
    """(M, 3) points of a KITTI velodyne file (x, y, z, reflectance as float32) in the frame of the
    reference camera.

    Raises LabelFileError: the file is missing or is not made of points, or the calibration has no
    lidar.
    """
    try:
        values = np.fromfile(path, np.float32)
    except OSError as error:
        raise LabelFileError(
            f"{path}: expected the lidar points of an image, found no readable file."
        ) from error
    if len(values) % 4 or not np.isfinite(values).all():
        raise LabelFileError(
            f"{path}: expected points of four float32 numbers each, found {len(values)} numbers."
        )
    rotation, transform = _matrix(calib, "R", (3, 3)), _matrix(calib, "T", (3, 4))
    points_m = values.reshape(-1, 4)[:, :3].astype(np.float64)
    return np.asarray((points_m @ transform[:, :3].T + transform[:, 3]) @ rotation.T)


def _matrix(calib: Path, matrix: str, shape: tuple[int, int]) -> FloatArray:
    for line in read_text(calib, LabelFileError, "a calibration file of KITTI").splitlines():
        name, *values = line.replace(":", " ").split()[: 1 + shape[0] * shape[1]] or [""]
        if name in _ROWS[matrix] and len(values) == shape[0] * shape[1]:
            try:
                return np.array(values, np.float64).reshape(shape)
            except ValueError:
                break
    raise LabelFileError(
        f"{calib}: expected the row {' or '.join(_ROWS[matrix])} of the lidar, found none that is "
        "valid."
    )
