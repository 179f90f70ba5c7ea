"""Parts of a camera, and the cameras, from the draft of a calibration."""

import math

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import quoted
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.geometry.rig_checks import MAX_SIDE_PX
from track_range.stereo.lenses.lens import KANNALA_BRANDT, PINHOLE
from track_range.stereo.rig_formats.values.aliases import COEFFICIENTS, Side
from track_range.stereo.rig_formats.values.draft import RigDraft
from track_range.stereo.rig_formats.values.stated import Stated

_FISHEYE_RAD = 1.6  # 2 cx / fx of images with four coefficients above which the lens is a fisheye
_FISHEYE_MODELS = ("kannala", "fisheye", "equidistant")  # words in the name of the lens model


def camera_of(draft: RigDraft, index: int) -> PinholeCamera:
    """The first (0) or second (1) camera; RigError if a part is missing, or cannot be that of a
    camera.
    """
    side, number = draft.pair[index], index + 1
    matrix, distortion = matrix_of(draft, side, number), distortion_of(draft, side)
    if matrix is None:
        raise incomplete(draft, [f"M{number}"])
    is_of_parallel_pair = draft.dialect.is_rectified or draft.pair_has("baseline", "bf")
    if distortion is None and not is_of_parallel_pair:
        raise RigError(
            f"{draft.path}: expected the distortion coefficients D{number} of the camera "
            f"{_name(draft, side, number)}, found none; write zeros for undistorted images."
        )
    coefficients = np.zeros(0) if distortion is None else distortion
    is_fisheye = coefficients.size == 4 and lens_of(draft)[0]
    size_px = size_px_of(draft, side, matrix[:2, 2])
    return PinholeCamera.of_matrix(
        matrix, size_px, coefficients, KANNALA_BRANDT if is_fisheye else PINHOLE
    )


def incomplete(draft: RigDraft, missing: list[str]) -> RigError:
    """The error of a pair without the matrices with these names."""
    return RigError(
        f"{draft.path}: expected M2, D2, R, T of two cameras in this file or "
        f"intrinsics/extrinsics{draft.path.suffix} in its folder, found no {', '.join(missing)}; give "
        "the complete calibration, one with M1 and D1 for one camera, or complete a track-range "
        f"rig template (keys found: {draft.listed_keys})."
    )


def shaped(stated: Stated, shape: tuple[int, ...], name: str) -> FloatArray:
    """The numbers of a value in this shape; RigError for another number of numbers."""
    values: FloatArray = stated.value
    if values.size != np.prod(shape):
        raise RigError(
            f"{stated.path}: expected {np.prod(shape)} numbers in {name}, found {values.size}; "
            "calibrate again."
        )
    return values.reshape(shape)


def _name(draft: RigDraft, side: Side, number: int) -> str:
    """The key of a camera's matrix, for messages."""
    stated = draft.get(side, "K", is_own=True)
    return f"M{number}" if stated is None else stated.key


def matrix_of(draft: RigDraft, side: Side, number: int) -> FloatArray | None:
    """(3, 3) camera matrix, with pixels counted from 0; None if it is incomplete."""
    stated = draft.get(side, "K")
    if stated is None or stated.value.size == 4:
        numbers = of_scalars(draft, side) if stated is None else stated.value
        if numbers is None:
            return None
        fx, fy, cx, cy = numbers
        matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    else:
        matrix = shaped(stated, (3, 3), _name(draft, side, number)).copy()
    # MATLAB's are transposed
    is_transposed = matrix[2, 0] and matrix[2, 1] and not (matrix[0, 2] or matrix[1, 2])
    if is_transposed:
        matrix = matrix.T.copy()
    matrix[:2, 2] -= 1.0 if is_transposed else draft.dialect.first_pixel
    if not np.array_equal(matrix[2], (0.0, 0.0, 1.0)):
        raise RigError(
            f"{draft.path}: expected 0, 0, 1 in the last row of {_name(draft, side, number)}, found "
            f"{quoted(matrix[2].tolist())}; give the camera matrix."
        )
    return matrix


def of_scalars(draft: RigDraft, side: Side) -> FloatArray | None:
    """(4,) fx, fy, cx, cy by their names; None if they are incomplete."""
    fx, fy = draft.of(side, "fx"), draft.of(side, "fy")
    cx, cy = draft.of(side, "cx"), draft.of(side, "cy")
    centre = draft.of(side, "centre")
    if fx is None:
        return None
    focal = [fx[0], fx[-1] if fy is None else fy[0]]
    if centre is not None:
        return np.array([*focal, *centre])
    if cx is None or cy is None:
        return None
    return np.array([*focal, cx[0], cy[0]])


