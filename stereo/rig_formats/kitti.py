"""KITTI's calib.txt: 3 x 4 projection matrices P0..P3 of rectified cameras, P = K [I | t], t from
reference camera 0.

    P0, P1  left and right grey camera       P2, P3  left and right colour camera
    t = K^-1 P[:, 3]                         baseline = -(P3[0, 3] - P2[0, 3]) / fx

The lines are `P2: 12 numbers` in the odometry, tracking and stereo sets; some copies lack the
colon, and some are two lines of 12 numbers without names. The raw set's calib_cam_to_cam.txt has
rectified and recorded images:

    P_rect_02, S_rect_02      projection and size of the rectified images
    K_02, D_02, S_02          camera matrix, distortion k1 k2 p1 p2 k3 and size of the images before rectification
    R_02, T_02                x2 = R x0 + T of a point x0 in the frame of camera 0

(Geiger et al., Vision meets Robotics: The KITTI Dataset, IJRR 2013, and the readme of the raw set.)
"""

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import quoted
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError, inverse_motion, rigid_motion
from track_range.stereo.geometry.rig_checks import (
    BASELINE_M,
    MAX_SIDE_PX,
    NO_VERTICAL_PAIRS,
    RigCalibration,
)
from track_range.stereo.rig_formats.rig_format import RigFormat

_LINE = re.compile(r"^[ \t]*(P|S)(?:_rect_0?)?(\d{1,3})[ \t]*[: \t][ \t]*(.*)$", re.MULTILINE)
# beginning of a word that is a number
_NUMBER = re.compile(r"[-+.]*\d|[-+]?(nan|inf)", re.IGNORECASE)
_MIN_NAMELESS = 9  # smallest number of words of a line that is meant as a projection matrix
_BRACKETS = str.maketrans("[](),;", "      ")  # separators, and the brackets of copied matrices
_RAW_LINE = re.compile(r"^[ \t]*([SKDRT]_\d{2,3})[ \t]*[: \t][ \t]*([-+\d].*)$", re.MULTILINE)
# numbers in the lines of the images before rectification
_RAW_COUNTS = {"K": 9, "D": 5, "R": 9, "T": 3}
# largest plausible magnitude of a number in a projection; NaN and larger numbers are rejected
_MAX_VALUE = 1e7
_COLOUR, _GREY = (2, 3), (0, 1)  # numbers of the left and right camera of each pair


def _has_projections(text: str) -> bool:
    """Whether a line of a file has one of KITTI's names, or all lines have only numbers."""
    return bool(_lines(text, "P") or _RAW_LINE.search(text) or _nameless(text))


def _lines(text: str, kind: str) -> list[tuple[int, str]]:
    """Number of the camera and values of each line P or S of rectified images; the last line of a
    camera counts.
    """
    return [(int(number), values) for name, number, values in _LINE.findall(text) if name == kind]


def _nameless(text: str) -> list[str]:
    """The lines of a file of numbers only, about 12 per line, without comments; empty for other
    files.
    """
    lines = [line.partition("#")[0].translate(_BRACKETS) for line in text.splitlines()]
    lines = [line for line in lines if line.strip()]
    is_matrix = [
        len(words) >= _MIN_NAMELESS and all(map(_NUMBER.match, words))
        for words in (line.split() for line in lines)
    ]
    return lines if all(is_matrix) else []


