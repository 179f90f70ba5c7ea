"""KITTI's calib.txt: 3 x 4 projection matrices P0..P3 of rectified cameras, P = K [I | t], t from reference camera 0.

    P0, P1  left and right grey camera       P2, P3  left and right colour camera
    t = K^-1 P[:, 3]                         baseline = -(P3[0, 3] - P2[0, 3]) / fx

The lines are `P2: 12 numbers` in the odometry, tracking and stereo sets; some copies lack the colon, and others are two
lines of 12 numbers without names. The raw set's calib_cam_to_cam.txt has rectified and recorded images:

    P_rect_02, S_rect_02      projection and size of the rectified images
    K_02, D_02, S_02          camera matrix, distortion k1 k2 p1 p2 k3 and size of the images before rectification
    R_02, T_02                x2 = R x0 + T of a point x0 in the frame of camera 0

(Geiger et al., Vision meets Robotics: The KITTI Dataset, IJRR 2013, and the readme of the raw set.)
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import quoted
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.geometry.rig_checks import BASELINE_M, MAX_SIDE_PX, NO_VERTICAL_PAIRS, RigCalibration
from track_range.stereo.rig_formats.rig_format import RigFormat

_LINE = re.compile(r"^[ \t]*(P|S)(?:_rect_0)?([0-3])[ \t]*[: \t][ \t]*(.*)$", re.MULTILINE)
_NUMBER = re.compile(r"[-+.]*\d|[-+]?(nan|inf)", re.IGNORECASE)  # beginning of a word that is a number
_MIN_NAMELESS = 9  # smallest number of words of a line that is meant as a projection matrix
_BRACKETS = str.maketrans("[](),;", "      ")  # separators, and the brackets of copied matrices
_RAW_LINE = re.compile(r"^[ \t]*([SKDRT]_0[0-3])[ \t]*[: \t][ \t]*(.*)$", re.MULTILINE)
_RAW_COUNTS = {"S": 2, "K": 9, "D": 5, "R": 9, "T": 3}  # numbers in the lines of the images before rectification
_MAX_VALUE = 1e7  # largest plausible magnitude of a number in a projection; NaN and larger numbers are rejected
_COLOUR, _GREY = (2, 3), (0, 1)  # numbers of the left and right camera of each pair


def _has_projections(text: str) -> bool:
    """Whether a line of a file is one of KITTI's, or all are numbers."""
    return any(kind == "P" for kind, _, _ in _LINE.findall(text)) or bool(_RAW_LINE.search(text) or _nameless(text))


def _nameless(text: str) -> list[str]:
    """The lines of a file of numbers only, about 12 per line, without comments; empty for other files."""
    lines = [line.partition("#")[0].translate(_BRACKETS) for line in text.splitlines()]
    lines = [line for line in lines if line.strip()]
    is_matrix = [
        len(words) >= _MIN_NAMELESS and all(map(_NUMBER.match, words)) for words in (line.split() for line in lines)
    ]
    return lines if all(is_matrix) else []


def _read(text: str, source: object, is_grey: bool) -> RigCalibration:
    """The cameras of a calib.txt: the colour pair, or the grey one if `is_grey` or if it is the only one.

    Raises RigError if a matrix is not 12 numbers of the form K [I | t], or the left camera's is missing.
    """
    if lines := _nameless(text):
        return _read_nameless(lines, source)
    matrix, size = _matrices(text, source), _sizes(text, source)
    if not matrix:
        raise RigError(
            f"{source}: expected the projection matrices P_rect_02 and P_rect_03, found none; give the complete "
            "calib_cam_to_cam.txt."
        )
    pairs = (_GREY, _COLOUR) if is_grey else (_COLOUR, _GREY)
    left, right = next((pair for pair in pairs if pair[0] in matrix or pair[1] in matrix), pairs[0])
    if left not in matrix:
        raise RigError(f"{source}: expected P{left} of the left camera, found only P{right}; give the complete file.")
    notes = () if (left, right) == pairs[0] else (f"{source}: using cameras {left} and {right}, the only ones.",)
    if right in matrix and _is_vertical(matrix[left], matrix[right]):
        raise RigError(f"{source}: expected cameras side by side, found one above the other; {NO_VERTICAL_PAIRS}.")
    left_camera = _camera(matrix[left], size.get(left, (0, 0)))
    right_camera = _camera(matrix[right], size.get(right, (0, 0))) if right in matrix else None
    rectified = _calibration(matrix[left], matrix.get(right), left_camera, right_camera, notes)
    unrectified = _unrectified(text, source, (left, right), notes)
    if unrectified is None or not rectified.left.width_px:
        return rectified
    names, width_px, height_px = (
        f"P_rect_0{left} and P_rect_0{right}",
        rectified.left.width_px,
        rectified.left.height_px,
    )
    note = f"{source}: {names}, for KITTI's rectified images of {width_px}x{height_px} px."
    return replace(rectified, notes=(*notes, note), unrectified=unrectified)


