r"""RoadPlane: the plane of the road before a camera that stands still, in metres, and what is not known of it.

The frame of the plane is right-handed, z up, z = 0 on the road. theta has nine unknowns:

    theta = (log f, cx, cy, pitch, roll, log h, yaw, x, y)     f, cx, cy: pinhole with square pixels; h: height;
                                                               pitch (down), roll (right side lower) and yaw (to the
                                                               left) as in `Mounting`; x, y: the camera's place

    ray d = R (u, 1)      point = c + s d,  s = -h / d_z      R = Rz(yaw) Ry(pitch) Rx(roll) L,  c = (x, y, h)

Errors of theta change all positions and speeds of a recording together: they do not average out. Members k = 1..9 of
the family are theta + sigma_k e_k along the axes of the covariance, so that the variance of anything that follows from
theta is the sum of its squared differences over the members.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.ranging.world.ego_path import EgoPose
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.mounting import Mounting

THETA = (
    "log_focal",
    "cx_px",
    "cy_px",
    "pitch_rad",
    "roll_rad",
    "log_height",
    "yaw_rad",
    "x_m",
    "y_m",
)
LOG_F, CX, CY, PITCH, ROLL, LOG_H, YAW, X, Y = range(len(THETA))
_LEVEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
# smallest fall of a ray per length: 0.2 degrees below the horizon
_MIN_FALL = 0.0035


@dataclass(frozen=True, slots=True)
class PlaneViews:
    """K pinholes above the plane, of parameters (K, 9)."""

    theta: FloatArray  # (K, 9)
    rotation: FloatArray  # (K, 3, 3) from the camera's axes to those of the plane
    focal_px: FloatArray  # (K,)
    height_m: FloatArray  # (K,)

    @classmethod
    def of(cls, theta: FloatArray) -> PlaneViews:
        """The views of parameters (K, 9)."""
        (cp, cr, cy), (sp, sr, sy) = (f(theta[:, [PITCH, ROLL, YAW]].T) for f in (np.cos, np.sin))
        zero, one = np.zeros_like(cp), np.ones_like(cp)
        turn = np.array([[cy, -sy, zero], [sy, cy, zero], [zero, zero, one]])
        nod = np.array([[cp, zero, sp], [zero, one, zero], [-sp, zero, cp]])
        tilt = np.array([[one, zero, zero], [zero, cr, -sr], [zero, sr, cr]])
        turn, nod, tilt = (matrix.transpose(2, 0, 1) for matrix in (turn, nod, tilt))
        focal_px, height_m = np.exp(theta[:, LOG_F]), np.exp(theta[:, LOG_H])
        return cls(theta, turn @ nod @ tilt @ _LEVEL, focal_px, height_m)

    def on_road_m(self, xy_px: FloatArray) -> FloatArray:
        """(K, N, 2) points of the road at pixels (N, 2), or (K, N, 2); NaN at and above the
        horizon.
        """
        xy = (xy_px - self.theta[:, None, [CX, CY]]) / self.focal_px[:, None, None]
        rays = np.concatenate([xy, np.ones((*xy.shape[:2], 1))], axis=2)
        rays = rays @ self.rotation.transpose(0, 2, 1)
        fall = -rays[:, :, 2] / np.linalg.norm(rays, axis=2)
        length = np.where(fall > _MIN_FALL, -self.height_m[:, None] / rays[:, :, 2], np.nan)
        return np.asarray(self.theta[:, None, [X, Y]] + length[:, :, None] * rays[:, :, :2])

    def pixels(self, xyz_m: FloatArray) -> FloatArray:
        """(K, N, 2) pixels of points (N, 3) of the frame of the plane; NaN behind the camera."""
        place = np.concatenate([self.theta[:, [X, Y]], self.height_m[:, None]], axis=1)
        in_camera = (xyz_m - place[:, None]) @ self.rotation
        depth = np.where(in_camera[:, :, 2] > 0.1, in_camera[:, :, 2], np.nan)[:, :, None]
        centre = self.theta[:, None, [CX, CY]]
        return np.asarray(centre + self.focal_px[:, None, None] * in_camera[:, :, :2] / depth)


@dataclass(frozen=True, slots=True)
class PlaneResidual:
    """Difference of one measurement from the fitted plane."""

    name: str  # the measurement as given
    value: float  # measured minus fitted, in `unit`
    sigma: float  # its standard deviation
    unit: str  # "m", "px" or "deg"


@dataclass(frozen=True, slots=True)
class RoadPlane:
    """The plane of the road in the undistorted images of one camera that stands still.

    Example:
        >>> import numpy as np, track_range as tr
        >>> camera = tr.PinholeCamera.of_focal_length(1000.0, (1280, 720))
        >>> plane = tr.RoadPlane.of_mounting(camera, tr.Mounting(pitch_deg=20.0, z_m=6.0))
        >>> plane.on_road_m(np.array([[639.5, 359.5]])).round(1).tolist()  # 6 m / tan(20 degrees)
        [[16.5, 0.0]]
    """

    theta: FloatArray  # (9,) see above
    covariance: FloatArray  # (9, 9)
    size_px: tuple[int, int]  # (width, height) of the images
    source: str  # what it was fitted to, in words
    is_mirrored: bool = False  # whether y was given to the right: it is counted to the left here
    residuals: tuple[PlaneResidual, ...] = ()
    view: PlaneViews = field(init=False, repr=False, compare=False)  # one view, of theta
    family: PlaneViews = field(init=False, repr=False, compare=False)  # nine views, see above

    def __post_init__(self) -> None:
        variance, axes = np.linalg.eigh(self.covariance)
        members = self.theta + np.sqrt(np.maximum(variance, 0.0))[:, None] * axes.T
        object.__setattr__(self, "view", PlaneViews.of(self.theta[None]))
        object.__setattr__(self, "family", PlaneViews.of(members))

    @classmethod
    def of_mounting(
        cls, camera: PinholeCamera, mounting: Mounting, focal_sigma: float = 0.01
    ) -> RoadPlane:
        """The plane below a camera of known height and angles, with the origin below the camera and
        x along its axis; ValueError without a height or a pitch.
        """
        if mounting.z_m is None or mounting.pitch_deg <= 0:
            raise ValueError("expected the height z and the pitch (down) of the camera")
        angle = math.radians(mounting.sigma_deg)
        pitch, roll = math.radians(mounting.pitch_deg), math.radians(mounting.roll_deg)
        centre = camera.cx_px, camera.cy_px
        theta = [math.log(camera.fx_px), *centre, pitch, roll, math.log(mounting.z_m), 0, 0, 0]
        sigma = np.array([focal_sigma, 0, 0, angle, angle, HEIGHT_SIGMA, 0, 0, 0])
        return cls(
            np.array(theta), np.diag(sigma**2), camera.size_px, "height and angles (--mount)"
        )

    @property
    def pose(self) -> EgoPose:
        """The pose of the camera in the frame of the plane, in which errors of the plane count as
        those of positions.
        """
        x_m, y_m, yaw = self.theta[[X, Y, YAW]].tolist()
        return EgoPose(x_m, y_m, yaw, np.zeros((3, 3)))

    def summary(self) -> dict[str, float]:
        """Focal length, height and angles of the camera, and their standard deviations."""
        sigma = np.sqrt(np.diag(self.covariance))
        focal_px, height_m = float(self.view.focal_px[0]), float(self.view.height_m[0])
        values = {
            "focal_px": focal_px,
            "focal_sigma_px": focal_px * sigma[LOG_F],
            "height_m": height_m,
            "height_sigma_m": height_m * sigma[LOG_H],
        }
        for name, at in (("pitch", PITCH), ("roll", ROLL)):
            values[f"{name}_deg"] = math.degrees(self.theta[at])
            values[f"{name}_sigma_deg"] = math.degrees(sigma[at])
        return {name: round(float(value), 3) for name, value in values.items()}

    @property
    def camera(self) -> PinholeCamera:
        """The pinhole of the images."""
        cx_px, cy_px = self.theta[[CX, CY]].tolist()
        focal_px = float(self.view.focal_px[0])
        return PinholeCamera(focal_px, focal_px, cx_px, cy_px, *self.size_px)

    def on_road_m(self, xy_px: FloatArray) -> FloatArray:
        """(N, 2) x and y in metres of the road at pixels (N, 2); NaN at and above the horizon."""
        return np.asarray(self.view.on_road_m(xy_px)[0])

    def pixels(self, xyz_m: FloatArray) -> FloatArray:
        """(N, 2) pixels of points (N, 3); NaN behind the camera."""
        return np.asarray(self.view.pixels(xyz_m)[0])

    def shared_covariance(
        self, xy_m: FloatArray, velocity_mps: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """(N, 2, 2) covariances of positions and of velocities (N, 2) by the errors of the plane,
        which all measurements share.
        """
        zero = np.zeros((len(xy_m), 1))
        now, later = (
            self.pixels(np.concatenate([at_m, zero], axis=1))
            for at_m in (xy_m, xy_m + _STEP_S * velocity_mps)
        )
        at_m, moved_m = self.family.on_road_m(now), self.family.on_road_m(later)
        speed = np.nan_to_num((moved_m - at_m) / _STEP_S - velocity_mps)
        place = np.nan_to_num(at_m - xy_m)
        return tuple(np.einsum("kni,knj->nij", one, one) for one in (place, speed))

    def scale_sigma(self, xy_px: FloatArray) -> tuple[float, float]:
        """Relative standard deviations of lengths on the road along and across the view, in the
        middle of pixels (N, 2).
        """
        middle_m = np.nanmean(self.on_road_m(xy_px), axis=0)
        along = middle_m - self.theta[[X, Y]]
        along = along / max(float(np.linalg.norm(along)), 1e-9)
        axes = np.array([along, [-along[1], along[0]]])
        _, covariance = self.shared_covariance(np.array([middle_m] * 2), axes)
        variances = np.einsum("ni,nij,nj->n", axes, covariance, axes)
        first, second = np.sqrt(variances).tolist()
        return first, second


_STEP_S = 0.2  # of the numerical derivative of positions
HEIGHT_SIGMA = 0.02  # relative standard deviation of a measured height of the camera
