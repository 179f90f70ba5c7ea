"""Parts of a camera, and the cameras, from the draft of a calibration."""

import math
import re
from typing import NamedTuple

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import quoted, shortened
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.geometry.rig_checks import MAX_SIDE_PX
from track_range.stereo.lenses.lens import KANNALA_BRANDT, PINHOLE, KalibrModel
from track_range.stereo.lenses.registry import LENSES
from track_range.stereo.rig_formats.values.aliases import COEFFICIENTS, Side
from track_range.stereo.rig_formats.values.draft import RigDraft
from track_range.stereo.rig_formats.values.lens_models import stated_lens
from track_range.stereo.rig_formats.values.stated import Stated

_FISHEYE_RAD = 1.6  # 2 cx / fx of images with four coefficients above which the lens is a fisheye
_MIN_SKEW_PX = 0.5  # of a skew that is worth a note
_SIZE = re.compile(r"(\d{3,5})x(\d{3,5})")  # in the name of a camera or mode


class StatedLens(NamedTuple):
    """The lens model of a camera."""

    name: str
    notes: tuple[str, ...] = ()  # on a model that is not stated
    model: KalibrModel | None = None  # as stated

    @property
    def is_ideal(self) -> bool:
        """Whether the file states that there is no distortion."""
        return self.model is not None and self.model.distortion == "none"


def camera_of(draft: RigDraft, side: Side, number: int) -> PinholeCamera:
    """The camera of a side, the first (1) or second (2); RigError if a part is missing, or cannot
    be that of a camera.
    """
    lens = lens_of(draft, side)
    matrix = matrix_of(draft, side, number)
    if matrix is None:
        raise incomplete(draft, [f"M{number}"])
    coefficients = _coefficients(draft, side, number, lens)
    return PinholeCamera.of_matrix(
        matrix, size_px_of(draft, side, matrix[:2, 2]), coefficients, lens.name
    )


def _coefficients(draft: RigDraft, side: Side, number: int, lens: StatedLens) -> FloatArray:
    """The coefficients of a lens; RigError if they are missing, or of another number."""
    names = LENSES.named(lens.name).coefficients
    scalars = [draft.of(side, name) for name in names]
    if lens.name not in (PINHOLE, KANNALA_BRANDT) and None not in scalars:
        return np.array([scalar[0] for scalar in scalars])
    matrix = draft.of(side, "K")
    n_leading = _n_leading(draft, side)
    leading = np.zeros(0)
    if matrix is not None and matrix.size == 4 + n_leading:
        leading = matrix[:n_leading]
    distortion = distortion_of(draft, side)
    if lens.model is not None and lens.is_ideal:
        distortion = np.zeros(len(names) - lens.model.n_intrinsics)
    if distortion is None:
        if not _may_be_ideal(draft, side, lens):
            raise _without_distortion(draft, side, number)
        distortion = np.zeros(0)
    if lens.name == PINHOLE:
        if lens.is_ideal or not distortion.size:
            return np.zeros(0)
        n_missing = max(4 - distortion.size, 0) if lens.model is None else 0
        return np.append(distortion, np.zeros(n_missing))
    return _of_wide_lens(draft, side, lens.name, np.append(leading, distortion))


def _may_be_ideal(draft: RigDraft, side: Side, lens: StatedLens) -> bool:
    """Whether a camera without coefficients is one of undistorted images, by its kind of file."""
    is_of_parallel_pair = draft.dialect.is_rectified or draft.pair_has("baseline", "bf")
    states_terms = lens.model is not None and any(
        "distort" in key for key in draft.stated_models(side)
    )
    is_ideal_without = draft.dialect.is_ideal_without and not states_terms
    return is_of_parallel_pair or is_ideal_without or draft.is_undistorted


def _of_wide_lens(draft: RigDraft, side: Side, lens: str, coefficients: FloatArray) -> FloatArray:
    """As many coefficients as a lens has; RigError for another number."""
    names = LENSES.named(lens).coefficients
    n_missing = len(names) - coefficients.size
    is_by_name = draft.get(side, "D") is None  # of which files leave out those that are 0
    if n_missing > 0 and is_by_name and draft.dialect.is_ideal_without:
        return np.append(coefficients, np.zeros(n_missing))
    if n_missing > 0 or coefficients[len(names) :].any():
        raise RigError(
            f"{draft.path}: expected {len(names)} coefficients ({' '.join(names)}) of the lens "
            f"model {lens}, which the file states, in {_key(draft, side, 'D')}, found "
            f"{coefficients.size}; give all of them."
        )
    return coefficients[: len(names)]