def _read(text: str, source: object, is_grey: bool) -> RigCalibration:
    """The cameras of a calib.txt: the colour pair, or the grey pair if `is_grey` or if it is the
    only pair.
    """
    if lines := _nameless(text):
        return _read_nameless(lines, source)
    matrix = {
        number: _matrix(values, f"{source}: P{number}") for number, values in _lines(text, "P")
    }
    size = {
        number: _size(values, f"{source}: S_rect_{number:02d}")
        for number, values in _lines(text, "S")
    }
    if not matrix:
        raise RigError(
            f"{source}: expected the projection matrices P_rect_02 and P_rect_03, found none; give "
            "the complete calib_cam_to_cam.txt."
        )
    pairs = (_GREY, _COLOUR) if is_grey else (_COLOUR, _GREY)
    if max(matrix) > max(_COLOUR):  # of other data sets, such as 101 and 103 of DrivingStereo
        numbers = sorted(matrix, key=lambda number: -matrix[number][0, 3] / matrix[number][0, 0])[
            :2
        ]
        pairs = ((numbers[0], numbers[-1]), (numbers[0], numbers[-1]))
    left, right = next((pair for pair in pairs if pair[0] in matrix or pair[1] in matrix), pairs[0])
    if left not in matrix:
        raise RigError(
            f"{source}: expected P{left} of the left camera, found only P{right}; give "
            "the complete file."
        )
    notes = (
        ()
        if (left, right) == pairs[0]
        else (f"{source}: the only cameras, {left} and {right}, are used.",)
    )
    projections = [
        (matrix[number], size.get(number, (0, 0))) for number in (left, right) if number in matrix
    ]
    rectified = _calibration(projections, source, notes)
    unrectified = _unrectified(text, source, (left, right), notes)
    if unrectified is None or not rectified.left.width_px:
        return rectified
    size_text = f"{rectified.left.width_px}x{rectified.left.height_px}"
    note = (
        f"{source}: P_rect_{left:02d} and P_rect_{right:02d}, for the rectified images of "
        f"{size_text} px."
    )
    return replace(rectified, notes=(*notes, note), others=(unrectified,))


def _read_nameless(lines: Sequence[str], source: object) -> RigCalibration:
    """The one or two cameras of lines without names; the right camera has the smaller P[0, 3] = -f
    B.
    """
    if len(lines) > 2:
        raise RigError(
            f"{source}: expected one or two lines of 12 numbers, the projection matrices of the "
            f"left and right camera, found {len(lines)}; give KITTI's calib.txt with its names P0 "
            "to P3."
        )
    matrices = [_matrix(line, f"{source}: line {n}") for n, line in enumerate(lines, 1)]
    if len(lines) == 1:
        note = (
            f"{source}: a line without a name is taken as the projection matrix P of rectified "
            "images."
        )
        return _calibration([(matrices[0], (0, 0))], source, (note,))
    offsets_m = [float(matrix[0, 3] / matrix[0, 0]) for matrix in matrices]
    left, right = (0, 1) if offsets_m[0] > offsets_m[1] else (1, 0)
    note = (
        f"{source}: two lines without names are taken as projection matrices P of rectified "
        f"images; line {left + 1} is the left camera, since P[0, 3] = -f B."
    )
    calibration = _calibration(
        [(matrices[left], (0, 0)), (matrices[right], (0, 0))], source, (note,)
    )
    if offsets_m[0] == offsets_m[1]:
        raise RigError(
            f"{source}: expected a baseline, P[0, 3] = -f B of the right camera, found "
            f"{matrices[0][0, 3]:g} in both lines; give the lines of the left and of the right "
            "camera."
        )
    return calibration


def _calibration(
    projections: Sequence[tuple[FloatArray, tuple[int, int]]],
    source: object,
    notes: tuple[str, ...],
) -> RigCalibration:
    """The rectified left camera, and the right one if there is one, of (3, 4) projection matrices
    and image sizes.
    """
    left, *others = [PinholeCamera.of_matrix(matrix, size_px) for matrix, size_px in projections]
    p_left = projections[0][0]
    x_m, y_m, z_m = np.linalg.solve(p_left[:, :3], p_left[:, 3]).tolist()
    if not others:
        return RigCalibration(left, None, None, (x_m, y_m, z_m), notes)
    p_right = projections[1][0]
    x, y = (
        abs(float(p_left[row, 3] / p_left[row, row] - p_right[row, 3] / p_right[row, row]))
        for row in (0, 1)
    )
    if y > max(x, BASELINE_M[0]):
        raise RigError(
            f"{source}: expected cameras side by side, found one above the other; "
            f"{NO_VERTICAL_PAIRS}."
        )
    offset_m = (p_right[0, 3] * (p_left[0, 0] / p_right[0, 0]) - p_left[0, 3]) / left.fx_px
    return RigCalibration(
        left, others[0], rigid_motion(np.eye(3), [offset_m, 0.0, 0.0]), (x_m, y_m, z_m), notes
    )


