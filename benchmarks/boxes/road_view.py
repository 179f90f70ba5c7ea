"""RoadView: boxes of a real drive as a camera at any place of the vehicle would see them.

The outline of an object is that of a rounded body inside its cuboid, whose fractions follow from
the boxes of `av2/label_shape` (front camera): edges of cars are reproduced with median differences
of 2 px or less in 1550x2048. An object is hidden by the cuboids in front of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from benchmarks.boxes.cuboid_drive import CLASS_OF_KIND, MIN_POINTS, CuboidDrive, Cuboids
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.mounting import Mounting

MIN_HEIGHT_PX = 25.0  # as in the labels
NEAR_M = 1.5  # depth of the nearest point of a body; a nearer one has no outline
MIN_SEEN = 0.3  # visible share from which a detector finds an object
_N_RAYS = 8  # per side of the grid through a box that measures its visible share
_CUT_PX = 0.5

# (half length, half width, height, exponent of the rounded corners, forward shift) of rings of a
# body, in fractions of the cuboid
_WHEELS = (0.36, 0.49, 0.0, 8.0, 0.0)
_RINGS = {
    "car": (
        _WHEELS,
        (0.492, 0.504, 0.148, 8.2, 0.0),
        (0.492, 0.504, 0.19, 8.2, 0.0),
        (0.225, 0.407, 0.99, 8.2, -0.116),
    ),
    "large": (
        _WHEELS,
        (0.5, 0.505, 0.13, 8.0, 0.0),
        (0.5, 0.505, 0.57, 8.0, 0.0),
        (0.49, 0.5, 0.97, 8.0, 0.0),
    ),
    "person": (
        (0.36, 0.44, 0.0, 8.0, 0.0),
        (0.402, 0.453, 0.95, 26.0, 0.0),
        (0.16, 0.138, 1.0, 26.0, 0.0),
    ),
}
_BODY_OF_CLASS = {"car": "car", "person": "person", "truck": "large", "bus": "large"}


def _body(name: str) -> FloatArray:
    """(M, 3) points of a body in fractions of its cuboid."""
    angle = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    cos, sin = np.cos(angle), np.sin(angle)
    rings = []
    for length, width, height, exponent, shift in _RINGS[name]:
        x, y = (np.sign(value) * np.abs(value) ** (2 / exponent) for value in (cos, sin))
        ring = [shift + length * x, width * y, np.full_like(x, height)]
        rings.append(np.stack(ring, axis=1))
    return np.concatenate(rings)


@dataclass(frozen=True, slots=True)
class ViewRows:
    """The N boxes of a view, by frame."""

    frame: IntArray
    track_id: IntArray
    class_name: npt.NDArray[np.str_]
    xyxy_px: FloatArray  # (N, 4), clipped to the image
    is_cut: npt.NDArray[np.bool_]  # whether the border of the image cuts the object
    visible_share: FloatArray  # of the box, by the cuboids in front
    true_m: FloatArray  # z at which the ray through the middle of the box meets the cuboid
    # (N, 2) velocity over ground in the vehicle's axes, forward and to the left; NaN = unknown
    velocity_mps: FloatArray


@dataclass(frozen=True, slots=True)
class RoadView:
    """A drive as one camera sees it."""

    name: str
    camera: PinholeCamera
    mounting: Mounting  # with the true height above the road
    times_s: FloatArray  # (T,)
    speed_mps: FloatArray  # (T,) of the vehicle
    yaw_rate_rad_s: FloatArray  # (T,) of the vehicle, positive = to the right
    # (T, 2) positions of the camera along its axis, in the road's plane, and to the left of it, both
    # in the first frame
    path_m: FloatArray
    rows: ViewRows

    @property
    def axial_mps(self) -> FloatArray:
        """(T,) speed of the camera along its axis."""
        motion = zip(self.speed_mps.tolist(), self.yaw_rate_rad_s.tolist(), strict=True)
        return np.array([self.mounting.velocity_mps(*of_frame)[2] for of_frame in motion])


def road_view(
    drive: CuboidDrive, camera: PinholeCamera, mounting: Mounting, *, z_m: float
) -> RoadView:
    """The view of a camera, `z_m` above the origin of the vehicle's axes; its height above the road
    is that of the cuboids' bottoms.
    """
    origin_m = np.array([mounting.x_m, mounting.y_m, z_m])
    height_m = z_m - drive.road_z_m(mounting.x_m, mounting.y_m)
    velocity_mps = drive.ground_velocity_mps()[:, :2]
    parts = []
    for frame in range(len(drive.times_s)):
        rows = np.flatnonzero(drive.cuboids.frame == frame)
        part, kept = _frame(drive.cuboids.select(rows), camera, mounting, origin_m)
        parts.append((*part, velocity_mps[rows[kept]]))
    return RoadView(
        drive.name,
        camera,
        replace(mounting, z_m=height_m),
        drive.times_s,
        drive.speed_mps,
        drive.yaw_rate_rad_s,
        _path_m(drive, mounting, origin_m),
        ViewRows(*(np.concatenate(column) for column in zip(*parts, strict=True))),
    )


def _path_m(drive: CuboidDrive, mounting: Mounting, origin_m: FloatArray) -> FloatArray:
    camera_m = drive.position_m + drive.rotation @ origin_m
    moved_m = (camera_m - camera_m[0]) @ drive.rotation[0]
    yaw_rad = np.radians(mounting.yaw_deg)
    along = np.array([[np.cos(yaw_rad), -np.sin(yaw_rad)], [np.sin(yaw_rad), np.cos(yaw_rad)]])
    return np.asarray(moved_m[:, :2] @ along)


def _frame(
    cuboids: Cuboids, camera: PinholeCamera, mounting: Mounting, origin_m: FloatArray
) -> tuple[tuple[npt.NDArray[np.generic], ...], IntArray]:
    """The columns of `ViewRows` but the velocity, of one frame, and the rows of its cuboids."""
    boxes, depth_m = _outlines(cuboids, camera, mounting, origin_m)
    edge = np.array([camera.width_px - 1, camera.height_px - 1] * 2, np.float64)
    inside = np.clip(boxes, 0, edge)
    size_px = inside[:, 2:] - inside[:, :2]
    is_seen = (depth_m > NEAR_M) & (size_px[:, 0] > 2) & (size_px[:, 1] >= MIN_HEIGHT_PX)
    is_scored = np.isin(cuboids.kind, list(CLASS_OF_KIND)) & (cuboids.points >= MIN_POINTS)
    kept = np.flatnonzero(is_seen & is_scored)
    share = np.zeros(len(kept))
    true_m = np.full(len(kept), np.nan)
    to_vehicle = mounting.vehicle_from_camera.T
    for row, index in enumerate(kept.tolist()):
        box = inside[index]
        steps = (np.arange(_N_RAYS) + 0.5) / _N_RAYS
        x_px, y_px = (box[axis] + (box[axis + 2] - box[axis]) * steps for axis in (0, 1))
        grid_px = np.stack(np.meshgrid(x_px, y_px), axis=-1).reshape(-1, 2)
        middle_px = (box[:2] + box[2:])[None] / 2
        rays = camera.rays(np.concatenate([grid_px, middle_px])) @ to_vehicle
        entered = cuboids.entered(origin_m, rays)
        own, is_own = entered[index], np.isfinite(entered[index, :-1])
        others = np.delete(entered, index, axis=0).min(axis=0, initial=np.inf)
        is_first = np.asarray(own <= others)[:-1]
        share[row] = is_first[is_own].mean() if is_own.any() else 0.0
        true_m[row] = own[-1] if np.isfinite(own[-1]) else np.nan
    names = np.array([CLASS_OF_KIND[kind] for kind in cuboids.kind[kept]], np.str_)
    is_cut = np.asarray(np.max(np.abs(boxes - inside), axis=1) > _CUT_PX)
    found = np.flatnonzero(share >= MIN_SEEN)
    columns = (
        *(cuboids.frame[kept], cuboids.track_id[kept], names, inside[kept], is_cut[kept]),
        *(share, true_m),
    )
    return tuple(column[found] for column in columns), kept[found]


def _outlines(
    cuboids: Cuboids, camera: PinholeCamera, mounting: Mounting, origin_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(N, 4) outlines in the image, and (N,) depths of their nearest points."""
    boxes, depth_m = np.zeros((len(cuboids), 4)), np.zeros(len(cuboids))
    names = [_BODY_OF_CLASS.get(CLASS_OF_KIND.get(kind, ""), "large") for kind in cuboids.kind]
    for name in _RINGS:
        rows = np.flatnonzero(np.array(names) == name)
        points_m = cuboids.select(rows).from_body(_body(name)) - origin_m
        points_m = points_m @ mounting.vehicle_from_camera
        depth_m[rows] = points_m[:, :, 2].min(axis=1, initial=np.inf)
        points_m[:, :, 2] = np.maximum(points_m[:, :, 2], 0.1)
        xy_px = camera.project(points_m.reshape(-1, 3)).reshape(*points_m.shape[:2], 2)
        boxes[rows] = np.concatenate([xy_px.min(axis=1), xy_px.max(axis=1)], axis=1)
    return boxes, depth_m
