"""tracks.csv: one row per track and frame, with the columns of `track_range.results.columns`."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from track_range.foundation.input_files import MAX_TABLE_BYTES, read_text
from track_range.results.columns import Columns, result_columns
from track_range.results.formats.row_file import RowFile
from track_range.results.output_files import OutputError
from track_range.results.writers import RunInfo
from track_range.run.frame_result import FrameResult

TABLE_FILE = "tracks.csv"

_MAX_CLASS = 200
"""Largest number of characters of a class name."""


class CsvWriter:
    """Writer of tracks.csv, frame by frame (see `RowFile`). An empty cell = not measured."""

    files = (TABLE_FILE,)

    def open(self, info: RunInfo, folder: Path) -> None:
        """Create the file with its header."""
        self._columns = result_columns()
        self._file = RowFile(folder / TABLE_FILE, _csv_text([[column.name for column in self._columns]]))

    def write(self, result: FrameResult) -> None:
        """Add the rows of a frame."""
        self._file.write(_csv_text(zip(*(column.text(result) for column in self._columns), strict=True)))

    def discard_last(self) -> None:
        """Remove the rows of the last frame."""
        self._file.discard_last()

    def close(self, summary: Mapping[str, Any] | None) -> None:
        """Close the file."""
        self._file.close()


def _csv_text(rows: Iterable[Iterable[str]]) -> str:
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def read_tracks_csv(path: Path) -> Columns:
    """Columns of a tracks.csv: `class` as str, the others as float64 with NaN for an empty cell.

    Rows with a different number of cells than the header, such as the last one of a killed run, are skipped.

    Raises:
        OutputError: the file cannot be read, or is not a tracks.csv.
    """
    import pyarrow as pa
    from pyarrow import ArrowException
    from pyarrow import csv as arrow_csv

    text = read_text(path, OutputError, "the tracks.csv of a run", max_bytes=MAX_TABLE_BYTES)
    try:
        header = next(csv.reader([text.partition("\n")[0]]))
        if len(set(header)) < len(header):
            raise ValueError("duplicate column")
        table = arrow_csv.read_csv(
            pa.BufferReader(text.encode()),
            read_options=arrow_csv.ReadOptions(use_threads=False),
            parse_options=arrow_csv.ParseOptions(invalid_row_handler=lambda row: "skip"),
            convert_options=arrow_csv.ConvertOptions(
                column_types={name: "string" if name == "class" else "float64" for name in header}, null_values=[""]
            ),
        )
        columns = {name: table.column(name) for name in header}
        if "class" in columns and max(map(len, columns["class"].to_pylist()), default=0) > _MAX_CLASS:
            raise ValueError("class name too long")
    except (ValueError, LookupError, StopIteration, csv.Error, ArrowException) as error:
        raise OutputError(f"{path}: cannot be read as the tracks.csv of a run.") from error
    return {
        name: np.asarray(values.to_pylist(), np.str_) if name == "class" else np.asarray(values.to_numpy(), np.float64)
        for name, values in columns.items()
    }
