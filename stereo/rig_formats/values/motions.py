"""The transform between two cameras from the draft of a calibration, in the unit of its files.

    R, T         x2 = R x1 + T, or of each camera, x = R x_world + T
    R1 R2 P1 P2  R = R2^T R1, T = R2^T (P2[0, 3] / P2[0, 0], 0, 0), or -bf / fx of rectified images

R and T are checked with the rest of the file: R2 R R1^T = 1, |T| = |P2[0, 3]| / f.
"""

from typing import NamedTuple

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import quoted
from track_range.stereo.geometry.rig import RigError, inverse_motion, rigid_motion
from track_range.stereo.rig_formats.values.aliases import Side
from track_range.stereo.rig_formats.values.cameras import incomplete, shaped
from track_range.stereo.rig_formats.values.draft import RigDraft
from track_range.stereo.rig_formats.values.stated import TOLERANCE, Stated

_SECOND_CAMERA = {"M2": ("K", "fx"), "D2": ("D", "radial", "k1")}  # its matrices, and quantities


class PairMotion(NamedTuple):
    """The transform from the first camera's frame to the second's."""

    matrix: FloatArray  # (4, 4)
    notes: tuple[str, ...] = ()
    key: str = "T"  # of its length


def motion_of(draft: RigDraft) -> PairMotion:
    """The transform by the quantities of a draft; RigError if they are incomplete."""
    transform = draft.get(None, "transform")
    if transform is not None:
        return PairMotion(_from_first(_rigid(transform), transform), key=transform.key)
    if not draft.pair_has("T"):
        first, second = (pose_of(draft, side) for side in draft.pair)
        if first is not None and second is not None:
            return PairMotion(np.asarray(second @ inverse_motion(first), np.float64))
        rectified = _motion_of_rectification(draft)
        if rectified is not None:
            source = "P1 and P2" if draft.has("P") else "f B"
            return PairMotion(
                rectified, (f"{draft.path}: R and T are computed from R1, R2, {source}.",), "P2"
            )
    missing = _missing(draft)
    if missing:
        raise incomplete(draft, missing)
    stated = draft.get(None, "T")
    return PairMotion(motion_of_pair(draft), key="T" if stated is None else stated.key)


def pose_of(draft: RigDraft, side: Side) -> FloatArray | None:
    """(4, 4) transform from a frame that the cameras share to a camera: by its pose on a body, by R
    and T of each camera, or by the transforms from the camera before it; None = unknown.
    """
    body = draft.get(side, "body", is_own=True)
    if body is not None:
        pose = _rigid(body)
        return pose if body.meaning.is_inverse else inverse_motion(pose)
    if any(draft.own(one, "T") is not None for one in draft.sides if one is not None):
        is_moved = draft.own(side, "T") is not None
        is_turned = draft.own(side, "R") is not None or draft.own(side, "rect") is not None
        is_first = side == draft.sides[0] and not is_moved
        return _pose(draft, side) if is_first or (is_moved and is_turned) else None
    numbers = [one for one in draft.sides if isinstance(one, int)]
    if not isinstance(side, int) or not any(_link(draft, one) for one in numbers):
        return None
    pose, number = np.eye(4), side
    while (link := _link(draft, number)) is not None:
        pose = np.asarray(pose @ _rigid(link))
        number -= 1
    return pose if number == numbers[0] else None


def _link(draft: RigDraft, number: int) -> Stated | None:
    """Kalibr's transform from the camera before a camera, T_cn_cnm1."""
    stated = draft.get(number, "transform", is_own=True)
    return stated if stated is not None and stated.key.endswith("T_cn_cnm1") else None


def _rigid(stated: Stated) -> FloatArray:
    """(4, 4) transform of 16 or 12 numbers."""
    if not np.allclose(stated.value[12:], (0.0, 0.0, 0.0, 1.0)[: stated.value.size - 12]):
        raise RigError(
            f"{stated.path}: expected 0, 0, 0, 1 in the last row of {stated.key}, found "
            f"{quoted(stated.value[12:].tolist())}; give the file unchanged."
        )
    rotation, translation = np.split(stated.value.reshape(-1, 4)[:3], [3], axis=1)
    return rigid_motion(rotation, translation)


def motion_of_pair(draft: RigDraft) -> FloatArray:
    """(4, 4) transform of R and T of the pair."""
    return _from_first(_pose(draft, None), draft.get(None, "T"))


def _from_first(motion: FloatArray, stated: Stated | None) -> FloatArray:
    """The transform from the first camera to the second of one in a stated direction."""
    is_inverse = stated is not None and stated.meaning.is_inverse
    return inverse_motion(motion) if is_inverse else motion


