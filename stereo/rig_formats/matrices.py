"""Calibrations with matrices or numbers by name, from OpenCV, scripts, data sets and programs.

    K1 D1 K2 D2 R T          x2 = R x1 + T; T has the unit of the chessboard's square size
    K1 D1 K2 D2 R1 R2 P1 P2  R = R2^T R1, T = R2^T (P2[0, 3] / P2[0, 0], 0, 0)
    P1 P2, or K and B        rectified images: B = -P2[0, 3] / P2[0, 0], or bf / fx

R and T are checked with the rest of the file: the right camera is to the right, R2 R R1^T = 1, |T|
= |P2[0, 3]| / f. (OpenCV, calib3d: stereoCalibrate and stereoRectify; MathWorks: stereoParameters,
cameraIntrinsicsToOpenCV.)
"""

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import quoted, shortened
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.lenses import KANNALA_BRANDT, PINHOLE
from track_range.stereo.geometry.rig import RigError, inverse_motion, rigid_motion
from track_range.stereo.geometry.rig_checks import MAX_SIDE_PX, RigCalibration
from track_range.stereo.rig_formats.rig_format import format_by_pattern
from track_range.stereo.rig_formats.values.containers import (
    EXPECTED,
    K_AND_BASELINE,
    VIRTUAL_KITTI,
    plain_values,
)
from track_range.stereo.rig_formats.values.partners import is_second, other_half, partner_of
from track_range.stereo.rig_formats.values.quantities import (
    Quantities,
    Side,
    quantities_of,
    read_quantities,
)

Pair = tuple[Side, Side]
_WIDE_M = 1.0  # of usual baselines; scripts without a square size have 2 to 5 squares
_VEHICLE = 2.6  # width of the widest vehicles, metres; no baseline is longer
# |T| from which it is read as millimetres, and as centimetres
_MILLIMETRES, _CENTIMETRES = 30.0, 5.0
_FISHEYE_RAD = 1.6  # 2 cx / fx of images with four coefficients above which the lens is a fisheye
_TOLERANCE = 0.02  # largest relative difference of lengths, and difference of rotations, that agree
_UNITS = {
    "mm": 0.001,
    "millimeter": 0.001,
    "cm": 0.01,
    "centimeter": 0.01,
    "m": 1.0,
    "meter": 1.0,
    "in": 0.0254,
}
UNIT_NAMES = {0.001: "millimetres", 0.01: "centimetres", 1.0: "metres", 0.0254: "inches"}
_DOUBT = "in doubt"  # in the place of the reason for a unit


class Kind(NamedTuple):
    """A kind of file with values by name: how it is recognised, and what its files do not state."""

    name: str  # for messages and the table of formats
    title: str
    pattern: re.Pattern[str]  # in the text
    metres_per_unit: float | None = None  # of lengths; None = by their size
    size_px: tuple[int, int] = (0, 0)  # (width, height) of the images of all files of the kind
    assumption: str = ""  # for the note
    is_rectified: bool = False


_M = re.MULTILINE
KINDS = (
    Kind("middlebury", "Middlebury's calib.txt", re.compile(r"^cam0\s*=\s*\[", _M), 0.001, is_rectified=True),
    Kind("cityscapes", "Cityscapes' camera.json", re.compile(r'\A(?=[\s\S]*"baseline")[\s\S]*"u0"'), 1.0,
         (2048, 1024), "images of 2048x1024 px, the size of all Cityscapes images", is_rectified=True),
    Kind("foundation-stereo", "FoundationStereo's K.txt", K_AND_BASELINE, 1.0, is_rectified=True),
    Kind("virtual-kitti", "Virtual KITTI's intrinsic.txt", VIRTUAL_KITTI, 1.0, (1242, 375),
         "the baseline of Virtual KITTI 2 and its images of 1242x375 px", is_rectified=True),
    Kind("orb-slam", "ORB-SLAM's settings", re.compile(r"^(?:Camera1?\.fx|LEFT\.K)\s*:", _M), 1.0),
    Kind("matlab", "MATLAB's stereoParameters", re.compile("(?i)RotationOfCamera2|RadialDistortion")),
    Kind("realsense-json", "RealSense's intrinsics and extrinsics in JSON", re.compile(r'"(?:ppx|PPX)"'), 1.0),
    Kind("opencv", "the files of OpenCV's stereo_calib", re.compile("opencv-matrix|<opencv_storage>")),
    Kind("matrices", "matrices by name, K1 D1 K2 D2 R T", re.compile("")),
)  # fmt: skip
_EXTRINSIC = ("R", "T", "second_from_first", "first_from_second")


