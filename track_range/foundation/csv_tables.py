"""CSV tables with named columns; errors name the file and the line."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class CsvTable:
    """Cells of a CSV file, stripped of surrounding spaces; blank lines are omitted.

    Attributes:
        path: the file.
        header: names of the columns, in lower case.
        rows: N lists of one cell per column.
        lines: N line numbers in the file, from 1.
        error: class of the exceptions that the methods raise.
        expected: what the file should hold, for messages.
    """

    path: Path
    header: tuple[str, ...]
    rows: list[list[str]]
    lines: list[int]
    error: type[Exception]
    expected: str

    def __len__(self) -> int:
        return len(self.rows)

    def __contains__(self, name: str) -> bool:
        return name in self.header

    def fault(self, row: int, message: str) -> Exception:
        """An exception about row `row`, counted from 0, that the caller raises."""
        return self.error(f"{self.path}, line {self.lines[row]}: {message}")

    def require(self, names: Iterable[str]) -> None:
        """Raise `error` unless there is exactly one column of each of these names."""
        missing = [name for name in names if name not in self.header]
        if missing:
            raise self.error(f"{self.path}: no column {', '.join(missing)}; expected {self.expected}.")
        self.refuse_duplicates(names)

    def refuse_duplicates(self, names: Iterable[str]) -> None:
        """Raise `error` if two columns have one of these names."""
        for name in names:
            if self.header.count(name) > 1:
                raise self.error(f"{self.path}: expected one column {name}, got two; rename or remove one.")

    def texts(self, name: str) -> list[str]:
        """N cells of a column; empty texts if there is no such column."""
        if name not in self.header:
            return [""] * len(self.rows)
        column = self.header.index(name)
        return [row[column] for row in self.rows]

    def numbers(self, name: str) -> FloatArray:
        """(N,) numbers of a column; NaN for cells that are not numbers, and for a missing column."""
        return np.array([number(cell) for cell in self.texts(name)], np.float64)

    def finite(self, name: str) -> FloatArray:
        """(N,) numbers of a column.

        Raises:
            error: a cell is not a finite number.
        """
        values = self.numbers(name)
        self.check(name, values, np.isfinite(values), "a finite number")
        return values

    def check(self, name: str, values: FloatArray, is_valid: BoolArray, expected: str) -> None:
        """Raise `error` for the first invalid row; `values` (N,) are the numbers of column `name`."""
        for row in np.flatnonzero(~is_valid).tolist():
            cell = self.texts(name)[row] if name in self.header else f"{values[row]:g}"
            raise self.fault(row, f"expected {expected} for {name}, got '{cell}'.")


def read_csv_table(
    path: Path, error: type[Exception], expected: str, *, default_header: Sequence[str] = (), exact: bool = False
) -> CsvTable:
    """Read a CSV file in UTF-8 with a header line.

    Args:
        path: the file.
        error: class of the exceptions to raise.
        expected: expected content of the file, for messages, such as "columns time_s and speed_mps".
        default_header: names of the columns, in order, of a file without a header: one with none of them in its first
            line.
        exact: reject rows that are shorter than the header, instead of filling them with empty cells.

    Raises:
        error: the file is unreadable or empty, or a row has more cells than the header.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file)
            numbered = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if any(map(str.strip, row))]
    except OSError as reason:
        raise error(
            f"{path}: cannot be read ({reason.strerror or reason}); check the path and permissions."
        ) from reason
    except (UnicodeDecodeError, csv.Error) as reason:
        raise error(
            f"{path}: cannot be read as CSV in UTF-8 ({type(reason).__name__}); expected {expected}."
        ) from reason
    if not numbered:
        raise error(f"{path}: the file is empty; expected {expected}.")
    lines, rows = [line for line, _ in numbered], [row for _, row in numbered]
    header = tuple(cell.lower() for cell in rows[0])
    if default_header and not set(header) & set(default_header):
        header = tuple(default_header[: len(rows[0])])
    else:
        rows, lines = rows[1:], lines[1:]
    table = CsvTable(path, header, rows, lines, error, expected)
    for index, row in enumerate(rows):
        if len(row) < len(header) and not exact:
            row.extend([""] * (len(header) - len(row)))
        if len(row) != len(header) and (exact or any(row[len(header) :])):
            raise table.fault(index, f"expected {len(header)} cells as in the header, got {len(row)}.")
    return table


def number(cell: str) -> float:
    """The number in a cell; NaN if it is not a number."""
    try:
        return float("nan") if "_" in cell else float(cell)  # float() accepts 1_000
    except ValueError:
        return float("nan")
