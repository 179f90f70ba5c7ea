"""Figures from the rows of tracks: of one clip, and their sum over clips, in memory that does not
grow with the clips.

Coverage of a method in a distance band = observed boxes with a distance of the method / observed
boxes. The band is chosen by the filtered fused distance, which every ranged track has.

Times to collision are `ttc_front_s`, of the front with road users on the path; rows of earlier
versions have none. Distances and times are supported ones (`results.rows.supported`).
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np

from track_range.detection.classes import STATIC_CLASSES
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.ranging.truth.errors import BANDS_M
from track_range.results.approaches import reference_distance
from track_range.results.rows.columns import distance_names
from track_range.results.rows.rows import Rows
from track_range.results.rows.supported import supported_values

if TYPE_CHECKING:
    import pyarrow as pa

N_RANKED = 20  # number of tracks in a ranking
# edges of the distance bands: those of the evaluation, and all other distances
EDGES_M = (0.0, *BANDS_M, float("inf"))
_MAX_NUMBER = 1e12  # limit of track numbers, and of times in s

_NEEDED = ("time_s", "track_id", "class")
_OTHERS = (
    "observed",
    "is_cut",
    "closing_mps",
    "closing_sigma_mps",
    "ttc_s",
    "ttc_front_s",
    "ttc_sigma_s",
    "x_m",
    "x1_px",
    "x2_px",
    "path_offset_m",
    "utc",
)

Figures = dict[str, Any]  # figures by name, as in the JSON file; None = unknown


@dataclass(slots=True)
class TrackFigures:
    """Figures of the rows of one or more clips."""

    n_rows: int = 0
    n_tracks: Counter[str] = field(default_factory=Counter)  # by class
    visible_s: dict[str, float] = field(default_factory=dict)  # first to last row, by class
    # UTC; None = unknown
    n_by_hour: Counter[tuple[int | None, str]] = field(default_factory=Counter)
    # with a reference distance, by index of the distance band
    n_boxes: Counter[int] = field(default_factory=Counter)
    # of these, by method and index of the band
    n_measured: Counter[tuple[str, int]] = field(default_factory=Counter)
    # moments of smallest distance; see `approaches`
    closest: list[Figures] = field(default_factory=list)
    collisions: list[Figures] = field(default_factory=list)  # moments of smallest time to collision

    def add(self, other: TrackFigures) -> None:
        """Add the figures of other clips."""
        self.n_rows += other.n_rows
        for name, n in other.n_tracks.items():
            self.count(name, n, other.visible_s[name])
        self.n_by_hour.update(other.n_by_hour)
        self.n_boxes.update(other.n_boxes)
        self.n_measured.update(other.n_measured)
        self.closest = _ranked([*self.closest, *other.closest], "distance_m")
        self.collisions = _ranked([*self.collisions, *other.collisions], "ttc_s")

    def count(self, name: str, n_tracks: int, visible_s: float) -> None:
        """Add tracks of a class, with the sum of their times."""
        self.n_tracks[name] += n_tracks
        self.visible_s[name] = self.visible_s.get(name, 0.0) + visible_s


def _ranked(approaches: Iterable[Figures], key: str) -> list[Figures]:
    return heapq.nsmallest(
        N_RANKED, approaches, key=lambda item: (item[key], item["clip"], item["track_id"])
    )


def needed_columns(names: Sequence[str]) -> list[str]:
    """The columns of a tracks.parquet that the figures need; raises ValueError if a required column
    is missing.
    """
    if missing := [name for name in _NEEDED if name not in names]:
        raise ValueError(f"no column {missing[0]}")
    distances = [
        name for method in _methods(names) for name in (f"{method}_m", f"{method}_sigma_m")
    ]
    return [name for name in names if name in (*_NEEDED, *_OTHERS, *distances)]


def _methods(names: Sequence[str]) -> list[str]:
    return [method for method in distance_names(names) if f"{method}_sigma_m" in names]


def track_figures(clip: str, table: pa.Table) -> TrackFigures:
    """Figures of the rows of a clip, from the columns `needed_columns` of its tracks.parquet.

    Raises ValueError for a row without a track or time, and ArrowException for a column with
    another type.
    """
    figures = TrackFigures(n_rows=table.num_rows)
    if table.num_rows:
        rows = _ClipRows(table)
        rows.count_tracks(figures)
        rows.count_coverage(figures)
        figures.closest = _ranked(rows.approaches(clip, "distance_m"), "distance_m")
        figures.collisions = _ranked(rows.approaches(clip, "ttc_front_s"), "ttc_s")
    return figures


class _ClipRows:
    """Rows of a clip, by track and time."""

    def __init__(self, table: pa.Table) -> None:
        import pyarrow as pa

        classes = (
            table["class"].cast(pa.string()).combine_chunks().fill_null("").dictionary_encode()
        )
        numbers = {
            name: table[name].cast(pa.float64()).to_numpy()
            for name in table.column_names
            if name != "class"
        }
        keys = np.array([numbers["time_s"], numbers["track_id"]])
        if not np.all(np.abs(keys) < _MAX_NUMBER):
            raise ValueError("rows without a track or time")
        order = np.lexsort(keys)
        self._rows = Rows(numbers).select(order)
        self._methods = _methods(table.column_names)
        is_first = np.diff(self._rows["track_id"], prepend=np.nan) != 0
        self.starts: IntArray = np.flatnonzero(is_first)  # (T,) first row of each track
        self.track: IntArray = np.cumsum(is_first) - 1  # (N,) index of the track of each row
        self.time_s: FloatArray = self._rows["time_s"]
        self.observed: BoolArray = self._rows["observed"]

        names = classes.dictionary.to_pylist()
        codes = classes.indices.to_numpy()[order].astype(np.int64)
        n_cells = len(self.starts) * len(names)
        counts = np.bincount(self.track * len(names) + codes, minlength=n_cells).reshape(
            -1, len(names)
        )
        # the most frequent one
        self.class_of_track = [names[code] for code in counts.argmax(axis=1)]

        self.distance_m, self.sigma_m = reference_distance(self._rows)
        self.supported = supported_values(self._rows, self.distance_m, self.sigma_m)

    def count_tracks(self, figures: TrackFigures) -> None:
        ends = np.append(self.starts[1:], len(self.track)) - 1
        visible_s = self.time_s[ends] - self.time_s[self.starts]
        utc_s = self._rows["utc"][self.starts]
        for name, seconds, utc in zip(
            self.class_of_track, visible_s.tolist(), utc_s.tolist(), strict=True
        ):
            figures.count(name, 1, seconds)
            figures.n_by_hour[int(utc // 3600 % 24) if np.isfinite(utc) else None, name] += 1

    def count_coverage(self, figures: TrackFigures) -> None:
        rows = self.observed & np.isfinite(self.distance_m)
        band = np.searchsorted(EDGES_M, self.distance_m[rows], side="right") - 1
        figures.n_boxes.update(band.tolist())
        for method in self._methods:
            is_measured = np.isfinite(self._rows[f"{method}_m"][rows])
            figures.n_measured.update((method, i) for i in band[is_measured].tolist())

    def _lateral_m(self) -> FloatArray:
        """Column x_m; where only the filter has a distance, x of the box centre at this distance,
        by the camera.
        """
        x_m, z_m, u = (
            self._rows["x_m"],
            self._rows["fused_m"],
            self._rows["x1_px"] + self._rows["x2_px"],
        )
        known = np.isfinite([x_m, z_m, u]).all(axis=0)
        if not known.any() or np.ptp(u[known]) < 1:
            return x_m
        rays = np.stack([u, np.ones(len(u))], axis=1)  # x / z is affine in u
        affine = np.linalg.lstsq((z_m[:, None] * rays)[known], x_m[known])[0]
        return np.where(np.isfinite(x_m), x_m, self.distance_m * (rays @ affine))

    def approaches(self, clip: str, measure: str) -> list[Figures]:
        """The row of each road user with the smallest supported value of a measure, as the moment
        of the track.

        Times are in s of the video (`time_s`) and Unix time (`utc_s`), x positive to the right of
        the camera, m; None = unknown.
        """
        values = {"distance_m": self.distance_m, "ttc_front_s": self._rows["ttc_front_s"]}
        values[measure] = self.supported[measure]
        ranked = np.where(
            np.isfinite(self.distance_m) & ~np.isnan(values[measure]), values[measure], np.inf
        )
        smallest = np.minimum.reduceat(ranked, self.starts)
        tracks = [i for i in np.argsort(smallest, kind="stable").tolist() if smallest[i] < np.inf]
        road_users = (i for i in tracks if self.class_of_track[i] not in STATIC_CLASSES)
        rows = {
            i: self.starts[i] + int(np.argmax(ranked[self.starts[i] :] == smallest[i]))
            for i in islice(road_users, N_RANKED)
        }
        columns = {
            "time_s": self.time_s,
            "utc_s": self._rows["utc"],
            "distance_m": values["distance_m"],
            "sigma_m": self.sigma_m,
            "x_m": self._lateral_m(),
            "path_offset_m": self._rows["path_offset_m"],
            "ttc_s": values["ttc_front_s"],
            "ttc_sigma_s": self._rows["ttc_sigma_s"],
        }
        return [
            {
                "clip": clip,
                "track_id": int(self._rows["track_id"][row]),
                "road_class": self.class_of_track[i],
                **{
                    name: float(v[row]) if np.isfinite(v[row]) else None
                    for name, v in columns.items()
                },
            }
            for i, row in rows.items()
        ]
