"""RadialLens: the few numbers of a lens that a drive can show, and their derivatives.

    m = s (x, y),   u = f m_x + cx,   v = f m_y + cy     (x, y, z): direction, camera frame

    pinhole       s = (1 + k1 rho + k2 rho^2) / z,            rho = (x^2 + y^2) / z^2
    equidistant   s = theta (1 + k1 theta^2 + k2 theta^4) / r,   r = |(x, y)|,  theta = atan2(r, z)

(Brown 1966 as in OpenCV; Kannala and Brandt 2006, equation 6.) Pixels are square.
"""

from dataclasses import dataclass, replace
from typing import Literal, Self

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.lenses.kannala_brandt import distorted_angle

Family = Literal["pinhole", "equidistant"]
# the shared parameters of a bundle, by their numbers
LOG_FOCAL, K1, K2, CX, CY, READOUT = range(6)
N_PARAMETERS = 6
# smallest depth ahead, and distance from the axis at which s has a derivative, for |q| = 1
_MIN_Z, _MIN_RADIUS = 1e-3, 1e-4
# largest angle from the axis of an image with straight lines
_MAX_ANGLE_RAD = 1.2


@dataclass(frozen=True, slots=True)
class RadialLens:
    """A lens; `parameters` (6,) are log f (px), k1, k2, the principal point from the image centre
    (px), and the time in which the rows of an image are read out (s).
    """

    parameters: FloatArray
    centre_px: FloatArray  # (2,) centre of the image
    family: Family = "pinhole"

    @classmethod
    def of_focal_length(
        cls, focal_px: float, size_px: tuple[int, int], family: Family = "pinhole"
    ) -> Self:
        """The lens without distortion and with its principal point at the centre of the image."""
        parameters = np.array([np.log(focal_px), 0.0, 0.0, 0.0, 0.0, 0.0])
        return cls(parameters, (np.array(size_px) - 1) / 2, family)

    @property
    def focal_px(self) -> float:
        """Focal length."""
        return float(np.exp(self.parameters[LOG_FOCAL]))

    def moved(self, step: FloatArray) -> Self:
        """The lens after a step (6,) of its parameters."""
        return replace(self, parameters=self.parameters + step)

    def directions(self, xy_px: FloatArray) -> FloatArray:
        """(N, 3) unit directions of pixels (N, 2), to first order in the distortion."""
        _, k1, k2, cx, cy, _ = self.parameters
        m = (xy_px - self.centre_px - (cx, cy)) / self.focal_px
        radius = np.hypot(m[:, 0], m[:, 1])
        undistorted = radius / (1 + k1 * radius**2 + k2 * radius**4)
        if self.family == "pinhole":
            undistorted = np.arctan(undistorted)
        across = m * (np.sin(undistorted) / np.maximum(radius, 1e-12))[:, None]
        return np.column_stack([across, np.cos(undistorted)])

    def opencv_distortion(self) -> tuple[float, ...]:
        """OpenCV's (k1, k2, p1, p2[, k3 .. k6]) with the same focal length, up to the corners of the
        image.

        No polynomial is an equidistant lens: with k1, k2 and k3 the edges of a lens of 110 degrees are
        off by 2 to 3 px, the corners by 10 px. Two terms above and two below the fraction, by least
        squares, are within 0.1 px.
        """
        _, k1, k2, *_ = self.parameters.tolist()
        if self.family == "pinhole":
            return k1, k2, 0.0, 0.0
        corner = float(np.hypot(*self.centre_px)) / self.focal_px
        angle = np.linspace(0.0, _MAX_ANGLE_RAD, 200)[1:]
        m = distorted_angle(angle, (k1, k2, 0.0, 0.0))
        r, m = np.tan(angle[m < corner]), m[m < corner]
        powers = np.stack([r**3, r**5, -m * r**2, -m * r**4], axis=1)
        above1, above2, below1, below2 = np.linalg.lstsq(powers, m - r, rcond=None)[0].tolist()
        return above1, above2, 0.0, 0.0, 0.0, below1, below2, 0.0

    def project(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Pixels (N, 2) of points (N, 3), and their derivatives by the points (N, 2, 3) and by the
        parameters (N, 2, 6); the readout is that of `SceneBundle`.

        Points that the lens does not image have NaN.
        """
        scale, by_q, by_k = self._pinhole(q) if self.family == "pinhole" else self._angular(q)
        f, xy = self.focal_px, q[:, :2]
        from_centre = f * scale[:, None] * xy
        point_slope = f * xy[:, :, None] * by_q[:, None, :]
        point_slope[:, 0, 0] += f * scale
        point_slope[:, 1, 1] += f * scale
        slope = np.zeros((len(q), 2, N_PARAMETERS))
        slope[:, :, LOG_FOCAL] = from_centre
        slope[:, :, K1 : K2 + 1] = f * xy[:, :, None] * by_k[:, None, :]
        slope[:, 0, CX] = slope[:, 1, CY] = 1.0
        return from_centre + self.centre_px + self.parameters[CX : CY + 1], point_slope, slope

    def _pinhole(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(N,) s, (N, 3) its derivatives by q, and (N, 2) by k1 and k2."""
        _, k1, k2, *_ = self.parameters
        inverse_z = 1.0 / np.where(q[:, 2] > _MIN_Z, q[:, 2], np.nan)
        x, y = q[:, 0] * inverse_z, q[:, 1] * inverse_z
        rho = x**2 + y**2
        growth = 1 + (k1 + k2 * rho) * rho
        by_rho = k1 + 2 * k2 * rho
        by_q = np.stack([2 * x * by_rho, 2 * y * by_rho, -growth - 2 * rho * by_rho], axis=1)
        by_k = np.stack([rho, rho**2], axis=1) * inverse_z[:, None]
        return growth * inverse_z, by_q * inverse_z[:, None] ** 2, by_k

    def _angular(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """As `_pinhole`, of the equidistant lens."""
        _, k1, k2, *_ = self.parameters
        x, y, z = q.T
        r = np.maximum(np.hypot(x, y), _MIN_RADIUS)
        theta = np.arctan2(r, z)
        squared = theta**2
        angle = distorted_angle(theta, (k1, k2, 0.0, 0.0))
        by_theta = 1 + squared * (3 * k1 + squared * 5 * k2)
        length2 = r**2 + z**2
        by_r = (by_theta * z / length2 - angle / r) / r
        by_q = np.stack([by_r * x / r, by_r * y / r, -by_theta / length2], axis=1)
        by_k = np.stack([theta**3, theta**5], axis=1) / r[:, None]
        return angle / r, by_q, by_k
