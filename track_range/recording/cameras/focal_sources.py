"""Guesses of the focal length from the data of a recording: header of the video, EXIF of images,
camera model.

f_px = f_35 diagonal_px / 43.27 mm       f_35: focal length for 35 mm film, whose diagonal is 43.27 mm
"""

import math
import re
from collections.abc import Mapping
from pathlib import Path

from track_range.foundation.files.images import IMAGE_SUFFIXES
from track_range.recording.cameras.known_lenses import KNOWN_CAMERAS, UNKNOWN_LENS, GivenLens
from track_range.recording.video.video import Video
from track_range.stereo.geometry.focal_guess import FocalGuess, default_guess

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


def focal_guesses(video: Video, lens: GivenLens = UNKNOWN_LENS) -> tuple[FocalGuess, ...]:
    """Guesses from what is stated of the lens, else from the header or EXIF, else a usual focal
    length.
    """
    size_px = video.shown_size_px
    if lens:
        return lens.guesses(size_px)
    tags = {key.lower(): value for key, value in video.metadata.items()} or _exif(
        Path(str(video.path))
    )
    guesses = (_of_film(tags, size_px), _of_tags(tags, size_px))
    return tuple(guess for guess in guesses if guess is not None) or (default_guess(size_px),)


def _of_film(tags: Mapping[str, str], size_px: tuple[int, int]) -> FocalGuess | None:
    text = next((tags[key] for key in _FILM_KEYS if key in tags), "")
    number = re.search(r"\d+(\.\d+)?", text)
    if number is None or not _PLAUSIBLE_MM[0] <= float(number[0]) <= _PLAUSIBLE_MM[1]:
        return None
    focal_px = float(number[0]) * math.hypot(*size_px) / _FILM_DIAGONAL_MM
    return FocalGuess(focal_px, _FILM_SIGMA, f"the file's metadata, {number[0]} mm for 35 mm film")


def _of_tags(tags: Mapping[str, str], size_px: tuple[int, int]) -> FocalGuess | None:
    texts = [tags[key].lower() for key in _MODEL_KEYS if key in tags]
    for camera in KNOWN_CAMERAS:
        if any(text.startswith(tag) for text in texts for tag in camera.tags):
            return camera.guess(size_px, f"the file's metadata, which names a {camera.name}")
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
