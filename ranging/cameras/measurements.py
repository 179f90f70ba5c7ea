"""Measurements from which a camera without a calibration is fitted: known metres and
boxes of a video.

Pixels are pixels of the video, with the principal point at the image centre and without lens
distortion. A known distance is the project's `distance_m`: the depth z, along the camera's axis, of
the surface in which the ray through the centre of the box meets the object. For an object straight
ahead, this is the distance from the lens to the object's nearest surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray, check_shape
from track_range.ranging.size_models.size_model import BORDER_PX, BoxNoise

# largest fraction of a box inside a nearer one for which it counts as not hidden
_MAX_COVERED = 0.03


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownObject:
    """One object with metres known from a tape measure or a data sheet; NaN = unknown."""

    name: str  # the measurement in the user's words, for the table of residuals
    xyxy_px: tuple[float, float, float, float]  # (4,) box
    size_class: int  # index into `SIZE_CLASSES`
    distance_m: float = np.nan  # depth of its visible surface
    height_m: float = np.nan  # height above the road
    width_m: float = np.nan  # width of the side that faces the camera
    relative_sigma: float = 0.01  # relative standard deviation of the metres


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownLane:
    """A lane, or any other stretch across the road, of known width."""

    name: str  # the measurement in the user's words
    x1_px: float  # column of its left end
    x2_px: float  # column of its right end
    y_px: float  # row of both ends
    width_m: float  # distance between the ends
    relative_sigma: float = 0.02  # relative standard deviation of `width_m`
    time_s: float = 0.0  # time of the frame, in seconds from the first one


@dataclass(frozen=True, slots=True)
class SceneBoxes:
    """Boxes of road users in frames of a video, one row per box."""

    xyxy_px: FloatArray = field(default_factory=lambda: np.zeros((0, 4)))  # (N, 4) boxes
    # (N,) index into `SIZE_CLASSES`
    size_class: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    # (N,) identity of the object
    track_id: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))

    def __post_init__(self) -> None:
        n = len(self.track_id)
        check_shape("xyxy_px", self.xyxy_px, (n, 4))
        check_shape("size_class", self.size_class, (n,))

    def __len__(self) -> int:
        return len(self.track_id)

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """All boxes of several sets."""
        if not parts:
            return cls()
        return cls(
            np.concatenate([part.xyxy_px for part in parts]),
            np.concatenate([part.size_class for part in parts]),
            np.concatenate([part.track_id for part in parts]),
        )

    def select(self, rows: BoolArray | IntArray) -> SceneBoxes:
        """The boxes selected by a mask or an index array."""
        return SceneBoxes(self.xyxy_px[rows], self.size_class[rows], self.track_id[rows])

    def are_whole(self, size_px: tuple[int, int], *, min_height_px: float) -> BoolArray:
        """(N,) whether boxes do not touch the border of images of `size_px` (width, height), and
        are high enough.
        """
        x1, y1, x2, y2 = self.xyxy_px.T
        is_inside = (x1 >= BORDER_PX) & (y1 >= BORDER_PX) & (x2 <= size_px[0] - 1 - BORDER_PX)
        return np.asarray(
            is_inside & (y2 <= size_px[1] - 1 - BORDER_PX) & (y2 - y1 >= min_height_px)
        )

    @property
    def views(self) -> FloatArray:
        """(N,) number of boxes of the same track."""
        _, index, count = np.unique(self.track_id, return_inverse=True, return_counts=True)
        return np.asarray(count[index], np.float64)


@dataclass(frozen=True, slots=True)
class HorizonRow:
    """Row of the horizon in the middle column, from lane lines or the direction of travel."""

    y_px: float
    sigma_px: float  # its standard deviation
    source: str  # where it comes from


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraMeasurements:
    """Everything that is measured in images of one camera."""

    objects: Sequence[KnownObject] = ()
    lanes: Sequence[KnownLane] = ()
    horizon: Sequence[HorizonRow] = ()
    scene: SceneBoxes = field(default_factory=SceneBoxes)  # boxes of other road users
    # standard deviation of the edges of these boxes as a fraction of their size
    scene_noise: float = BoxNoise().relative


def unhidden(xyxy_px: FloatArray) -> BoolArray:
    """(N,) whether no other box of the same frame, with a lower bottom edge and so nearer, covers a
    part of a box.
    """
    x1, y1, x2, y2 = xyxy_px.T
    width = np.minimum(x2[:, None], x2) - np.maximum(x1[:, None], x1)
    height = np.minimum(y2[:, None], y2) - np.maximum(y1[:, None], y1)
    covered = (
        np.maximum(width, 0.0) * np.maximum(height, 0.0)
        > _MAX_COVERED * ((x2 - x1) * (y2 - y1))[:, None]
    )
    return np.asarray(~(covered & (y2 > y2[:, None])).any(axis=1))
