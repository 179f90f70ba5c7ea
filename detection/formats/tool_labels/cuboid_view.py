r"""CuboidView: cuboids of ASAM OpenLABEL as one camera sees them.

    val of a cuboid: x y z | rotation | sx sy sz
    rotation: quaternion qx qy qz qw, or Euler angles rx ry rz
    camera_from_box = camera_from_system · [R t]     R = Rz(rz) Ry(ry) Rx(rx)

The coordinate systems are a tree. `pose_wrt_parent` and the `transforms` of a frame are matrices
that take points of the child or source to the parent or destination; the path between two systems
goes over their first common ancestor. Camera axes are x right, y down, z forward, as the camera
matrix needs them. A camera whose z axis points up in a vehicle or world system has ISO 8855 axes (x
forward, y left, z up), as in OSDaR23, and is turned.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from track_range.detection.boxes import HALF_PIXEL_PX
from track_range.foundation.arrays import FloatArray

Steps = Mapping[tuple[str, str], FloatArray]  # matrices (4, 4) by source and destination

_CAMERA_FROM_ISO8855 = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])
_MIN_UP = 0.7  # z component, in a system with z up, of an axis that points up
_MIN_Z_M = 0.1  # of a corner that has an image
# signs of the corners of a box
_CORNERS = np.array(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5])).reshape(3, 8).T


@dataclass(frozen=True, slots=True)
class CuboidView:
    """A pinhole camera with a lens distortion of OpenCV, among the coordinate systems of a file."""

    name: str
    matrix: FloatArray  # (3, 4), pixel centres at integers
    distortion: FloatArray
    size_px: tuple[int, int]
    systems: Mapping[str, Mapping[str, Any]]

    @classmethod
    def of(cls, name: str, lens: Mapping[str, Any], systems: Any) -> CuboidView | None:
        """The camera of an `intrinsics_pinhole`; None without the matrix of a camera. KeyError,
        TypeError or ValueError for invalid values.
        """
        values = lens.get("camera_matrix", lens.get("camera_matrix_3x4")) or np.zeros(12)
        matrix = np.array(values, np.float64).reshape(3, 4)
        if matrix[0, 0] <= 0 or matrix[1, 0] != 0 or matrix[2, :3].tolist() != [0, 0, 1]:
            return None  # a projection from the axes of another sensor
        lens_values = lens.get("distortion_coeffs", lens.get("distortion_coeffs_1xN"))
        distortion = np.array(lens_values or [0.0] * 5, np.float64)
        return cls(name, matrix, distortion, (lens["width_px"], lens["height_px"]), systems)

    def seen(self, cuboids: Sequence[tuple[str, Any]], steps: Steps) -> SeenCuboid | None:
        """The first of the cuboids, each with its coordinate system and its `val`, that has a size
        and a place relative to the camera; None = none.
        """
        for system, val in cuboids:
            values = np.array(val or [0.0] * 9, np.float64)
            if len(values) not in (9, 10):
                raise ValueError(f"expected 9 or 10 values of a cuboid, found {len(values)}")
            camera_from = self._camera_from(system, steps)
            if camera_from is not None and (values[-3:] > 0).all():
                turn = (
                    ("quaternion", values[3:7])
                    if len(values) == 10
                    else ("euler_angles", values[5:2:-1])
                )
                pose = camera_from @ _matrix(dict([turn, ("translation", values[:3])]))
                return SeenCuboid(self, pose[:3, :3], pose[:3, 3], values[-3:])
        return None

    def _camera_from(self, system: str, steps: Steps) -> FloatArray | None:
        """(4, 4) matrix from a coordinate system to the camera; None = the file states none."""
        above, others = self._ancestors(self.name, steps), self._ancestors(system, steps)
        common = next((name for name in others if name in above), None)
        if common is None:
            return None
        with_z_up = [name for name, matrix in above.items() if matrix[2, 2] > _MIN_UP]
        is_turned = any(
            not str(self.systems.get(name, {}).get("type")).startswith("sensor")
            for name in with_z_up
        )
        axes: FloatArray = _CAMERA_FROM_ISO8855.copy() if is_turned else np.eye(4)
        axes[:3, 3] = np.linalg.solve(self.matrix[:, :3], self.matrix[:, 3])
        return np.asarray(axes @ np.linalg.inv(above[common]) @ others[common])

    def _ancestors(self, name: str, steps: Steps) -> dict[str, FloatArray]:
        """The matrices (4, 4) from a system to itself, and to ancestors whose poses are known."""
        total: FloatArray = np.eye(4)
        ancestors = {name: total}
        while (parent := self.systems.get(name, {}).get("parent")) and parent not in ancestors:
            pose = self.systems[name].get("pose_wrt_parent")
            step = steps.get((name, parent), None if pose is None else _matrix(pose))
            if step is None:
                break
            total, name = step @ total, parent
            ancestors[name] = total
        return ancestors


@dataclass(frozen=True, slots=True)
class SeenCuboid:
    """A cuboid in the axes of a camera."""

    view: CuboidView
    turn: FloatArray  # (3, 3) from the axes of the cuboid
    centre_m: FloatArray  # (3,)
    size_m: FloatArray  # (3,) along its axes

    def outline(self) -> Sequence[float]:
        """Left, top, right, bottom around the image of the cuboid, clipped to the camera's image,
        in the corner convention; zeros = it is not in front of the camera, or beside the image.
        """
        corners = (_CORNERS * self.size_m) @ self.turn.T + self.centre_m
        if corners[:, 2].min() < _MIN_Z_M:
            return [0.0] * 4
        zero, matrix = np.zeros(3), self.view.matrix[:, :3]
        points, _ = cv2.projectPoints(corners, zero, zero, matrix, self.view.distortion)
        edges = np.clip(points.reshape(8, 2) + HALF_PIXEL_PX, 0, self.view.size_px)
        return [*edges.min(axis=0).tolist(), *edges.max(axis=0).tolist()]

    def surface_m(self, edges: Sequence[float]) -> float:
        """The z at which the ray through the middle of a box (corner convention) first meets the
        cuboid, by slabs (Kay and Kajiya 1986); infinite = it misses it, or starts inside it.
        """
        middle = (np.array(edges[:2]) + edges[2:]) / 2 - HALF_PIXEL_PX
        matrix, lens = self.view.matrix[:, :3], self.view.distortion
        (ray,) = cv2.undistortPoints(middle[None, None], matrix, lens)[0]
        direction, origin = np.array([*ray, 1.0]) @ self.turn, -self.centre_m @ self.turn
        direction[np.abs(direction) < 1e-12] = 1e-12
        near, far = (-self.size_m / 2 - origin) / direction, (self.size_m / 2 - origin) / direction
        enters, leaves = np.minimum(near, far).max(), np.maximum(near, far).min()
        return float(enters) if 0 < enters <= leaves else math.inf


def steps_of(transforms: Mapping[str, Mapping[str, Any]]) -> Steps:
    """The `transforms` of a frame and their inverses; KeyError or ValueError for invalid values."""
    stated = {
        (step["src"], step["dst"]): _matrix(step["transform_src_to_dst"])
        for step in transforms.values()
    }
    inverse = {(b, a): np.asarray(np.linalg.inv(matrix)) for (a, b), matrix in stated.items()}
    return {**inverse, **stated}


def _matrix(data: Mapping[str, Any]) -> FloatArray:
    """(4, 4) matrix of a transform: a matrix row by row, or a translation with a quaternion or with
    Euler angles, which turn about the axes that the turns before have moved.
    """
    from scipy.spatial.transform import Rotation  # 0.1 s, for files with cuboids only

    if "matrix4x4" in data:
        return np.array(data["matrix4x4"], np.float64).reshape(4, 4)
    sequence = str(data.get("sequence", "ZYX")).upper()
    rotation = (
        Rotation.from_quat(data["quaternion"])
        if "quaternion" in data
        else Rotation.from_euler(sequence, data["euler_angles"])
    )
    at_m = np.reshape(data["translation"], (3, 1))
    return np.vstack([np.hstack([rotation.as_matrix(), at_m]), [0.0, 0.0, 0.0, 1.0]])
