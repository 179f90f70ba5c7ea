"""Frame results reconstructed from the rows of a run, without images, for writing files after the
run.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Set
from dataclasses import replace

import numpy as np

from track_range.detection.classes import map_to_road_classes
from track_range.foundation.arrays import FloatArray
from track_range.pipeline.alarming import Alarms
from track_range.pipeline.filtering import Approach
from track_range.pipeline.frame_result import FrameResult
from track_range.pipeline.world import World
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.registry import methods as ranging_methods
from track_range.ranging.warning.safety import SafetyMeasures
from track_range.ranging.warning.warnings import Warnings
from track_range.ranging.world.ego_path import EgoPose
from track_range.ranging.world.object_motion import MOTION_STATES, ObjectMotion
from track_range.results.formats.poses_file import Poses
from track_range.results.rows.columns import SAFETY_UNITS, Columns, boxes_px, methods_with_sigma
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.ego_motion import EgoMotion
from track_range.tracking.tracks import Tracks

_NO_IMAGE = np.zeros((0, 0, 3), np.uint8)


def frames_of_rows(
    columns: Columns,
    frame_index: Iterable[int],
    methods: Iterable[str],
    fps: float,
    poses: Poses | None = None,
) -> Iterator[FrameResult]:
    """One result per frame; numbers have the precision of the rows, and the UTC of frames without
    tracks is unknown.

    `columns` are in the order of their frames; `frame_index` are the numbers of all frames of the
    run, in order; `methods` are the distances that were measured; `fps` is the frame rate of the
    video; `poses` are the camera's.
    """
    rows = _Rows(columns, set(methods), fps)
    for index in frame_index:
        pose = None if poses is None else poses.at(index)
        yield rows.result(index, pose or EgoPose())


class _Rows:
    """The rows of a run as parts of `FrameResult`; files of earlier versions lack some columns."""

    def __init__(self, columns: Columns, methods: Set[str], fps: float) -> None:
        self._columns, self._frame, self._fps = columns, columns["frame"], fps
        self._known_frame, first_row = np.unique(self._frame, return_index=True)
        self._known_s = columns["time_s"][first_row]
        self._unknown = np.full(len(self._frame), np.nan)
        self._class_id = map_to_road_classes([str(name) for name in columns["class"]])
        self._track_id, self._boxes = columns["track_id"].astype(np.int64), boxes_px(columns)
        listed = ranging_methods()
        self._measured = [name for name in methods_with_sigma() if name in methods]
        self._measured += [method.name for method in listed if not method.measures_distance]
        self._details = {
            method.name: [key for key in method.details if f"{method.name}_{key}" in columns]
            for method in listed
        }
        self._alarms, self._motion = self._all_alarms(), self._all_motion()

    def result(self, index: int, pose: EgoPose) -> FrameResult:
        """The result of the frame with this number."""
        columns = self._columns
        first, last = np.searchsorted(self._frame, [index, index + 1]).tolist()
        rows, has_rows = slice(first, last), last > first
        utc_s = float(self._column("utc")[first]) if has_rows else math.nan
        ego_mps = float(self._column("ego_mps")[first]) if has_rows else math.nan
        xyz_m = np.stack([columns[name][rows] for name in ("x_m", "y_m", "fused_m")], axis=1)
        approach = ("closing_mps", "closing_sigma_mps", "ttc_s", "ttc_sigma_s")
        return FrameResult(
            frame=Frame(index, self._time_s(index), _NO_IMAGE, None, utc_s),
            tracks=Tracks(
                self._track_id[rows],
                self._boxes[rows],
                self._class_id[rows],
                columns["score"][rows],
                columns["observed"][rows] > 0,
            ),
            ranges={name: self._ranges(name, rows) for name in self._measured},
            approach=Approach(*(columns[name][rows] for name in approach)),
            world=World(xyz_m, self._motion.select(rows), pose),
            alarms=self._alarms.select(rows),
            ego=EgoMotion(ego_mps),
        )

    def _column(self, name: str) -> FloatArray:
        return self._columns.get(name, self._unknown)

    def _time_s(self, index: int) -> float:
        """Time of a frame: between frames with rows interpolated, beyond them at the frame rate."""
        if not len(self._known_frame):
            return index / self._fps
        nearest = np.clip(index, self._known_frame[0], self._known_frame[-1])
        known_s = float(np.interp(nearest, self._known_frame, self._known_s))
        return max(float(known_s + (index - nearest) / self._fps), 0.0)

    def _ranges(self, name: str, rows: slice) -> Ranges:
        return Ranges(
            self._track_id[rows],
            self._column(f"{name}_m")[rows],
            self._column(f"{name}_sigma_m")[rows],
            details={
                key: self._columns[f"{name}_{key}"][rows] for key in self._details.get(name, ())
            },
        )

    def _all_alarms(self) -> Alarms:
        """Warnings and measures of safety of all rows."""
        columns, alarms = self._columns, Alarms.none(len(self._frame))
        if "contact_probability" in columns and "warning" in columns:
            path_offset_m = self._column("path_offset_m")
            is_active = columns["warning"] > 0
            warnings = Warnings(columns["contact_probability"], is_active, path_offset_m)
            alarms = replace(alarms, warnings=warnings, has_warnings=True)
        if "gap_m" in columns:
            measures = {name: self._column(name) for name in SAFETY_UNITS}
            safety = SafetyMeasures(**measures, is_lead=self._column("is_lead") > 0)
            alarms = replace(alarms, safety=safety, has_safety=True)
        return alarms

    def _all_motion(self) -> ObjectMotion:
        """Motion over ground of all rows."""
        if "world_x_m" not in self._columns:
            return ObjectMotion.unknown(len(self._frame))
        codes: dict[str, float] = {name: code for code, name in enumerate(MOTION_STATES)}
        names = self._columns.get("state", self._unknown)
        state = np.array([codes.get(str(name), math.nan) for name in names], np.float64)
        numbers = [name for name in ObjectMotion.__slots__ if name != "state"]
        return ObjectMotion(**{name: self._column(name) for name in numbers}, state=state)
