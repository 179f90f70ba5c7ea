"""tracks.csv: one row per track and frame, with the columns of `track_range.results.columns`."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping
from operator import methodcaller
from pathlib import Path
from typing import Any

import numpy as np

from track_range.foundation.files.input_files import MAX_TABLE_BYTES, quoted, read_text, shortened
from track_range.foundation.files.output_files import OutputError
from track_range.pipeline.frame_result import FrameResult
from track_range.results.columns import MAX_CLASS, MAX_COLUMNS, Columns, result_columns
from track_range.results.formats.row_file import RowFile, csv_text
from track_range.results.writers import RunInfo

TABLE_FILE = "tracks.csv"

_INVALID_NUMBER = re.compile(r"column #(\d+): Row #(\d+): .*invalid value '(.*)'", re.DOTALL)
"""Message of pyarrow on a cell that is not a number: column from 0, line from 1, cell."""

_MAX_PROBLEM = 150
"""Largest number of characters of the description of a problem."""


class CsvWriter:
    """Writer of tracks.csv, frame by frame (see `RowFile`). An empty cell = not measured."""

    files = (TABLE_FILE,)

    def open(self, info: RunInfo, folder: Path) -> None:
        """Create the file with its header."""
        self._columns = result_columns()
        self._file = RowFile(folder / TABLE_FILE, csv_text([[column.name for column in self._columns]]))

    def write(self, result: FrameResult) -> None:
        """Add the rows of a frame."""
        self._file.write(csv_text(zip(*map(methodcaller("text", result), self._columns), strict=True)))

    def discard_last(self) -> None:
        """Remove the rows of the last frame."""
        self._file.discard_last()

    def close(self, summary: Mapping[str, Any] | None) -> None:
        """Close the file."""
        self._file.close()


def read_tracks_csv(path: Path) -> Columns:
    """Columns of a tracks.csv: `class` as str, the others as float64 with NaN for an empty cell.

    Rows with a different number of cells than the header, such as the last one of a killed run, are skipped.

    Raises:
        OutputError: the file cannot be read, is not a tracks.csv, or has no row of the header's length but others.
    """
    import pyarrow as pa
    from pyarrow import ArrowException
    from pyarrow import csv as arrow_csv

    header: list[str] = []
    n_cells: list[int] = []  # of the rows that are skipped
    text = read_text(path, OutputError, "the tracks.csv of a run", max_bytes=MAX_TABLE_BYTES)
    try:
        header = next(csv.reader([text.partition("\n")[0]]))
        if len(set(header)) < len(header):
            raise ValueError("two columns of the same name")
        if len(header) > MAX_COLUMNS:
            raise ValueError(f"{len(header)} columns, more than {MAX_COLUMNS}")

        def skip(row: arrow_csv.InvalidRow) -> str:
            n_cells.append(row.actual_columns)
            return "skip"

        table = arrow_csv.read_csv(
            pa.BufferReader(text.encode()),
            read_options=arrow_csv.ReadOptions(use_threads=False),
            parse_options=arrow_csv.ParseOptions(invalid_row_handler=skip),
            convert_options=arrow_csv.ConvertOptions(
                column_types={name: "string" if name == "class" else "float64" for name in header}, null_values=[""]
            ),
        )
        columns = {name: table.column(name) for name in header}
        if "class" in columns and max(map(len, columns["class"].to_pylist()), default=0) > MAX_CLASS:
            raise ValueError(f"a class name of more than {MAX_CLASS} characters")
        if not len(table) and (len(n_cells) > 1 or (n_cells and text.endswith("\n"))):
            raise ValueError(f"{len(n_cells)} rows, none with the {len(header)} cells of the header")
    except (ValueError, LookupError, StopIteration, csv.Error, ArrowException) as error:
        problem = shortened(_problem(str(error), header), _MAX_PROBLEM)
        raise OutputError(
            f"{path}: expected the tracks.csv of a run, found {problem}; repeat the run or restore the file."
        ) from error
    return {
        name: np.asarray(values.to_pylist(), np.str_) if name == "class" else np.asarray(values.to_numpy(), np.float64)
        for name, values in columns.items()
    }


def _problem(reason: str, header: list[str]) -> str:
    """What was found instead of rows, from an error of reading."""
    invalid = _INVALID_NUMBER.search(reason)
    if invalid is not None and int(invalid[1]) < len(header):
        column, line, value = invalid.groups()
        return f"{quoted(value)} in the column {header[int(column)]} in line {line}"
    return reason or "no header"
