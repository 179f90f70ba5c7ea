"""Columns of the rows of a run (one row per track and frame): name, unit, decimals and source of each.

tracks.csv, the table in memory and all other formats with rows are written from this declaration. The order of the
first columns is fixed for readers of tracks.csv; the columns of further ranging methods follow at the end.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import FloatArray
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.ranges import Ranges
from track_range.ranging.registry import methods
from track_range.ranging.warning.warnings import Warnings

Columns = Mapping[str, npt.NDArray[Any]]
"""Rows by column: `class` as str, all others float64 with NaN = not measured."""

MAX_COLUMNS = 1000
"""Largest number of columns that is read; runs with all methods have fewer than 100, and pyarrow is slow with more."""

MAX_CLASS = 200
"""Largest number of characters of a class name that is read."""

NOT_METHODS = ("truth", "scored_truth", "x", "y", "path_offset")
"""Names NAME of columns NAME_m that are not the distance of a method."""

ColumnKind = Literal["number", "whole", "flag", "class"]


@dataclass(frozen=True, slots=True)
class ResultColumn:
    """Declaration of a column.

    Attributes:
        name: heading.
        unit: unit of the values; "" = none.
        kind: type of the values: number = float64, NaN = not measured; whole = int64; flag = bool; class = index of
            `ROAD_CLASSES`, written as its name.
        decimals: decimals of numbers, to which values are rounded in files and tables.
        read: returns the (N,) values of the N tracks of a frame.
    """

    name: str
    unit: str
    read: Callable[[FrameResult], Any]
    kind: ColumnKind = "number"
    decimals: int = 3

    def rounded(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Numbers rounded to the decimals of the column; other values unchanged."""
        return np.round(values.astype(np.float64), self.decimals) if self.kind == "number" else values

    def text(self, result: FrameResult) -> list[str]:
        """Values of a frame as text for tracks.csv; empty = not measured."""
        values = np.asarray(self.read(result)).tolist()
        if self.kind == "class":
            return list(map(ROAD_CLASSES.__getitem__, values))
        if self.kind == "number":
            return ["" if math.isnan(value) else f"{value:.{self.decimals}f}" for value in values]
        return list(map(str, map(int, values)))


def result_columns() -> tuple[ResultColumn, ...]:
    """All columns of this installation, in the order of tracks.csv."""
    columns = (
        ResultColumn("frame", "", _of_frame("index"), "whole"),
        ResultColumn("time_s", "s", _of_frame("time_s"), decimals=6),
        ResultColumn("track_id", "", attrgetter("tracks.track_id"), "whole"),
        ResultColumn("class", "", attrgetter("tracks.class_id"), "class"),
        ResultColumn("score", "", attrgetter("tracks.score"), decimals=4),
        ResultColumn("observed", "", attrgetter("tracks.observed"), "flag"),
        ResultColumn("x1_px", "px", _axis("tracks.xyxy_px", 0)),
        ResultColumn("y1_px", "px", _axis("tracks.xyxy_px", 1)),
        ResultColumn("x2_px", "px", _axis("tracks.xyxy_px", 2)),
        ResultColumn("y2_px", "px", _axis("tracks.xyxy_px", 3)),
        *(_distance("mono"), _sigma("mono")),
        *(_distance("lane"), _sigma("lane")),
        *(_distance("stereo"), _sigma("stereo")),
        *(_distance("sgbm"), _sigma("sgbm")),
        *(_distance("fused"), _sigma("fused")),
        ResultColumn("closing_mps", "m/s", attrgetter("closing_mps")),
        ResultColumn("ttc_s", "s", attrgetter("ttc_s")),
        *(_distance("mono_kf"), _distance("stereo_kf"), _distance("fused_kf")),
        _distance("ground"),
        ResultColumn("x_m", "m", _axis("xyz_m", 0)),
        ResultColumn("y_m", "m", _axis("xyz_m", 1)),
        *(_sigma("mono_kf"), _sigma("stereo_kf"), _sigma("fused_kf")),
        _sigma("ground"),
        ResultColumn("closing_sigma_mps", "m/s", attrgetter("closing_sigma_mps")),
        ResultColumn("ttc_sigma_s", "s", attrgetter("ttc_sigma_s")),
        ResultColumn("utc", "s", _of_frame("utc_s"), decimals=6),
        ResultColumn("ego_mps", "m/s", _of_frame("ego_mps")),
        ResultColumn("contact_probability", "", _of_warnings("probability")),
        ResultColumn("warning", "", _of_warnings("active"), "flag"),
        ResultColumn("path_offset_m", "m", _of_warnings("path_offset_m")),
    )
    names = {column.name for column in columns}
    return (*columns, *(column for column in _method_columns() if column.name not in names))


