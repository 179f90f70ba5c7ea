"""Array type aliases, and the shape check of all data classes."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
FloatArray32 = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
Image = npt.NDArray[np.uint8]
"""(H, W, 3) BGR or (H, W) grey."""


def check_shape(name: str, array: npt.NDArray[Any], expected: tuple[int | None, ...]) -> None:
    """Raise ValueError unless `array` has the shape `expected` (None matches any length)."""
    shape = array.shape
    if shape == expected:
        return
    is_match = [length is None or length == actual for length, actual in zip(expected, shape, strict=False)]
    if len(shape) != len(expected) or not all(is_match):
        text = ", ".join("*" if length is None else str(length) for length in expected)
        raise ValueError(f"{name}: expected shape ({text}), got {shape}")


def row_numbers(rows: BoolArray | IntArray) -> IntArray:
    """(M,) the row numbers that a mask (N,) or an array of row numbers (M,) selects; `take` is faster than indexing."""
    return rows.nonzero()[0] if rows.dtype == np.bool_ else np.asarray(rows, np.int64)
