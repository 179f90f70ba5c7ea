"""Reading camera calibrations from files: a new format is a module with a RigFormat and a row of
`RIG_FORMATS`, or an entry point of the group `track_range.rig_formats`.
"""

import contextlib
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.registry import Registry
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.geometry.rig_checks import (
    RigCalibration,
    check_camera,
    check_rig,
    shared_view_notes,
)
from track_range.stereo.geometry.size_notes import fitted_rig, fitted_to_size
from track_range.stereo.rig_formats.camera_choice import chosen
from track_range.stereo.rig_formats.rig_format import RigFormat, RigWriter
from track_range.stereo.rig_formats.ros import read_folder
from track_range.stereo.rig_formats.values.containers import calibration_text
from track_range.stereo.rig_formats.values.partners import files_of

RIG_FORMATS = Registry(
    "track_range.rig_formats",
    {
        "ours": "track_range.stereo.rig_formats.rig_yaml:RIG_YAML",
        "zed": "track_range.stereo.rig_formats.devices:ZED",
        "oak": "track_range.stereo.rig_formats.devices:OAK",
        "realsense": "track_range.stereo.rig_formats.devices:REALSENSE",
        "vins": "track_range.stereo.rig_formats.vins:VINS",
        "dialects": "track_range.stereo.rig_formats.dialects:READ_ONLY",
        "opencv": "track_range.stereo.rig_formats.opencv:OPENCV",
        "kitti": "track_range.stereo.rig_formats.kitti:KITTI",
        "ros": "track_range.stereo.rig_formats.ros:ROS",
    },
    RigFormat,
    error=RigError,
)
# largest relative difference of the factors by which left and right images are scaled
_SCALE_TOLERANCE = 0.01


def load_rig(
    path: Path,
    *,
    size_px: tuple[int, int],
    right_size_px: tuple[int, int] | None = None,
    is_grey: bool = False,
    cameras: Sequence[str] = (),
) -> tuple[StereoRig, tuple[str, ...]]:
    """The rig of a file, for images of `size_px` = (width, height), and notes for the user.

    `cameras` are the names of the left and the right one in a file of several; `path` may be a
    folder with ROS's camera_info of two cameras; `right_size_px` None = `size_px`; `is_grey`
    chooses the grey pair of a KITTI file. Raises RigError if the file cannot be read, is not a rig,
    has only one camera, is implausible, or is for other images.
    """
    calibration = read_calibration(
        path, is_grey=is_grey, is_pair=True, cameras=cameras, size_px=size_px
    ).of_size(size_px)
    if (rig := calibration.checked_rig(path)) is None:
        names = list(dict.fromkeys(known.name for known in calibration.known_cameras))
        present = "one camera" if len(names) == 1 else f"only the cameras {' and '.join(names)}"
        raise RigError(
            f"{path}: expected {missing_camera(path, is_grey=is_grey)}, found {present}; give a "
            "file with both cameras, or run on one video with --mono."
        )
    return _fitted(rig, calibration.notes, path, (size_px, right_size_px or size_px))


def _fitted(
    rig: StereoRig,
    notes: tuple[str, ...],
    path: Path,
    sizes_px: tuple[tuple[int, int], tuple[int, int]],
) -> tuple[StereoRig, tuple[str, ...]]:
    """The rig for images of two sizes, and notes."""
    if sizes_px[0] != sizes_px[1]:
        _check_sizes((rig.left, rig.right), sizes_px, path)
    rig, size_notes = fitted_rig(rig, sizes_px, path)
    check_rig(rig, path)
    return rig, (*notes, *size_notes, *shared_view_notes(rig, path))


def _check_sizes(
    cameras: tuple[PinholeCamera, PinholeCamera],
    sizes_px: tuple[tuple[int, int], tuple[int, int]],
    path: Path,
) -> None:
    """Check that images of unequal sizes have the sizes of the file's cameras, or both sizes
    reduced by one factor.
    """
    scales = [
        size_px[0] / max(camera.width_px, 1)
        for camera, size_px in zip(cameras, sizes_px, strict=True)
    ]
    if not cameras[0].width_px or abs(scales[1] / scales[0] - 1) > _SCALE_TOLERANCE:
        expected = (
            " and ".join(f"{camera.width_px}x{camera.height_px}" for camera in cameras) + " px"
        )
        raise RigError(
            f"{path}: expected left and right images of "
            f"{expected if cameras[0].width_px else 'equal size'}, found "
            f"{' and '.join(f'{width}x{height}' for width, height in sizes_px)} px; give a rig of "
            "these images."
        )


def load_camera(
    path: Path,
    *,
    size_px: tuple[int, int] | None,
    is_grey: bool = False,
    cameras: Sequence[str] = (),
) -> tuple[PinholeCamera, tuple[str, ...]]:
    """The only, or left, camera of a file, or the one with the name in `cameras`, for images of
    `size_px` = (width, height), and notes for the user.

    With `size_px` None, the camera has the file's image size, which may be 0. Raises RigError if
    the file cannot be read, is not a calibration, is implausible, or is for other images.
    """
    calibration = read_calibration(
        path, is_grey=is_grey, is_pair=False, cameras=cameras, size_px=size_px
    ).of_size(size_px)
    check_camera(calibration.left, f"{path}: left")
    if size_px is None:
        return calibration.left, calibration.notes
    camera, notes = fitted_to_size(calibration.left, size_px, path)
    check_camera(camera, f"{path}: left")
    return camera, (*calibration.notes, *notes)


