"""Frame results reconstructed from the rows of a run, without images, for writing files after the run."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np

from track_range.detection.classes import map_to_road_classes
from track_range.foundation.arrays import FloatArray
from track_range.ranging.ranges import Ranges
from track_range.results.columns import Columns, methods_with_sigma
from track_range.results.truth import boxes_px
from track_range.run.frame_result import FrameResult
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

_NO_IMAGE = np.zeros((0, 0, 3), np.uint8)


def frames_of_rows(columns: Columns, frame_index: Iterable[int], methods: Iterable[str]) -> Iterator[FrameResult]:
    """One result per frame; frames without tracks have the time NaN, and numbers have the precision of the rows.

    Args:
        columns: rows in the order of their frames, `RunTable.to_columns()`.
        frame_index: numbers of all frames of the run, in order.
        methods: names of the distances that were measured.
    """
    utc_s = columns.get("utc", np.full(len(columns["frame"]), np.nan))  # files of earlier versions have none
    measured = [name for name in methods_with_sigma() if name in set(methods)]
    class_id = map_to_road_classes([str(name) for name in columns["class"]])
    track_id, boxes = columns["track_id"].astype(np.int64), boxes_px(columns)
    observed = columns["observed"] > 0
    for index in frame_index:
        first, last = np.searchsorted(columns["frame"], [index, index + 1]).tolist()
        rows = slice(first, last)
        ids = track_id[rows]
        yield FrameResult(
            frame=_frame(index, columns["time_s"][rows], utc_s[rows]),
            tracks=Tracks(ids, boxes[rows], class_id[rows], columns["score"][rows], observed[rows]),
            ranges={
                name: Ranges(ids, columns[f"{name}_m"][rows], columns[f"{name}_sigma_m"][rows]) for name in measured
            },
            closing_mps=columns["closing_mps"][rows],
            closing_sigma_mps=columns["closing_sigma_mps"][rows],
            ttc_s=columns["ttc_s"][rows],
            ttc_sigma_s=columns["ttc_sigma_s"][rows],
            xyz_m=np.stack([columns["x_m"][rows], columns["y_m"][rows], columns["fused_m"][rows]], axis=1),
        )


def _frame(index: int, time_s: FloatArray, utc_s: FloatArray) -> Frame:
    """A frame without image; its times are those of its rows, NaN if there are none."""
    if not len(time_s):
        return Frame(index, math.nan, _NO_IMAGE, None)
    return Frame(index, float(time_s[0]), _NO_IMAGE, None, float(utc_s[0]))