def distortion_of(draft: RigDraft, side: Side) -> FloatArray | None:
    """OpenCV's coefficients of a camera, in D, as MATLAB's radial and tangential coefficients, or
    by their names.
    """
    distortion = draft.of(side, "D")
    if distortion is not None:
        n_missing = max(4 - distortion.size, 0)
        return np.append(distortion, [0.0] * n_missing) if n_missing else np.asarray(distortion)
    radial, tangential = draft.of(side, "radial"), draft.of(side, "tangential")
    if radial is not None:
        if tangential is None:
            tangential = np.zeros(2)
        return np.array([*radial[:2], *tangential, *radial[2:]])
    numbers = {name: draft.of(side, name) for name in COEFFICIENTS}
    values = {name: float(number[0]) for name, number in numbers.items() if number is not None}
    if not values:
        return None
    return np.array([values.get(name, 0.0) for name in _names_in_order(values)])


def _names_in_order(values: dict[str, float]) -> tuple[str, ...]:
    """Names of the coefficients of the lens model that has these values."""
    if "k4" in values and "p1" not in values and "k5" not in values:  # Kannala-Brandt
        return ("k1", "k2", "k3", "k4")
    if any(values.get(name) for name in ("k4", "k5", "k6")):
        return COEFFICIENTS
    return COEFFICIENTS[:5] if "k3" in values else COEFFICIENTS[:4]


def lens_of(draft: RigDraft) -> tuple[bool, tuple[str, ...]]:
    """Whether the lens is OpenCV's fisheye model, as the file states, or by four coefficients and
    the field of view; with a note in the latter case.
    """
    side = draft.pair[0]
    flag = draft.of(None, "fisheye")
    if flag is not None:
        return bool(flag.any()), ()
    if _has_fisheye_names(draft, side):
        return True, ()
    distortion = distortion_of(draft, side)
    matrix = draft.of(side, "K")
    has_four = distortion is not None and distortion.size == 4
    if not has_four or matrix is None or matrix.size != 9:
        return False, ()
    if not _name(draft, side, 1).startswith("K"):
        return False, ()
    fx, cx = matrix[0], matrix[2]
    is_wide = bool(2 * cx > _FISHEYE_RAD * fx)
    lens, other = (
        ("OpenCV's fisheye model", 0) if is_wide else ("k1, k2, p1, p2 of a usual lens", 1)
    )
    note = (
        f"{draft.path}: the four coefficients are read as {lens}, because of the field of view of "
        f"{math.degrees(2 * math.atan(cx / fx)):.0f} degrees; if this is wrong, add fisheye_model: "
        f"{other}."
    )
    return is_wide, (note,)


def _has_fisheye_names(draft: RigDraft, side: Side) -> bool:
    """Whether the model is called a fisheye, or the coefficients have the names of one."""
    model = str(draft.of(side, "model") or "").lower()
    if model == "kb" or any(word in model for word in _FISHEYE_MODELS):
        return True
    has_k4, has_p1, has_k5 = (draft.of(side, name) is not None for name in ("k4", "p1", "k5"))
    return has_k4 and not has_p1 and not has_k5


def stated_size(draft: RigDraft, side: Side, centre: FloatArray) -> FloatArray | None:
    """(2,) width and height of the images, in the order that fits their principal point, (2,); None
    = not stated.
    """
    sides: list[Side] = [side, None] if side is not None else [None, *draft.sides]
    width, height, size = (
        next((value for place in sides if (value := draft.get(place, name, is_own=True))), None)
        for name in ("width", "height", "size")
    )
    if width is not None and height is not None:
        return np.array([width.value[0], height.value[0]])
    if size is None:
        return None
    if size.is_assumed:
        return np.asarray(size.value)
    either = size.value[[0, 1]], size.value[[1, 0]]  # or rows and columns, as MATLAB's and NumPy's
    return np.asarray(min(either, key=lambda size: float(np.abs(size / 2 - centre).sum())))


def size_px_of(draft: RigDraft, side: Side, centre_px: FloatArray) -> tuple[int, int]:
    """(width, height) of the images with this principal point, (2,); (0, 0) = not in the file."""
    size = stated_size(draft, side, centre_px)
    if size is None:
        return 0, 0
    if not ((size >= 1) & (size <= MAX_SIDE_PX)).all():
        raise RigError(
            f"{draft.path}: expected an image_width and image_height of 1 to {MAX_SIDE_PX} px, found "
            f"{quoted(size.tolist())}; correct the file."
        )
    return round(float(size[0])), round(float(size[1]))


def stated_camera(draft: RigDraft, index: int) -> dict[str, object]:
    """The values of the first (0) or second (1) camera that are known, by key of rig.yaml."""
    if index and not draft.has_two_cameras:
        return {}
    side = draft.pair[index]
    values: dict[str, object] = {}
    matrix = matrix_of(draft, side, index + 1)
    if matrix is not None:
        focal = matrix[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
        values |= zip(("fx_px", "fy_px", "cx_px", "cy_px"), focal, strict=True)
    size = stated_size(draft, side, np.zeros(2) if matrix is None else matrix[:2, 2])
    if size is not None:
        values |= {"width_px": round(float(size[0])), "height_px": round(float(size[1]))}
    distortion = distortion_of(draft, side)
    return values if distortion is None else values | {"distortion": distortion.tolist()}
