"""Rows: the rows of a run in memory, one per track and frame, by declared column."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.results.rows.column import ResultColumn
from track_range.results.rows.columns import declared_columns, distance_names


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """N rows of one or more tracks in the order of a file.

    Example:
        >>> import numpy as np
        >>> rows = Rows({"frame": np.array([0.0, 1.0]), "gap_m": np.array([8.0, np.nan])})
        >>> rows["frame"].tolist(), rows["state"].tolist(), "state" in rows
        ([0, 1], ['', ''], False)

    Attributes:
        columns: (N,) values by name of the column; values of declared columns get their type,
            others keep theirs, such as distances of methods that are not installed here.
        declared: the declared columns by name.
    """

    columns: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict)
    declared: Mapping[str, ResultColumn] = field(default_factory=declared_columns, repr=False)

    def __post_init__(self) -> None:
        typed = {}
        for name, values in self.columns.items():
            column = self.declared.get(name)
            typed[name] = np.asarray(values) if column is None else column.typed(values)
        lengths = {len(values) for values in typed.values()}
        if len(lengths) > 1:
            raise ValueError(f"expected columns of equal length, got {sorted(lengths)}")
        object.__setattr__(self, "columns", MappingProxyType(typed))

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        """(N,) values of a column; unknown ones if the rows lack a declared column.

        KeyError: the rows have no such column, and none is declared.
        """
        values = self.columns.get(name)
        return np.full(len(self), self.declared[name].unknown) if values is None else values

    @property
    def boxes_px(self) -> FloatArray:
        """(N, 4) boxes x1, y1, x2, y2 in pixels."""
        return np.stack([self[name] for name in ("x1_px", "y1_px", "x2_px", "y2_px")], axis=1)

    @property
    def methods_measured(self) -> list[str]:
        """Names of the distances with at least one value, in the order of the columns."""
        return [
            name
            for name in distance_names(self.columns)
            if bool(np.isfinite(self[f"{name}_m"]).any())
        ]

    def distance(self, method: str) -> tuple[FloatArray, FloatArray]:
        """(N,) distances of a method and their standard deviations; NaN = unknown."""
        unknown = np.full(len(self), np.nan)
        distance_m, sigma_m = (
            self.columns.get(f"{method}_{part}", unknown) for part in ("m", "sigma_m")
        )
        return distance_m, sigma_m

    def by_track(self) -> list[IntArray]:
        """Rows of each track in the order of time, by increasing track ID."""
        track_id = self["track_id"]
        if not len(track_id):
            return []
        order = np.lexsort((self["time_s"], track_id))
        return np.split(order, np.flatnonzero(np.diff(track_id[order])) + 1)

    def select(self, rows: BoolArray | IntArray | slice) -> Self:
        """The chosen rows: a mask, indices in their order, or a slice."""
        return replace(self, columns={name: values[rows] for name, values in self.columns.items()})

    def with_columns(self, columns: Mapping[str, npt.NDArray[Any]]) -> Self:
        """The rows with further columns."""
        return replace(self, columns={**self.columns, **columns})

    def rounded(self) -> Self:
        """The rows with numbers rounded as in tracks.csv; undeclared columns unchanged."""
        rounded = {
            name: self.declared[name].rounded(values) if name in self.declared else values
            for name, values in self.columns.items()
        }
        return replace(self, columns=rounded)


def most_frequent(names: npt.NDArray[Any]) -> str:
    """The most frequent name, such as the class of a track; among equally frequent names, the first
    in the alphabet.
    """
    values, counts = np.unique(names, return_counts=True)
    return str(values[np.argmax(counts)])