def _unrectified(
    text: str, source: object, pair: tuple[int, int], notes: tuple[str, ...]
) -> RigCalibration | None:
    """The cameras of the images before rectification; None if the file lacks values of the left
    camera.
    """
    values, sizes = _raw_lines(text, source)
    cameras, motions = [], []
    for number in pair:
        names = [f"{kind}_{number:02d}" for kind in _RAW_COUNTS]
        if f"S_{number:02d}" not in sizes or not all(name in values for name in names):
            break
        k, distortion, r, t = (values[name] for name in names)
        cameras.append(
            PinholeCamera.of_matrix(k.reshape(3, 3), sizes[f"S_{number:02d}"], distortion)
        )
        motions.append(rigid_motion(r.reshape(3, 3), t))
    if not cameras:
        return None
    left, right = pair
    note = (
        f"{source}: using K, D, R and T of cameras {left} and {right}, because the images have "
        f"KITTI's size before rectification, {cameras[0].width_px}x{cameras[0].height_px} px."
    )
    if len(cameras) == 1:
        return RigCalibration(cameras[0], None, None, notes=(*notes, note))
    right_from_left = motions[1] @ inverse_motion(motions[0])
    return RigCalibration(cameras[0], cameras[1], right_from_left, notes=(*notes, note))


def _raw_lines(
    text: str, source: object
) -> tuple[dict[str, FloatArray], dict[str, tuple[int, int]]]:
    """The numbers of the lines before rectification by name, such as K_02, and the sizes S_02."""
    values: dict[str, FloatArray] = {}
    sizes: dict[str, tuple[int, int]] = {}
    for name, line in _RAW_LINE.findall(text):
        if name[0] == "S":
            sizes[name] = _size(line, f"{source}: {name}")
            continue
        values[name] = _numbers(line, _RAW_COUNTS[name[0]], f"{source}: {name}")
        if not np.abs(values[name]).max() <= _MAX_VALUE:  # also NaN
            raise RigError(
                f"{source}: {name}: expected numbers up to {_MAX_VALUE:g}, found other values; "
                "correct the line."
            )
    return values, sizes


def _missing(text: str, _path: object, is_grey: bool) -> str:
    if _nameless(text):
        return "a second line of 12 numbers with the projection matrix of the right camera"
    numbers = {number for number, _ in _lines(text, "P")}
    left, right = _GREY if 0 in numbers and (is_grey or 2 not in numbers) else _COLOUR
    if {left, right} <= numbers:
        return (
            f"S_0{right}, K_0{right}, D_0{right}, R_0{right} and T_0{right} of the right camera "
            "before rectification"
        )
    return f"P{right} of the right camera"


def _matrix(values: str, name: str) -> FloatArray:
    matrix = _numbers(values, 12, name).reshape(3, 4)
    if not np.isfinite(matrix).all():
        words = quoted(values.strip())
        raise RigError(
            f"{name}: expected a projection matrix of 12 finite numbers, found {words}; "
            "correct the line."
        )
    is_upper = matrix[1, 0] == matrix[2, 0] == matrix[2, 1] == 0 and matrix[2, 2] == 1
    if not (
        is_upper and np.abs(matrix).max() <= _MAX_VALUE and matrix[0, 0] > 0 and matrix[1, 1] > 0
    ):
        raise RigError(
            f"{name}: expected a projection matrix K [I | t], found focal lengths of "
            f"{matrix[0, 0]:g} and {matrix[1, 1]:g} or another form; give the calibration of the "
            "rectified images."
        )
    return matrix


def _numbers(values: str, count: int, name: str) -> FloatArray:
    try:
        numbers = np.array([float(word) for word in values.split()])
    except ValueError as error:
        words = quoted(values.strip())
        raise RigError(
            f"{name}: expected {count} numbers, found {words}; correct the line."
        ) from error
    if len(numbers) != count:
        raise RigError(
            f"{name}: expected {count} numbers, found {len(numbers)}; give the complete file."
        )
    return numbers


def _size(values: str, name: str) -> tuple[int, int]:
    try:
        width, height = (float(word) for word in values.split())
    except ValueError:
        width = height = 0.0
    if not (1 <= width <= MAX_SIDE_PX and 1 <= height <= MAX_SIDE_PX):
        raise RigError(
            f"{name}: expected a width and height of 1 to {MAX_SIDE_PX} px, found "
            f"{quoted(values.strip())}; correct the line."
        )
    return round(width), round(height)


KITTI = RigFormat(
    name="kitti",
    title="calib.txt of KITTI, KITTI-360 or DrivingStereo",
    recognises=_has_projections,
    read=_read,
    missing=_missing,
    priority=-20,  # files of OpenCV have lines P1 and P2, too
)