def load_calibration(
    path: Path,
    *,
    size_px: tuple[int, int] | None = None,
    is_grey: bool = False,
    metres_per_unit: float | None = None,
    cameras: Sequence[str] = (),
) -> tuple[PinholeCamera | StereoRig, tuple[str, ...]]:
    """The rig of a file, or its only camera, or those with the names in `cameras`, and notes for
    the user; see `load_rig` and `load_camera`.

    `metres_per_unit` is the unit of the lengths in the file, None = by the format, the file or
    their size.
    """
    calibration = (
        read_calibration(path, is_grey=is_grey, is_pair=None, cameras=cameras, size_px=size_px)
        .in_unit(metres_per_unit)
        .of_size(size_px)
    )
    if (rig := calibration.checked_rig(path)) is None:
        return load_camera(path, size_px=size_px, is_grey=is_grey, cameras=cameras)
    return (
        (rig, calibration.notes)
        if size_px is None
        else _fitted(rig, calibration.notes, path, (size_px, size_px))
    )


def missing_camera(path: Path, *, is_grey: bool = False) -> str:
    """The part that a file with one camera lacks for a rig, for messages; RigError if the file is
    not a calibration.
    """
    rig_format, text = format_of(path)
    return rig_format.missing(text, path, is_grey)


def left_from_reference_m(
    path: Path, *, is_grey: bool, size_px: tuple[int, int] | None = None
) -> FloatArray:
    """(3,) translation from the frame of KITTI's reference camera, which its labels use, to the
    left camera's frame.

    Zeros for other formats, and for KITTI's images before rectification. Labels are moved by this
    translation before they are compared with measured distances. `size_px` is the (width, height)
    of the images; None = rectified. Raises RigError if the file cannot be read or is not a
    calibration.
    """
    calibration = content_of(path, is_grey=is_grey, is_pair=False).of_size(size_px)
    return np.array(calibration.left_from_reference_m)


# calibrations that are found beside a video, the first counts
RIG_NAMES = ("rig.yaml", "calib.txt")


def rig_names(video: str) -> tuple[str, ...]:
    """Names of the calibration beside a video, in the order in which they are looked for: of this
    video, `NAME.rig.yaml` and `NAME.calib.txt`, and of all videos of the folder, `rig.yaml` and
    `calib.txt`.
    """
    return (*(f"{Path(video).stem}.{name}" for name in RIG_NAMES), *RIG_NAMES)


def find_rig(left_video: Path) -> Path | None:
    """The first of `rig_names` in the folder of the left video, or in a folder of images or its
    parent.
    """
    folders = (left_video, left_video.parent) if left_video.is_dir() else (left_video.parent,)
    candidates = (folder / name for folder in folders for name in rig_names(left_video.name))
    return next((candidate for candidate in candidates if candidate.is_file()), None)


def format_of(path: Path) -> tuple[RigFormat, str]:
    """The format of a calibration file, and its text; raises RigError if it cannot be read."""
    text = calibration_text(path)
    answers = RIG_FORMATS.answers(lambda form: form.recognises(text))
    return next(form for form, is_recognised in answers if is_recognised), text


def read_calibration(
    path: Path,
    *,
    is_grey: bool,
    is_pair: bool | None,
    cameras: Sequence[str] = (),
    size_px: tuple[int, int] | None = None,
) -> RigCalibration:
    """The two cameras of a file, or of the two camera_info of ROS in a folder, or one of them; None
    = two, if the file is of a pair. See `camera_choice.chosen`.
    """
    content = content_of(path, is_grey=is_grey, is_pair=is_pair is not False)
    return chosen(content, path, cameras, size_px, is_pair=is_pair)


def content_of(path: Path, *, is_grey: bool, is_pair: bool) -> RigCalibration:
    """Content of a file with all its cameras."""
    if os.path.isdir(path):
        return _read_folder(path, is_grey=is_grey)
    rig_format, text = format_of(path)
    read = (rig_format.read_pair or rig_format.read) if is_pair else rig_format.read
    return read(text, path, is_grey)


def _read_folder(folder: Path, *, is_grey: bool) -> RigCalibration:
    """The pair in a folder: two camera_info of ROS, else the first file that gives a pair; also in
    cam0 or left.
    """
    if (rig := read_folder(folder)) is not None:
        return rig
    inside = [folder / name for name in ("mav0/cam0", "cam0", "left") if (folder / name).is_dir()]
    n_single = 0
    for file in (file for place in (folder, *inside) for file in files_of(place)):
        with contextlib.suppress(RigError):
            calibration = content_of(file, is_grey=is_grey, is_pair=True)
            if calibration.right is not None:
                return calibration
            n_single += 1
    raise RigError(
        f"{folder}: expected a folder with ROS's camera_info of two cameras in YAML, or a "
        f"calibration of a pair, found {n_single} calibrations of single cameras; give the "
        "calibration file of the pair."
    )


def rig_writers() -> dict[str, RigWriter]:
    """The writers by name of the format, rig.yaml's first."""
    return {
        rig_format.name: rig_format.write
        for rig_format in RIG_FORMATS.usable.values()
        if rig_format.write is not None
    }
