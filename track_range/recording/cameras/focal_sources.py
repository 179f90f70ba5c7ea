"""Guesses of the focal length from the data of a recording: header of the video, EXIF of images,
camera model.

f_px = f_35 diagonal_px / 43.27 mm       f_35: focal length for 35 mm film, whose diagonal is 43.27 mm

A field of view of a wide lens does not determine the focal length f at the image centre, since it
depends on the projection. With half the image width r and half the field of view w, a lens without
distortion has r = f tan w, and a fisheye r = f w. Wide lenses of dashcams are between the two; r =
2 f tan(w / 2) (stereographic) is used from 80 degrees on, with a sigma that covers both.
"""

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from track_range.foundation.errors import UsageError
from track_range.foundation.files.images import IMAGE_SUFFIXES
from track_range.foundation.files.input_files import quoted
from track_range.recording.video.video import Video
from track_range.stereo.geometry.focal_guess import FocalGuess, default_guess

# relative standard deviation of a focal length from the field of view of a wide lens
_WIDE_SIGMA = 0.15
_MEASURED_SIGMA = 0.02  # relative standard deviation of a focal length in px that was measured


class KnownCamera(NamedTuple):
    """One camera model."""

    name: str  # maker and model, also as the option takes it
    focal_per_width: float  # focal length at the image centre divided by the image width
    source: str  # where the value is published
    # texts in the metadata of its videos that identify it, in lower case
    tags: tuple[str, ...] = ()
    sigma: float = _MEASURED_SIGMA  # relative standard deviation of the focal length

    def guess(self, width_px: int, evidence: str) -> FocalGuess:
        """The focal length in images of this width."""
        return FocalGuess(
            self.focal_per_width * width_px, self.sigma, f"{evidence} ({self.source})"
        )


_OPENPILOT = "openpilot, common/transformations/camera.py"

KNOWN_CAMERAS = (  # the mode of a camera with several fields of view is part of its name
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
)

_FILM_DIAGONAL_MM = 43.27  # diagonal of 36 mm x 24 mm
# relative, of a 35 mm focal length: rounded, of diagonal or width, of cropped stabilised video
_FILM_SIGMA = 0.08
_PLAUSIBLE_MM = 8.0, 400.0  # range of focal lengths for 35 mm film

_FILM_KEYS = ("com.apple.quicktime.camera.focal_length.35mm_equivalent", "focallengthin35mmformat")
"""Keys of headers with the focal length for 35 mm film, in mm; the first key is Apple's."""

_MODEL_KEYS = ("com.apple.quicktime.model", "com.android.model", "model", "firmware")
"""Keys of headers that identify the camera."""

# tags: folder of details, the two in it
_EXIF_FOLDER, _EXIF_FILM_MM, _EXIF_MODEL = 0x8769, 0xA405, 0x0110


def focal_guesses(video: Video, camera_model: str | None = None) -> tuple[FocalGuess, ...]:
    """Guesses from the given model, the header or EXIF, else a usual focal length; UsageError for
    an unknown model.
    """
    size_px = video.shown_size_px
    if camera_model is not None:
        return (_of_model(camera_model, size_px[0]),)
    tags = {key.lower(): value for key, value in video.metadata.items()} or _exif(
        Path(str(video.path))
    )
    guesses = (_of_film(tags, size_px), _of_tags(tags, size_px[0]))
    return tuple(guess for guess in guesses if guess is not None) or (default_guess(size_px[0]),)


def _of_model(name: str, width_px: int) -> FocalGuess:
    plain = "".join(name.lower().split())
    camera = next(
        (known for known in KNOWN_CAMERAS if "".join(known.name.lower().split()) == plain), None
    )
    if camera is None:
        names = ", ".join(known.name for known in KNOWN_CAMERAS)
        raise UsageError(f"--camera-model {quoted(name)}: expected one of {names}.")
    return camera.guess(width_px, f"the camera model {camera.name}")


def _of_film(tags: Mapping[str, str], size_px: tuple[int, int]) -> FocalGuess | None:
    text = next((tags[key] for key in _FILM_KEYS if key in tags), "")
    number = re.search(r"\d+(\.\d+)?", text)
    if number is None or not _PLAUSIBLE_MM[0] <= float(number[0]) <= _PLAUSIBLE_MM[1]:
        return None
    focal_px = float(number[0]) * math.hypot(*size_px) / _FILM_DIAGONAL_MM
    return FocalGuess(focal_px, _FILM_SIGMA, f"the file's metadata, {number[0]} mm for 35 mm film")


def _of_tags(tags: Mapping[str, str], width_px: int) -> FocalGuess | None:
    texts = [tags[key].lower() for key in _MODEL_KEYS if key in tags]
    for camera in KNOWN_CAMERAS:
        if any(text.startswith(tag) for text in texts for tag in camera.tags):
            return camera.guess(width_px, f"the file's metadata, which names a {camera.name}")
    return None


def _exif(path: Path) -> dict[str, str]:
    """Tags of the first image of a folder, with the keys of `_FILM_KEYS` and `_MODEL_KEYS`."""
    if not path.is_dir():
        return {}
    first = next(
        (file for file in sorted(path.iterdir()) if file.suffix.lower() in IMAGE_SUFFIXES), None
    )
    if first is None:
        return {}
    from PIL import Image, UnidentifiedImageError  # slow to import

    try:
        with Image.open(first) as image:
            exif = image.getexif()
    except (OSError, UnidentifiedImageError, ValueError):
        return {}
    values = {
        _FILM_KEYS[1]: exif.get_ifd(_EXIF_FOLDER).get(_EXIF_FILM_MM),
        "model": exif.get(_EXIF_MODEL),
    }
    return {key: str(value) for key, value in values.items() if value}