def read_kind(kind: Kind, text: str, path: Path, *, is_pair: bool) -> RigCalibration:
    """The cameras of a file of a kind; with the files beside it that complete a pair, if
    `is_pair`.
    """
    expected = "a calibration of OpenCV" if kind.name == "opencv" else EXPECTED
    given, beside = _completed(
        quantities_of(plain_values(text, path, expected), path), path, is_pair=is_pair
    )
    if not given.has("K", "fx", "P"):
        raise RigError(_unusable(given, path))
    sides = given.sides()[:2] or [None]
    pair: Pair = sides[0], sides[1] if len(sides) == 2 else 2
    title = kind.title + (f" with {' and '.join(file.name for file in beside)}" if beside else "")
    notes: list[str] = []
    is_fisheye = _is_fisheye(given, sides, path, notes)
    has_extrinsics = given.has(*_EXTRINSIC)
    if has_extrinsics and sides in ([2], ["right"]):
        raise _incomplete(given, ["M1"], path)
    projections = _projections(given, pair) if len(sides) == 2 else None
    if projections is not None and not any(given.of(side, "K") is not None for side in sides):
        size_px = _size(given, None, PinholeCamera.of_matrix(projections[0], (0, 0)), path)
        cameras = [PinholeCamera.of_matrix(projection, size_px) for projection in projections]
        note = f"{path}: projection matrices P1 and P2"
        return _parallel(kind, given, cameras, _offset(*projections), note, "rectified images")
    left = _camera(kind, given, sides[0], "1", path, is_fisheye=is_fisheye)
    length = given.of(None, "baseline")
    if length is None and (bf := given.of(None, "bf")) is not None:
        fx = given.of(None, "fx")
        length = bf / (left.fx_px if fx is None else fx)
    is_depth_camera = "DepthMapFactor" in text or (kind.name == "orb-slam" and any(left.distortion))
    if length is not None and not has_extrinsics and projections is None and not is_depth_camera:
        right = (
            _camera(kind, given, sides[1], "2", path, is_fisheye=is_fisheye)
            if len(sides) == 2
            else left
        )
        images = (
            "rectified images" if kind.is_rectified or not left.is_distorted else "parallel cameras"
        )
        notes += [f"{path}: assumed: {kind.assumption}."] if kind.assumption else []
        return _parallel(
            kind, given, [left, right], -abs(float(length[0])), f"{path}: {title}", images, notes
        )
    if not has_extrinsics and len(sides) < 2:
        return RigCalibration(left, None, None, notes=tuple(notes))
    motion = _motion(given, pair, path, notes)
    right = _camera(kind, given, pair[1], "2", path, is_fisheye=is_fisheye)
    length = float(np.linalg.norm(motion[:3, 3]))
    metres, reason = _unit(kind, given, length)
    doubt = (
        f"{path}: expected T in metres, found one {length:.4g} long, which is wider than a vehicle; give its unit: "
        "rig convert FILE rig.yaml --unit mm, cm or m; or multiply T by the side of a square, if it counts squares of "
        "the board."
    )
    _contradictions(given, pair, motion, path, notes)
    motion[:3, 3] *= metres
    notes.insert(0, f"{path}: {title}: the baseline is {length * metres:.4g} m, {reason}.")
    if motion[0, 3] > abs(motion[1, 3]) and sides[0] is not None:
        motion = inverse_motion(motion)
        if sides[0] == "left":
            notes.append(
                f"{path}: R and T put the right camera to the left of the left one, so they are read as the transform "
                "from the right camera to the left one; if the left and the right camera are swapped instead, swap "
                "them in the file."
            )
        else:
            left, right = right, left
            notes.append(
                f"{path}: by T, camera {sides[1]} is to the left of camera {sides[0]} (x2 = R x1 + T), so it is used "
                "as the left camera; if T is its position instead, swap the cameras in the file."
            )
    return RigCalibration(
        left,
        right,
        motion,
        notes=tuple(notes),
        metres_per_unit=metres,
        unit_doubt=doubt if reason == _DOUBT else "",
    )


