"""Stated: a value of a calibration with its file and key, and which of several values counts."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import quoted
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.rig_formats.values.aliases import Meaning, Side

UNIT_NAMES = {0.001: "millimetres", 0.01: "centimetres", 1.0: "metres", 0.0254: "inches"}
TOLERANCE = 0.02  # largest relative difference of lengths, and difference of rotations, that agree

Place = tuple[Side, str]  # the side of a value, and the name of its quantity


class Stated(NamedTuple):
    """A value of a calibration, and where it is from."""

    value: Any  # (N,) array; the text of a unit or model
    path: Path  # the file
    key: str  # the keys of the file from the outside in, with dots; "" = assumed
    meaning: Meaning  # what the key states

    @property
    def is_assumed(self) -> bool:
        """Whether the value is that of all files of the dialect, and not in the file."""
        return not self.key

    @property
    def block(self) -> tuple[Path, str]:
        """The file and the keys around the value."""
        return self.path, self.key.rpartition(".")[0]


def merged(*parts: Mapping[Place, Stated]) -> dict[Place, Stated]:
    """The values of several files, those of the last first; of one place the `counting` one."""
    places = dict.fromkeys(place for part in reversed(parts) for place in part)
    return {place: counting([part[place] for part in parts if place in part]) for place in places}


def counting(values: Sequence[Stated]) -> Stated:
    """The value of one place that counts: the first whose key states its unit, else the first.

    RigError if a length contradicts one whose key states its unit, or two camera matrices in one
    block differ. Other values may differ, such as the poses of several boards.
    """
    first = values[0]
    quantity = first.meaning.quantity.name
    if quantity == "K":
        others = [value for value in values if value.block == first.block]
        _check(first, others, [_is_same_matrix(first.value, other.value) for other in others])
    elif is_compared(quantity):
        named = next((value for value in values if value.meaning.metres is not None), first)
        if named.meaning.metres is not None:
            _check(named, values, [_is_same_length(named, value) for value in values])
        return named
    return first


def is_compared(quantity: str) -> bool:
    """Whether the values of a quantity may contradict one another."""
    return quantity in ("K", "T", "baseline")


def agree(length: float, other: float) -> bool:
    """Whether two lengths are equal, but for rounding."""
    return abs(length - other) <= TOLERANCE * abs(other)


def _check(value: Stated, others: Sequence[Stated], are_same: Sequence[bool]) -> None:
    for other, is_same in zip(others, are_same, strict=True):
        if not is_same:
            raise RigError(
                f"{value.path}: expected {value.key} and {other.key} to agree, found "
                f"{quoted(value.value.tolist())} and {quoted(other.value.tolist())}; remove the "
                "wrong one."
            )


def _is_same_matrix(first: FloatArray, second: FloatArray) -> bool:
    """Whether two camera matrices of (9,) or (4,) numbers are equal but for rounding."""
    a, b = _focal_and_centre(first), _focal_and_centre(second)
    return a.size == b.size and bool(np.all(np.abs(a - b) <= TOLERANCE * np.abs(a).max(initial=0)))


def _focal_and_centre(matrix: FloatArray) -> FloatArray:
    """(4,) fx, fy, cx, cy of a matrix row by row, or column by column as MATLAB's."""
    if matrix.size != 9:
        return matrix
    return np.array([matrix[0], matrix[4], matrix[2] or matrix[6], matrix[5] or matrix[7]])


def _is_same_length(named: Stated, other: Stated) -> bool:
    """Whether a length is that of a key with its unit, in the unit of its key or in any unit."""
    known = other.meaning.metres
    metres = UNIT_NAMES if known is None else (known,)
    expected, length = named.value * named.meaning.metres, other.value
    if length.size != expected.size:
        return False
    if length.size == 1 or named.meaning.is_inverse != other.meaning.is_inverse:
        expected, length = np.linalg.norm(expected), np.linalg.norm(length)
    limit = TOLERANCE * np.linalg.norm(expected)
    return any(bool(np.linalg.norm(length * unit - expected) <= limit) for unit in metres)
