"""CuboidDrive: a real drive as 3-D boxes around the vehicle, frame by frame, with its poses.

Axes of the vehicle: x forward, y to the left, z up, origin at the rear axle (Argoverse 2). The
files are those of `av2/annotations` in the real data: NAME.parquet and NAME.poses.parquet.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow.parquet as pq
from scipy.spatial.transform import Rotation, Slerp

from track_range.evaluation.motion.labelled_motion import track_slopes
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray

MIN_POINTS = 10  # lidar points below which a cuboid is a guess
_HALF_SPAN_S = 0.5  # velocities are slopes over this time to either side, as in the labels
_EGO_HALF_SPAN_S = 0.1  # the same, of the motion of the vehicle
_ROAD_M = 20.0  # distance up to which bottoms of cuboids show the plane of the road
_PERSONS = ("PEDESTRIAN",)
_TRUCKS = ("TRUCK", "TRUCK_CAB", "BOX_TRUCK")
CLASS_OF_KIND = {
    "REGULAR_VEHICLE": "car",
    **dict.fromkeys(_TRUCKS, "truck"),
    "BUS": "bus",
    "SCHOOL_BUS": "bus",
    "PEDESTRIAN": "person",
}
"""Road classes of the scored categories; others only hide what is behind them."""


@dataclass(frozen=True, slots=True)
class Cuboids:
    """N cuboids of one or more frames, in the axes of the vehicle at their time."""

    frame: IntArray  # (N,)
    track_id: IntArray  # (N,)
    kind: npt.NDArray[np.str_]  # (N,) category of the data set
    bottom_m: FloatArray  # (N, 3) middle of the bottom
    size_lwh_m: FloatArray  # (N, 3)
    yaw_rad: FloatArray  # (N,) of the length, to the left of x
    points: IntArray  # (N,) lidar points inside

    def __len__(self) -> int:
        return len(self.frame)

    def select(self, rows: BoolArray | IntArray) -> Cuboids:
        """The cuboids of the given rows."""
        return Cuboids(*(getattr(self, name)[rows] for name in Cuboids.__slots__))

    def from_body(self, points: FloatArray) -> FloatArray:
        """(N, M, 3) points of bodies in the axes of the vehicle; `points` (M, 3) are fractions of
        length and width from the middle, and of the height from the bottom.
        """
        x, y, z = np.moveaxis(points * self.size_lwh_m[:, None], 2, 0)
        cos, sin = np.cos(self.yaw_rad)[:, None], np.sin(self.yaw_rad)[:, None]
        turned = np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=2)
        return np.asarray(turned + self.bottom_m[:, None])

    def entered(self, origin_m: FloatArray, rays: FloatArray) -> FloatArray:
        """(N, R) multiples of rays (R, 3) from a point at which they enter the cuboids; inf = they
        miss.
        """
        cos, sin = np.cos(self.yaw_rad)[:, None], np.sin(self.yaw_rad)[:, None]
        start = (origin_m - self.bottom_m)[:, None]
        near, far = np.full((2, len(self), len(rays)), (-np.inf,))
        far = -far
        for axis in range(3):
            from_m, along = start[..., axis], rays[None, :, axis]
            if axis < 2:
                c, s = ((cos, sin), (-sin, cos))[axis]
                from_m = c * start[..., 0] + s * start[..., 1]
                along = c * rays[None, :, 0] + s * rays[None, :, 1]
            half_m = self.size_lwh_m[:, axis, None] / 2
            low_m, high_m = (0 * half_m, 2 * half_m) if axis == 2 else (-half_m, half_m)
            with np.errstate(divide="ignore", invalid="ignore"):
                at = np.stack([(low_m - from_m) / along, (high_m - from_m) / along])
            near, far = np.fmax(near, at.min(axis=0)), np.fmin(far, at.max(axis=0))
        return np.where((near <= far) & (near > 0), near, np.inf)


@dataclass(frozen=True, slots=True)
class CuboidDrive:
    """T frames; positions of the vehicle are in the axes of a map, z up."""

    name: str
    times_s: FloatArray  # (T,) from the first frame
    cuboids: Cuboids  # of all frames
    position_m: FloatArray  # (T, 3) of the vehicle
    rotation: FloatArray  # (T, 3, 3) map from vehicle

    @classmethod
    def read(cls, folder: Path, name: str) -> CuboidDrive:
        """The drive `name` of the folder `annotations`."""
        rows = _columns(folder / f"{name}.parquet")
        poses = _columns(folder / f"{name}.poses.parquet")
        time_ns, frame = np.unique(rows["time_ns"], return_inverse=True)
        first_ns = int(time_ns[0])
        pose_s, order = np.unique((poses["time_ns"] - first_ns) / 1e9, return_index=True)
        times_s = np.clip((time_ns - first_ns) / 1e9, pose_s[0], pose_s[-1])
        xyz = _stacked(poses, "tx_m", "ty_m", "tz_m")[order]
        attitude = Rotation.from_quat(_stacked(poses, "qx", "qy", "qz", "qw")[order])
        size_lwh_m = _stacked(rows, "length_m", "width_m", "height_m")
        bottom_m = _stacked(rows, "tx_m", "ty_m", "tz_m")
        bottom_m[:, 2] -= size_lwh_m[:, 2] / 2
        cuboids = Cuboids(
            frame,
            rows["id"].astype(np.int64),
            rows["class"].astype(np.str_),
            bottom_m,
            size_lwh_m,
            2 * np.arctan2(rows["qz"], rows["qw"]),
            rows["points"].astype(np.int64),
        )
        return cls(
            name,
            times_s,
            cuboids,
            np.stack([np.interp(times_s, pose_s, column) for column in xyz.T], axis=1),
            Slerp(pose_s, attitude)(times_s).as_matrix(),
        )

    @property
    def speed_mps(self) -> FloatArray:
        """(T,) speed of the vehicle along its x axis."""
        velocity_mps = self._slopes(self.position_m)
        return np.asarray((velocity_mps * self.rotation[:, :, 0]).sum(axis=1))

    @property
    def yaw_rate_rad_s(self) -> FloatArray:
        """(T,) yaw rate, positive = to the right, as in `EgoMotion`."""
        heading_rad = np.unwrap(np.arctan2(self.rotation[:, 1, 0], self.rotation[:, 0, 0]))
        return np.asarray(-self._slopes(heading_rad[:, None])[:, 0])

    def _slopes(self, values: FloatArray) -> FloatArray:
        """(T, K) slopes per second of the values (T, K) of the frames."""
        one = np.zeros((1, len(values)), np.int64)
        return track_slopes(one, self.times_s, values, half_span_s=_EGO_HALF_SPAN_S, min_side_s=0.0)

    def ground_velocity_mps(self) -> FloatArray:
        """(N, 3) velocities of the cuboids over ground, in the axes of the vehicle; NaN = seen for
        less than half a second.
        """
        cuboids = self.cuboids
        rotation = self.rotation[cuboids.frame]
        world_m = np.einsum("nij,nj->ni", rotation, cuboids.bottom_m)
        world_m += self.position_m[cuboids.frame]
        at_s, key = self.times_s[cuboids.frame], cuboids.track_id[None]
        velocity_mps = track_slopes(key, at_s, world_m, half_span_s=_HALF_SPAN_S, min_side_s=0.0)
        for track_id in np.unique(cuboids.track_id):
            rows = cuboids.track_id == track_id
            if np.ptp(at_s[rows]) < _HALF_SPAN_S:
                velocity_mps[rows] = np.nan
        return np.asarray(np.einsum("nji,nj->ni", rotation, velocity_mps))

    def road_z_m(self, x_m: float, y_m: float) -> float:
        """Height of the road in the axes of the vehicle: the plane through the bottoms of the
        cuboids near it, by a median over frames and an L1 fit.
        """
        bottom_m = self.cuboids.bottom_m[np.isin(self.cuboids.kind, ("REGULAR_VEHICLE", *_TRUCKS))]
        bottom_m = bottom_m[np.hypot(bottom_m[:, 0] - x_m, bottom_m[:, 1] - y_m) < _ROAD_M]
        A = np.column_stack([np.ones(len(bottom_m)), bottom_m[:, 0] - x_m, bottom_m[:, 1] - y_m])
        weight = np.ones(len(A))
        for _ in range(30):  # iteratively reweighted least squares
            plane = np.linalg.lstsq(A * weight[:, None], bottom_m[:, 2] * weight, rcond=None)[0]
            weight = 1 / np.sqrt(np.maximum(np.abs(bottom_m[:, 2] - A @ plane), 0.02))
        return float(plane[0])


def _columns(path: Path) -> dict[str, npt.NDArray[Any]]:
    table = pq.read_table(path)
    return {name: table[name].to_numpy(zero_copy_only=False) for name in table.schema.names}


def _stacked(columns: dict[str, npt.NDArray[Any]], *names: str) -> FloatArray:
    return np.stack([columns[name] for name in names], axis=1).astype(np.float64)
