"""Numbers in text files, more strictly than Python's `float`, which accepts 1_000 and digits of
other scripts.
"""

import math
from collections.abc import Iterable

import numpy as np

from track_range.foundation.arrays import FloatArray


def number(cell: str) -> float:
    """The number in a cell, which may be infinite; NaN if it is not a number in ASCII."""
    try:
        return float(cell) if cell.isascii() and "_" not in cell else math.nan
    except ValueError:
        return math.nan


def numbers(cells: Iterable[str]) -> list[float]:
    """The number in each cell; NaN for cells that are not numbers."""
    return [number(cell) for cell in cells]


def plain_number(value: object) -> float:
    """A value as float; NaN if it is not a number."""
    return (
        float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
    )


def are_integers(values: FloatArray, low: float, high: float) -> bool:
    """Whether all values are integers from `low` to `high`; NaN is not an integer."""
    return bool(np.all((values >= low) & (values <= high) & (np.rint(values) == values)))