def _completed(given: Quantities, path: Path, *, is_pair: bool) -> tuple[Quantities, list[Path]]:
    """The quantities, completed by files in the folder of `path`: extrinsics, intrinsics, other
    camera.
    """
    has_cameras, has_extrinsics = (
        given.has("K", "fx"),
        given.has(*_EXTRINSIC, "P", "baseline", "bf"),
    )
    is_single = has_cameras and len(given.sides()) < 2
    if has_extrinsics != has_cameras and (not is_single or "intrinsic" in path.stem):
        other = other_half(path, is_intrinsic=has_cameras)
        merged = given if other is None else given | read_quantities(other)
        if (
            has_cameras
            or other is None
            or len(merged.sides()) == 2
            or (partner := partner_of(other)) is None
        ):
            return merged, [] if other is None else [other]
        return given | _both(other, partner), [other, partner]
    if is_pair and is_single and not has_extrinsics and (partner := partner_of(path)) is not None:
        first, second = (partner, path) if is_second(path) else (path, partner)
        both = _both(first, second)
        other = other_half(path, is_intrinsic=True)
        return (
            (both, [partner])
            if other is None
            else (both | read_quantities(other), [partner, other])
        )
    return given, []


def _both(left: Path, right: Path) -> Quantities:
    return read_quantities(left).of_one_side("left") | read_quantities(right).of_one_side("right")


def _parallel(
    kind: Kind,
    given: Quantities,
    cameras: Sequence[PinholeCamera],
    offset: float,
    note: str,
    images: str,
    notes: Sequence[str] = (),
) -> RigCalibration:
    """The pair of two parallel cameras; `offset` = -B in the unit of the file."""
    metres, reason = _unit(kind, given, abs(offset))
    motion = rigid_motion(np.eye(3), [offset * metres, 0.0, 0.0])
    note = f"{note}: the baseline is {abs(offset) * metres:.5g} m, {reason}; {images}."
    return RigCalibration(
        cameras[0], cameras[1], motion, notes=(note, *notes), metres_per_unit=metres
    )


def _projections(given: Quantities, pair: Pair) -> list[FloatArray] | None:
    """The (3, 4) projection matrices of both rectified cameras; None if one is missing."""
    projections = [given.of(side, "P") for side in pair]
    return (
        [p.reshape(3, 4) for p in projections]
        if all(p is not None and p.size == 12 for p in projections)
        else None
    )


def _offset(first: FloatArray, second: FloatArray) -> float:
    """-B of two projection matrices, in the unit of the file."""
    return float(second[0, 3] / second[0, 0] - first[0, 3] / first[0, 0])


def _motion(given: Quantities, pair: Pair, path: Path, notes: list[str]) -> FloatArray:
    """(4, 4) transform from the first camera's frame to the second's, in the unit of the file."""
    for quantity in ("second_from_first", "first_from_second"):
        if (numbers := given.of(None, quantity)) is not None:
            motion = rigid_motion(*np.split(numbers.reshape(-1, 4)[:3], [3], axis=1))
            return motion if quantity == "second_from_first" else inverse_motion(motion)
    if (None, "T") not in given.values:
        if (pair[1], "T") in given.values:  # a pose of each camera
            first, second = (_pose(given, side, path) for side in pair)
            return np.asarray(second @ inverse_motion(first))
        projections, rotations = (
            _projections(given, pair),
            [given.of(side, "rect") for side in pair],
        )
        if projections is not None and all(rotation is not None for rotation in rotations):
            r1, r2 = (rotation.reshape(3, 3) for rotation in rotations)
            notes.append(f"{path}: R and T are computed from R1, R2, P1 and P2.")
            return rigid_motion(r2.T @ r1, r2.T @ [_offset(*projections), 0.0, 0.0])
    of_second = {"M2": ("K", "fx"), "D2": ("D", "radial", "k1")}
    missing = [
        name
        for name, keys in of_second.items()
        if not any((pair[1], key) in given.values for key in keys)
    ]
    missing += [name for name in ("R", "T") if given.of(None, name) is None]
    if missing:
        raise _incomplete(given, missing, path)
    motion = _pose(given, None, path)
    return inverse_motion(motion) if given.of(None, "inverse") else motion


def _incomplete(given: Quantities, missing: list[str], path: Path) -> RigError:
    return RigError(
        f"{path}: expected M2, D2, R, T of two cameras in this file or intrinsics/extrinsics{path.suffix} in its "
        f"folder, found no {', '.join(missing)}; give the complete calibration, one with M1 and D1 for one camera, "
        f"or complete a track-range rig template (keys found: {_listed(given.keys)})."
    )


