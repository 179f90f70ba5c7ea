"""tracks.parquet: the columns of tracks.csv in full precision, with units and provenance; null =
not measured.

During the run the rows are in tracks.arrows, an Arrow IPC stream with one record batch per frame,
which is converted and removed at the end. After a kill, tracks.arrows contains all finished frames,
and is read instead.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from track_range.foundation.files.atomic_files import atomic_path, writable
from track_range.foundation.files.input_files import MAX_TABLE_BYTES, check_regular, shortened
from track_range.foundation.files.output_files import OutputError
from track_range.foundation.schemas.schema_version import check_schema_version
from track_range.pipeline.frame_result import FrameResult
from track_range.results.formats.row_file import RowFile
from track_range.results.formats.run_info import RunInfo
from track_range.results.rows.arrow import record_batch, rows_schema
from track_range.results.rows.column import RowReader
from track_range.results.rows.columns import (
    MAX_COLUMNS,
    MAX_NAME,
    learn_networks,
    result_columns,
    text_columns,
)

if TYPE_CHECKING:
    import pyarrow as pa

PARQUET_FILE, STREAM_FILE = "tracks.parquet", "tracks.arrows"
_END = b"\xff\xff\xff\xff\0\0\0\0"  # of an Arrow IPC stream, which goes on with later frames
_ROWS_PER_GROUP = 32_768  # rows per row group, about 9 MB in memory: minutes of video


class ParquetWriter:
    """Writer of tracks.parquet, by way of tracks.arrows."""

    files = (PARQUET_FILE,)
    temporary_files = (STREAM_FILE,)

    def open(self, info: RunInfo, folder: Path) -> None:
        """Create tracks.arrows with its schema."""
        import pyarrow as pa

        self._path, self._stream_path = folder / PARQUET_FILE, folder / STREAM_FILE
        self._columns = result_columns(info.methods)
        self._reader = RowReader(self._columns)
        self._schema = rows_schema(self._columns, info.provenance.metadata())
        start = pa.BufferOutputStream()
        with pa.ipc.new_stream(start, self._schema) as stream:
            # this batch without rows contains the class names, which later batches refer to
            stream.write_batch(record_batch([], self._columns, self._schema))
        self._file = RowFile(self._stream_path, start.getvalue().to_pybytes()[: -len(_END)])

    def write(self, result: FrameResult) -> None:
        """Add the rows of a frame to tracks.arrows."""
        if not len(result.tracks):
            self._file.write(b"")
            return
        batch = record_batch([self._reader.read(result)], self._columns, self._schema)
        self._file.write(batch.serialize())

    def discard_last(self) -> None:
        """Remove the rows of the last frame."""
        self._file.discard_last()

    def close(self, summary: Mapping[str, Any] | None) -> None:
        """Convert tracks.arrows to tracks.parquet, and remove tracks.arrows unless that fails."""
        self._file.close()
        with _stream(self._stream_path) as reader, atomic_path(self._path) as partial:
            _write_batches(partial, reader.schema, _complete_batches(reader))
        self._stream_path.unlink()


def write_table(path: Path, table: pa.Table) -> None:
    """Write rows in full precision and metadata as tracks.parquet; equal rows give equal bytes.
    Raises OutputError.
    """
    with writable(path, OutputError), atomic_path(path, is_flushed=False) as partial:
        _write_batches(partial, table.schema, table.to_batches())


def _write_batches(path: Path, schema: pa.Schema, batches: Iterable[pa.RecordBatch]) -> None:
    """Write Parquet with groups of about `_ROWS_PER_GROUP` rows, one of which is in memory at a
    time.
    """
    import pyarrow as pa
    from pyarrow import parquet

    # other numbers hardly repeat
    coded = [
        name for name in ("frame", "time_s", "track_id", *text_columns()) if name in schema.names
    ]
    with parquet.ParquetWriter(path, schema, compression="zstd", use_dictionary=coded) as writer:
        group: list[pa.RecordBatch] = []
        n_rows = 0
        for batch in batches:
            group.append(batch)
            n_rows += batch.num_rows
            if n_rows >= _ROWS_PER_GROUP:
                writer.write_table(pa.Table.from_batches(group, schema).combine_chunks())
                group, n_rows = [], 0
        if n_rows:
            writer.write_table(pa.Table.from_batches(group, schema).combine_chunks())


@contextmanager
def _stream(path: Path) -> Iterator[pa.RecordBatchStreamReader]:
    import pyarrow as pa

    with pa.OSFile(str(path)) as file, pa.ipc.open_stream(file) as reader:
        yield reader


def _complete_batches(
    reader: pa.RecordBatchStreamReader, errors: list[Exception] | None = None
) -> Iterator[pa.RecordBatch]:
    """Batches with rows; the error of an incomplete last batch is added to `errors`."""
    from pyarrow import ArrowException

    while True:
        try:
            batch = reader.read_next_batch()
            batch.validate(full=True)
        except StopIteration:
            return
        except (ArrowException, OSError) as error:
            if errors is not None:
                errors.append(error)
            return
        if batch.num_rows:
            yield batch


def read_tracks_parquet(path: Path) -> dict[str, npt.NDArray[Any]]:
    """Columns of a tracks.parquet, not validated: names as str, other columns as float64 with NaN
    for null.

    Columns of other types are skipped. OutputError if the file cannot be read, is not of a run, or
    was written by a newer version.
    """
    from pyarrow import parquet

    with _errors_of(path), parquet.ParquetFile(path) as file:
        names = _usable_columns(path, file.schema_arrow)
        n_bytes = 8 * len(names) * file.metadata.num_rows
        if n_bytes > MAX_TABLE_BYTES:
            raise OutputError(
                f"{path}: expected at most {MAX_TABLE_BYTES / 1e9:.0f} GB of rows, found "
                f"{n_bytes / 1e9:.3g} GB; read it with pyarrow or DuckDB."
            )
        table = file.read(columns=names, use_threads=False)
        table.validate(full=True)
        return _columns(table)


def read_tracks_arrows(path: Path) -> tuple[dict[str, npt.NDArray[Any]], bool]:
    """Columns of the complete frames of a tracks.arrows, and whether it ends within a frame; errors
    as for Parquet.
    """
    import pyarrow as pa

    errors: list[Exception] = []
    with _errors_of(path), _stream(path) as reader:
        names = _usable_columns(path, reader.schema)
        table = pa.Table.from_batches(list(_complete_batches(reader, errors)), reader.schema)
        return _columns(table.select(names)), bool(errors)


@contextmanager
def _errors_of(path: Path) -> Iterator[None]:
    from pyarrow import ArrowException

    check_regular(path, OutputError, f"the {path.name} of a run", max_bytes=MAX_TABLE_BYTES)
    try:
        yield
    except (ArrowException, OSError, ValueError, LookupError, MemoryError) as error:
        raise OutputError(
            f"{path}: expected the {path.name} of a run, found a damaged file "
            f"({shortened(str(error))}); repeat the run or restore the file."
        ) from error


def _usable_columns(path: Path, schema: pa.Schema) -> list[str]:
    """Names of the readable columns; OutputError for a newer version, ValueError for too many or
    equal names.
    """
    from pyarrow import types

    check_schema_version(path, schema.metadata, OutputError)
    if len(schema) > MAX_COLUMNS or len(set(schema.names)) < len(schema):
        raise ValueError("columns")
    learn_networks(schema.names)
    names, texts = [], text_columns()
    for field in schema:
        is_text = field.name in texts
        kind = field.type.value_type if types.is_dictionary(field.type) and is_text else field.type
        if is_text:
            is_usable = types.is_string(kind) or types.is_large_string(kind)
        else:
            is_usable = types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind)
        names += [field.name] if is_usable else []
    return names


def _columns(table: pa.Table) -> dict[str, npt.NDArray[Any]]:
    """Columns as NumPy arrays; ValueError if a name is too long."""
    columns: dict[str, npt.NDArray[Any]] = {}
    texts = text_columns()
    for name in table.column_names:
        values = table.column(name)
        if name not in texts:
            columns[name] = np.asarray(values.to_numpy(), np.float64)
            continue
        for chunk in values.chunks:  # each name of a dictionary once
            names = chunk.dictionary if hasattr(chunk, "dictionary") else chunk
            if (
                names.nbytes > MAX_NAME * (len(names) + 1)
                and max(map(len, names.drop_null().to_pylist())) > MAX_NAME
            ):
                raise ValueError("class name too long")
        columns[name] = np.asarray(
            ["" if value is None else str(value) for value in values.to_pylist()], np.str_
        )
    return columns
