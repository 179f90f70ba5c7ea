"""Columns of the rows of a run (one row per track and frame): name, unit, decimals and source of each.

tracks.csv, the table in memory and all other formats with rows are written from this declaration. The order of the
first columns is fixed for readers of tracks.csv; the columns of further ranging methods follow at the end.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import FloatArray
from track_range.pipeline.frame_result import FrameResult
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
            return [ROAD_CLASSES[class_id] for class_id in values]
        if self.kind == "number":
            return ["" if math.isnan(value) else f"{value:.{self.decimals}f}" for value in values]
        return [str(int(value)) for value in values]


def result_columns() -> tuple[ResultColumn, ...]:
    """All columns of this installation, in the order of tracks.csv."""
    columns = (
        ResultColumn("frame", "", lambda result: np.full(len(result.tracks), result.index), "whole"),
        ResultColumn("time_s", "s", lambda result: np.full(len(result.tracks), result.time_s), decimals=6),
        ResultColumn("track_id", "", lambda result: result.tracks.track_id, "whole"),
        ResultColumn("class", "", lambda result: result.tracks.class_id, "class"),
        ResultColumn("score", "", lambda result: result.tracks.score, decimals=4),
        ResultColumn("observed", "", lambda result: result.tracks.observed, "flag"),
        ResultColumn("x1_px", "px", lambda result: result.tracks.xyxy_px[:, 0]),
        ResultColumn("y1_px", "px", lambda result: result.tracks.xyxy_px[:, 1]),
        ResultColumn("x2_px", "px", lambda result: result.tracks.xyxy_px[:, 2]),
        ResultColumn("y2_px", "px", lambda result: result.tracks.xyxy_px[:, 3]),
        *(_distance("mono"), _sigma("mono")),
        *(_distance("lane"), _sigma("lane")),
        *(_distance("stereo"), _sigma("stereo")),
        *(_distance("sgbm"), _sigma("sgbm")),
        *(_distance("fused"), _sigma("fused")),
        ResultColumn("closing_mps", "m/s", lambda result: result.closing_mps),
        ResultColumn("ttc_s", "s", lambda result: result.ttc_s),
        *(_distance("mono_kf"), _distance("stereo_kf"), _distance("fused_kf")),
        _distance("ground"),
        ResultColumn("x_m", "m", lambda result: result.xyz_m[:, 0]),
        ResultColumn("y_m", "m", lambda result: result.xyz_m[:, 1]),
        *(_sigma("mono_kf"), _sigma("stereo_kf"), _sigma("fused_kf")),
        _sigma("ground"),
        ResultColumn("closing_sigma_mps", "m/s", lambda result: result.closing_sigma_mps),
        ResultColumn("ttc_sigma_s", "s", lambda result: result.ttc_sigma_s),
        ResultColumn("utc", "s", lambda result: np.full(len(result.tracks), result.utc_s), decimals=6),
        ResultColumn("ego_mps", "m/s", lambda result: np.full(len(result.tracks), result.ego_mps)),
        ResultColumn("contact_probability", "", lambda result: _warnings(result).probability),
        ResultColumn("warning", "", lambda result: _warnings(result).active, "flag"),
        ResultColumn("path_offset_m", "m", lambda result: _warnings(result).path_offset_m),
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


def _warnings(result: FrameResult) -> Warnings:
    return Warnings.unknown(len(result.tracks)) if result.warnings is None else result.warnings


def _distance(method: str) -> ResultColumn:
    def read(result: FrameResult) -> FloatArray:
        return result.ranges[method].distance_m if method in result.ranges else np.full(len(result.tracks), np.nan)

    return ResultColumn(f"{method}_m", "m", read)


def _sigma(method: str) -> ResultColumn:
    def read(result: FrameResult) -> FloatArray:
        return result.ranges[method].sigma_m if method in result.ranges else np.full(len(result.tracks), np.nan)

    return ResultColumn(f"{method}_sigma_m", "m", read)


def _detail(method: str, detail: str) -> ResultColumn:
    def read(result: FrameResult) -> FloatArray:
        nothing = np.full(len(result.tracks), np.nan)
        return result.ranges[method].details.get(detail, nothing) if method in result.ranges else nothing

    return ResultColumn(f"{method}_{detail}", "", read)
