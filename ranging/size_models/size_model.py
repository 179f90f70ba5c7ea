"""What of a box is measured, free of any camera, and what a model of sizes says of it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Protocol

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.stereo.geometry.camera import PinholeCamera

SIZE_CLASSES = (*ROAD_CLASSES, "van")
"""Index = size class: the road classes, and what has a size of its own but is no road class."""

_IS_SOFT = np.array([name in ("person", "bicycle", "motorcycle") for name in SIZE_CLASSES])

BORDER_PX = 1.5
"""A box this near the image's border is taken as cut off by it: detectors stop a pixel short."""


@dataclass(frozen=True, slots=True)
class BoxNoise:
    """How unsure the edges of boxes are: independent errors with a standard deviation of hypot(px, share size).

    A good detector (RRC on KITTI) misses an edge by half a pixel on a small box, and by 1-2 % of the height of a large
    vehicle, 4 % of a person's: limbs move, and so does what counts as their end.

    Attributes:
        px: what every edge is unsure by.
        relative: share of the box's size, vehicles and things,
        relative_soft: and people, on wheels or not.
    """

    px: float = 0.5
    relative: float = 0.01
    relative_soft: float = 0.04

    def sigma_px(self, size_px: FloatArray, size_class: IntArray) -> FloatArray:
        """(N, 2) standard deviation of the edges of boxes of (N, 2) width and height."""
        share = np.where(_IS_SOFT, self.relative_soft, self.relative)[size_class]
        relative_px = share[:, None] * size_px
        return np.asarray(np.sqrt(self.px**2 + relative_px * relative_px))


@dataclass(frozen=True, slots=True)
class BoxExtents:
    """Boxes of one frame, (N,) each unless said otherwise; all lengths over the focal length.

    Attributes:
        wh_over_f: (N, 2) width and height, positive.
        bearing: tangent of the middle column's angle from the camera's axis.
        bottom: tangent of the bottom edge's angle below the camera's axis.
        size_class: index into `SIZE_CLASSES`.
        uses_width: False = a side is cut off.
        uses_bottom: False = the bottom edge is not where it stands.
        edge_sigma: (N, 2) standard deviation of one edge, in x and in y.
    """

    wh_over_f: FloatArray
    bearing: FloatArray
    bottom: FloatArray
    size_class: IntArray
    uses_width: BoolArray
    uses_bottom: BoolArray
    edge_sigma: FloatArray

    def __len__(self) -> int:
        return len(self.bearing)

    def select(self, keep: BoolArray | IntArray) -> BoxExtents:
        """The rows that a mask or an index array names."""
        return BoxExtents(*(getattr(self, field.name)[keep] for field in fields(self)))

    @property
    def log_variance(self) -> FloatArray:
        """(N, 2) variance of log width and log height: a size is the difference of two edges."""
        return np.asarray(2.0 * (self.edge_sigma / self.wh_over_f) ** 2)


def measured_boxes(
    xyxy_px: FloatArray,
    size_class: IntArray,
    *,
    camera: PinholeCamera,
    noise: BoxNoise,
    uses_width_bottom: tuple[BoolArray, BoolArray] | None = None,
) -> BoxExtents:
    """Boxes (N, 4) of positive size as `camera` (undistorted) sees them; None = all their edges are seen."""
    focal_px = np.array([camera.fx_px, camera.fy_px])
    size_px = xyxy_px[:, 2:] - xyxy_px[:, :2]
    uses_width, uses_bottom = uses_width_bottom or (np.ones(len(xyxy_px), np.bool_), np.ones(len(xyxy_px), np.bool_))
    return BoxExtents(
        wh_over_f=size_px / focal_px,
        bearing=((xyxy_px[:, 0] + xyxy_px[:, 2]) / 2 - camera.cx_px) / camera.fx_px,
        bottom=(xyxy_px[:, 3] - camera.cy_px) / camera.fy_px,
        size_class=size_class,
        uses_width=uses_width,
        uses_bottom=uses_bottom,
        edge_sigma=noise.sigma_px(size_px, size_class) / focal_px,
    )


@dataclass(frozen=True, slots=True)
class SizeRanges:
    """Distances by size, (N,) each, NaN = nothing is known of the class.

    Attributes:
        distance_m: z of the visible surface.
        sigma_m: its standard deviation.
        sigma_systematic_m: systematic part of sigma_m, which the object keeps from frame to frame: it is taller than
            others. The rest, the noise of the box, is new in every frame.
    """

    distance_m: FloatArray
    sigma_m: FloatArray
    sigma_systematic_m: FloatArray


class SizeModel(Protocol):
    """What is known of sizes: curves, or priors over cuboids."""

    def measure(self, boxes: BoxExtents) -> SizeRanges:
        """How far the boxes of one frame are."""
        ...


class StoredSizeModel(SizeModel, Protocol):
    """A size model that can be written to a curve file, see `curve.save_curves`."""

    def document(self) -> dict[str, Any]:
        """Content of the file: "kind", and the model's numbers as JSON."""
        ...
