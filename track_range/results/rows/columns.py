"""Columns of the rows of a run (one row per track and frame): name, unit, decimals and source of
each.

tracks.csv, the table in memory and all other formats with rows are written from this declaration.
The order of the first columns is fixed for readers of tracks.csv; the columns of ranging methods of
other packages follow at the end.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.registry import METHODS, methods
from track_range.ranging.world.object_motion import MOTION_STATES

if TYPE_CHECKING:
    import pyarrow as pa

# rows by column: `TEXT_COLUMNS` as str, others float64, NaN = not measured
Columns = Mapping[str, npt.NDArray[Any]]
# values of the rows of one frame, not rounded: one (N,) array per column
FrameValues = list[npt.NDArray[Any]]
# that are read; runs with all methods have fewer than 100, and pyarrow is slow with more
MAX_COLUMNS = 1000
MAX_CLASS = 200  # largest number of characters of a class name that is read
SAFETY_UNITS: Mapping[str, str] = {  # unit of the columns of `SafetyMeasures` that are numbers
    "gap_m": "m",
    "ttc_front_s": "s",
    "headway_s": "s",
    "drac_mps2": "m/s2",
    "mdrac_mps2": "m/s2",
    "tet_s": "s",
    "tit_s2": "s2",
    "lane_index": "",
    "lane_index_sigma": "",
}
TEXT_COLUMNS = ("class", "state")  # columns of names, "" = unknown; all others are numbers

_TYPES = {"whole": np.int64, "number": np.float64, "flag": np.bool_, "name": np.int8}

ColumnKind = Literal["number", "whole", "flag", "name"]


@dataclass(frozen=True, slots=True)
class ResultColumn:
    """Declaration of a column.

    Values are of a kind: number = float64, NaN = not measured; whole = int64; flag = bool; name =
    index of `names`, NaN = unknown, written as the name.
    """

    name: str  # heading
    unit: str  # "" = none
    read: Callable[[FrameResult], Any]  # returns the (N,) values of the N tracks of a frame
    kind: ColumnKind = "number"
    decimals: int = 3  # to which numbers are rounded in files and tables
    names: tuple[str, ...] = ()  # of the kind "name"

    def rounded(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Numbers rounded to the decimals of the column; other values unchanged."""
        return (
            np.round(values.astype(np.float64), self.decimals) if self.kind == "number" else values
        )

    def text(self, result: FrameResult) -> list[str]:
        """Values of a frame as text for tracks.csv; empty = not measured."""
        values = np.asarray(self.read(result)).tolist()
        if self.kind == "name":
            return ["" if math.isnan(value) else self.names[int(value)] for value in values]
        if self.kind == "number":
            return ["" if math.isnan(value) else f"{value:.{self.decimals}f}" for value in values]
        return list(map(str, map(int, values)))


def result_columns() -> tuple[ResultColumn, ...]:
    """All columns of this installation, in the order of tracks.csv."""
    columns = (
        ResultColumn("frame", "", _of_frame("index"), "whole"),
        ResultColumn("time_s", "s", _of_frame("time_s"), decimals=6),
        ResultColumn("track_id", "", attrgetter("tracks.track_id"), "whole"),
        ResultColumn("class", "", attrgetter("tracks.class_id"), "name", names=ROAD_CLASSES),
        ResultColumn("score", "", attrgetter("tracks.score"), decimals=4),
        ResultColumn("observed", "", attrgetter("tracks.observed"), "flag"),
        *(
            ResultColumn(f"{edge}_px", "px", _axis("tracks.xyxy_px", i))
            for i, edge in enumerate(("x1", "y1", "x2", "y2"))
        ),
        *(_of_method(name, part) for name in _first_distances() for part in ("m", "sigma_m")),
        ResultColumn("x_m", "m", _axis("xyz_m", 0)),
        ResultColumn("y_m", "m", _axis("xyz_m", 1)),
        ResultColumn("closing_mps", "m/s", attrgetter("closing_mps")),
        ResultColumn("closing_sigma_mps", "m/s", attrgetter("closing_sigma_mps")),
        ResultColumn("ttc_s", "s", attrgetter("ttc_s")),
        ResultColumn("ttc_sigma_s", "s", attrgetter("ttc_sigma_s")),
        ResultColumn("utc", "s", _of_frame("utc_s"), decimals=6),
        ResultColumn("ego_mps", "m/s", _of_frame("ego_mps")),
        ResultColumn("contact_probability", "", _of_part("warnings.probability")),
        ResultColumn("warning", "", _of_part("warnings.active", missing=False), "flag"),
        ResultColumn("path_offset_m", "m", _of_part("warnings.path_offset_m")),
    )
    in_world = (
        ResultColumn("speed_mps", "m/s", _of_part("motion.speed_mps")),
        ResultColumn("speed_sigma_mps", "m/s", _of_part("motion.speed_sigma_mps")),
        ResultColumn("heading_deg", "deg", _of_part("motion.heading_deg"), decimals=2),
        ResultColumn("world_x_m", "m", _of_part("motion.world_x_m")),
        ResultColumn("world_y_m", "m", _of_part("motion.world_y_m")),
        ResultColumn("state", "", _of_part("motion.state"), "name", names=MOTION_STATES),
        *(
            ResultColumn(name, unit, _of_part(f"safety.{name}"))
            for name, unit in SAFETY_UNITS.items()
        ),
        ResultColumn("is_lead", "", _of_part("safety.is_lead", missing=False), "flag"),
    )
    names = {column.name for column in columns}
    own = [column for column in _method_columns(is_built_in=True) if column.name not in names]
    return (*columns, *own, *in_world, *_method_columns(is_built_in=False))


