"""Fields of view of cameras by model, as their makers or calibrations of others state them.

A field of view of a wide lens does not determine the focal length f at the image centre, since it depends on the
projection. With half the image width r and half the field of view w, a lens without distortion has r = f tan w, and a
fisheye r = f w. Wide lenses of dashcams are between the two; r = 2 f tan(w / 2) (stereographic) is used, with a sigma
that covers both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

_WIDE_DEG = 80.0  # field of view above which a lens counts as wide

_SIGMA, _WIDE_SIGMA = 0.05, 0.15
"""Relative standard deviation of a focal length from a stated field of view: stabilisation and modes crop the image;
the projection of wide lenses is unknown."""

_MEASURED_SIGMA = 0.02  # relative standard deviation of a focal length in px that was measured


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownCamera:
    """One camera model; a field of view or a focal length is known.

    Attributes:
        name: maker and model, also as the option takes it.
        tags: texts in the metadata of its videos that identify it, in lower case.
        field_deg: stated horizontal field of view; NaN = `focal_per_width` is known.
        focal_per_width: measured focal length divided by the image width.
        source: where the value is published.
    """

    name: str
    tags: tuple[str, ...] = ()
    field_deg: float = math.nan
    focal_per_width: float = math.nan
    source: str

    def focal_px(self, width_px: int) -> float:
        """Focal length at the image centre in images of this width."""
        if math.isfinite(self.focal_per_width):
            return self.focal_per_width * width_px
        half = math.radians(self.field_deg) / 2
        tangent = 2 * math.tan(half / 2) if self.is_wide else math.tan(half)
        return width_px / 2 / tangent

    @property
    def is_wide(self) -> bool:
        """Whether the projection of the lens matters."""
        return math.isfinite(self.field_deg) and self.field_deg > _WIDE_DEG

    @property
    def sigma(self) -> float:
        """Relative standard deviation of the focal length."""
        return _MEASURED_SIGMA if math.isfinite(self.focal_per_width) else _WIDE_SIGMA if self.is_wide else _SIGMA


_OPENPILOT = "openpilot, common/transformations/camera.py"

KNOWN_CAMERAS: tuple[KnownCamera, ...] = (
    KnownCamera(name="comma EON", focal_per_width=910.0 / 1164, source=_OPENPILOT),
    KnownCamera(name="comma three", focal_per_width=2648.0 / 1928, source=_OPENPILOT),
    KnownCamera(
        name="GoPro HERO9 Black wide",
        tags=("hd9.",),
        focal_per_width=869.96 / 1920,
        source="calibration of 1920x1080 at 60 fps, Wide, by urbste/OpenImuCameraCalibrator, Readme.md",
    ),
    KnownCamera(
        name="GoPro HERO3 Black wide",
        tags=("hd3.",),
        field_deg=121.0,
        source="measured by R. Cunniff, racunniff.blogspot.com, December 2012",
    ),
)
"""The known cameras; the mode of a camera with several fields of view is part of its name."""


def camera_named(name: str) -> KnownCamera | None:
    """The camera with this name, regardless of case and spaces; None = unknown."""
    plain = "".join(name.lower().split())
    return next((camera for camera in KNOWN_CAMERAS if "".join(camera.name.lower().split()) == plain), None)
