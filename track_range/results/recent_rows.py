"""RecentRows: rows and events of the last frames of a drive without an end, in bounded memory."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from track_range.pipeline.frame_result import FrameResult
from track_range.results.arrow_rows import FrameValues, frame_values, record_batch, rounded_batch, rows_schema
from track_range.results.columns import result_columns
from track_range.results.events.event import Event
from track_range.results.events.finder import EventFinder

if TYPE_CHECKING:
    import pyarrow as pa


class RecentRows:
    """Rows and events of the last `keep_s` seconds."""

    def __init__(self, keep_s: float, finder: EventFinder | None = None) -> None:
        self._keep_s, self._finder = keep_s, finder or EventFinder()
        self._columns = result_columns()
        self._rows: deque[tuple[float, FrameValues]] = deque()

    def add(self, result: FrameResult) -> None:
        """Add a frame, and forget what is older than `keep_s`."""
        self._finder.update(result)
        if len(result.tracks):
            # copies, since the caller may change the arrays of the result
            self._rows.append((result.time_s, list(map(np.array, frame_values(result, self._columns)))))
        first_s = result.time_s - self._keep_s
        self._finder.forget(first_s)
        while self._rows and self._rows[0][0] < first_s:
            self._rows.popleft()

    def events(self) -> tuple[Event, ...]:
        """Events so far, in the order of their starts; of those in progress, what is known."""
        return self._finder.so_far()

    def to_arrow(self) -> pa.Table:
        """The rows, rounded as in tracks.csv."""
        import pyarrow as pa

        rows = [values for _, values in self._rows]
        batch = record_batch(rows, self._columns, rows_schema(self._columns))
        return pa.Table.from_batches([rounded_batch(batch, self._columns)])
