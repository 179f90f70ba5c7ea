"""Columns of clips.parquet as arrays; a column that is missing or has another type than expected is empty."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray

if TYPE_CHECKING:
    import pyarrow as pa


class ClipColumns:
    """Rows of clips.parquet by column.

    Attributes:
        names: names of the columns.
    """

    def __init__(self, table: pa.Table) -> None:
        self._table = table
        self.names: list[str] = table.column_names

    def __len__(self) -> int:
        return int(self._table.num_rows)

    def where(self, rows: BoolArray) -> ClipColumns:
        """The rows of a mask (N,)."""
        import pyarrow as pa

        return ClipColumns(self._table.filter(pa.array(rows)))

    @property
    def done(self) -> ClipColumns:
        """The complete clips."""
        return self.where(np.array([status == "done" for status in self.texts("status")], bool))

    @property
    def failed(self) -> ClipColumns:
        """The failed clips."""
        return self.where(np.array([status == "failed" for status in self.texts("status")], bool))

    def texts(self, name: str) -> list[str]:
        """Column as text; "" = null."""
        import pyarrow as pa

        if name not in self.names or pa.types.is_nested(self._table.schema.field(name).type):
            return [""] * len(self)
        values = self._table[name].to_pylist()
        return ["" if value is None else str(value) for value in values]

    def numbers(self, name: str) -> FloatArray:
        """Column (N,) as numbers; NaN = null, or not a column of numbers."""
        import pyarrow as pa

        kind = self._table.schema.field(name).type if name in self.names else pa.null()
        if not (pa.types.is_floating(kind) or pa.types.is_integer(kind)):
            return np.full(len(self), np.nan)
        values: FloatArray = self._table[name].cast(pa.float64()).to_numpy()
        return values

    def lists(self, name: str) -> list[list[str]]:
        """Column of lists of texts."""
        import pyarrow as pa

        if name not in self.names or not pa.types.is_list(self._table.schema.field(name).type):
            return [[] for _ in range(len(self))]
        return [[str(text) for text in texts or ()] for texts in self._table[name].to_pylist()]

    def utc_s(self, name: str) -> FloatArray:
        """Column of times (N,) in ISO 8601 as Unix time; NaN = unknown."""
        return np.array([unix_time(text) for text in self.texts(name)], np.float64)

    def prefixes(self, suffix: str) -> list[str]:
        """The columns of numbers with a suffix, without it, if they have a value."""
        names = [name.removesuffix(suffix) for name in self.names if name.endswith(suffix) and name != suffix]
        return [name for name in names if np.isfinite(self.numbers(f"{name}{suffix}")).any()]


def unix_time(text: str) -> float:
    """Unix time of a time in ISO 8601; NaN = not a time, or without a time zone."""
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        return float("nan")
    return moment.timestamp() if moment.tzinfo is not None else float("nan")