def _first_distances() -> list[str]:
    """Names of the distances of the first columns: by the built-in methods, fused, and filtered."""
    built_in = [
        method
        for method in methods()
        if method.name in METHODS.built_in and method.measures_distance
    ]
    filtered = [f"{method.name}_kf" for method in built_in if method.is_filtered]
    return [*(method.name for method in built_in), "fused", *filtered, "fused_kf"]


def _method_columns(*, is_built_in: bool) -> Iterator[ResultColumn]:
    """Columns NAME_m and NAME_sigma_m of ranging methods and of their filters, if any, and
    NAME_DETAIL.

    `is_built_in`: for built-in methods that measure distances, else for all other methods.
    """
    for method in methods():
        if (method.name in METHODS.built_in and method.measures_distance) != is_built_in:
            continue
        names = (method.name, *([f"{method.name}_kf"] if method.is_filtered else []))
        for name in names if method.measures_distance else ():
            yield _of_method(name, "m")
            yield _of_method(name, "sigma_m")
        for detail in method.details:
            yield _of_method(method.name, detail)


def _of_method(method: str, part: str) -> ResultColumn:
    """Column METHOD_PART of a method: m = its distance, sigma_m, else one of its details; NaN = no
    such part.
    """
    attribute = {"m": "distance_m", "sigma_m": "sigma_m"}.get(part)

    def read(result: FrameResult) -> FloatArray:
        ranges: Ranges | None = result.ranges.get(method)
        known = (
            None
            if ranges is None
            else getattr(ranges, attribute)
            if attribute
            else ranges.details.get(part)
        )
        return np.full(len(result.tracks), np.nan) if known is None else known

    return ResultColumn(
        f"{method}_{part}", "m" if attribute else "s" if part.endswith("_s") else "", read
    )


def _of_frame(name: str) -> Callable[[FrameResult], Any]:
    """Reads an attribute of the frame, the same for all tracks."""
    return lambda result: np.full(len(result.tracks), getattr(result, name))


def _axis(name: str, axis: int) -> Callable[[FrameResult], Any]:
    """Reads one column of an (N, ...) attribute."""
    values = attrgetter(name)
    return lambda result: values(result)[:, axis]


def _of_part(path: str, *, missing: float | bool = math.nan) -> Callable[[FrameResult], Any]:
    """Reads an array of a part of the result, such as "safety.gap_m"; `missing` in results without
    this part.
    """
    part, name = path.split(".")

    def read(result: FrameResult) -> Any:
        values = getattr(result, part)
        return np.full(len(result.tracks), missing) if values is None else getattr(values, name)

    return read


def column_names() -> list[str]:
    """Column names in the header of tracks.csv."""
    return [column.name for column in result_columns()]


def methods_with_sigma() -> list[str]:
    """Names of all distances with a sigma (methods, "fused", filtered ones as NAME_kf), in the
    order of the summary.
    """
    names = [name.removesuffix("_sigma_m") for name in column_names() if name.endswith("_sigma_m")]
    return sorted(names, key=lambda name: name.endswith("_kf"))


def distance_names(names: Iterable[str]) -> list[str]:
    """Names NAME of the columns NAME_m that are distances, in their order.

    These are registered methods, "fused" and filtered ones, and methods of packages that are not
    installed here: columns that this installation does not have.
    """
    known, others = set(methods_with_sigma()), {*column_names(), "truth_m", "scored_truth_m"}
    listed = [
        name.removesuffix("_m")
        for name in names
        if name.endswith("_m") and not name.endswith("_sigma_m")
    ]
    return [name for name in listed if name in known or f"{name}_m" not in others]


def methods_measured(columns: Columns) -> list[str]:
    """Names of the distances with at least one value, in the order of the columns."""
    return [
        name for name in distance_names(columns) if bool(np.isfinite(columns[f"{name}_m"]).any())
    ]


def rounded(columns: Columns) -> dict[str, npt.NDArray[Any]]:
    """Rows with numbers rounded as in tracks.csv; unknown columns unchanged."""
    declared = {column.name: column for column in result_columns()}
    return {
        name: declared[name].rounded(values) if name in declared else values
        for name, values in columns.items()
    }


def boxes_px(columns: Columns) -> FloatArray:
    """(N, 4) boxes x1, y1, x2, y2 in pixels."""
    return np.stack([columns[name] for name in ("x1_px", "y1_px", "x2_px", "y2_px")], axis=1)


# -- Apache Arrow, for the table in memory and tracks.parquet
# -------------------------------------------------------


def rows_schema(
    columns: Sequence[ResultColumn], metadata: Mapping[str, str] | None = None
) -> pa.Schema:
    """Schema of the rows: `TEXT_COLUMNS` are dictionaries of names, and the metadata of a field
    contains its unit.
    """
    import pyarrow as pa

    fields = [
        pa.field(
            column.name,
            pa.dictionary(pa.int8(), pa.string())
            if column.kind == "name"
            else pa.from_numpy_dtype(np.dtype(_TYPES[column.kind])),
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
        dtype = np.float64 if column.kind == "name" else _TYPES[column.kind]
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


def rows_by_track(columns: Columns) -> list[IntArray]:
    """Rows of each track in the order of time, by increasing track ID."""
    track_id = columns["track_id"]
    if not len(track_id):
        return []
    order = np.lexsort((columns["time_s"], track_id))
    return np.split(order, np.flatnonzero(np.diff(track_id[order])) + 1)


def most_frequent(names: npt.NDArray[Any]) -> str:
    """The most frequent name, such as the class of a track; among equally frequent names, the first
    in the alphabet.
    """
    values, counts = np.unique(names, return_counts=True)
    return str(values[np.argmax(counts)])
