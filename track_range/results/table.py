"""RunTable: rows of a run in Apache Arrow's columnar format, collected during the run.

frame results --> buffer --> record batches in one temporary file (Arrow IPC stream) --> pyarrow.Table, memory-mapped

Only the buffer is held in memory, so that memory use does not grow over hours; a run that is shorter than one batch
writes no file. The file is deleted with the `RunTable`.
"""

from __future__ import annotations

import shutil
import tempfile
import weakref
from contextlib import suppress
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import numpy.typing as npt

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.files.atomic_files import describe
from track_range.foundation.files.output_files import OutputError
from track_range.pipeline.frame_result import FrameResult
from track_range.results.arrow_rows import FrameValues, frame_values, record_batch, rounded_batch, rows_schema
from track_range.results.columns import ResultColumn, result_columns

if TYPE_CHECKING:
    import pyarrow as pa

ROWS_PER_BATCH = 8192
"""Rows per batch, a few MB: about a minute of video."""

FRAMES_PER_BATCH = 512
"""Largest number of frames per batch: the arrays of a frame take 5 kB, however few rows it has."""


class RunTable:
    """Rows of a run, one per track and frame; also a context manager.

    Args:
        rows_per_batch: number of rows that are held in memory before they are written to disk.
    """

    def __init__(self, *, rows_per_batch: int = ROWS_PER_BATCH) -> None:
        self.columns = result_columns()
        self._rows_per_batch = rows_per_batch
        self._buffer: list[FrameValues] = []
        self._n_buffered = 0
        self._file: _BatchFile | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def append(self, result: FrameResult) -> None:
        """Add the rows of one frame.

        Raises:
            OutputError: a batch cannot be written to the temporary folder; the table is as before.
        """
        if not len(result.tracks):
            return
        # copies, since the caller may change the arrays of the result
        self._buffer.append(list(map(np.array, frame_values(result, self.columns))))
        self._n_buffered += len(result.tracks)
        if self._n_buffered >= self._rows_per_batch or len(self._buffer) >= FRAMES_PER_BATCH:
            try:
                self._store(self._buffered())
            except BaseException:
                self._buffer.pop()  # the caller discards this frame
                self._n_buffered -= len(result.tracks)
                raise
            self._buffer, self._n_buffered = [], 0

    def _store(self, batch: pa.RecordBatch) -> None:
        if self._file is None:
            self._file = _BatchFile(batch.schema)
        self._file.write(batch)

    def to_arrow(self, *, is_rounded: bool = True) -> pa.Table:
        """Rows so far as a `pyarrow.Table`.

        Null = not measured; `class` is a dictionary column of names; the metadata of a field contains its unit.

        Args:
            is_rounded: whether numbers are rounded as in tracks.csv; without rounding, the rows in the temporary file
                are memory-mapped.
        """
        import pyarrow as pa

        batches = [*([] if self._file is None else self._file.batches()), self._buffered()]
        return pa.Table.from_batches([rounded_batch(b, self.columns) for b in batches] if is_rounded else batches)

    def to_pandas(self) -> Any:
        """Rows so far as a `pandas.DataFrame`.

        Raises:
            ImportError: pandas is not installed.
        """
        return self.to_arrow().to_pandas()

    def to_columns(self, *, is_rounded: bool = True) -> dict[str, npt.NDArray[Any]]:
        """Rows so far as `track_range.results.columns.Columns`.

        Args:
            is_rounded: whether they equal those read from tracks.csv; False = full precision.
        """
        table = self.to_arrow(is_rounded=False)
        columns = {column.name: _as_numpy(table.column(column.name), column) for column in self.columns}
        if is_rounded:
            return {column.name: column.rounded(columns[column.name]) for column in self.columns}
        return columns

    def close(self) -> None:
        """Delete the temporary file; tables made from it remain valid."""
        self._buffer, self._n_buffered = [], 0
        if self._file is not None:
            self._file.close()
            self._file = None

    def _buffered(self) -> pa.RecordBatch:
        return record_batch(self._buffer, self.columns, rows_schema(self.columns))


def _as_numpy(values: pa.ChunkedArray, column: ResultColumn) -> npt.NDArray[Any]:
    if column.kind == "class":
        names = np.array(ROAD_CLASSES)
        chunks = [names[chunk.indices.to_numpy()] for chunk in values.chunks]
        return np.concatenate(chunks) if chunks else np.zeros(0, np.str_)
    return np.asarray(values.to_numpy(), np.float64)


class _BatchFile:
    """File of record batches in a temporary folder, readable while it grows.

    Raises:
        OutputError: the file cannot be created.
    """

    def __init__(self, schema: pa.Schema) -> None:
        import pyarrow as pa

        try:
            folder = tempfile.mkdtemp(prefix="track-range-")
            self._remove = weakref.finalize(
                self, shutil.rmtree, folder, ignore_errors=True
            )  # also when garbage-collected
            self._path = Path(folder) / "rows.arrows"
            self._file = pa.OSFile(str(self._path), "wb")
            self._writer = pa.ipc.new_stream(self._file, schema)
            self._n_batches = 0
        except OSError as error:
            raise _not_stored(Path(tempfile.gettempdir()), error) from error

    def write(self, batch: pa.RecordBatch) -> None:
        """Add a batch.

        Raises:
            OutputError: the batch cannot be written.
        """
        try:
            self._writer.write_batch(batch)
        except OSError as error:
            raise _not_stored(self._path, error) from error
        self._n_batches += 1

    def batches(self) -> list[pa.RecordBatch]:
        """All batches, memory-mapped; without one that could not be written completely."""
        import pyarrow as pa

        with pa.ipc.open_stream(pa.memory_map(str(self._path))) as reader:
            return list(islice(reader, self._n_batches))

    def close(self) -> None:
        """Delete the file."""
        with suppress(OSError):  # a full disk has been reported by `write`
            self._writer.close()
            self._file.close()
        self._remove()


def _not_stored(place: Path, error: OSError) -> OutputError:
    return OutputError(f"{place}: rows of the run cannot be stored ({describe(error)}).")
