"""PinholeCamera: u = fx X / Z + cx, v = fy Y / Z + cy, with a lens distortion.

The distortion is OpenCV's (k1 k2 p1 p2 k3 ...), or the distortion of a wide lens (`stereo.lenses`), which
images angles up to and beyond 90 degrees from the optical axis. Images are undistorted before
anything is measured; images of a wide lens are resampled to the virtual pinhole of
`virtual_pinhole.py`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray
from track_range.stereo.lenses.lens import PINHOLE
from track_range.stereo.lenses.registry import LENSES

# relative difference of fx and fy up to which pixels are used as they are; lenses differ by 0.01
_SQUARE = 0.03


# Sizes of recorders that leave out every other column (720N, 1080N, 4M-N, 5M-N, 4K-N); no sensor
# has them.
_HALVED_PX = {(640, 720), (960, 1080), (1280, 1440), (1296, 1944), (1920, 2160)}


def pixel_aspect_of(size_px: tuple[int, int], stated: float | None) -> float:
    """Width / height of the pixels of recorded images, from the value in their file (None = none)
    and their size.
    """
    return 2.0 if stated in (None, 1.0) and size_px in _HALVED_PX else stated or 1.0


def square_size(size_px: tuple[int, int], pixel_aspect: float) -> tuple[int, int]:
    """(width, height) after resampling images with pixels `pixel_aspect` times as wide as high to
    square pixels.
    """
    width_px, height_px = size_px
    return round(width_px * max(pixel_aspect, 1.0)), round(height_px * max(1.0 / pixel_aspect, 1.0))


def shown_size(size_px: tuple[int, int], pixel_aspect: float) -> tuple[int, int]:
    """(width, height) of recorded images after reading: those of `square_size`, or unchanged if
    their pixels are almost square.
    """
    return PinholeCamera.of_pixel_aspect(1.0, size_px, pixel_aspect).squared().size_px


@dataclass(frozen=True, slots=True)
class PinholeCamera:
    """One calibrated camera: axes x right, y down, z forward; pixel centres at integer coordinates.

    Example:
        >>> import numpy as np, track_range as tr
        >>> camera = tr.PinholeCamera(700.0, 700.0, 320.0, 180.0, width_px=640, height_px=360)
        >>> camera.project(np.array([[1.0, 0.0, 10.0]])).tolist()
        [[390.0, 180.0]]
    """

    fx_px: float  # focal length in units of the pixel width
    fy_px: float  # focal length in units of the pixel height
    cx_px: float  # principal point, x
    cy_px: float  # principal point, y
    width_px: int  # image width
    height_px: int  # image height
    # coefficients of the lens model; of a pinhole OpenCV's (4, 5, 8, 12 or 14 of them); empty =
    # none
    distortion: tuple[float, ...] = ()
    lens: str = PINHOLE  # name of the lens model, one of `LENSES`

    @classmethod
    def of_focal_length(cls, focal_px: float, size_px: tuple[int, int]) -> PinholeCamera:
        """A camera with square pixels and its principal point at the image centre; `size_px` is
        (width, height).
        """
        width_px, height_px = size_px
        return cls(focal_px, focal_px, (width_px - 1) / 2, (height_px - 1) / 2, width_px, height_px)

    @classmethod
    def of_pixel_aspect(
        cls, focal_px: float, size_px: tuple[int, int], pixel_aspect: float
    ) -> PinholeCamera:
        """A camera of recorded images, whose pixels are `pixel_aspect` times as wide as high.

        Its principal point is at the image centre; `size_px` is (width, height), and `focal_px`
        is in pixels of images with square pixels, see `square_size`.
        """
        square = cls.of_focal_length(focal_px, square_size(size_px, pixel_aspect))
        return square.resized(size_px)

    @classmethod
    def of_matrix(
        cls,
        k: npt.ArrayLike,
        size_px: tuple[int, int],
        distortion: Iterable[float] = (),
        lens: str = PINHOLE,
    ) -> PinholeCamera:
        """The camera with a matrix K (3, 3), or (3, 4) as in a projection; `size_px` is (width,
        height).
        """
        (fx_px, _, cx_px), (_, fy_px, cy_px) = np.asarray(k, np.float64)[:2, :3].tolist()
        return cls(fx_px, fy_px, cx_px, cy_px, *size_px, tuple(map(float, distortion)), lens)

    @property
    def matrix(self) -> FloatArray:
        """(3, 3) camera matrix K."""
        return np.array(
            [[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]]
        )

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height) of the images."""
        return self.width_px, self.height_px

    @property
    def is_distorted(self) -> bool:
        """Whether the images differ from images of an ideal pinhole."""
        return self.is_wide or any(coefficient != 0.0 for coefficient in self.distortion)

    @property
    def is_wide(self) -> bool:
        """Whether the lens model covers fields of view up to and beyond 180 degrees."""
        return LENSES.named(self.lens).is_wide

    def without_distortion(self) -> PinholeCamera:
        """The ideal pinhole with the same matrix: the camera of undistorted images, except of a
        wide lens.
        """
        return replace(self, distortion=(), lens=PINHOLE)

    def resized(self, size_px: tuple[int, int]) -> PinholeCamera:
        """The camera of its images after they are resized to `size_px` = (width, height): pixel
        edges map to edges.
        """
        if size_px == self.size_px:
            return self
        scale_x, scale_y = size_px[0] / self.width_px, size_px[1] / self.height_px
        return replace(
            self,
            fx_px=self.fx_px * scale_x,
            fy_px=self.fy_px * scale_y,
            cx_px=(self.cx_px + 0.5) * scale_x - 0.5,
            cy_px=(self.cy_px + 0.5) * scale_y - 0.5,
            width_px=size_px[0],
            height_px=size_px[1],
        )

    def with_focal_length(self, focal_px: float) -> PinholeCamera:
        """The camera with another focal length, that of its finer axis; the shape of its pixels
        remains.
        """
        own_px = max(self.fx_px, self.fy_px)
        return replace(
            self,
            fx_px=focal_px * (self.fx_px / own_px),
            fy_px=focal_px * (self.fy_px / own_px),
        )

    @property
    def has_square_pixels(self) -> bool:
        """Whether the focal lengths in x and y are about equal; other images are resampled before
        anything else. Almost square pixels stay as they are, with two focal lengths.
        """
        return abs(self.fy_px / self.fx_px - 1.0) <= _SQUARE

    def squared(self) -> PinholeCamera:
        """The ideal pinhole with square pixels, for images whose coarser axis is enlarged."""
        if self.has_square_pixels:
            return self.without_distortion()
        resized = self.without_distortion().resized(
            square_size(self.size_px, self.fy_px / self.fx_px)
        )
        focal_px = max(self.fx_px, self.fy_px)
        return replace(resized, fx_px=focal_px, fy_px=focal_px)

    def recorded_rays(self, xy_px: FloatArray) -> FloatArray:
        """(N, 3) unit direction of each pixel (N, 2) of the images with distortion; NaN outside the
        image circle.
        """
        normalised = (xy_px - (self.cx_px, self.cy_px)) / (self.fx_px, self.fy_px)
        return LENSES.named(self.lens).undistort(normalised, self.distortion)

    def recorded_px(self, xyz_m: FloatArray) -> FloatArray:
        """(N, 2) pixels of the images with distortion of points (N, 3) in the camera's frame; NaN
        where not imaged.
        """
        normalised = LENSES.named(self.lens).distort(xyz_m, self.distortion)
        return np.asarray(normalised * (self.fx_px, self.fy_px) + (self.cx_px, self.cy_px))

    def rays(self, xy_px: FloatArray) -> FloatArray:
        """(N, 3) ray of each undistorted pixel (N, 2), scaled to z = 1: a ray times z in metres is
        a point.
        """
        rays = np.ones((len(xy_px), 3))
        rays[:, 0] = (xy_px[:, 0] - self.cx_px) / self.fx_px
        rays[:, 1] = (xy_px[:, 1] - self.cy_px) / self.fy_px
        return rays

    def project(self, xyz_m: FloatArray) -> FloatArray:
        """(N, 2) undistorted pixels of points (N, 3) in the camera's frame; NaN for points behind
        the camera.
        """
        z = np.where(xyz_m[:, 2] > 0, xyz_m[:, 2], np.nan)
        return np.stack(
            [self.fx_px * xyz_m[:, 0] / z + self.cx_px, self.fy_px * xyz_m[:, 1] / z + self.cy_px],
            axis=1,
        )
