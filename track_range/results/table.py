"""Rows and events of a run in memory: `RunTable` (rows), `RunRows` (of a run), `RecentRows` (of an
endless drive).
"""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections import deque
from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import numpy.typing as npt

from track_range.foundation.files.atomic_files import describe
from track_range.foundation.files.output_files import OutputError
from track_range.pipeline.frame_result import FrameResult
from track_range.results.counts.counter import LineCounter
from track_range.results.events.event import Event
from track_range.results.events.finder import EventFinder
from track_range.results.rows.arrow import record_batch, rounded_batch, rows_schema
from track_range.results.rows.column import FrameValues, RowReader
from track_range.results.rows.columns import result_columns
from track_range.results.rows.rows import Rows

if TYPE_CHECKING:
    import pyarrow as pa

ROWS_PER_BATCH = 8192  # rows per batch, a few MB: about a minute of video
# largest number of frames per batch: the arrays of a frame take 5 kB, however few rows it has
FRAMES_PER_BATCH = 512


class RunTable:
    """Rows of a run in Apache Arrow's columnar format, one per track and frame; also a context manager.

        frame results --> buffer --> record batches in one temporary file (Arrow IPC stream) --> memory-mapped table

    Only the buffer of `rows_per_batch` rows is held in memory, so that memory use does not grow over hours; a run that
    is shorter than one batch writes no file. The file is deleted with the `RunTable`.
    """

    def __init__(
        self, *, methods: Collection[str] = (), rows_per_batch: int = ROWS_PER_BATCH
    ) -> None:
        """A table without rows; `methods` are those that measure in the run."""
        self.columns = result_columns(methods)
        self._reader = RowReader(self.columns)
        self._rows_per_batch = rows_per_batch
        self._buffer: list[FrameValues] = []
        self._n_buffered = 0
        self._file: _BatchFile | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def append(self, result: FrameResult) -> None:
        """Add the rows of one frame; OutputError if a batch cannot be written: the table is then
        unchanged.
        """
        if not len(result.tracks):
            return
        # copies, since the caller may change the arrays of the result
        self._buffer.append(self._reader.read(result))
        self._n_buffered += len(result.tracks)
        if self._n_buffered >= self._rows_per_batch or len(self._buffer) >= FRAMES_PER_BATCH:
            try:
                batch = self._buffered()
                if self._file is None:
                    self._file = _BatchFile(batch.schema)
                self._file.write(batch)
            except BaseException:
                self._buffer.pop()  # the caller discards this frame
                self._n_buffered -= len(result.tracks)
                raise
            self._buffer, self._n_buffered = [], 0

    def to_arrow(self, *, is_rounded: bool = True) -> pa.Table:
        """Rows so far as a `pyarrow.Table`, rounded as in tracks.csv or in full precision, which is
        memory-mapped.

        Null = not measured; `class` is a dictionary column of names; the metadata of a field
        contains its unit.
        """
        import pyarrow as pa

        batches = [*([] if self._file is None else self._file.batches()), self._buffered()]
        return pa.Table.from_batches(
            [rounded_batch(b, self.columns) for b in batches] if is_rounded else batches
        )

    def to_rows(self, *, is_rounded: bool = True) -> Rows:
        """Rows so far, as in tracks.csv or in full precision."""
        table = self.to_arrow(is_rounded=False)
        columns: dict[str, npt.NDArray[Any]] = {}
        for column in self.columns:
            values = table.column(column.name)
            if column.kind == "name":
                names = np.array([*column.names, ""])  # the last one stands for null
                codes = [
                    chunk.indices.fill_null(len(column.names)).to_numpy() for chunk in values.chunks
                ]
                columns[column.name] = names[np.concatenate(codes)]
            else:
                columns[column.name] = values.to_numpy()
        rows = Rows(columns)
        return rows.rounded() if is_rounded else rows

    def close(self) -> None:
        """Delete the temporary file; tables made from it remain valid."""
        self._buffer, self._n_buffered = [], 0
        if self._file is not None:
            self._file.close()
            self._file = None

    def _buffered(self) -> pa.RecordBatch:
        return record_batch(self._buffer, self.columns, rows_schema(self.columns))


