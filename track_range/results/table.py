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
from track_range.foundation.atomic_files import describe
from track_range.results.columns import ResultColumn, result_columns
from track_range.results.output_files import OutputError
from track_range.run.frame_result import FrameResult

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
        self._buffer: list[list[npt.NDArray[Any]]] = []
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
        self._buffer.append([np.asarray(column.read(result)) for column in self.columns])
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

    def to_arrow(self) -> pa.Table:
        """Rows so far as a `pyarrow.Table`, memory-mapped from the temporary file if there is one.

        Null = not measured; `class` is a dictionary column of names; the metadata of a field contains its unit.
        """
        import pyarrow as pa

        stored = [] if self._file is None else self._file.batches()
        return pa.Table.from_batches([*stored, self._buffered()])

    def to_pandas(self) -> Any:
        """Rows so far as a `pandas.DataFrame`.

        Raises:
            ImportError: pandas is not installed.
        """
        return self.to_arrow().to_pandas()

    def to_columns(self) -> dict[str, npt.NDArray[Any]]:
        """Rows so far as `track_range.results.columns.Columns`, equal to those read from tracks.csv."""
        table = self.to_arrow()
        return {column.name: _as_numpy(table.column(column.name), column) for column in self.columns}

    def close(self) -> None:
        """Delete the temporary file; tables made from it remain valid."""
        self._buffer, self._n_buffered = [], 0
        if self._file is not None:
            self._file.close()
            self._file = None

    def _buffered(self) -> pa.RecordBatch:
        import pyarrow as pa

        by_column = zip(*self._buffer, strict=True) if self._buffer else [()] * len(self.columns)
        arrays = [_as_arrow(parts, column) for parts, column in zip(by_column, self.columns, strict=True)]
        fields = [
            pa.field(column.name, array.type, metadata={"unit": column.unit} if column.unit else None)
            for column, array in zip(self.columns, arrays, strict=True)
        ]
        return pa.record_batch(arrays, schema=pa.schema(fields))


def _as_arrow(parts: tuple[npt.NDArray[Any], ...], column: ResultColumn) -> pa.Array:
    import pyarrow as pa

    kinds = {"whole": np.int64, "number": np.float64, "flag": np.bool_, "class": np.int8}
    values: npt.NDArray[Any] = np.concatenate(
        [*parts, np.zeros(0, kinds[column.kind])], dtype=kinds[column.kind], casting="unsafe"
    )
    if column.kind == "class":
        return pa.DictionaryArray.from_arrays(pa.array(values), pa.array(ROAD_CLASSES))
    return pa.array(column.rounded(values), from_pandas=True)  # NaN becomes null


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
