"""Rows in Apache Arrow, for the table in memory and tracks.parquet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from track_range.results.rows.column import DTYPES, ResultColumn

if TYPE_CHECKING:
    import pyarrow as pa

# values of the rows of one frame, not rounded: one (N,) array per column
FrameValues = list[npt.NDArray[Any]]


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

    arrays = []
    for column, parts in zip(
        columns, zip(*frames, strict=True) if frames else [()] * len(columns), strict=True
    ):
        dtype = np.float64 if column.kind == "name" else DTYPES[column.kind]
        values: npt.NDArray[Any]
        if len(parts) == 1:
            values = np.ascontiguousarray(parts[0], dtype)
        else:
            values = np.concatenate([*parts, np.zeros(0, dtype)], dtype=dtype, casting="unsafe")
        if column.kind == "name":
            codes = pa.array(np.nan_to_num(values).astype(np.int8), mask=np.isnan(values))
            arrays.append(pa.DictionaryArray.from_arrays(codes, pa.array(column.names)))
        else:
            arrays.append(pa.array(values, from_pandas=True))  # NaN becomes null
    return pa.record_batch(arrays, schema=schema)


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
