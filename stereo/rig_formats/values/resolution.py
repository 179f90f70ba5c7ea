"""The cameras and the rig that a draft determines.

    K1 D1 K2 D2 R T          x2 = R x1 + T; T has the unit of the chessboard's square size
    K1 D1 K2 D2 R1 R2 P1 P2  R = R2^T R1, T = R2^T (P2[0, 3] / P2[0, 0], 0, 0)
    P1 P2, or K and B        rectified images: B = -P2[0, 3] / P2[0, 0], or bf / fx

The right camera of the rig is to the right. (OpenCV, calib3d: stereoCalibrate and stereoRectify;
MathWorks: stereoParameters, cameraIntrinsicsToOpenCV.)
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError, inverse_motion, rigid_motion
from track_range.stereo.geometry.rig_checks import NamedCamera, RigCalibration
from track_range.stereo.rig_formats.values.cameras import (
    camera_notes,
    camera_of,
    incomplete,
    size_px_of,
)
from track_range.stereo.rig_formats.values.draft import RigDraft
from track_range.stereo.rig_formats.values.lens_models import stated_lens
from track_range.stereo.rig_formats.values.motions import (
    checked_with_rectification,
    motion_of,
    motion_of_pair,
    offset_of,
    pose_of,
    projections_of,
)
from track_range.stereo.rig_formats.values.units import unit_of

_MOST_CAMERAS = 100  # of a file that are read; some list those of thousands of images


def resolved(draft: RigDraft, *, is_pair: bool) -> RigCalibration:
    """The cameras by projection matrices, by a baseline, alone, or by R and T; RigError if a part
    is missing, or contradicts another one. Cameras whose pair is not determined are `cameras` of
    the result, of which the caller chooses.
    """
    if not draft.has("K", "fx", "P"):
        for side in draft.models:
            stated_lens(draft.stated_models(side), draft.path)
        raise RigError(_unusable(draft))
    if draft.has_extrinsics and draft.sides in ([2], ["right"]):
        raise incomplete(draft, ["M1"])
    projections = projections_of(draft) if draft.has_two_cameras else None
    has_matrices = any(draft.of(side, "K") is not None for side in draft.sides[:2] or [None])
    if projections is not None and not has_matrices:
        return _of_projections(draft, projections)
    if draft.has_two_cameras and not _is_pair(draft):
        return _of_several(draft)
    try:
        return _related(draft, has_projections=projections is not None)
    except RigError:
        if is_pair or not (draft.has_two_cameras or draft.has_extrinsics):
            raise
        return _of_several(draft)  # one camera needs no pair


def _is_pair(draft: RigDraft) -> bool:
    """Whether the files have the relation of two cameras, and these are a left and a right one, or
    the only ones.
    """
    is_related = draft.has_extrinsics or draft.has("P", "body", "baseline", "bf")
    n_numbered = sum(isinstance(side, int) for side in draft.sides)
    is_only_pair = draft.sides[:2] == ["left", "right"] or n_numbered == 2 or len(draft.sides) == 2
    return is_related and is_only_pair


def _related(draft: RigDraft, *, has_projections: bool) -> RigCalibration:
    """The only camera, or the pair of a baseline or of R and T."""
    first, second = draft.pair
    left = camera_of(draft, first, 1)
    baseline = _baseline(draft, left)
    if baseline is not None and not draft.has_extrinsics and not has_projections:
        return _of_baseline(draft, left, *baseline)
    if not draft.has_two_cameras and not draft.has("T"):  # a pose of one camera is of no pair
        return RigCalibration(left, None, None, notes=camera_notes(draft, first))
    rig = _of_transform(draft, left)
    if not draft.names:
        return rig
    names = [draft.name_of(side) for side in (first, second)]
    named = zip(names if rig.left is left else names[::-1], rig.known_cameras, strict=True)
    pair = tuple(known._replace(name=name) for name, known in named)
    others = tuple(
        one._replace(pose=None) for one in _of_several(draft).cameras if one.name not in names
    )
    return replace(rig, cameras=(*pair, *others))


def _of_several(draft: RigDraft) -> RigCalibration:
    """The cameras of a file, each by itself, with their poses if the file has them."""
    cameras = [
        NamedCamera(
            draft.name_of(side),
            camera_of(draft, side, number),
            pose_of(draft, side),
            camera_notes(draft, side),
        )
        for number, side in enumerate(draft.sides[:_MOST_CAMERAS] or [None], 1)
    ]
    positions = [inverse_motion(one.pose)[:3, 3] for one in cameras if one.pose is not None]
    lengths = [float(np.linalg.norm(a - b)) for a, b in pairwise(positions)]
    length = min((length for length in lengths if length), default=0.0)
    if length:
        unit = unit_of(draft, length)
        note = f"{draft.path}: {draft.title}: lengths {unit.reason}."
        cameras = [one.scaled(unit.metres, note) for one in cameras]
    return RigCalibration(cameras[0].camera, None, None, cameras=tuple(cameras))


def stated_motion(draft: RigDraft) -> FloatArray | None:
    """(4, 4) transform of R and T alone, metres; None if one is missing, or the unit is in
    doubt.
    """
    translation = draft.get(None, "T")
    if translation is None or not draft.pair_has("R"):
        return None
    motion = motion_of_pair(draft)
    unit = unit_of(draft, float(np.linalg.norm(motion[:3, 3])), translation.key)
    if unit.is_doubtful:
        return None
    return rigid_motion(motion[:3, :3], motion[:3, 3] * unit.metres)


def _of_projections(draft: RigDraft, projections: Sequence[FloatArray]) -> RigCalibration:
    """The rectified cameras of two projection matrices (3, 4)."""
    size_px = size_px_of(draft, None, projections[0][:2, 2])
    cameras = [PinholeCamera.of_matrix(projection, size_px) for projection in projections]
    kind = "projection matrices P1 and P2"
    baseline = -offset_of(*projections)
    return _parallel(draft, cameras, (baseline, "P2"), kind, "rectified images")


def _baseline(draft: RigDraft, left: PinholeCamera) -> tuple[float, str] | None:
    """The baseline in the unit of the file, stated or bf / fx, and its key; None if unknown, or
    that of a depth camera.
    """
    is_of_other_images = draft.dialect.is_baseline_rectified and any(left.distortion)
    if draft.has("depth_scale") or is_of_other_images:
        return None
    baseline, bf = draft.get(None, "baseline"), draft.get(None, "bf")
    if baseline is not None:
        return abs(float(baseline.value[0])), baseline.key
    if bf is None:
        return None
    fx = draft.of(None, "fx")
    return abs(float(bf.value[0] / (left.fx_px if fx is None else fx[0]))), bf.key


def _of_baseline(draft: RigDraft, left: PinholeCamera, baseline: float, key: str) -> RigCalibration:
    """The pair of parallel cameras with this baseline of a key, in the unit of the file."""
    first, second = draft.pair
    right = camera_of(draft, second, 2) if draft.has_two_cameras else left
    is_rectified = draft.dialect.is_rectified or not left.is_distorted
    images = "rectified images" if is_rectified else "parallel cameras"
    rig = _parallel(draft, [left, right], (baseline, key), draft.title, images)
    return replace(rig, notes=(*rig.notes, *camera_notes(draft, first)))


def _parallel(
    draft: RigDraft,
    cameras: Sequence[PinholeCamera],
    stated: tuple[float, str],
    kind: str,
    images: str,
) -> RigCalibration:
    """The pair of two parallel cameras with a baseline, in the unit of the file, of a key; a note
    names the kind of the file and of the images.
    """
    baseline, key = stated
    unit = unit_of(draft, abs(baseline), key)
    motion = rigid_motion(np.eye(3), [-baseline * unit.metres, 0.0, 0.0])
    length_m = abs(baseline) * unit.metres
    note = f"{draft.path}: {kind}: the baseline is {length_m:.5g} m, {unit.reason}; {images}."
    return RigCalibration(
        cameras[0], cameras[1], motion, notes=(note,), metres_per_unit=unit.metres
    )


def _of_transform(draft: RigDraft, left: PinholeCamera) -> RigCalibration:
    """The pair of cameras by R and T."""
    stated = motion_of(draft)
    first, second = draft.pair
    right = camera_of(draft, second, 2)
    length = float(np.linalg.norm(stated.matrix[:3, 3]))
    unit = unit_of(draft, length, stated.key)
    motion = checked_with_rectification(draft, stated)
    baseline = f"the baseline is {length * unit.metres:.4g} m, {unit.reason}"
    doubt = (
        f"{draft.path}: expected {stated.key} in metres, found one {length:.4g} long, which is wider than a "
        "vehicle; give its unit: rig convert FILE rig.yaml --unit mm, cm or m; or multiply T by "
        "the side of a square, if it counts squares of the board."
    )
    rig = RigCalibration(
        left,
        right,
        rigid_motion(motion.matrix[:3, :3], motion.matrix[:3, 3] * unit.metres),
        notes=(
            f"{draft.path}: {draft.title}: {baseline}.",
            *camera_notes(draft, first),
            *motion.notes,
        ),
        metres_per_unit=unit.metres,
        unit_doubt=doubt if unit.is_doubtful else "",
    )
    return _from_left_to_right(draft, rig)


def _from_left_to_right(draft: RigDraft, rig: RigCalibration) -> RigCalibration:
    """The rig with its right camera to the right of the left one, and a note if the file has it on
    the left.
    """
    motion = rig.right_from_left
    first, second = draft.pair
    if motion is None or rig.right is None or first is None:
        return rig
    if not motion[0, 3] > abs(motion[1, 3]):
        return rig
    if first == "left":
        note = (
            f"{draft.path}: R and T put the right camera to the left of the left one, so they are "
            "read as the transform from the right camera to the left one; if the left and the "
            "right camera are swapped instead, swap them in the file."
        )
    else:
        rig = replace(rig, left=rig.right, right=rig.left)
        note = (
            f"{draft.path}: by T, camera {second} is to the left of camera {first} (x2 = R x1 + T), "
            "so it is used as the left camera; if T is its position instead, swap the cameras in "
            "the file."
        )
    return replace(rig, right_from_left=inverse_motion(motion), notes=(*rig.notes, note))


def _unusable(draft: RigDraft) -> str:
    """The probable kind of a file without cameras, and advice."""
    keys = " ".join(draft.keys).lower()
    advice = next((advice for pattern, advice in _SEEN if pattern.search(keys)), None) or (
        "expected the matrix M1 of a camera (or track_range_rig)",
        "track-range rig template FILE writes a rig.yaml with blanks",
    )
    return f"{draft.path}: {advice[0]}, found the keys {draft.listed_keys or 'none'}; {advice[1]}."


_SEEN = (
    (re.compile(r"stereo_?map|_map_?[xy]|map[lr12]?_?[xy]\b|remap|rectify_?map"), (
        "expected camera matrices, but this file seems to contain only remap tables",
        "give the file with M1, D1, M2, D2, R and T, or P1 and P2, of the same calibration",
    )),
    (re.compile(r"imagelist|images\b"), (
        "expected a calibration, but this file seems to list images for a calibration",
        "track-range calibrate --stereo 'left*.jpg' 'right*.jpg' --board 9x6 --square-mm 24 calibrates the cameras",
    )),
    (re.compile("mappingcoefficients"), (
        "expected a camera matrix, but this file seems to contain a fisheye camera of MATLAB "
        "(OCamCalib)",
        "calibrate with OpenCV's fisheye model, or undistort the video and give the pinhole of "
        "its images",
    )),
    (re.compile(r"\br\b|\bt\b"), (
        "expected the matrix M1 in this file or in an intrinsics file in its folder, but this file seems to contain "
        "only extrinsics",
        "give stereo_calib's intrinsics.yml beside it",
    )),
    (re.compile(r"controls-|param-|parameters\."), (
        "expected a calibration, but this file seems to contain RealSense's settings",
        "rs-enumerate-devices -c > rig.txt writes the calibration",
    )),
)  # fmt: skip
