"""Several virtual pinholes of one wide lens: a run in each direction, and their tracks in one
table.

    OUT/view-60, OUT/view+0, OUT/view+60    the runs, with --yaw-deg -60, 0 and 60
    OUT/views.csv                           view_deg and the columns of recorded_boxes.csv, in the camera's frame

An object in the overlap of two views has the row of the view whose axis is nearer. Track ids belong
to their view.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from track_range.detection.boxes import fraction_inside
from track_range.foundation.errors import UsageError
from track_range.foundation.files.csv_tables import read_csv_table
from track_range.foundation.files.output_files import OutputError, write_text
from track_range.results.formats.box_files import RECORDED_BOXES_COLUMNS, RECORDED_BOXES_FILE
from track_range.run.build import open_input
from track_range.run.options.settings import RunSettings

VIEWS_FILE = "views.csv"
_MAX_DEG = 120.0  # largest angle of a view to the camera's axis, as of --yaw-deg
# of the smaller box in the recorded image, from which tracks of two views are one; views cut boxes
_SAME_OVERLAP = 0.6
_EDGES = ("x1_px", "y1_px", "x2_px", "y2_px")
_NUMBERS = ("frame", *_EDGES, "azimuth_deg")  # columns that are compared


def run_views(
    settings: RunSettings, views_deg: Sequence[float], run: Callable[[RunSettings], Any]
) -> Path:
    """Run in each direction, degrees to the right of the camera's axis, write `VIEWS_FILE`, and
    return its path.

    `out` of the settings is the folder of the runs' folders; `run` processes a run.
    """
    for view_deg in views_deg:  # an impossible direction must not be found after runs of the others
        open_input(settings.model_copy(update={"yaw_deg": view_deg, "align": "off"})).close()
    folders = []
    for view_deg in views_deg:
        folder = settings.out_dir / f"view{view_deg:+g}"
        writers = tuple(dict.fromkeys([*settings.write, "recorded"]))
        run(settings.model_copy(update={"out": folder, "yaw_deg": view_deg, "write": writers}))
        folders.append(folder)
    path = settings.out_dir / VIEWS_FILE
    write_text(path, joined_text(views_deg, folders))
    return path


def directions_deg(text: str, settings: RunSettings) -> tuple[float, ...]:
    """Directions of a value of --views, ascending; UsageError if not two or more, or if the
    settings allow one view.
    """
    if settings.mono is None or settings.yaw_deg:
        raise UsageError(
            "--views: expected --mono and no --yaw-deg, since each view has its own direction."
        )
    if settings.table is not None:
        raise UsageError(
            "--table: not allowed with --views, since each view would replace the file; omit one."
        )
    try:
        views_deg = tuple(sorted(float(part) for part in text.split(",")))
    except ValueError:
        views_deg = ()
    if len(set(views_deg)) < max(len(views_deg), 2) or not all(
        abs(view_deg) <= _MAX_DEG for view_deg in views_deg
    ):
        raise UsageError(
            f"--views {text}: expected two or more different directions of at most {_MAX_DEG:g} "
            "degrees, such as -60,0,60."
        )
    return views_deg


def joined_text(views_deg: Sequence[float], folders: Sequence[Path]) -> str:
    """Content of `VIEWS_FILE` from the runs of the views: rows by frame, each object once."""
    tables = [
        read_csv_table(folder / RECORDED_BOXES_FILE, OutputError, "the boxes of a view")
        for folder in folders
    ]
    rows = [row for table in tables for row in table.rows]
    view_deg = np.repeat(np.array(views_deg, np.float64), [len(table) for table in tables])
    columns = {name: np.concatenate([table.numbers(name) for table in tables]) for name in _NUMBERS}
    class_name = np.array([name for table in tables for name in table.texts("class")], np.str_)
    boxes_px = np.stack([columns[name] for name in _EDGES], axis=1)
    off_axis_deg = np.abs(columns["azimuth_deg"] - view_deg)
    kept = []
    for frame in np.unique(columns["frame"]):
        i = np.flatnonzero(columns["frame"] == frame)
        fractions = fraction_inside(boxes_px[i], boxes_px[i])  # NaN for boxes with NaN
        is_same = np.nan_to_num(np.maximum(fractions, fractions.T)) >= _SAME_OVERLAP
        is_same &= np.not_equal.outer(view_deg[i], view_deg[i]) & np.equal.outer(
            class_name[i], class_name[i]
        )
        is_worse = np.greater.outer(off_axis_deg[i], off_axis_deg[i])
        kept += i[~(is_same & is_worse).any(axis=1)].tolist()
    lines = (",".join((f"{view_deg[i]:g}", *rows[i])) for i in kept)
    return "\n".join([",".join(("view_deg", *RECORDED_BOXES_COLUMNS)), *lines]) + "\n"