def _without_distortion(draft: RigDraft, side: Side, number: int) -> RigError:
    """The error of a camera without coefficients; zeros are advised only where the file has none of
    any kind.
    """
    expected = (
        f"{draft.path}: expected the distortion coefficients D{number} of the camera "
        f"{shortened(_name(draft, side, number), 40)}, found"
    )
    name = draft.names.get(side)
    unread = [key for key in draft.unread if name is None or name in key.split(".")]
    if unread:
        return RigError(
            f"{expected} {shortened(', '.join(unread), 60)}, which are not understood; write "
            "OpenCV's k1, k2, p1, p2, k3 as D1, or a rig.yaml (track-range rig template FILE)."
        )
    return RigError(f"{expected} none; write zeros for undistorted images.")


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
    if shape == (3, 3) and values.size == 12:  # with a column of zeros
        values = values.reshape(3, 4)[:, :3]
    if values.size != np.prod(shape):
        raise RigError(
            f"{stated.path}: expected {np.prod(shape)} numbers in {name}, found {values.size}; "
            "calibrate again."
        )
    return values.reshape(shape)


def _key(draft: RigDraft, side: Side, quantity: str) -> str:
    """The key of a value, for messages."""
    stated = draft.get(side, quantity)
    return quantity if stated is None else stated.key


def _name(draft: RigDraft, side: Side, number: int) -> str:
    """The key of a camera's matrix, for messages."""
    stated = draft.get(side, "K", is_own=True)
    return f"M{number}" if stated is None else stated.key


def matrix_of(draft: RigDraft, side: Side, number: int) -> FloatArray | None:
    """(3, 3) camera matrix, with pixels counted from 0; None if it is incomplete."""
    stated = draft.get(side, "K")
    n_leading = _n_leading(draft, side)
    if stated is None or stated.value.size in (4, 4 + n_leading):
        numbers = of_scalars(draft, side) if stated is None else stated.value[-4:]
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
    if draft.dialect.convention is not None:
        numbers = matrix[[0, 1, 0, 1], [0, 1, 2, 2]]
        size = stated_size(draft, side, numbers[2:])
        if size is None:
            raise RigError(
                f"{draft.path}: expected the size of the images, found none; {draft.dialect.title} "
                "needs its width and height."
            )
        numbers = draft.dialect.convention(numbers, np.asarray(size, np.float64))
        matrix[[0, 1, 0, 1], [0, 1, 2, 2]] = numbers
    matrix[:2, 2] -= 1.0 if is_transposed else draft.dialect.first_pixel
    if not np.array_equal(matrix[2], (0.0, 0.0, 1.0)):
        raise RigError(
            f"{draft.path}: expected 0, 0, 1 in the last row of {_name(draft, side, number)}, found "
            f"{quoted(matrix[2].tolist())}; give the camera matrix."
        )
    return matrix


def _n_leading(draft: RigDraft, side: Side) -> int:
    """How many coefficients of a stated lens stand before fx in a list of Kalibr."""
    stated = stated_lens(draft.stated_models(side), draft.path)
    return 0 if stated is None else stated[1].n_intrinsics


def of_scalars(draft: RigDraft, side: Side) -> FloatArray | None:
    """(4,) fx, fy, cx, cy by their names; None if they are incomplete."""
    fx, fy = draft.of(side, "fx"), draft.of(side, "fy")
    cx, cy = draft.of(side, "cx"), draft.of(side, "cy")
    centre = draft.of(side, "centre")
    if fx is None:
        return None
    b1 = draft.of(side, "b1")
    fx = fx if b1 is None else np.array([fx[0] + b1[0], fx[0]])
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
    if distortion is not None and distortion.size == 3:
        if not draft.dialect.has_radial_only:
            raise RigError(
                f"{draft.path}: expected 4, 5, 8, 12 or 14 distortion coefficients, found 3, which "
                "may be k1 k2 k3 or k1 k2 p1; write k1, k2, p1, p2, k3, with zeros for missing "
                "ones."
            )
        return np.array([*distortion[:2], 0.0, 0.0, distortion[2]])
    if distortion is not None:
        return np.asarray(distortion)
    radial, tangential = draft.of(side, "radial"), draft.of(side, "tangential")
    if radial is not None:
        if tangential is None:
            tangential = np.zeros(2)
        radial = np.append(radial, np.zeros(max(2 - radial.size, 0)))
        return np.array([*radial[:2], *tangential, *radial[2:]])
    numbers = {name: draft.of(side, name) for name in COEFFICIENTS}
    values = {name: float(number[0]) for name, number in numbers.items() if number is not None}
    if not values:
        return None
    if is_fisheye_lens(draft, side) and "k5" in values and "k1" not in values:
        values = {f"k{n}": values.get(f"k{n + 1}", 0.0) for n in range(1, 5)}  # camodocal's
    if draft.dialect.is_tangential_swapped:
        values |= {"p1": values.get("p2", 0.0), "p2": values.get("p1", 0.0)}
    if draft.dialect.has_radial_k4 and not is_fisheye_lens(draft, side):
        values.pop("k4", None)
    return np.array([values.get(name, 0.0) for name in _names_in_order(draft, side, values)])


