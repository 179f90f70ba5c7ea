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
    if array.shape == expected:
        return
    is_match = array.ndim == len(expected) and all(
        length is None or length == actual for length, actual in zip(expected, array.shape, strict=True)
    )
    if not is_match:
        text = ", ".join("*" if length is None else str(length) for length in expected)
        raise ValueError(f"{name}: expected shape ({text}), got {array.shape}")