def column_names() -> list[str]:
    """Column names in the header of tracks.csv."""
    return [column.name for column in result_columns()]


def methods_with_sigma() -> list[str]:
    """Names of all distances with a sigma (methods, "fused", filtered ones as NAME_kf), in the order of the summary."""
    names = [name.removesuffix("_sigma_m") for name in column_names() if name.endswith("_sigma_m")]
    return sorted(names, key=lambda name: name.endswith("_kf"))


def methods_measured(columns: Columns) -> list[str]:
    """Names of the distances with at least one value, in the order of the columns."""
    names = [name.removesuffix("_m") for name in columns if name.endswith("_m") and not name.endswith("_sigma_m")]
    return [name for name in names if name not in NOT_METHODS and bool(np.isfinite(columns[f"{name}_m"]).any())]


def rounded(columns: Columns) -> dict[str, npt.NDArray[Any]]:
    """Rows with numbers rounded as in tracks.csv; unknown columns unchanged."""
    declared = {column.name: column for column in result_columns()}
    return {name: declared[name].rounded(values) if name in declared else values for name, values in columns.items()}


def no_rows() -> dict[str, npt.NDArray[Any]]:
    """Columns of a run without tracks: zero rows."""
    return {name: np.zeros(0, np.str_ if name == "class" else np.float64) for name in column_names()}


def _method_columns() -> Iterator[ResultColumn]:
    """Columns NAME_m and NAME_sigma_m of every ranging method and of its filter if it has one, and NAME_DETAIL."""
    for method in methods():
        for name in (method.name, *([f"{method.name}_kf"] if method.is_filtered else [])):
            yield _distance(name)
            yield _sigma(name)
        for detail in method.details:
            yield _detail(method.name, detail)


def _of_frame(name: str) -> Callable[[FrameResult], Any]:
    """Reads an attribute of the frame, the same for all tracks."""
    return lambda result: np.full(len(result.tracks), getattr(result, name))


def _axis(name: str, axis: int) -> Callable[[FrameResult], Any]:
    """Reads one column of an (N, ...) attribute."""
    values = attrgetter(name)
    return lambda result: values(result)[:, axis]


def _of_warnings(name: str) -> Callable[[FrameResult], Any]:
    """Reads an attribute of the warnings."""
    values = attrgetter(name)
    return lambda result: values(result.warnings or Warnings.unknown(len(result.tracks)))


def _distance(method: str) -> ResultColumn:
    return ResultColumn(f"{method}_m", "m", _of_method(method, attrgetter("distance_m")))


def _sigma(method: str) -> ResultColumn:
    return ResultColumn(f"{method}_sigma_m", "m", _of_method(method, attrgetter("sigma_m")))


def _detail(method: str, detail: str) -> ResultColumn:
    return ResultColumn(f"{method}_{detail}", "", _of_method(method, lambda ranges: ranges.details.get(detail)))


def _of_method(method: str, values: Callable[[Ranges], FloatArray | None]) -> Callable[[FrameResult], FloatArray]:
    """Reads values of the ranges of a method; NaN without these."""

    def read(result: FrameResult) -> FloatArray:
        known = values(result.ranges[method]) if method in result.ranges else None
        return np.full(len(result.tracks), np.nan) if known is None else known

    return read