def _names_in_order(draft: RigDraft, side: Side, values: dict[str, float]) -> tuple[str, ...]:
    """Names of the coefficients of the lens model that has these values."""
    if is_fisheye_lens(draft, side):
        return ("k1", "k2", "k3", "k4")
    if any(values.get(name) for name in ("k4", "k5", "k6")):
        return COEFFICIENTS
    return COEFFICIENTS[:5] if "k3" in values else COEFFICIENTS[:4]


def is_fisheye_lens(draft: RigDraft, side: Side) -> bool:
    """Whether the lens is OpenCV's fisheye model, as stated, or by the names of its coefficients."""
    stated = stated_lens(draft.stated_models(side), draft.path)
    if stated is not None:
        return stated[0] == KANNALA_BRANDT
    has_k4, has_p1, has_k5 = (draft.of(side, name) is not None for name in ("k4", "p1", "k5"))
    return has_k4 and not has_p1 and not has_k5


def lens_of(draft: RigDraft, side: Side) -> StatedLens:
    """The lens model of a camera, as the file states, or by its coefficients and the field of view,
    with a note in the latter case.
    """
    stated = stated_lens(draft.stated_models(side), draft.path)
    if stated is not None:
        return StatedLens(stated[0], model=stated[1])
    if is_fisheye_lens(draft, side):
        note = (
            f"{draft.path}: k1, k2, k3 and k4 without p1 are read as OpenCV's fisheye model; if "
            "this is wrong, add fisheye_model: 0."
        )
        return StatedLens(KANNALA_BRANDT, (note,))
    distortion = draft.of(side, "D")
    matrix = matrix_of(draft, side, 1)
    if distortion is None or distortion.size != 4 or matrix is None:
        return StatedLens(PINHOLE)
    fx, cx = matrix[0, 0], matrix[0, 2]
    is_wide = bool(2 * cx > _FISHEYE_RAD * fx)
    is_named_k = _name(draft, side, 1).startswith("K")
    if not (is_wide or is_named_k):
        return StatedLens(PINHOLE)
    is_fisheye = is_wide and is_named_k
    lens, other = (
        ("OpenCV's fisheye model", 0) if is_fisheye else ("k1, k2, p1, p2 of a usual lens", 1)
    )
    note = (
        f"{draft.path}: the four coefficients are read as {lens}, "
        f"{'because of the' if is_fisheye == is_wide else 'at a'} field of view of "
        f"{math.degrees(2 * math.atan(cx / fx)):.0f} degrees; if this is wrong, add fisheye_model: "
        f"{other}."
    )
    return StatedLens(KANNALA_BRANDT if is_fisheye else PINHOLE, (note,))


def camera_notes(draft: RigDraft, side: Side) -> tuple[str, ...]:
    """Notes on what the file does not state about a camera, and what a camera here does not have."""
    matrix = draft.get(side, "K")
    matrix_key = "" if matrix is None else matrix.key
    is_fisheye = is_fisheye_lens(draft, side)
    skew_px, k4, p1, p2, p3, p4 = (
        _scalar(draft, side, name) for name in ("skew", "k4", "p1", "p2", "p3", "p4")
    )
    sentences = (
        (draft.dialect.assumption, f"assumed: {draft.dialect.assumption}."),
        (
            "original" in matrix_key.lower(),
            f"{matrix_key}, of the images as recorded, is used; for undistorted images write a "
            "rig.yaml with the other matrix and without distortion.",
        ),
        (abs(skew_px) > _MIN_SKEW_PX, f"the skew of {skew_px:.4g} px is left out."),
        (
            k4 and draft.dialect.has_radial_k4 and not is_fisheye,
            f"k4, {k4:.4g}, is the coefficient of r^8 here, which OpenCV's model does not have, "
            "and is left out; only the corners of the images need it.",
        ),
        (
            is_fisheye and (p1 or p2),
            "p1 and p2 are left out, which OpenCV's fisheye model does not have.",
        ),
        (p3 or p4, "p3 and p4 are left out, which OpenCV's models do not have."),
    )
    notes = (f"{draft.path}: {sentence}" for is_true, sentence in sentences if is_true)
    return (*lens_of(draft, side).notes, *notes)


def _scalar(draft: RigDraft, side: Side, name: str) -> float:
    """A number by name; 0 without it."""
    stated = draft.of(side, name)
    return 0.0 if stated is None else float(stated[0])


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
        named = _SIZE.search(draft.name_of(side))
        return None if named is None else np.array([float(number) for number in named.groups()])
    if size.is_assumed:
        return np.asarray(size.value)
    sides_px = shaped(size._replace(value=size.value[:2]), (2,), size.key)
    either = sides_px, sides_px[::-1]  # or rows and columns, as MATLAB's and NumPy's
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
