"""virtual_pinhole: the ideal pinhole to which the images of a wide lens are undistorted.

    f = the lens's own resolution on its axis, pixels per radian
    W = f (tan left + tan right),  H = f (tan up + tan down)

with the angles from the axis that the lens images, up to a limit. Objects on the axis keep their
size in pixels; towards the edges a pinhole stretches the image by 1 / cos^2, which limits a useful
field of view to about 120 degrees. Wider lenses need several virtual pinholes with axes in other
directions.
"""

import math
from typing import NamedTuple

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError

# smallest, and largest (default) horizontal field of view, also in --fov-deg
FOV_LIMITS_DEG = (20.0, 120.0)
# Largest angle above and below the axis that is shown; a road user that is cut there is nearer than
# the hood.
_MAX_HALF_HEIGHT_RAD = math.radians(45.0)
_N_ANGLES = 1201  # number of angles at which the reach of a lens is sampled, 0.05 degrees apart
_MIN_SIDE_PX = 32  # smallest width and height of a virtual pinhole's images
_SMALL_RAD = 1e-5  # angle from the axis at which the resolution on the axis is measured
_N_SAMPLES = 257  # number of pixels along a row or column at which the field of view is sampled


class FieldOfView(NamedTuple):
    """Angles from the optical axis that a camera images along the row and column of its principal
    point, radians.
    """

    left_rad: float
    right_rad: float
    up_rad: float
    down_rad: float

    @property
    def horizontal_deg(self) -> float:
        """Horizontal field of view, degrees."""
        return math.degrees(self.left_rad + self.right_rad)

    @property
    def vertical_deg(self) -> float:
        """Vertical field of view, degrees."""
        return math.degrees(self.up_rad + self.down_rad)


def field_of_view(camera: PinholeCamera) -> FieldOfView:
    """The field of view of a camera's images with their distortion."""
    x = np.linspace(-0.5, camera.width_px - 0.5, _N_SAMPLES)
    y = np.linspace(-0.5, camera.height_px - 0.5, _N_SAMPLES)
    row = camera.recorded_rays(np.stack([x, np.full_like(x, camera.cy_px)], axis=1))
    column = camera.recorded_rays(np.stack([np.full_like(y, camera.cx_px), y], axis=1))
    across, along = np.arctan2(row[:, 0], row[:, 2]), np.arctan2(column[:, 1], column[:, 2])
    limits = -np.nanmin(across), np.nanmax(across), -np.nanmin(along), np.nanmax(along)
    return FieldOfView(*(float(limit) for limit in limits))


def axial_focal_px(camera: PinholeCamera) -> float:
    """Resolution on the optical axis, pixels per radian: the focal length of a pinhole with the
    same resolution.
    """
    if not camera.is_wide:
        return camera.fx_px
    rays = np.array([[_SMALL_RAD, 0.0, 1.0], [0.0, _SMALL_RAD, 1.0]])
    offset_px = camera.recorded_px(rays) - (camera.cx_px, camera.cy_px)
    return math.sqrt(offset_px[0, 0] * offset_px[1, 1]) / _SMALL_RAD


def view_from_camera(yaw_deg: float) -> FloatArray:
    """(3, 3) rotation from a camera's frame to a view whose axis is `yaw_deg` to the right of the
    camera's axis.
    """
    sine, cosine = math.sin(math.radians(yaw_deg)), math.cos(math.radians(yaw_deg))
    return np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]])


def virtual_pinhole(
    camera: PinholeCamera, fov_deg: float | None = None, yaw_deg: float = 0.0
) -> PinholeCamera:
    """The ideal pinhole camera with the resolution of a wide camera on its axis, and an even image
    size.

    `fov_deg` is the horizontal field of view within `FOV_LIMITS_DEG`, None = the view of the lens,
    up to the upper limit; parts that the lens does not image on one side are left out. `yaw_deg` is
    the direction of the pinhole's axis, to the right of the camera's axis. Raises RigError if the
    lens images hardly anything there.
    """
    half_rad = math.radians(FOV_LIMITS_DEG[1] if fov_deg is None else fov_deg) / 2
    focal_px = axial_focal_px(camera)
    left_px, right_px, up_px, down_px = (
        focal_px * math.tan(_reach_rad(camera, yaw_deg, across, limit_rad))
        for across, limit_rad in (
            ((-1.0, 0.0), half_rad),
            ((1.0, 0.0), half_rad),
            ((0.0, -1.0), _MAX_HALF_HEIGHT_RAD),
            ((0.0, 1.0), _MAX_HALF_HEIGHT_RAD),
        )
    )
    width_px, height_px = (
        2 * round(side_px / 2) for side_px in (left_px + right_px, up_px + down_px)
    )
    if min(width_px, height_px) < _MIN_SIDE_PX:
        raise RigError(
            f"--yaw-deg {yaw_deg:g}: expected a direction that the lens sees, found only "
            f"{width_px}x{height_px} px in view; choose one nearer to the middle of the image."
        )
    return PinholeCamera(focal_px, focal_px, left_px - 0.5, up_px - 0.5, width_px, height_px)


def _reach_rad(
    camera: PinholeCamera, yaw_deg: float, across: tuple[float, float], limit_rad: float
) -> float:
    """Largest angle from a view's axis up to which the camera images all directions of one half row
    or column.

    `across` is the direction (x, y) of the half row or column in the view, of length 1; `limit_rad`
    the largest result.
    """
    angles = np.linspace(0.0, limit_rad, _N_ANGLES)
    rays = np.stack(
        [np.sin(angles) * across[0], np.sin(angles) * across[1], np.cos(angles)], axis=1
    )
    x, y = camera.recorded_px(rays @ view_from_camera(yaw_deg)).T
    is_imaged = (
        (x >= -0.5) & (x <= camera.width_px - 0.5) & (y >= -0.5) & (y <= camera.height_px - 0.5)
    )
    return float(angles[max(int(np.append(~is_imaged, True).argmax()) - 1, 0)])
