"""CSV tables with named columns; errors name the file and the line."""

import csv
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.foundation.files.input_files import MAX_TABLE_BYTES, quoted, read_text
from track_range.foundation.files.numeric_text import number

# lines in which the header is looked for, and characters of each that are read
_MAX_PREAMBLE, _MAX_HEADER = 200, 10_000
_DECIMAL_COMMA = re.compile(r"([+-]?\d{1,20}),(\d{1,20}(?:[eE][+-]?\d{1,3})?)")


@dataclass(frozen=True, slots=True)
class CsvTable:
    """The N rows of stripped cells of a CSV file, with line numbers from 1 and the column names in
    lower case.

    `error` and `expected` are the class of exceptions and what the file should hold, for messages.
    """

    path: Path
    header: tuple[str, ...]
    rows: list[list[str]]
    lines: list[int]
    error: type[Exception]
    expected: str
    preamble: tuple[str, ...] = ()  # lines before the header

    def __len__(self) -> int:
        return len(self.rows)

    def __contains__(self, name: str) -> bool:
        return name in self.header

    def fault(self, row: int, message: str) -> Exception:
        """An exception about row `row`, counted from 0, that the caller raises."""
        return self.error(f"{self.path}, line {self.lines[row]}: {message}")

    def require(self, names: Iterable[str]) -> None:
        """Raise `error` unless there is exactly one column of each name."""
        missing = [name for name in names if name not in self.header]
        if missing:
            raise self.error(
                f"{self.path}: no column {', '.join(missing)}; expected {self.expected}."
            )
        self.refuse_duplicates(names)

    def refuse_duplicates(self, names: Iterable[str]) -> None:
        """Raise `error` if two columns have one of the names."""
        for name in names:
            if self.header.count(name) > 1:
                raise self.error(
                    f"{self.path}: expected one column {name}, got two; rename or remove one."
                )

    def texts(self, name: str) -> list[str]:
        """N cells of a column; empty texts if there is no such column."""
        if name not in self.header:
            return [""] * len(self.rows)
        column = self.header.index(name)
        return [row[column] for row in self.rows]

    def numbers(self, name: str) -> FloatArray:
        """(N,) numbers of a column; NaN for cells that are not numbers, and for a missing
        column.
        """
        return np.array([number(cell) for cell in self.texts(name)], np.float64)

    def finite(self, name: str) -> FloatArray:
        """(N,) numbers of a column; raises `error` for a cell that is not a finite number."""
        values = self.numbers(name)
        self.check(name, np.isfinite(values), "a finite number")
        return values

    def check(self, name: str, is_valid: BoolArray, expected: str) -> None:
        """Raise `error` for the first row (N,) whose cell of column `name` is invalid."""
        for row in np.flatnonzero(~is_valid).tolist():
            cell = self.texts(name)[row]
            advice = "; write decimals with a point" if _DECIMAL_COMMA.fullmatch(cell) else ""
            got = quoted(cell) if name in self.header else f"no column {name}"
            raise self.fault(row, f"expected {expected} for {name}, got {got}{advice}.")


def read_csv_table(
    path: Path,
    error: type[Exception],
    expected: str,
    *,
    default_header: Sequence[str] = (),
    exact: bool = False,
    is_header: Callable[[Sequence[str]], bool] | None = None,
) -> CsvTable:
    """Read a CSV file in UTF-8 with a header line; `expected` is the expected content, such as
    "columns time_s".

    Columns may be separated by semicolons or tabs instead of commas; then decimals may have a
    comma. `default_header` names the columns of a file whose first line has no column names. Rows
    with missing cells, or one separator at the end, are allowed unless `exact`. `is_header`:
    whether cells in lower case are the header, of files that may have lines before it. Raises
    `error` if the file is unreadable, empty or not CSV, a row has too many cells, or a column has
    no name.
    """
    text = read_text(path, error, "CSV", max_bytes=MAX_TABLE_BYTES)
    lines = text.split("\n")
    n_before = 0 if is_header is None else line_of_header(lines, is_header) or 0
    separator = _separator("\n".join(lines[n_before:]))
    reader = csv.reader(lines[n_before:], strict=True, delimiter=separator)
    try:
        numbered = [
            (n_before + reader.line_num, [cell.strip() for cell in row])
            for row in reader
            if any(map(str.strip, row))
        ]
    except csv.Error as reason:
        raise error(
            f"{path}, line {n_before + reader.line_num}: expected {expected} as CSV; check the "
            f"quotation marks ({reason})."
        ) from reason
    if not numbered:
        raise error(f"{path}: the file is empty; expected {expected}.")
    preamble = tuple(lines[:n_before])
    places, rows = [line for line, _ in numbered], [row for _, row in numbered]
    header = tuple(cell.lower().lstrip("# ") for cell in rows[0])
    if separator != ",":
        rows = [[_with_decimal_point(cell) for cell in row] for row in rows]
    if default_header and not set(header) & set(default_header):
        header = tuple(default_header[: len(rows[0])])
    else:
        rows, places = rows[1:], places[1:]
    table = CsvTable(path, header, rows, places, error, expected, preamble)
    _complete(table, exact=exact)
    return table


def line_of_header(lines: Sequence[str], is_header: Callable[[Sequence[str]], bool]) -> int | None:
    """Index of the first line that is a header, comments last; None = none near the start."""
    starts = [line[:_MAX_HEADER].strip("# ") for line in lines[:_MAX_PREAMBLE]]
    rows = [next(csv.reader([line.lower()], delimiter=_separator(line)), []) for line in starts]
    headers = [i for i, row in enumerate(rows) if is_header([cell.strip() for cell in row])]
    return min(headers, key=lambda index: (lines[index].startswith("#"), index), default=None)


def _with_decimal_point(cell: str) -> str:
    return _DECIMAL_COMMA.sub(r"\1.\2", cell) if _DECIMAL_COMMA.fullmatch(cell) else cell


def _complete(table: CsvTable, *, exact: bool) -> None:
    """Append the missing cells of each row; raises the table's error for a wrong number of
    cells.
    """
    n_columns = len(table.header)
    unnamed = [column for column, name in enumerate(table.header) if not name]
    for index, row in enumerate(table.rows):
        if len(row) < n_columns and not exact:
            row.extend([""] * (n_columns - len(row)))
        has_separator_at_end = not exact and len(row) == n_columns + 1 and not row[-1]
        if len(row) != n_columns and not has_separator_at_end:
            raise table.fault(
                index,
                f"expected {n_columns} cells as in the header, got {len(row)}; write decimals with "
                "a point, and put texts with commas in double quotes.",
            )
        if any(row[column] for column in unnamed):
            raise table.fault(index, "expected a name in the header for each column with values.")


def _separator(text: str) -> str:
    """Separator of the columns: a semicolon or tab if the first line that is not empty has one
    outside quotes.
    """
    first = re.sub(r'"[^"]*"', "", next((line for line in text.split("\n") if line.strip()), ""))
    return next((mark for mark in ";\t" if mark in first), ",") if "," not in first else ","
