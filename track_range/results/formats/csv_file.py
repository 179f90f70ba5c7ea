"""tracks.csv: one row per track and frame, with the columns of `results.rows.columns`."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from track_range.foundation.files.input_files import MAX_TABLE_BYTES, quoted, read_text, shortened
from track_range.foundation.files.output_files import OutputError
from track_range.pipeline.frame_result import FrameResult
from track_range.results.formats.row_file import RowWriter, csv_text
from track_range.results.rows.column import RowReader
from track_range.results.rows.columns import (
    MAX_COLUMNS,
    MAX_NAME,
    learn_networks,
    result_columns,
    text_columns,
)

if TYPE_CHECKING:
    from pyarrow import csv as arrow_csv


TABLE_FILE = "tracks.csv"

_INVALID_NUMBER = re.compile(r"column #(\d+): Row #(\d+): .*invalid value '(.*)'", re.DOTALL)
"""Message of pyarrow on a cell that is not a number: column from 0, line from 1, cell."""

_MAX_PROBLEM = 150  # largest number of characters of the description of a problem


class CsvWriter(RowWriter):
    """Writer of tracks.csv, frame by frame. An empty cell = not measured."""

    files = (TABLE_FILE,)

    def header(self) -> str:
        """Names of the columns."""
        columns = result_columns(self.info.methods)
        self._reader = RowReader(columns)
        self._line = ",".join(column.cell for column in columns) + "\n"
        return csv_text([[column.name for column in columns]])

    def rows(self, result: FrameResult) -> str:
        """The rows of a frame."""
        values = {
            kind: iter(of_kind.tolist()) for kind, of_kind in self._reader.read(result).items()
        }
        cells: list[Sequence[float | str]] = []
        for column in self._reader.columns:
            of_column = next(values[column.kind])
            if column.kind == "name":
                of_column = ["" if isnan(code) else column.names[int(code)] for code in of_column]
            cells.append(of_column)
        # formatted line by line; names of classes and states do not contain "nan"
        return "".join([self._line % row for row in zip(*cells, strict=True)]).replace("nan", "")


def read_tracks_csv(path: Path) -> dict[str, npt.NDArray[Any]]:
    """Columns of a tracks.csv, not validated: names as str, other columns as float64 with NaN for
    an empty cell.

    Rows with a different number of cells than the header, such as the last one of a killed run, are
    skipped. OutputError if the file cannot be read, is not a tracks.csv, or has rows, but none of
    the header's length.
    """
    from pyarrow import ArrowException

    header: list[str] = []
    text = read_text(path, OutputError, "the tracks.csv of a run", max_bytes=MAX_TABLE_BYTES)
    try:
        header = _checked_header(text)
        columns = _arrow_columns(text, header)
        texts = text_columns()
        for name in columns.keys() & texts:
            longest = max((len(text or "") for text in columns[name].to_pylist()), default=0)
            if longest > MAX_NAME:
                raise ValueError(f"a {name} name of more than {MAX_NAME} characters")
    except (ValueError, LookupError, StopIteration, csv.Error, ArrowException) as error:
        problem = str(error) or "no header"
        invalid = _INVALID_NUMBER.search(problem)
        if invalid is not None and int(invalid[1]) < len(header):
            column, line, value = invalid.groups()
            problem = f"{quoted(value)} in the column {header[int(column)]} in line {line}"
        raise OutputError(
            f"{path}: expected the tracks.csv of a run, found {shortened(problem, _MAX_PROBLEM)}; "
            "repeat the run or restore the file."
        ) from error
    return {
        name: np.asarray([text or "" for text in values.to_pylist()], np.str_)
        if name in texts
        else np.asarray(values.to_numpy(), np.float64)
        for name, values in columns.items()
    }


def _checked_header(text: str) -> list[str]:
    """Names of the columns; ValueError: two are equal, or there are too many."""
    header = next(csv.reader([text.partition("\n")[0]]))
    if len(set(header)) < len(header):
        raise ValueError("two columns of the same name")
    if len(header) > MAX_COLUMNS:
        raise ValueError(f"{len(header)} columns, more than {MAX_COLUMNS}")
    learn_networks(header)
    return header


def _arrow_columns(text: str, header: Sequence[str]) -> dict[str, Any]:
    """The columns of the rows with the header's number of cells; ValueError: no row has it."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    n_cells: list[int] = []  # of the rows that are skipped

    def skip(row: arrow_csv.InvalidRow) -> str:
        n_cells.append(row.actual_columns)
        return "skip"

    texts = text_columns()
    types = {name: "string" if name in texts else "float64" for name in header}
    table = arrow_csv.read_csv(
        pa.BufferReader(text.encode()),
        read_options=arrow_csv.ReadOptions(use_threads=False),
        parse_options=arrow_csv.ParseOptions(invalid_row_handler=skip),
        convert_options=arrow_csv.ConvertOptions(column_types=types, null_values=[""]),
    )
    is_whole = len(n_cells) > 1 or text.endswith("\n")  # else a killed run's first row
    if not len(table) and n_cells and is_whole:
        raise ValueError(f"{len(n_cells)} rows, none with the {len(header)} cells of the header")
    return {name: table.column(name) for name in header}
