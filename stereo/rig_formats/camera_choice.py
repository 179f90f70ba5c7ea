"""The cameras that images are of, among those of a calibration file: by their names, by the size of
the images, or the left one of the only pair.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from track_range.foundation.files.input_files import quoted, shortened
from track_range.stereo.geometry.image_size import is_size_of
from track_range.stereo.geometry.rig import RigError, inverse_motion
from track_range.stereo.geometry.rig_checks import NamedCamera, RigCalibration
from track_range.stereo.rig_formats.values.partners import other_sides

# relative difference of the focal lengths of cameras above which a note names the one that is used
_FOCAL_DIFFERENCE = 0.01
_MAX_LISTED = 400  # characters of the names in a message

_Cameras = Mapping[str, Sequence[NamedCamera]]  # by name, one for each size of its images


def chosen(
    calibration: RigCalibration,
    path: Path,
    names: Sequence[str],
    size_px: tuple[int, int] | None,
    *,
    is_pair: bool | None,
) -> RigCalibration:
    """The calibration of one camera or of a pair; `is_pair` None = a pair if the file has one.

    `names` are those of the camera, or of the left and the right one; empty = by `size_px`, the
    (width, height) of the images. RigError if the file has no such cameras, or several that may be
    meant.
    """
    cameras: dict[str, list[NamedCamera]] = {}
    for known in calibration.known_cameras:
        cameras.setdefault(known.name, []).append(known)
    has_poses = any(known.pose is not None for known in calibration.known_cameras)
    is_unrelated = len(cameras) == 1 or not has_poses
    # the caller reports that the pair is missing
    if not names and is_pair is not False and (calibration.right or (is_pair and is_unrelated)):
        return calibration
    fitting = _of_size(cameras, size_px)
    usual = _usual_pair(fitting) if is_pair else _usual_one(calibration, cameras, fitting)
    wanted = list(names) or usual
    _check_names(wanted, cameras, path, names, is_pair=is_pair)
    if len(wanted) == 2:
        return _pair(calibration, [cameras[name][0] for name in wanted], path, is_given=bool(names))
    focal_px = [known.camera.fx_px for known in calibration.known_cameras]
    notes: tuple[str, ...] = ()
    if not names and max(focal_px) > min(focal_px) * (1 + _FOCAL_DIFFERENCE):
        notes = (
            f"{path}: camera {wanted[0]} of {_listed(cameras)} is used (--camera NAME uses "
            "another).",
        )
    return _alone(calibration, wanted[0], notes)


def _listed(cameras: _Cameras) -> str:
    return shortened(", ".join(cameras), _MAX_LISTED)


def _check_names(
    wanted: Sequence[str],
    cameras: _Cameras,
    path: Path,
    given: Sequence[str],
    *,
    is_pair: bool | None,
) -> None:
    """Raise RigError unless the wanted names are those of one camera or a pair of the file."""
    n_expected = len(wanted) if is_pair is None else 1 + is_pair
    if len(cameras) == 1 and given and given[0] not in cameras:
        raise RigError(
            f"{path}: expected no --camera for a file of one camera, found "
            f"{quoted(','.join(given))}; omit it."
        )
    is_right = len(wanted) == n_expected and 1 <= n_expected <= 2
    if not is_right or any(name not in cameras for name in wanted):
        what = "the names LEFT,RIGHT of two cameras" if is_pair else "the NAME of one camera"
        raise RigError(
            f"{path}: expected {what} in --camera, since the file has {_listed(cameras)}, found "
            f"{quoted(','.join(given)) if given else 'none'}; give it, or the rig.yaml that rig "
            "convert writes with it."
        )


def _of_size(cameras: _Cameras, size_px: tuple[int, int] | None) -> list[str]:
    """The names of the cameras whose images have a size; all if there are none."""
    if size_px is None:
        return list(cameras)
    fitting = [
        name
        for name, modes in cameras.items()
        if any(is_size_of(known.camera, size_px) for known in modes)
    ]
    return fitting or list(cameras)


def _usual_pair(names: list[str]) -> list[str]:
    """The only two names, or the only ones of a left and a right camera; [] = others."""
    if len(names) == 2:
        return names
    pairs = [
        [name, other]
        for name in names
        for other in other_sides(name)
        if "left" in name.lower() and other in names
    ]
    return pairs[0] if len(pairs) == 1 else []


def _usual_one(calibration: RigCalibration, cameras: _Cameras, names: list[str]) -> list[str]:
    """The only camera, or the left one of the only pair; [] = others."""
    first = cameras[names[0]][0].camera
    if len(names) == 1 or all(known.camera == first for name in names for known in cameras[name]):
        return names[:1]
    both = (calibration.left, calibration.right)
    is_known_pair = all(cameras[name][0].camera in both for name in names)
    if len(names) != 2 or not (is_known_pair or names[1] in other_sides(names[0])):
        return []
    return [name for name in names if cameras[name][0].camera == calibration.left]


def _alone(calibration: RigCalibration, name: str, notes: tuple[str, ...]) -> RigCalibration:
    """The calibration of one camera, with that of its other sizes."""
    if calibration.left == calibration.known_cameras[0].camera and name == "left":
        notes = (*calibration.notes, *notes)
        return replace(calibration, right=None, right_from_left=None, cameras=(), notes=notes)
    modes = [
        RigCalibration(known.camera, None, None, notes=(*known.notes, *notes))
        for content in (calibration, *calibration.others)
        for known in content.known_cameras
        if known.name == name
    ]
    return replace(modes[0], others=tuple(modes[1:]))


def _pair(
    calibration: RigCalibration, cameras: Sequence[NamedCamera], path: Path, *, is_given: bool
) -> RigCalibration:
    """The calibration of two cameras; if these are not given, the left one is that by their poses."""
    left, right = cameras
    if left.pose is None or right.pose is None:
        raise RigError(
            f"{path}: expected R and T between the cameras {left.name} and {right.name}, found "
            "none; write them into this file, or into an extrinsics file beside it, or run on one "
            "video with --mono."
        )
    motion = np.asarray(right.pose @ inverse_motion(left.pose))
    if not is_given and motion[0, 3] > abs(motion[1, 3]):
        left, right, motion = right, left, inverse_motion(motion)
    note = f"{path}: {left.name} is the left camera, {right.name} the right one."
    notes = tuple(dict.fromkeys((*left.notes, note)))
    return RigCalibration(left.camera, right.camera, motion, notes=notes)