def _pose(given: Quantities, side: Side, path: Path) -> FloatArray:
    """(4, 4) transform of R and T of a side; the identity for a camera without them."""
    rotation, translation = (
        given.values.get((side, "R")),
        given.values.get((side, "T"), np.zeros(3)),
    )
    if rotation is None:
        rotation = given.values.get((side, "rect"), np.eye(3))
    rotation = rotation if rotation.size != 3 else np.asarray(cv2.Rodrigues(rotation)[0])
    return rigid_motion(_shaped(rotation, (3, 3), "R", path), _shaped(translation, (3,), "T", path))


def _contradictions(
    given: Quantities, pair: Pair, motion: FloatArray, path: Path, notes: list[str]
) -> None:
    """Compare R and T with the rectification in the same file; an R that is the inverse is inverted
    in place.
    """
    r: list[FloatArray | None] = [given.values.get((side, "rect")) for side in pair]
    p = given.values.get((pair[1], "P"))
    if r[0] is not None and r[1] is not None and p is not None and (None, "T") in given.values:
        r1, r2 = r[0].reshape(3, 3), r[1].reshape(3, 3)
        rotation = motion[:3, :3]
        errors = [
            float(np.abs(r2 @ either @ r1.T - np.eye(3)).max()) for either in (rotation, rotation.T)
        ]
        if errors[0] > _TOLERANCE > errors[1]:
            motion[:] = inverse_motion(motion)
            notes.append(
                f"{path}: R and T are the transform from camera 2 to camera 1, by R1 and R2; they are inverted."
            )
        elif errors[0] > _TOLERANCE:
            notes.append(
                f"{path}: R contradicts R1 and R2, which rectify another pair (R2 R R1^T differs from the identity by "
                f"{errors[0]:.2g}); R and T are used."
            )
    if p is not None and p.size == 12 and p[3]:
        length, projected = float(np.linalg.norm(motion[:3, 3])), abs(float(p[3] / p[0]))
        if abs(projected / max(length, 1e-9) - 1) > _TOLERANCE:
            notes.append(
                f"{path}: |T| is {length:.4g}, but P2[0, 3] / f is {projected:.4g}; T is used."
            )


def _unit(kind: Kind, given: Quantities, length: float) -> tuple[float, str]:
    """Metres per unit of the lengths in a file, and the reason; `length` is the baseline in that
    unit.
    """
    stated = str(given.of(None, "unit") or "").lower().rstrip("s").replace("metre", "meter")
    square, baseline = given.of(None, "square"), given.of(None, "baseline")
    if kind.metres_per_unit is not None:
        return kind.metres_per_unit, f"in {UNIT_NAMES[kind.metres_per_unit]} as in all such files"
    if stated in _UNITS:
        return _UNITS[stated], f"in {UNIT_NAMES[_UNITS[stated]]} as the file states"
    for quantity in ("T", "baseline"):
        unit = _UNITS.get(given.names.get((None, quantity), "").lower().rpartition("_")[2], 0.0)
        length_m = unit * (
            length if quantity == "T" or baseline is None else abs(float(baseline[0]))
        )
        units = [
            u
            for u in (unit, 1.0, 0.01, 0.001)
            if u and length_m and abs(length * u / length_m - 1) < _TOLERANCE
        ]
        if units:
            return units[0], f"in {UNIT_NAMES[units[0]]} by the name of {quantity}"
    if kind.name == "matlab":
        return 0.001, "assuming millimetres, MATLAB's default"
    if length <= _VEHICLE:
        wide = (
            "; a wide baseline: if T counts squares, multiply T by the side of a square"
            if length > _WIDE_M
            else ""
        )
        of_board = (
            "that the square size was given in metres" if (None, "T") in given.values else "metres"
        )
        return 1.0, f"assuming {of_board}{wide}"
    if length <= _CENTIMETRES:
        return 1.0, _DOUBT
    unit = (
        0.001
        if length >= _MILLIMETRES or (square is not None and float(square[0]) > _CENTIMETRES)
        else 0.01
    )
    also = (
        f" (in millimetres it would be {length * 0.001:.3g} m: rig convert --unit mm)"
        if unit == 0.01
        else ""
    )
    return unit, f"since the length of T, {length:.4g}, is taken to be in {UNIT_NAMES[unit]}{also}"


