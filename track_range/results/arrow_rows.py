"""Rows of frame results as Arrow record batches, for the table in memory and tracks.parquet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from track_range.detection.classes import ROAD_CLASSES
from track_range.pipeline.frame_result import FrameResult
from track_range.results.columns import ResultColumn

if TYPE_CHECKING:
    import pyarrow as pa

FrameValues = list[npt.NDArray[Any]]
"""Values of the rows of one frame: one (N,) array per column."""

_TYPES = {"whole": np.int64, "number": np.float64, "flag": np.bool_, "class": np.int8}


def frame_values(result: FrameResult, columns: Sequence[ResultColumn]) -> FrameValues:
    """Values of the rows of a frame, not rounded."""
    return [np.asarray(column.read(result)) for column in columns]


def rows_schema(columns: Sequence[ResultColumn], metadata: Mapping[str, str] | None = None) -> pa.Schema:
    """Schema of the rows: `class` is a dictionary of names, and the metadata of a field contains its unit.

    Args:
        columns: the columns.
        metadata: metadata of the schema.
    """
    import pyarrow as pa

    def kind(column: ResultColumn) -> pa.DataType:
        if column.kind == "class":
            return pa.dictionary(pa.int8(), pa.string())
        return pa.from_numpy_dtype(np.dtype(_TYPES[column.kind]))

    fields = [
        pa.field(column.name, kind(column), metadata={"unit": column.unit} if column.unit else None)
        for column in columns
    ]
    return pa.schema(fields, metadata=None if metadata is None else dict(metadata))


def record_batch(frames: Sequence[FrameValues], columns: Sequence[ResultColumn], schema: pa.Schema) -> pa.RecordBatch:
    """Rows of some frames in full precision; null = not measured.

    Args:
        frames: values of each frame; may be empty.
        columns: the columns.
        schema: `rows_schema` of the columns.
    """
    import pyarrow as pa

    by_column = zip(*frames, strict=True) if frames else [()] * len(columns)
    return pa.record_batch(list(map(_array, by_column, columns)), schema=schema)


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


def _array(parts: Sequence[npt.NDArray[Any]], column: ResultColumn) -> pa.Array:
    import pyarrow as pa

    dtype = _TYPES[column.kind]
    values: npt.NDArray[Any]
    if len(parts) == 1:
        values = np.ascontiguousarray(parts[0], dtype)
    else:
        values = np.concatenate([*parts, np.zeros(0, dtype)], dtype=dtype, casting="unsafe")
    if column.kind == "class":
        return pa.DictionaryArray.from_arrays(pa.array(values), pa.array(ROAD_CLASSES))
    return pa.array(values, from_pandas=True)  # NaN becomes null
