"""Parts of a camera from the quantities of a calibration."""

import math
from pathlib import Path

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import quoted
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.geometry.rig_checks import MAX_SIDE_PX
from track_range.stereo.rig_formats.values.quantities import Quantities, Side

_FISHEYE_RAD = 1.6  # 2 cx / fx of images with four coefficients above which the lens is a fisheye
_FISHEYE_MODELS = ("kannala", "fisheye", "equidistant")  # words in the name of the lens model
_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")  # in OpenCV's order


def of_scalars(given: Quantities, side: Side) -> FloatArray | None:
    """(4,) fx, fy, cx, cy by their names; None if they are incomplete."""
    fx, fy = given.of(side, "fx"), given.of(side, "fy")
    cx, cy = given.of(side, "cx"), given.of(side, "cy")
    centre = given.of(side, "centre")
    if fx is None:
        return None
    focal = [fx[0], fx[-1] if fy is None else fy[0]]
    if centre is not None:
        return np.array([*focal, *centre])
    if cx is None or cy is None:
        return None
    return np.array([*focal, cx[0], cy[0]])


def distortion_of(given: Quantities, side: Side) -> FloatArray | None:
    """OpenCV's coefficients of a camera, in D, as MATLAB's radial and tangential coefficients, or
    by their names.
    """
    distortion = given.of(side, "D")
    if distortion is not None:
        n_missing = max(4 - distortion.size, 0)
        return np.append(distortion, [0.0] * n_missing) if n_missing else np.asarray(distortion)
    radial, tangential = given.of(side, "radial"), given.of(side, "tangential")
    if radial is not None:
        if tangential is None:
            tangential = np.zeros(2)
        return np.array([*radial[:2], *tangential, *radial[2:]])
    numbers = {name: given.of(side, name) for name in _COEFFICIENTS}
    values = {name: float(number[0]) for name, number in numbers.items() if number is not None}
    if not values:
        return None
    return np.array([values.get(name, 0.0) for name in _names_in_order(values)])


def _names_in_order(values: dict[str, float]) -> tuple[str, ...]:
    """Names of the coefficients of the lens model that has these values."""
    if "k4" in values and "p1" not in values and "k5" not in values:  # Kannala-Brandt
        return ("k1", "k2", "k3", "k4")
    if any(values.get(name) for name in ("k4", "k5", "k6")):
        return _COEFFICIENTS
    return _COEFFICIENTS[:5] if "k3" in values else _COEFFICIENTS[:4]


def fisheye_of(given: Quantities, side: Side, path: Path) -> tuple[bool, tuple[str, ...]]:
    """Whether the lens is OpenCV's fisheye model, as the file states, or by four coefficients and
    the field of view; with a note in the latter case.
    """
    flag = given.of(None, "fisheye")
    if flag is not None:
        return bool(flag.any()), ()
    if _has_fisheye_names(given, side):
        return True, ()
    distortion = distortion_of(given, side)
    matrix = given.of(side, "K")
    if distortion is None or distortion.size != 4 or matrix is None or matrix.size != 9:
        return False, ()
    if not given.names.get((side, "K"), "").startswith("K"):
        return False, ()
    fx, cx = matrix[0], matrix[2]
    is_wide = bool(2 * cx > _FISHEYE_RAD * fx)
    lens, other = (
        ("OpenCV's fisheye model", 0) if is_wide else ("k1, k2, p1, p2 of a usual lens", 1)
    )
    note = (
        f"{path}: the four coefficients are read as {lens}, because of the field of view of "
        f"{math.degrees(2 * math.atan(cx / fx)):.0f} degrees; if this is wrong, add fisheye_model: "
        f"{other}."
    )
    return is_wide, (note,)


def _has_fisheye_names(given: Quantities, side: Side) -> bool:
    """Whether the model is called a fisheye, or the coefficients have the names of one."""
    model = str(given.of(side, "model") or "").lower()
    if model == "kb" or any(word in model for word in _FISHEYE_MODELS):
        return True
    has_k4, has_p1, has_k5 = (given.of(side, name) is not None for name in ("k4", "p1", "k5"))
    return has_k4 and not has_p1 and not has_k5


def stated_size(given: Quantities, side: Side, centre: FloatArray) -> FloatArray | None:
    """(2,) width and height of the images, in the order that fits their principal point, (2,); None
    = not stated.
    """
    sides: list[Side] = [side, None] if side is not None else [None, *given.sides()]
    width, height, size = (
        next((given.values[place, name] for place in sides if (place, name) in given.values), None)
        for name in ("width", "height", "size")
    )
    if width is not None and height is not None:
        return np.array([width[0], height[0]])
    if size is None:
        return None
    either = size[[0, 1]], size[[1, 0]]  # or rows and columns, as MATLAB's and NumPy's
    return np.asarray(min(either, key=lambda size: float(np.abs(size / 2 - centre).sum())))


def size_px_of(
    given: Quantities, side: Side, centre_px: tuple[float, float], path: Path
) -> tuple[int, int]:
    """(width, height) of the images with this principal point; (0, 0) = not in the file."""
    size = stated_size(given, side, np.array(centre_px))
    if size is None:
        return 0, 0
    if not ((size >= 1) & (size <= MAX_SIDE_PX)).all():
        raise RigError(
            f"{path}: expected an image_width and image_height of 1 to {MAX_SIDE_PX} px, found "
            f"{quoted(size.tolist())}; correct the file."
        )
    return round(float(size[0])), round(float(size[1]))
