"""Rows in Apache Arrow, for the table in memory and tracks.parquet."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from itertools import count
from typing import TYPE_CHECKING

import numpy as np

from track_range.results.rows.column import (
    DTYPES,
    STORED,
    ColumnKind,
    FrameValues,
    ResultColumn,
)

if TYPE_CHECKING:
    import pyarrow as pa


def rows_schema(
    columns: Sequence[ResultColumn], metadata: Mapping[str, str] | None = None
) -> pa.Schema:
    """Schema of the rows: columns of names are dictionaries, and the metadata of a field contains
    its unit.
    """
    import pyarrow as pa

    fields = [
        pa.field(
            column.name,
            pa.dictionary(pa.int8(), pa.string())
            if column.kind == "name"
            else pa.from_numpy_dtype(np.dtype(DTYPES[column.kind])),
            metadata={"unit": column.unit} if column.unit else None,
        )
        for column in columns
    ]
    return pa.schema(fields, metadata=None if metadata is None else dict(metadata))


def record_batch(
    frames: Sequence[FrameValues], columns: Sequence[ResultColumn], schema: pa.Schema
) -> pa.RecordBatch:
    """Rows of any number of frames, in full precision and with the `rows_schema`; null = not
    measured.
    """
    import pyarrow as pa

    # columns are parts of one array of their kind: creating an array takes longer than a part of one
    parts = {kind: _parts(frames, kind) for kind in STORED}
    arrays = []
    for column in columns:
        array = next(parts[column.kind])
        if column.kind == "name":
            array = pa.DictionaryArray.from_arrays(array, _names(column.names))
        arrays.append(array)
    return pa.record_batch(arrays, schema=schema)


def _parts(frames: Sequence[FrameValues], kind: ColumnKind) -> Iterator[pa.Array]:
    """The rows of all frames of the columns of a kind, one after the other."""
    import pyarrow as pa

    no_rows = np.zeros((0, 0), STORED[kind])
    values = np.concatenate([frame[kind] for frame in frames], axis=1) if frames else no_rows
    if kind == "name":
        is_unknown = np.isnan(values).ravel()
        codes = np.where(is_unknown, 0, values.ravel()).astype(np.int8)
        array = pa.array(codes, mask=is_unknown)
    else:
        array = pa.array(values.ravel(), from_pandas=True)  # NaN becomes null
    n_rows = values.shape[1]
    return (array.slice(number * n_rows, n_rows) for number in count())


@cache  # of few columns
def _names(names: tuple[str, ...]) -> pa.Array:
    import pyarrow as pa

    return pa.array(names)


def rounded_batch(batch: pa.RecordBatch, columns: Sequence[ResultColumn]) -> pa.RecordBatch:
    """Rows with numbers rounded to the decimals of tracks.csv."""
    import pyarrow as pa

    arrays = [
        pa.array(column.rounded(values.to_numpy(zero_copy_only=False)), from_pandas=True)
        if column.kind == "number"
        else values
        for values, column in zip(batch.columns, columns, strict=True)
    ]
    return pa.record_batch(arrays, schema=batch.schema)
