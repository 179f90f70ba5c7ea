"""The rows that keep the results of frames: tracks.csv and mot.txt.

Rows are flushed frame by frame, so that a killed run leaves every finished frame readable.
"""

from __future__ import annotations

import csv
import math
from array import array
from contextlib import ExitStack
from pathlib import Path
from sys import intern
from types import TracebackType
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import FloatArray
from track_range.results.output_files import OutputError
from track_range.run.frame_result import FrameResult
from track_range.tracking.mot_format import mot_lines

MEASURED_METHODS = ("mono", "lane", "stereo", "sgbm", "fused", "ground")
"""Methods with a distance and a sigma in tracks.csv."""

_COLUMN_PAIRS = ("mono", "lane", "stereo", "sgbm", "fused")
"""Those that stand first, side by side."""

FILTERED_METHODS = ("mono_kf", "stereo_kf", "fused_kf")
"""The same after the per-track distance filter."""

COLUMNS = (
    *("frame", "time_s", "track_id", "class", "score", "observed", "x1_px", "y1_px", "x2_px", "y2_px"),
    *(f"{method}_{what}" for method in _COLUMN_PAIRS for what in ("m", "sigma_m")),
    *("closing_mps", "ttc_s"),
    *(f"{method}_m" for method in FILTERED_METHODS),
    *("ground_m", "x_m", "y_m"),
    *(f"{method}_sigma_m" for method in FILTERED_METHODS),
    *("ground_sigma_m", "closing_sigma_mps", "ttc_sigma_s"),
)
"""The columns of tracks.csv; an empty cell = not measured."""


class ResultRows:
    """tracks.csv and mot.txt of a run in progress."""

    def __init__(self, folder: Path) -> None:
        """Begin both files anew.

        Raises:
            OutputError: they cannot be created.
        """
        self.folder = folder
        with ExitStack() as opening:
            try:
                self._tracks = opening.enter_context((folder / "tracks.csv").open("w", encoding="utf-8", newline=""))
                self._mot = opening.enter_context((folder / "mot.txt").open("w", encoding="utf-8"))
            except OSError as error:
                raise OutputError(f"{folder}: cannot be written to ({error.strerror or error}).") from error
            self._files = opening.pop_all()
        self._rows = csv.writer(self._tracks, lineterminator="\n")
        self._rows.writerow(COLUMNS)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        try:
            self._files.close()
        except OSError as failed:  # a full disk is told once, by the write that met it first
            if error is None:
                raise OutputError(f"{self.folder}: writing failed ({failed.strerror or failed}).") from failed

    def write(self, result: FrameResult) -> None:
        """Add the rows of one frame.

        Raises:
            OutputError: the disk is full, say.
        """
        try:
            self._rows.writerows(_cells(result))
            self._mot.writelines(mot_lines(result.tracks, result.frame.index))
            self._tracks.flush()
            self._mot.flush()
        except OSError as error:
            raise OutputError(f"{self.folder}: writing failed ({error.strerror or error}).") from error


def _cells(result: FrameResult) -> list[list[str]]:
    """The frame's rows as text, column by column and then turned."""
    tracks, n = result.tracks, len(result.tracks)
    nothing = np.full(n, np.nan)

    def of(method: str, what: str) -> FloatArray:
        return np.asarray(getattr(result.ranges[method], what)) if method in result.ranges else nothing

    columns = [
        [str(result.frame.index)] * n,
        [f"{result.frame.time_s:.6f}"] * n,
        [str(i) for i in tracks.track_id.tolist()],
        [ROAD_CLASSES[c] for c in tracks.class_id.tolist()],
        _text(tracks.score, decimals=4),
        ["1" if o else "0" for o in tracks.observed.tolist()],
        *(_text(tracks.xyxy_px[:, edge]) for edge in range(4)),
        *(_text(of(method, what)) for method in _COLUMN_PAIRS for what in ("distance_m", "sigma_m")),
        _text(result.closing_mps),
        _text(result.ttc_s),
        *(_text(of(method, "distance_m")) for method in FILTERED_METHODS),
        _text(of("ground", "distance_m")),
        _text(result.xyz_m[:, 0]),
        _text(result.xyz_m[:, 1]),
        *(_text(of(method, "sigma_m")) for method in FILTERED_METHODS),
        _text(of("ground", "sigma_m")),
        _text(result.closing_sigma_mps),
        _text(result.ttc_sigma_s),
    ]
    return [list(row) for row in zip(*columns, strict=True)]


def _text(values: FloatArray, *, decimals: int = 3) -> list[str]:
    return ["" if math.isnan(value) else f"{value:.{decimals}f}" for value in values.tolist()]


def read_tracks_csv(path: Path) -> dict[str, npt.NDArray[Any]]:
    """The columns of a tracks.csv: `class` as str, the others float64 with NaN for an empty cell.

    A last row that a killed run left unfinished is dropped.

    Raises:
        OutputError: the file is not there, or not a tracks.csv.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = csv.reader(file)
            header = next(rows)
            if len(set(header)) < len(header):
                raise ValueError("a column twice")
            numbers = {name: array("d") for name in header if name != "class"}
            classes: list[str] = []
            for row in rows:
                _take(row, header, numbers, classes)
    except (OSError, ValueError, StopIteration, csv.Error) as error:
        raise OutputError(f"{path}: not a readable tracks.csv.") from error
    columns: dict[str, npt.NDArray[Any]] = {name: np.array(column) for name, column in numbers.items()}
    return {name: np.array(classes, np.str_) if name == "class" else columns[name] for name in header}


def _take(row: list[str], header: list[str], numbers: dict[str, array[float]], classes: list[str]) -> None:
    """Add a whole row to the columns; as numbers, since a long run has millions of cells."""
    if len(row) != len(header):
        return
    for name, cell in zip(header, row, strict=True):
        if name == "class":
            classes.append(intern(cell))
        else:
            numbers[name].append(float(cell) if cell else math.nan)
