"""GivenLens: the focal length from what a user knows of a lens: the camera's model, or the field
of view on its box.

A field of view of a wide lens does not determine the focal length f at the image centre, since it
depends on the projection. With half of a side of the image r and half of the field of view w across
it, a lens without distortion has r = f tan w, and a fisheye r = f w. Wide lenses of dashcams are
between the two, like r = 2 f tan(w / 2) (stereographic). Up to 75 degrees across the width a lens
is taken to have no distortion, from 115 degrees on to be stereographic; between the two it is either,
and sigma covers both. Boxes state wider fields than images have: seven cameras of `KNOWN_CAMERAS`
with 145 to 170 degrees on their boxes have the focal lengths of stereographic lenses of 99 to 150
degrees. A wider field than 125 degrees across the diagonal is taken as 125, which is within 17 % of
theirs (rms).
"""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple, Self

from track_range.foundation.errors import UsageError
from track_range.foundation.files.input_files import quoted
from track_range.stereo.geometry.focal_guess import FocalGuess

# relative standard deviation of a focal length from the field of view of a wide lens
_WIDE_SIGMA = 0.15
# of one without distortion, from rounded degrees, of a sensor of which a video may show a part
_STRAIGHT_SIGMA = 0.08
_MEASURED_SIGMA = 0.02  # relative standard deviation of a focal length in px that was measured
# that of one of users of the model, of which another unit, a mode or the stabilisation may differ
_SHARED_SIGMA = 0.05
# field of view across the width up to which lenses have no distortion, and from which on they are
# stereographic; assumed
_STRAIGHT_DEG, _STEREOGRAPHIC_DEG = 75.0, 115.0
_WIDEST_DEG = 125.0  # diagonal field of view as which wider ones are taken
_OVERSTATED_SIGMA = 0.2  # relative standard deviation of the focal length of these
_LIMITS_DEG = 10.0, 200.0  # smallest and largest field of view on a box
_CHECKED_PX = 1280, 720  # an image size, for the check of options

Side = Literal["d", "h", "v"]
_SIDES: dict[Side, tuple[str, Callable[[float, float], float]]] = {
    "d": ("diagonal", math.hypot),
    "h": ("horizontal", lambda width_px, _: width_px),
    "v": ("vertical", lambda _, height_px: height_px),
}


@dataclass(frozen=True, slots=True)
class LensField:
    """A field of view as on the box of a camera."""

    field_deg: float
    side: Side  # the side of the image that it is across: diagonal, horizontal or vertical

    @classmethod
    def of(cls, text: str) -> Self:
        """The field of view of an option: degrees with d, h or v. Raises UsageError."""
        match = re.fullmatch(
            r"(\d{1,3}(?:\.\d{1,4})?)\s*+(?:°|deg)?+\s*+([dhv])", text.strip().lower()
        )
        if match is None or not _LIMITS_DEG[0] <= float(match[1]) <= _LIMITS_DEG[1]:
            raise UsageError(
                f"--lens-fov-deg {quoted(text)}: expected {_LIMITS_DEG[0]:.0f} to "
                f"{_LIMITS_DEG[1]:.0f} degrees with the side that they are across: 140d diagonal "
                "(as on most boxes of dashcams), 120h horizontal, 70v vertical."
            )
        side = next(side for side in _SIDES if side == match[2])
        return cls(float(match[1]), side)

    def guess(self, size_px: tuple[int, int]) -> FocalGuess:
        """The focal length at the centre of images of `size_px` (width, height)."""
        name, length_px = _SIDES[self.side]
        source = f"the lens's {name} field of view of {self.field_deg:g} degrees (--lens-fov-deg)"
        radius_px, half_rad = length_px(*size_px) / 2, math.radians(self.field_deg) / 2
        wide_px = radius_px / 2 / math.tan(half_rad / 2)
        widest_px = math.hypot(*size_px) / 4 / math.tan(math.radians(_WIDEST_DEG) / 4)
        if wide_px < widest_px:
            return FocalGuess(widest_px, _OVERSTATED_SIGMA, source)
        width_deg = math.degrees(4 * math.atan(max(size_px) / 4 / wide_px))
        span_deg = _STEREOGRAPHIC_DEG - _STRAIGHT_DEG
        straight = min(max((_STEREOGRAPHIC_DEG - width_deg) / span_deg, 0.0), 1.0)
        ratio_log = math.log(radius_px / math.tan(half_rad) / wide_px)
        of_wide = _WIDE_SIGMA**2 + straight * ratio_log**2
        variance = straight * _STRAIGHT_SIGMA**2 + (1 - straight) * of_wide
        return FocalGuess(wide_px * math.exp(straight * ratio_log), math.sqrt(variance), source)


