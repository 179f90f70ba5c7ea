"""Camera calibrations from files in any of the formats of `registry.RIG_FORMATS`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.geometry.rig_checks import Calibration, check_camera, check_rig, fitted_to_size
from track_range.stereo.rig_formats.registry import FORMAT_TITLES, RIG_FORMATS
from track_range.stereo.rig_formats.rig_format import RigFormat

_MAX_BYTES = 1_000_000
"""No calibration is as large; a video given by mistake is, and is not read."""


def load_rig(path: Path, *, size_px: tuple[int, int], is_grey: bool = False) -> tuple[StereoRig, tuple[str, ...]]:
    """The rig of a file, for images of `size_px` = (width, height), and notes to tell the user.

    Args:
        path: a file in any of the formats.
        size_px: (width, height) of the images.
        is_grey: take the grey pair of a KITTI file that also has the colour one.

    Raises:
        RigError: the file cannot be read, is no rig, holds one camera only, is implausible or for other images.
    """
    text = _text_of(path)
    rig_format = _format_of(text, path)
    found = rig_format.read(text, path, is_grey)
    if found.right is None or found.right_from_left is None:
        missing = rig_format.missing(text, path, is_grey)
        raise RigError(f"{path}: {missing}; give a file with both cameras, or run on one video with --mono.")
    check_rig(StereoRig(found.left, found.right, found.right_from_left), path)
    left, left_notes = fitted_to_size(found.left, size_px, f"{path} (left)")
    right, right_notes = fitted_to_size(found.right, size_px, f"{path} (right)")
    rig = StereoRig(left, right, found.right_from_left)
    check_rig(rig, path)
    return rig, (*found.notes, *left_notes, *right_notes)


def load_camera(
    path: Path, *, size_px: tuple[int, int] | None, is_grey: bool = False
) -> tuple[PinholeCamera, tuple[str, ...]]:
    """The only, or left, camera of a file, for images of `size_px` = (width, height), and notes to tell the user.

    `size_px` None = there are no images to fit it to; the camera's size may then be 0.

    Raises:
        RigError: the file cannot be read, is no calibration, is implausible or for other images.
    """
    found = _read(path, is_grey=is_grey)
    check_camera(found.left, f"{path}: left")
    if size_px is None:
        return found.left, found.notes
    camera, notes = fitted_to_size(found.left, size_px, path)
    check_camera(camera, f"{path}: left")
    return camera, (*found.notes, *notes)


def load_calibration(
    path: Path, *, size_px: tuple[int, int] | None = None, is_grey: bool = False
) -> tuple[PinholeCamera | StereoRig, tuple[str, ...]]:
    """The camera of a file, or its rig if it holds one, and notes to tell the user; for no images in particular.

    Args:
        path: a file in any of the formats.
        size_px: (width, height) of images to fit it to; None = the file's own, which may be 0 where it gives none.
        is_grey: take the grey pair of a KITTI file that also has the colour one.

    Raises:
        RigError: the file cannot be read, is no calibration, is implausible or for other images.
    """
    found = _read(path, is_grey=is_grey)
    if found.right is None or found.right_from_left is None:
        return load_camera(path, size_px=size_px, is_grey=is_grey)
    if size_px is not None:
        return load_rig(path, size_px=size_px, is_grey=is_grey)
    rig = StereoRig(found.left, found.right, found.right_from_left)
    check_rig(rig, path)
    return rig, found.notes


def left_from_reference_m(path: Path, *, is_grey: bool) -> FloatArray:
    """(3,) shift that takes points of KITTI's reference camera (its labels' frame) into the left camera's frame.

    Zeros for the other formats. The label of an object is moved by it before it is compared with a distance of ours.

    Raises:
        RigError: the file cannot be read or is no calibration.
    """
    return np.array(_read(path, is_grey=is_grey).left_from_reference_m)


def find_rig(left_video: Path) -> Path | None:
    """`rig.yaml`, else `calib.txt`, beside the left video; for a folder of images inside it, then beside it."""
    folders = (left_video, left_video.parent) if left_video.is_dir() else (left_video.parent,)
    candidates = (folder / name for folder in folders for name in ("rig.yaml", "calib.txt"))
    return next((candidate for candidate in candidates if candidate.is_file()), None)


def _text_of(path: Path) -> str:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise RigError(f"{path}: larger than 1 MB, so not a rig file; give {FORMAT_TITLES}.")
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise RigError(f"{path}: there is no such file; name the cameras' rig.yaml or calib.txt.") from error
    except OSError as error:
        raise RigError(f"{path}: cannot be read ({error.strerror}); give {FORMAT_TITLES}.") from error
    except UnicodeDecodeError as error:
        raise RigError(f"{path}: not a text file, so not a rig; give {FORMAT_TITLES}.") from error


def _format_of(text: str, path: Path) -> RigFormat:
    """The format that recognises the text."""
    for rig_format in RIG_FORMATS:
        if rig_format.recognises(text):
            return rig_format
    raise RigError(f"{path}: not a rig in a known format (no key 'track_range_rig'); give {FORMAT_TITLES}.")


def _read(path: Path, *, is_grey: bool) -> Calibration:
    text = _text_of(path)
    return _format_of(text, path).read(text, path, is_grey)
