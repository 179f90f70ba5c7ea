"""Rows of numbers in a text file, before anything is known about the meaning of their columns.

Columns are separated by commas, semicolons, spaces or tabs; `#` starts a comment.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.files.input_files import MAX_TABLE_BYTES, quoted, read_text
from track_range.foundation.files.numeric_text import numbers

MAX_COLUMNS = 15


class NumberRows(NamedTuple):
    """The N rows of a file of numbers."""

    path: Path
    error: type[Exception]
    values: FloatArray  # (N, 15), NaN where there is no number
    n_columns: IntArray  # (N,)
    cells: list[list[str]]
    lines: list[int]

    @property
    def has_number(self) -> BoolArray:
        """(N, 15) mask of the columns that each row has."""
        return np.asarray(np.arange(MAX_COLUMNS) < self.n_columns[:, None])

    def check(self, is_valid: npt.ArrayLike, message: Callable[[list[str]], str]) -> None:
        """Raise `error` for the first row that is not valid, with a message about its cells."""
        for row in np.flatnonzero(np.logical_not(is_valid))[:1].tolist():
            raise self.error(f"{self.path}, line {self.lines[row]}: {message(self.cells[row])}.")


def are_whole(values: FloatArray, low: float, high: float) -> BoolArray:
    """Mask of the integers from `low` to `high`; False for NaN."""
    return np.asarray((values >= low) & (values <= high) & (np.rint(values) == values))


def is_number_row(line: str) -> bool:
    """Whether a line is a row of numbers in one of the layouts or a comment; False for KITTI's rows
    with a type.
    """
    cells = _cells(line.partition("#")[0])
    is_number = not any(map(math.isnan, numbers(cells)))
    return line.startswith("#") or (
        is_number and ("," in line or ";" in line or 6 <= len(cells) <= 10)
    )


def read_number_rows(path: Path, error: type[Exception], expected: str) -> NumberRows:
    """The rows of a file; raises `error` if it cannot be read, has more than 15 columns, or a cell
    is not a number.
    """
    text = read_text(path, error, expected, max_bytes=MAX_TABLE_BYTES)
    lines = ((i, line.partition("#")[0]) for i, line in enumerate(text.split("\n"), start=1))
    numbered = [(i, _cells(line)) for i, line in lines if line.strip()]
    n_columns = np.array([len(cells) for _, cells in numbered], np.int64)
    values = np.full((len(numbered), MAX_COLUMNS), np.nan)
    rows = NumberRows(
        path, error, values, n_columns, [cells for _, cells in numbered], [i for i, _ in numbered]
    )
    rows.check(
        n_columns <= MAX_COLUMNS, lambda cells: f"expected 6 to 10 numbers, got {len(cells)}"
    )
    values[rows.has_number] = numbers(cell for cells in rows.cells for cell in cells)
    for row, column in np.argwhere(np.isnan(values) & rows.has_number).tolist():
        if rows.cells[row][column].lower() != "nan":
            raise error(
                f"{path}, line {rows.lines[row]}: expected only numbers between commas or spaces, "
                f"got {quoted(rows.cells[row][column])}."
            )
    return rows


def _cells(line: str) -> list[str]:
    separator = next((mark for mark in ";," if mark in line), None)
    return [cell.strip() for cell in line.strip().rstrip(",;").split(separator)]