def _camera(
    kind: Kind, given: Quantities, side: Side, number: str, path: Path, *, is_fisheye: bool
) -> PinholeCamera:
    name, matrix = given.names.get((side, "K"), f"M{number}"), given.of(side, "K")
    matrix = _of_scalars(given, side) if matrix is None else matrix
    if matrix is None:
        raise _incomplete(given, [f"M{number}"], path)
    if matrix.size == 4:
        matrix = np.array([matrix[0], 0, matrix[2], 0, matrix[1], matrix[3], 0, 0, 1])
    matrix = _shaped(matrix, (3, 3), name, path)
    is_matlab = kind.name == "matlab"
    # MATLAB's are transposed
    if matrix[2, 0] and matrix[2, 1] and not (matrix[0, 2] or matrix[1, 2]):
        matrix, is_matlab = matrix.T.copy(), True
    if is_matlab:
        matrix[:2, 2] -= 1.0  # MATLAB counts pixels from 1
    if not np.array_equal(matrix[2], (0.0, 0.0, 1.0)):
        raise RigError(
            f"{path}: expected 0, 0, 1 in the last row of {name}, found {quoted(matrix[2].tolist())}; give the camera "
            "matrix."
        )
    distortion = _distortion(given, side)
    if distortion is None:
        if (
            not kind.is_rectified
            and (None, "baseline") not in given.values
            and (None, "bf") not in given.values
        ):
            raise RigError(
                f"{path}: expected the distortion coefficients D{number} of the camera {name}, found none; write zeros "
                "for undistorted images."
            )
        distortion = np.zeros(0)
    lens = KANNALA_BRANDT if is_fisheye and distortion.size == 4 else PINHOLE
    camera = PinholeCamera.of_matrix(matrix, (0, 0), distortion, lens)
    size_px = _size(given, side, camera, path)
    width_px, height_px = size_px if size_px[0] else kind.size_px
    return replace(camera, width_px=width_px, height_px=height_px)


def _of_scalars(given: Quantities, side: Side) -> FloatArray | None:
    """(4,) fx, fy, cx, cy by their names; None if they are incomplete."""
    fx, fy, cx, cy, centre = (given.of(side, name) for name in ("fx", "fy", "cx", "cy", "centre"))
    if fx is None:
        return None
    focal = [fx[0], fx[-1] if fy is None else fy[0]]
    if centre is not None:
        return np.array([*focal, *centre])
    return None if cx is None or cy is None else np.array([*focal, cx[0], cy[0]])


def _distortion(given: Quantities, side: Side) -> FloatArray | None:
    """OpenCV's coefficients of a camera, in D, as MATLAB's radial and tangential coefficients, or
    by their names.
    """
    distortion = given.of(side, "D")
    if distortion is not None:
        return (
            np.append(distortion, [0.0] * (4 - distortion.size))
            if distortion.size < 4
            else distortion
        )
    radial, tangential = given.of(side, "radial"), given.of(side, "tangential")
    if radial is not None:
        tangential = np.zeros(2) if tangential is None else tangential
        return np.array([*radial[:2], *tangential, *radial[2:]])
    names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    values = {
        name: float(number[0]) for name in names if (number := given.of(side, name)) is not None
    }
    if not values:
        return None
    if "k4" in values and "p1" not in values and "k5" not in values:  # Kannala-Brandt
        return np.array([values.get(name, 0.0) for name in ("k1", "k2", "k3", "k4")])
    n = 8 if any(values.get(name) for name in names[5:]) else 5 if "k3" in values else 4
    return np.array([values.get(name, 0.0) for name in names[:n]])


def _is_fisheye(given: Quantities, sides: list[Side], path: Path, notes: list[str]) -> bool:
    """Whether the lens is OpenCV's fisheye model, as the file states, or by four coefficients and
    the field of view.
    """
    if (flag := given.of(None, "fisheye")) is not None:
        return bool(flag.any())
    model = str(given.of(sides[0], "model") or "").lower()
    has_k4 = [given.of(sides[0], name) is not None for name in ("k4", "p1", "k5")] == [
        True,
        False,
        False,
    ]
    if (
        has_k4
        or model == "kb"
        or any(word in model for word in ("kannala", "fisheye", "equidistant"))
    ):
        return True
    distortion, k, name = (
        _distortion(given, sides[0]),
        given.of(sides[0], "K"),
        given.names.get((sides[0], "K"), ""),
    )
    if (
        distortion is None
        or k is None
        or distortion.size != 4
        or not name.startswith("K")
        or k.size != 9
    ):
        return False
    is_wide = bool(2 * k[2] > _FISHEYE_RAD * k[0])
    lens, other = (
        ("OpenCV's fisheye model", 0) if is_wide else ("k1, k2, p1, p2 of a usual lens", 1)
    )
    notes.append(
        f"{path}: the four coefficients are read as {lens}, because of the field of view of "
        f"{math.degrees(2 * math.atan(k[2] / k[0])):.0f} degrees; if this is wrong, add fisheye_model: {other}."
    )
    return is_wide


