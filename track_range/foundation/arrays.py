"""Array type aliases, and the shape check of all data classes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
FloatArray32 = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
# mask, row numbers or slice
Rows = BoolArray | npt.NDArray[np.integer[Any]] | Sequence[int] | slice
Image = npt.NDArray[np.uint8]  # (H, W, 3) BGR or (H, W) grey


def check_shape(name: str, array: npt.NDArray[Any], expected: tuple[int | None, ...]) -> None:
    """Raise ValueError unless `array` is an array and has the shape `expected` (None matches any
    length).
    """
    if not hasattr(array, "shape"):
        raise ValueError(f"{name}: expected an array, got {type(array).__name__}")
    shape = array.shape
    if shape == expected:
        return
    is_match = len(shape) == len(expected)
    for length, actual in zip(expected, shape, strict=False):
        is_match &= length is None or length == actual
    if not is_match:
        text = ", ".join("*" if length is None else str(length) for length in expected)
        raise ValueError(f"{name}: expected shape ({text}), got {shape}")


def row_numbers(rows: Rows, n_rows: int) -> IntArray:
    """(M,) the row numbers that `rows` selects among `n_rows`, for `take`, which is faster than
    indexing.

    Negative numbers count from the end. An IndexError means that a mask has another length, or that
    the numbers are not integers; `take` checks that the rows exist.
    """
    if isinstance(rows, slice):
        return np.arange(n_rows)[rows]
    if not isinstance(rows, np.ndarray):
        rows = np.asarray(rows)
    code = rows.dtype.kind
    if code == "b":
        if rows.shape != (n_rows,):
            raise IndexError(f"rows: expected a mask of shape ({n_rows},), got {rows.shape}")
        return rows.nonzero()[0]
    if code not in "iu" and rows.size:
        raise IndexError(f"rows: expected a mask or integers, got {rows.dtype}")
    return np.asarray(rows, np.int64)
