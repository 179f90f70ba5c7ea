"""ResultColumn: declaration of a column of the rows of a run."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from operator import attrgetter
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from track_range.pipeline.frame_result import FrameResult

ColumnKind = Literal["number", "whole", "flag", "name"]

DTYPES: Mapping[ColumnKind, Any] = {
    "number": np.float64,
    "whole": np.int64,
    "flag": np.bool_,
    "name": np.str_,
}
"""Types of the values in `Rows`."""

STORED: Mapping[ColumnKind, Any] = {**DTYPES, "name": np.float64}
"""Types of the values of frames, in which a name is its index."""

_UNKNOWN: Mapping[ColumnKind, Any] = {"number": math.nan, "whole": 0, "flag": False, "name": ""}


@dataclass(frozen=True, slots=True)
class ResultColumn:
    """Declaration of a column: the writers, readers, replays and the documentation derive from it.

    Values are of a kind: number = float64, NaN = not measured; whole = int64; flag = bool; name =
    one of `names`, "" = unknown. In a `FrameResult` a name is its index, NaN = unknown.
    """

    name: str  # heading
    unit: str  # "" = none
    # path of attributes and keys of a `FrameResult` to (N,) values of its tracks, or one value of
    # the frame; a number is a column of an (N, ...) array; "" = not from frames
    place: str
    # Markdown; [words] are links that the page of the columns defines
    meaning: str
    kind: ColumnKind = "number"
    decimals: int = 3  # to which numbers are rounded in files and tables
    names: tuple[str, ...] = ()  # of the kind "name"
    # value in rows of files without this column, or with an empty cell; None = that of the kind
    missing: float | bool | None = None
    largest: float = 1e10  # absolute value that is plausible in a file
    viewer_name: str = ""  # in messages for viewers, such as those of run.mcap; "" = not in them

    @property
    def unknown(self) -> Any:
        """Value in rows where it is not known."""
        return _UNKNOWN[self.kind] if self.missing is None else self.missing

    def read(self, result: FrameResult) -> npt.NDArray[Any]:
        """(N,) values of the N tracks of a frame, NaN where it has no such part."""
        value = _reader(self.place)(result)
        if isinstance(value, np.ndarray):
            return value
        return np.full(len(result.tracks), math.nan if value is None else value)

    def typed(self, values: npt.ArrayLike) -> npt.NDArray[Any]:
        """(N,) values of a file or of frames with the type of the kind; NaN becomes `unknown`."""
        given, dtype = np.asarray(values), np.dtype(DTYPES[self.kind])
        if self.kind == "name" and given.dtype == np.object_:
            given = np.array([self.unknown if name is None else name for name in given.tolist()])
        if given.dtype.kind == dtype.kind:
            return given if self.kind == "name" else given.astype(dtype, copy=False)
        if self.kind in ("whole", "flag") and given.dtype.kind == "f":
            given = np.where(np.isnan(given), self.unknown, given)
        return given.astype(dtype)

    def codes(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """(N,) values of `Rows` as those of a `FrameResult`: names become their indices."""
        if self.kind != "name":
            return values
        index: dict[str, float] = {name: code for code, name in enumerate(self.names)}
        return np.array([index.get(str(name), math.nan) for name in values], np.float64)

    def rounded(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Numbers rounded to the decimals of the column; other values unchanged."""
        if self.kind != "number":
            return values
        return np.round(values.astype(np.float64), self.decimals)

    @property
    def cell(self) -> str:
        """Format of a value in tracks.csv, of a name as text."""
        if self.kind == "name":
            return "%s"
        return f"%.{self.decimals}f" if self.kind == "number" else "%d"


# values of the rows of the N tracks of one frame, not rounded, in arrays of their own: (K, N) by
# kind of the K columns of this kind, in their order; a name is its index; NaN = unknown
FrameValues = Mapping[ColumnKind, npt.NDArray[Any]]


class RowReader:
    """Reads all columns of a frame, in one array for those of a kind: there are about a hundred."""

    def __init__(self, columns: Sequence[ResultColumn]) -> None:
        self.columns = columns
        by_kind = {kind: [one.place for one in columns if one.kind == kind] for kind in DTYPES}
        places = [place for of_kind in by_kind.values() for place in of_kind]
        # most are attributes, which are read with one call
        attributes = [place for place in places if _is_attribute(place)]
        self._attributes = attrgetter(*attributes)
        parts = [place for place in places if not _is_attribute(place)]
        self._parts = [_reader(place) for place in parts]
        order = [*attributes, *parts]
        self._order = {
            kind: [order.index(place) for place in of_kind] for kind, of_kind in by_kind.items()
        }

    def read(self, result: FrameResult) -> FrameValues:
        """The values of the rows of a frame."""
        n_tracks = len(result.tracks)
        unknown = np.full(n_tracks, math.nan)
        raw = [*self._attributes(result), *[reader(result) for reader in self._parts]]
        values = [unknown if value is None else value for value in raw]
        arrays = [
            value if isinstance(value, np.ndarray) else np.full(n_tracks, value) for value in values
        ]
        return {
            kind: np.concatenate(
                [arrays[place] for place in order], dtype=STORED[kind], casting="unsafe"
            ).reshape(len(order), n_tracks)
            for kind, order in self._order.items()
        }


def _is_attribute(place: str) -> bool:
    """Whether a place is a path of attributes alone."""
    return not place.startswith("ranges.") and not place.rpartition(".")[2].isdigit()


@cache  # of few places, for each frame of a run
def _reader(place: str) -> Callable[[FrameResult], Any]:
    """Reads the value at a place of a `FrameResult`; None = it has no such part."""
    first, *steps = place.split(".")
    if _is_attribute(place):
        return attrgetter(place)
    if first == "ranges":
        return lambda result: _of_ranges(result, *steps)
    values, axis = attrgetter(place.rpartition(".")[0]), int(steps[-1])
    return lambda result: values(result)[:, axis]


def _of_ranges(result: FrameResult, method: str, part: str, detail: str = "") -> Any:
    ranges = result.ranges.get(method)
    if ranges is None:
        return None
    return ranges.details.get(detail) if part == "details" else getattr(ranges, part)