def _read_nameless(lines: Sequence[str], source: object) -> RigCalibration:
    """The one or two cameras of lines without names; the right camera has the smaller P[0, 3] = -f B.

    Raises RigError if there are more lines, a line is not of the form K [I | t], or there is no baseline.
    """
    if len(lines) > 2:
        raise RigError(
            f"{source}: expected one or two lines of 12 numbers, the projection matrices of the left and right camera, "
            f"found {len(lines)}; give KITTI's calib.txt with its names P0 to P3."
        )
    matrices = [_matrix(line, f"{source}: line {n}") for n, line in enumerate(lines, 1)]
    offsets_m = [float(matrix[0, 3] / matrix[0, 0]) for matrix in matrices]
    if len(lines) == 1:
        note = f"{source}: a line without a name is taken as the projection matrix P of rectified images."
        return _calibration(matrices[0], None, _camera(matrices[0], (0, 0)), None, (note,))
    if _is_vertical(matrices[0], matrices[1]):
        raise RigError(f"{source}: expected cameras side by side, found one above the other; {NO_VERTICAL_PAIRS}.")
    if offsets_m[0] == offsets_m[1]:
        raise RigError(
            f"{source}: expected a baseline, P[0, 3] = -f B of the right camera, found {matrices[0][0, 3]:g} in both "
            "lines; give the lines of the left and of the right camera."
        )
    left, right = (0, 1) if offsets_m[0] > offsets_m[1] else (1, 0)
    note = (
        f"{source}: two lines without names are taken as projection matrices P of rectified images; line {left + 1} is "
        f"the left camera, by P[0, 3] = -f B."
    )
    cameras = [_camera(matrices[n], (0, 0)) for n in (left, right)]
    return _calibration(matrices[left], matrices[right], cameras[0], cameras[1], (note,))


def _is_vertical(a: FloatArray, b: FloatArray) -> bool:
    """Whether one camera of two (3, 4) projection matrices is above the other, not beside it."""
    x, y = (abs(float(a[row, 3] / a[row, row] - b[row, 3] / b[row, row])) for row in (0, 1))
    return y > max(x, BASELINE_M[0])


def _calibration(
    left_matrix: FloatArray,
    right_matrix: FloatArray | None,
    left: PinholeCamera,
    right: PinholeCamera | None,
    notes: tuple[str, ...],
) -> RigCalibration:
    """The rectified cameras of (3, 4) projection matrices."""
    x_m, y_m, z_m = np.linalg.solve(left_matrix[:, :3], left_matrix[:, 3]).tolist()
    right_from_left = None
    if right_matrix is not None:
        right_from_left = np.eye(4)
        right_from_left[0, 3] = (
            right_matrix[0, 3] * (left_matrix[0, 0] / right_matrix[0, 0]) - left_matrix[0, 3]
        ) / left.fx_px
    return RigCalibration(left, right, right_from_left, (x_m, y_m, z_m), notes)


def _unrectified(text: str, source: object, pair: tuple[int, int], notes: tuple[str, ...]) -> RigCalibration | None:
    """The cameras of the images before rectification; None if the file lacks values of the left one.

    Raises RigError if a line has other than its number of numbers, or is not a plausible image size.
    """
    values: dict[str, FloatArray] = {}
    for name, line in _RAW_LINE.findall(text):
        if name[:1] in _RAW_COUNTS:
            values[name] = _numbers(line, _RAW_COUNTS[name[:1]], f"{source}: {name}")
            if not np.abs(values[name]).max() <= _MAX_VALUE:  # also NaN
                raise RigError(
                    f"{source}: {name}: expected numbers up to {_MAX_VALUE:g}, found others; correct the line."
                )
    cameras, motions = [], []
    for number in pair:
        names = [f"{kind}_0{number}" for kind in _RAW_COUNTS]
        if not all(name in values for name in names):
            break
        size, k, distortion, r, t = (values[name] for name in names)
        width_px, height_px = _recorded_size(size, f"{source}: S_0{number}")
        fx_px, fy_px, cx_px, cy_px = k[[0, 4, 2, 5]].tolist()
        cameras.append(PinholeCamera(fx_px, fy_px, cx_px, cy_px, width_px, height_px, tuple(distortion.tolist())))
        motions.append(np.vstack([np.column_stack([r.reshape(3, 3), t]), [0.0, 0.0, 0.0, 1.0]]))
    if not cameras:
        return None
    left, right = pair
    note = (
        f"{source}: K, D, R and T of cameras {left} and {right}, as the images are of KITTI's size before "
        f"rectification, {cameras[0].width_px}x{cameras[0].height_px} px."
    )
    if len(cameras) == 1:
        return RigCalibration(cameras[0], None, None, notes=(*notes, note))
    # a rotation of six digits is inverted by its transpose; rig_checks verifies the product
    reference_from_left = np.eye(4)
    reference_from_left[:3, :3] = motions[0][:3, :3].T
    reference_from_left[:3, 3] = -motions[0][:3, :3].T @ motions[0][:3, 3]
    return RigCalibration(cameras[0], cameras[1], motions[1] @ reference_from_left, notes=(*notes, note))