def checked_with_rectification(draft: RigDraft, motion: PairMotion) -> PairMotion:
    """The transform, inverted if R1 and R2 in the same files show that, and notes on contradictions
    with them and P2.
    """
    motion = _checked_rotation(draft, motion)
    p = draft.own(draft.pair[1], "P")
    if p is None or p.size != 12 or not p[3]:
        return motion
    length, projected = float(np.linalg.norm(motion.matrix[:3, 3])), abs(float(p[3] / p[0]))
    if abs(projected / max(length, 1e-9) - 1) <= TOLERANCE:
        return motion
    note = f"{draft.path}: |T| is {length:.4g}, but P2[0, 3] / f is {projected:.4g}; T is used."
    return motion._replace(notes=(*motion.notes, note))


def projections_of(draft: RigDraft) -> list[FloatArray] | None:
    """The (3, 4) projection matrices of both rectified cameras; None if one is missing."""
    projections = [draft.of(side, "P") for side in draft.pair]
    if all(p is not None and p.size == 12 for p in projections):
        return [p.reshape(3, 4) for p in projections]
    return None


def offset_of(first: FloatArray, second: FloatArray) -> float:
    """-B of two projection matrices (3, 4), in the unit of the file."""
    return float(second[0, 3] / second[0, 0] - first[0, 3] / first[0, 0])


def _motion_of_rectification(draft: RigDraft) -> FloatArray | None:
    """R = R2^T R1, T = R2^T (-B, 0, 0); None without R1 and R2, and P1 and P2 or f B."""
    projections = projections_of(draft)
    first, second = (draft.of(side, "rect") for side in draft.pair)
    bf, fx = draft.own(None, "bf"), draft.own(None, "fx")  # of rectified images, as stella_vslam's
    if first is None or second is None:
        return None
    if projections is not None:
        offset = offset_of(*projections)
    elif bf is not None and fx is not None:
        offset = -float(bf[0] / fx[0])
    else:
        return None
    r1, r2 = first.reshape(3, 3), second.reshape(3, 3)
    return rigid_motion(r2.T @ r1, r2.T @ [offset, 0.0, 0.0])


def _missing(draft: RigDraft) -> list[str]:
    """Names of the matrices of a pair that the files lack."""
    second = draft.pair[1]
    missing = [
        name
        for name, quantities in _SECOND_CAMERA.items()
        if all(draft.own(second, quantity) is None for quantity in quantities)
    ]
    return [*missing, *(name for name in ("R", "T") if draft.of(None, name) is None)]


def _pose(draft: RigDraft, side: Side) -> FloatArray:
    """(4, 4) transform of R and T of a side; the identity for a camera without them."""
    stated = draft.get(side, "R", is_own=True) or draft.get(side, "rect", is_own=True)
    rotation = np.eye(3)
    if stated is not None and stated.value.size == 3:
        rotation = np.asarray(cv2.Rodrigues(stated.value)[0])
    elif stated is not None:
        rotation = shaped(stated, (3, 3), "R")
    translation = draft.get(side, "T", is_own=True)
    return rigid_motion(
        rotation, np.zeros(3) if translation is None else shaped(translation, (3,), "T")
    )


def _checked_rotation(draft: RigDraft, motion: PairMotion) -> PairMotion:
    """Comparison of R with R1 and R2: R2 R R1^T = 1."""
    rect1, rect2 = (draft.own(side, "rect") for side in draft.pair)
    is_complete = draft.own(draft.pair[1], "P") is not None and draft.pair_has("T")
    if rect1 is None or rect2 is None or not is_complete:
        return motion
    r1, r2 = rect1.reshape(3, 3), rect2.reshape(3, 3)
    rotation = motion.matrix[:3, :3]
    error, error_of_inverse = (
        float(np.abs(r2 @ either @ r1.T - np.eye(3)).max()) for either in (rotation, rotation.T)
    )
    if error <= TOLERANCE:
        return motion
    if error_of_inverse < TOLERANCE:
        note = (
            f"{draft.path}: R and T are the transform from camera 2 to camera 1, by R1 and R2; "
            "they are inverted."
        )
        return motion._replace(matrix=inverse_motion(motion.matrix), notes=(*motion.notes, note))
    note = (
        f"{draft.path}: R contradicts R1 and R2, which rectify another pair (R2 R R1^T differs from "
        f"the identity by {error:.2g}); R and T are used."
    )
    return motion._replace(notes=(*motion.notes, note))
