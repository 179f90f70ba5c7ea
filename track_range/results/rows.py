"""The rows that a run left in tracks.csv, as far as they are whole: a damaged file tells what it still can."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from track_range.foundation.arrays import BoolArray
from track_range.report.series import Columns
from track_range.results.csv_file import COLUMNS, read_tracks_csv
from track_range.results.output_files import OutputError

_NEEDED = frozenset(("frame", "time_s", "track_id", "class", "x1_px", "y1_px", "x2_px", "y2_px"))
"""Columns without which nothing can be told; an earlier version's file may lack others."""

_LARGEST = 2.0**53
"""Up to here every whole number is a float of its own."""


def read_run_rows(path: Path, missing: list[str]) -> dict[str, Any]:
    """A tracks.csv by column; rows that no run writes are left out, and counted in a sentence added to `missing`.

    Raises:
        OutputError: the file cannot be read, or is not a tracks.csv.
    """
    columns = read_tracks_csv(path)
    if not columns.keys() >= _NEEDED:
        raise OutputError(f"{path}: not a tracks.csv (no {', '.join(sorted(_NEEDED - columns.keys()))}).")
    whole = whole_rows(columns)
    n_broken = int(np.sum(~whole))
    if n_broken:
        missing.append(f"{n_broken} of {len(whole)} rows of tracks.csv are damaged and left out.")
    if _ends_within_a_row(path):
        missing.append("tracks.csv ends in the middle of a row: what should come after it is not shown.")
    n_rows = int(np.sum(whole))
    # A column that an earlier version did not write is empty; but sigmas, without which a method cannot be judged.
    unknown = {name: np.full(n_rows, np.nan) for name in COLUMNS if not name.endswith("_sigma_m")}
    return unknown | {name: values[whole] for name, values in columns.items()}


def _ends_within_a_row(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(-1, os.SEEK_END)  # it has a header at least
        return file.read() != b"\n"


def no_rows() -> dict[str, Any]:
    """The columns of a run that tracked nothing."""
    return {name: np.zeros(0, np.str_ if name == "class" else np.float64) for name in COLUMNS}


def whole_rows(columns: Columns) -> BoolArray:
    """(N,) rows with a frame, a time, an identity that the frame has but once, and a box."""
    frame, track_id = columns["frame"], columns["track_id"]
    edges = np.stack([columns[name] for name in ("x1_px", "y1_px", "x2_px", "y2_px")], axis=1)
    whole: BoolArray = np.isfinite(columns["time_s"]) & np.isfinite(edges).all(axis=1)
    for number, least in ((frame, 0), (track_id, 1)):
        whole &= (number >= least) & (number <= _LARGEST) & (number == np.floor(number))
    rows = np.flatnonzero(whole)
    _, first = np.unique(np.stack([frame, track_id], axis=1)[rows], axis=0, return_index=True)
    is_first = np.zeros(len(frame), np.bool_)
    is_first[rows[first]] = True
    return is_first