class _BatchFile:
    """File of record batches in a temporary folder, readable while it grows; OutputError if it
    cannot be written.
    """

    def __init__(self, schema: pa.Schema) -> None:
        import pyarrow as pa

        try:
            folder = tempfile.mkdtemp(prefix="track-range-")
            # also when garbage-collected
            self._remove = weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
            self._path = Path(folder) / "rows.arrows"
            self._file = pa.OSFile(str(self._path), "wb")
            self._writer = pa.ipc.new_stream(self._file, schema)
            self._n_batches = 0
        except OSError as error:
            raise _not_stored(Path(tempfile.gettempdir()), error) from error

    def write(self, batch: pa.RecordBatch) -> None:
        try:
            self._writer.write_batch(batch)
        except OSError as error:
            raise _not_stored(self._path, error) from error
        self._n_batches += 1

    def batches(self) -> list[pa.RecordBatch]:
        """All batches, memory-mapped; without a batch that could not be written completely."""
        import pyarrow as pa

        with pa.ipc.open_stream(pa.memory_map(str(self._path))) as reader:
            return list(islice(reader, self._n_batches))

    def close(self) -> None:
        with suppress(OSError):  # a full disk has been reported by `write`
            self._writer.close()
            self._file.close()
        self._remove()


def _not_stored(path: Path, error: OSError) -> OutputError:
    return OutputError(f"{path}: rows of the run cannot be stored ({describe(error)}).")


@dataclass(slots=True, kw_only=True)
class RunRows:
    """Rows and events of the finished frames of a run, or of any other sequence of frame
    results.
    """

    fps: float = 0.0  # nominal, for the duration of the last frame; 0 = unknown
    finder: EventFinder = field(default_factory=EventFinder)
    counter: LineCounter = field(default_factory=lambda: LineCounter(()))
    table: RunTable = field(default_factory=RunTable)
    # those that have ended; after `finish` all, in the order of their starts
    events: tuple[Event, ...] = ()
    frame_index: list[int] = field(default_factory=list)
    ego_mps: list[float] = field(default_factory=list)  # at the frames, NaN = unknown
    # names of the distances that were measured in any frame
    methods: set[str] = field(default_factory=set)
    starts_s: float = 0.0
    last_s: float = 0.0

    def __len__(self) -> int:
        return len(self.frame_index)

    def add(self, result: FrameResult) -> tuple[Event, ...]:
        """Add a frame, and return the events that ended before it; OutputError if its rows cannot
        be stored.
        """
        self.table.append(result)
        ended = self.finder.update(result)
        self.counter.update(result)
        self.events += ended
        self.last_s = result.time_s
        if not self.frame_index:
            self.starts_s = result.time_s
        self.frame_index.append(result.index)
        self.ego_mps.append(result.ego_mps)
        self.methods.update(result.ranges)
        return ended

    def finish(self) -> None:
        """End the search for events after the last frame: `events` then also contains events in
        progress.
        """
        self.events = self.finder.finish()
        self.counter.finish()

    @property
    def seconds(self) -> float:
        """Duration of the frames in seconds, including the duration of the last frame."""
        return (
            self.last_s - self.starts_s + (1 / self.fps if self.fps else 0.0)
            if self.frame_index
            else 0.0
        )


class RecentRows:
    """Rows and events of the last `keep_s` seconds of a drive without an end, in bounded memory."""

    def __init__(self, keep_s: float, finder: EventFinder | None = None) -> None:
        self._keep_s, self._finder = keep_s, finder or EventFinder()
        self._rows: deque[tuple[float, FrameValues]] = deque()
        self._read_methods(())

    def __getstate__(self) -> tuple[Any, ...]:
        return self._keep_s, self._finder, self._rows, self._methods

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self._keep_s, self._finder, self._rows, methods = state
        self._read_methods(methods)

    def _read_methods(self, methods: Collection[str]) -> None:
        """Use the columns of these methods."""
        self._methods = tuple(methods)
        self._columns = result_columns(methods)
        self._reader = RowReader(self._columns)

    def add(self, result: FrameResult) -> None:
        """Add a frame, and forget rows and events that are older than `keep_s`."""
        if not self._rows and self._methods != (measured := tuple(result.ranges)):
            self._read_methods(measured)
        self._finder.update(result)
        if len(result.tracks):
            # copies, since the caller may change the arrays of the result
            self._rows.append((result.time_s, self._reader.read(result)))
        first_s = result.time_s - self._keep_s
        self._finder.forget(first_s)
        while self._rows and self._rows[0][0] < first_s:
            self._rows.popleft()

    def events(self) -> tuple[Event, ...]:
        """Events so far, in the order of their starts; events in progress have the values known so
        far.
        """
        return self._finder.so_far()

    def to_arrow(self) -> pa.Table:
        """The rows, rounded as in tracks.csv."""
        import pyarrow as pa

        batch = record_batch(
            [values for _, values in self._rows], self._columns, rows_schema(self._columns)
        )
        return pa.Table.from_batches([rounded_batch(batch, self._columns)])
