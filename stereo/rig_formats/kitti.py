"""KITTI's calib.txt: 3 x 4 projection matrices P0..P3 of rectified cameras, P = K [I | t], t from reference camera 0.

    P0, P1  left and right grey camera       P2, P3  left and right colour camera
    t = K^-1 P[:, 3]                         baseline = -(P3[0, 3] - P2[0, 3]) / fx

The lines are `P2: 12 numbers` in the odometry, tracking and stereo sets, `P_rect_02: ...` in the raw set (with the
image size as S_rect_02); some copies lack the colon. (Geiger et al., IJRR 2013.)
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import quoted
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.geometry.rig_checks import MAX_SIDE_PX, Calibration
from track_range.stereo.rig_formats.rig_format import RigFormat

_LINE = re.compile(r"^[ \t]*(P|S)(?:_rect_0)?([0-3])[ \t]*[: \t][ \t]*(.*)$", re.MULTILINE)

_MAX_VALUE = 1e7
"""Largest plausible magnitude of a number in a projection; NaN and larger numbers are rejected."""

_COLOUR, _GREY = (2, 3), (0, 1)
"""Numbers of the left and right camera of each pair."""


def _has_projections(text: str) -> bool:
    """Whether any line of a file is one of KITTI's projections."""
    return any(kind == "P" for kind, _, _ in _LINE.findall(text))


def _read(text: str, source: object, is_grey: bool) -> Calibration:
    """The cameras of a calib.txt: the colour pair, or the grey one if `is_grey` or if it is the only one.

    Raises:
        RigError: a matrix is not 12 numbers of the form K [I | t], or the left camera's is missing.
    """
    matrix, size = _matrices(text, source), _sizes(text, source)
    pairs = (_GREY, _COLOUR) if is_grey else (_COLOUR, _GREY)
    left, right = next((pair for pair in pairs if pair[0] in matrix or pair[1] in matrix), pairs[0])
    if left not in matrix:
        raise RigError(f"{source}: expected P{left} of the left camera, found only P{right}; give the complete file.")
    left_camera = _camera(matrix[left], size.get(left, (0, 0)))
    reference_m = np.linalg.solve(matrix[left][:, :3], matrix[left][:, 3])
    notes = () if (left, right) == pairs[0] else (f"{source}: using cameras {left} and {right}, the only ones.",)
    right_camera = right_from_left = None
    if right in matrix:
        right_camera = _camera(matrix[right], size.get(right, (0, 0)))
        right_from_left = np.eye(4)
        right_from_left[0, 3] = (matrix[right][0, 3] - matrix[left][0, 3]) / left_camera.fx_px
    x_m, y_m, z_m = reference_m.tolist()
    return Calibration(left_camera, right_camera, right_from_left, (x_m, y_m, z_m), notes)


def _missing(text: str, _path: object, is_grey: bool) -> str:
    """The matrix that a file with one camera lacks."""
    numbers = {int(number) for kind, number, _ in _LINE.findall(text) if kind == "P"}
    _, right = _GREY if 0 in numbers and (is_grey or 2 not in numbers) else _COLOUR
    return f"P{right} of the right camera"


def _matrices(text: str, source: object) -> Mapping[int, FloatArray]:
    """The (3, 4) projection matrices by camera number."""
    matrices = {}
    for kind, number, values in _LINE.findall(text):
        if kind == "P":
            matrices[int(number)] = _matrix(values, f"{source}: P{number}")
    return matrices


def _matrix(values: str, name: str) -> FloatArray:
    words = values.split()
    try:
        matrix = np.array([float(word) for word in words])
    except ValueError as error:
        raise RigError(f"{name}: expected 12 numbers, found {quoted(values.strip())}; correct the line.") from error
    if len(words) != 12:
        raise RigError(f"{name}: expected 12 numbers, found {len(words)}; give the complete file.")
    matrix = matrix.reshape(3, 4)
    is_upper = matrix[1, 0] == matrix[2, 0] == matrix[2, 1] == 0 and matrix[2, 2] == 1
    if not (is_upper and np.abs(matrix).max() <= _MAX_VALUE and matrix[0, 0] > 0 and matrix[1, 1] > 0):
        raise RigError(
            f"{name}: expected a projection matrix K [I | t], found focal lengths of {matrix[0, 0]:g} and "
            f"{matrix[1, 1]:g} or another form; give the calibration of the rectified images."
        )
    return matrix


def _camera(matrix: FloatArray, size_px: tuple[int, int]) -> PinholeCamera:
    return PinholeCamera(
        float(matrix[0, 0]), float(matrix[1, 1]), float(matrix[0, 2]), float(matrix[1, 2]), size_px[0], size_px[1]
    )


def _sizes(text: str, source: object) -> Mapping[int, tuple[int, int]]:
    """(width, height) by camera number, from the raw set's S_rect lines.

    Raises:
        RigError: a line is not a plausible image size.
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