def _stated_size(given: Quantities, side: Side, centre: FloatArray) -> FloatArray | None:
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


def _size(given: Quantities, side: Side, camera: PinholeCamera, path: Path) -> tuple[int, int]:
    """(width, height) of the images; (0, 0) = not in the file."""
    size = _stated_size(given, side, np.array([camera.cx_px, camera.cy_px]))
    if size is None:
        return 0, 0
    if not ((size >= 1) & (size <= MAX_SIDE_PX)).all():
        raise RigError(
            f"{path}: expected an image_width and image_height of 1 to {MAX_SIDE_PX} px, found "
            f"{quoted(size.tolist())}; correct the file."
        )
    return round(float(size[0])), round(float(size[1]))


def _shaped(values: FloatArray, shape: tuple[int, ...], name: str, path: Path) -> FloatArray:
    if values.size != np.prod(shape):
        raise RigError(
            f"{path}: expected {np.prod(shape)} numbers in {name}, found {values.size}; calibrate again."
        )
    return values.reshape(shape)


def camera_values(given: Quantities, number: int) -> dict[str, object]:
    """The values of the first or second camera that could be read, by key of rig.yaml."""
    values: dict[str, object] = {}
    if number >= len(sides := given.sides() or [None]):
        return values
    side, matrix = sides[number], given.of(sides[number], "K")
    focal = (
        _of_scalars(given, side)
        if matrix is None
        else matrix[[0, 4, 2, 5]]
        if matrix.size == 9
        else matrix
    )
    if focal is not None:
        values |= zip(("fx_px", "fy_px", "cx_px", "cy_px"), focal.tolist(), strict=False)
    centre = np.zeros(2) if focal is None else focal[2:4]
    distortion, size = _distortion(given, side), _stated_size(given, side, centre)
    if size is not None:
        values |= {"width_px": round(float(size[0])), "height_px": round(float(size[1]))}
    return values if distortion is None else values | {"distortion": distortion.tolist()}


def partial_motion(given: Quantities, path: Path) -> FloatArray | None:
    """(4, 4) transform of R and T alone, metres; None if one is missing, or the unit is in
    doubt.
    """
    if given.of(None, "R") is None or given.of(None, "T") is None:
        return None
    motion = _pose(given, None, path)
    metres, reason = _unit(KINDS[-1], given, float(np.linalg.norm(motion[:3, 3])))
    motion[:3, 3] *= metres
    return None if reason == _DOUBT else motion


def _unusable(given: Quantities, path: Path) -> str:
    """The probable kind of a file without cameras, and advice."""
    keys = " ".join(given.keys).lower()
    advice = next((advice for pattern, advice in _SEEN if pattern.search(keys)), None) or (
        "expected the matrix M1 of a camera (or track_range_rig)",
        "track-range rig template FILE writes a rig.yaml with blanks",
    )
    seen = _listed(given.keys) or "none"
    return f"{path}: {advice[0]}, found the keys {seen}; {advice[1]}."


_SEEN = (
    (re.compile(r"stereo_?map|_map_?[xy]|map[lr12]?_?[xy]\b|remap|rectify_?map"), (
        "expected camera matrices, but this file seems to contain only remap tables",
        "give the file with M1, D1, M2, D2, R and T, or P1 and P2, of the same calibration",
    )),
    (re.compile(r"imagelist|images"), (
        "expected a calibration, but this file seems to list images for a calibration",
        "track-range calibrate --stereo 'left*.jpg' 'right*.jpg' --board 9x6 --square-mm 24 calibrates the cameras",
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


def _listed(keys: tuple[str, ...]) -> str:
    return shortened(", ".join(keys[:12]), 60)


FORMATS = {
    kind.name: format_by_pattern(
        kind.name,
        kind.title,
        kind.pattern,
        partial(read_kind, kind, is_pair=False),
        "M2, D2, R and T in this file or in intrinsics/extrinsics{suffix} in its folder",
        partial(read_kind, kind, is_pair=True),
    )
    for kind in KINDS
}