class KnownCamera(NamedTuple):
    """One camera model."""

    name: str  # maker and model, also as the option takes it
    focal_per_width: float  # focal length at the image centre divided by the longer image side
    source: str  # where the value is published
    # texts in the metadata of its videos that identify it, in lower case
    tags: tuple[str, ...] = ()
    sigma: float = _MEASURED_SIGMA  # relative standard deviation of the focal length

    def guess(self, size_px: tuple[int, int], evidence: str) -> FocalGuess:
        """The focal length in images of `size_px` (width, height)."""
        return FocalGuess(
            self.focal_per_width * max(size_px), self.sigma, f"{evidence} ({self.source})"
        )


_OPENPILOT = "openpilot, common/transformations/camera.py"
_GYROFLOW = "gyroflow/lens_profiles, CC0"


def _shared(name: str, focal_px: float, width_px: int) -> KnownCamera:
    """A camera of Gyroflow's lens profiles, whose calibrations are of users, without
    stabilisation.
    """
    return KnownCamera(name, focal_px / width_px, _GYROFLOW, sigma=_SHARED_SIGMA)


# The mode of a camera with several fields of view is part of its name. Only cameras of one mode, or
# whose usual one is known, are recognised by metadata.
KNOWN_CAMERAS = (
    KnownCamera("comma EON", 910.0 / 1164, _OPENPILOT),
    KnownCamera("comma three", 2648.0 / 1928, _OPENPILOT),
    KnownCamera(
        "GoPro HERO9 Black wide",
        869.96 / 1920,
        "calibration of 1920x1080 at 60 fps, Wide, by urbste/OpenImuCameraCalibrator, Readme.md",
        tags=("hd9.",),
    ),
    KnownCamera(
        "GoPro HERO3 Black wide",
        1 / (4 * math.tan(math.radians(121.0) / 4)),
        # the field of view, 121 degrees
        "measured by R. Cunniff, racunniff.blogspot.com, December 2012",
        tags=("hd3.",),
        sigma=_WIDE_SIGMA,
    ),
    _shared("GoPro HERO4 wide", 820.2, 1920),
    _shared("GoPro HERO4 Session", 1084.1, 1920),
    _shared("GoPro HERO10 Black wide", 1796.3, 3840),
    _shared("GoPro HERO10 Black linear", 2532.6, 5312),
    _shared("GoPro HERO11 Black wide", 1796.3, 3840),
    _shared("GoPro HERO11 Black linear", 2532.6, 5312),
    _shared("DJI Action 3", 1429.7, 3840),
    _shared("Insta360 ONE R 1-inch ultrawide", 2235.3, 3840),
    _shared("SJCAM SJ4000", 1029.4, 1920),
    _shared("SJCAM SJ8 Pro", 1765.4, 3840),
    _shared("AKASO EK7000 Pro 170", 2154.5, 3840),
    _shared("AKASO V50 Pro wide", 2389.5, 3840),
    _shared("Xiaomi Yi 4K", 837.7, 1920),
    _shared("Xiaomi Mijia 4K", 1991.4, 3840),
)


@dataclass(frozen=True, slots=True)
class GivenLens:
    """What a user states of the lens of a camera without a calibration."""

    camera_model: str | None = None  # one of `KNOWN_CAMERAS`, in any case and spacing
    fov_deg: str | None = None  # a field of view as `LensField.of` takes it

    def __post_init__(self) -> None:
        """Raises UsageError for a field of view that is none, or an unknown model."""
        self.guesses(_CHECKED_PX)

    def __bool__(self) -> bool:
        return self != UNKNOWN_LENS

    def guesses(self, size_px: tuple[int, int]) -> tuple[FocalGuess, ...]:
        """The focal lengths in images of `size_px` (width, height)."""
        guesses = []
        if self.camera_model is not None:
            camera = _of_model(self.camera_model)
            guesses.append(camera.guess(size_px, f"the camera model {camera.name}"))
        if self.fov_deg is not None:
            guesses.append(LensField.of(self.fov_deg).guess(size_px))
        return tuple(guesses)


UNKNOWN_LENS = GivenLens()


def _of_model(name: str) -> KnownCamera:
    plain = "".join(name.lower().split())
    for camera in KNOWN_CAMERAS:
        if "".join(camera.name.lower().split()) == plain:
            return camera
    names = ", ".join(known.name for known in KNOWN_CAMERAS)
    raise UsageError(
        f"--camera-model {quoted(name)}: expected one of {names}; of another camera, give the "
        "field of view on its box: --lens-fov-deg 140d."
    )
