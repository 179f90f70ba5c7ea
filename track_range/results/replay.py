"""Frame results reconstructed from the rows of a run, without images, for writing files after the run."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np

from track_range.detection.classes import map_to_road_classes
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.ranges import Ranges
from track_range.ranging.registry import methods as ranging_methods
from track_range.ranging.warning.warnings import Warnings
from track_range.results.columns import Columns, methods_with_sigma
from track_range.results.truth import boxes_px
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

_NO_IMAGE = np.zeros((0, 0, 3), np.uint8)


def frames_of_rows(
    columns: Columns, frame_index: Iterable[int], methods: Iterable[str], fps: float
) -> Iterator[FrameResult]:
    """One result per frame; numbers have the precision of the rows, and the UTC of frames without tracks is unknown.

    Args:
        columns: rows in the order of their frames, `RunTable.to_columns()`.
        frame_index: numbers of all frames of the run, in order.
        methods: names of the distances that were measured.
        fps: nominal frame rate.
    """
    time_s = _Times(columns, fps)
    utc_s = columns.get("utc", np.full(len(columns["frame"]), np.nan))  # files of earlier versions have none
    ego_mps = columns.get("ego_mps", np.full(len(columns["frame"]), np.nan))
    warnings = _warnings(columns)
    measured = [name for name in methods_with_sigma() if name in set(methods)]
    details = {
        method.name: [key for key in method.details if f"{method.name}_{key}" in columns]
        for method in ranging_methods()
    }
    class_id = map_to_road_classes([str(name) for name in columns["class"]])
    track_id, boxes = columns["track_id"].astype(np.int64), boxes_px(columns)
    observed = columns["observed"] > 0
    for index in frame_index:
        first, last = np.searchsorted(columns["frame"], [index, index + 1]).tolist()
        rows = slice(first, last)
        ids = track_id[rows]
        yield FrameResult(
            frame=Frame(index, time_s.at(index), _NO_IMAGE, None, float(utc_s[first]) if last > first else math.nan),
            tracks=Tracks(ids, boxes[rows], class_id[rows], columns["score"][rows], observed[rows]),
            ranges={
                name: Ranges(
                    ids,
                    columns[f"{name}_m"][rows],
                    columns[f"{name}_sigma_m"][rows],
                    details={key: columns[f"{name}_{key}"][rows] for key in details.get(name, ())},
                )
                for name in measured
            },
            closing_mps=columns["closing_mps"][rows],
            closing_sigma_mps=columns["closing_sigma_mps"][rows],
            ttc_s=columns["ttc_s"][rows],
            ttc_sigma_s=columns["ttc_sigma_s"][rows],
            xyz_m=np.stack([columns["x_m"][rows], columns["y_m"][rows], columns["fused_m"][rows]], axis=1),
            ego_mps=float(ego_mps[first]) if last > first else math.nan,
            warnings=None if warnings is None else warnings.select(rows),
        )


def _warnings(columns: Columns) -> Warnings | None:
    """Warnings of all rows; None in files of earlier versions, which have none."""
    if "contact_probability" not in columns or "warning" not in columns:
        return None
    path_offset_m = columns.get("path_offset_m", np.full(len(columns["frame"]), np.nan))
    return Warnings(columns["contact_probability"], columns["warning"] > 0, path_offset_m)


class _Times:
    """Times of the frames of a run: those of the rows, interpolated or at the frame rate where there are none.

    Args:
        columns: rows in the order of their frames.
        fps: nominal frame rate.
    """

    def __init__(self, columns: Columns, fps: float) -> None:
        self._frame, rows = np.unique(columns["frame"], return_index=True)
        self._time_s = columns["time_s"][rows]
        self._fps = fps

    def at(self, index: int) -> float:
        """Time of a frame in seconds."""
        if not len(self._frame):
            return index / self._fps
        nearest = np.clip(index, self._frame[0], self._frame[-1])
        time_s = np.interp(nearest, self._frame, self._time_s) + (index - nearest) / self._fps
        return max(float(time_s), 0.0)
