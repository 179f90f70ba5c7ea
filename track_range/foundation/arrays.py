"""Aliases of array types and the shape check that all data classes share."""

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


def check_shape(name: str, array: npt.NDArray[Any], wanted: tuple[int | None, ...]) -> None:
    """Raise ValueError unless `array` has the shape `wanted` (None matches any length)."""
    if array.shape == wanted:
        return
    fits = array.ndim == len(wanted) and all(w is None or w == g for w, g in zip(wanted, array.shape, strict=True))
    if not fits:
        text = ", ".join("*" if w is None else str(w) for w in wanted)
        raise ValueError(f"{name}: expected shape ({text}), got {array.shape}")