def _recorded_size(size: FloatArray, name: str) -> tuple[int, int]:
    """(width, height) of the images before rectification. Raises RigError if it is not plausible."""
    width_px, height_px = (round(side) for side in size.tolist())
    if not (1 <= width_px <= MAX_SIDE_PX and 1 <= height_px <= MAX_SIDE_PX):
        raise RigError(
            f"{name}: expected a width and height of 1 to {MAX_SIDE_PX} px, found {width_px} and {height_px}; correct "
            "the line."
        )
    return width_px, height_px


def _missing(text: str, _path: object, is_grey: bool) -> str:
    """The matrix that a file with one camera lacks."""
    if _nameless(text):
        return "a second line of 12 numbers with the projection matrix of the right camera"
    numbers = {int(number) for kind, number, _ in _LINE.findall(text) if kind == "P"}
    left, right = _GREY if 0 in numbers and (is_grey or 2 not in numbers) else _COLOUR
    if {left, right} <= numbers:
        return f"S_0{right}, K_0{right}, D_0{right}, R_0{right} and T_0{right} of the right camera before rectification"
    return f"P{right} of the right camera"


def _matrices(text: str, source: object) -> Mapping[int, FloatArray]:
    """The (3, 4) projection matrices by camera number."""
    matrices = {}
    for kind, number, values in _LINE.findall(text):
        if kind == "P":
            matrices[int(number)] = _matrix(values, f"{source}: P{number}")
    return matrices


def _matrix(values: str, name: str) -> FloatArray:
    """The (3, 4) projection matrix of a line."""
    matrix = _numbers(values, 12, name)
    matrix = matrix.reshape(3, 4)
    if not np.isfinite(matrix).all():
        words = quoted(values.strip())
        raise RigError(f"{name}: expected a projection matrix of 12 finite numbers, found {words}; correct the line.")
    is_upper = matrix[1, 0] == matrix[2, 0] == matrix[2, 1] == 0 and matrix[2, 2] == 1
    if not (is_upper and np.abs(matrix).max() <= _MAX_VALUE and matrix[0, 0] > 0 and matrix[1, 1] > 0):
        raise RigError(
            f"{name}: expected a projection matrix K [I | t], found focal lengths of {matrix[0, 0]:g} and "
            f"{matrix[1, 1]:g} or another form; give the calibration of the rectified images."
        )
    return matrix


def _numbers(values: str, count: int, name: str) -> FloatArray:
    """The (count,) numbers of a line.

    Raises RigError if a word is not a number of a plausible magnitude, or there are fewer or more.
    """
    words = values.split()
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError as error:
        raise RigError(
            f"{name}: expected {count} numbers, found {quoted(values.strip())}; correct the line."
        ) from error
    if len(words) != count:
        raise RigError(f"{name}: expected {count} numbers, found {len(words)}; give the complete file.")
    return numbers


def _camera(matrix: FloatArray, size_px: tuple[int, int]) -> PinholeCamera:
    return PinholeCamera(
        float(matrix[0, 0]), float(matrix[1, 1]), float(matrix[0, 2]), float(matrix[1, 2]), size_px[0], size_px[1]
    )


def _sizes(text: str, source: object) -> Mapping[int, tuple[int, int]]:
    """(width, height) by camera number, from the raw set's S_rect lines.

    Raises RigError if a line is not a plausible image size.
    """
    sizes = {}
    for kind, number, values in _LINE.findall(text):
        if kind == "S":
            try:
                width, height = (float(word) for word in values.split())
            except ValueError:
                width = height = 0.0
            if not (1 <= width <= MAX_SIDE_PX and 1 <= height <= MAX_SIDE_PX):
                raise RigError(
                    f"{source}: S_rect_0{number}: expected a width and height of 1 to {MAX_SIDE_PX} px, found "
                    f"{quoted(values.strip())}; correct the line."
                )
            sizes[int(number)] = (round(width), round(height))
    return sizes


KITTI = RigFormat(name="kitti", title="KITTI's calib.txt", recognises=_has_projections, read=_read, missing=_missing)
