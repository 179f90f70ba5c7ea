"""Rows in Apache Arrow, for the table in memory and tracks.parquet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from track_range.results.rows.column import DTYPES, FrameValues, ResultColumn

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

    n_rows = sum(frame.numbers.shape[1] for frame in frames)
    numbers = _joined([frame.numbers for frame in frames], np.float64)
    # columns are parts of one array, since creating an array takes longer than a part of one
    all_numbers = pa.array(numbers.ravel(), from_pandas=True)  # NaN becomes null
    arrays, begin, n_others = [], 0, 0
    for column in columns:
        if column.kind == "number":
            arrays.append(all_numbers.slice(begin, n_rows))
            begin += n_rows
            continue
        others = [frame.others[n_others] for frame in frames]
        n_others += 1
        if column.kind == "name":
            values = _joined(others, np.float64)
            is_unknown = np.isnan(values)
            codes = pa.array(np.where(is_unknown, 0, values).astype(np.int8), mask=is_unknown)
            arrays.append(pa.DictionaryArray.from_arrays(codes, pa.array(column.names)))
        else:
            arrays.append(pa.array(_joined(others, DTYPES[column.kind])))
    return pa.record_batch(arrays, schema=schema)


def _joined(parts: Sequence[npt.NDArray[Any]], dtype: Any) -> npt.NDArray[Any]:
    """The values of all frames, whose rows are the last axis; empty without frames."""
    if not parts:
        return np.zeros(0, dtype)
    return np.concatenate(parts, axis=-1, dtype=dtype, casting="unsafe")


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
