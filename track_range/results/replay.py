"""Frame results reconstructed from the rows of a run, without images, for writing files after the
run.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np

from track_range.detection.classes import map_to_road_classes
from track_range.pipeline.alarming import Alarms
from track_range.pipeline.filtering import Approach
from track_range.pipeline.frame_result import FrameResult
from track_range.pipeline.world import World
from track_range.ranging.ranges import Ranges
from track_range.ranging.registry import methods as ranging_methods
from track_range.ranging.warning.safety import SafetyMeasures
from track_range.ranging.warning.warnings import Warnings
from track_range.ranging.world.ego_path import EgoPose
from track_range.ranging.world.object_motion import MOTION_STATES, ObjectMotion
from track_range.results.columns import SAFETY_UNITS, Columns, boxes_px, methods_with_sigma
from track_range.results.formats.poses_file import Poses
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
    frame = columns["frame"]
    known_frame, first_row = np.unique(frame, return_index=True)
    known_s = columns["time_s"][first_row]
    unknown = np.full(len(frame), np.nan)  # files of earlier versions lack some columns
    utc_s, ego_mps = columns.get("utc", unknown), columns.get("ego_mps", unknown)
    warnings = Warnings.unknown(len(frame))
    has_warnings = "contact_probability" in columns and "warning" in columns
    if has_warnings:
        path_offset_m = columns.get("path_offset_m", unknown)
        warnings = Warnings(columns["contact_probability"], columns["warning"] > 0, path_offset_m)
    motion = ObjectMotion.unknown(len(frame))
    if "world_x_m" in columns:
        codes: dict[str, float] = {name: code for code, name in enumerate(MOTION_STATES)}
        state = np.array(
            [codes.get(str(name), math.nan) for name in columns.get("state", unknown)], np.float64
        )
        numbers = {
            name: columns.get(name, unknown) for name in ObjectMotion.__slots__ if name != "state"
        }
        motion = ObjectMotion(**numbers, state=state)
    safety, has_safety = SafetyMeasures.unknown(len(frame)), "gap_m" in columns
    if has_safety:
        measures = {name: columns.get(name, unknown) for name in SAFETY_UNITS}
        safety = SafetyMeasures(**measures, is_lead=columns.get("is_lead", unknown) > 0)
    methods = set(methods)
    listed = ranging_methods()
    measured = [name for name in methods_with_sigma() if name in methods]
    measured += [method.name for method in listed if not method.measures_distance]
    details = {
        method.name: [key for key in method.details if f"{method.name}_{key}" in columns]
        for method in listed
    }
    class_id = map_to_road_classes([str(name) for name in columns["class"]])
    track_id, boxes = columns["track_id"].astype(np.int64), boxes_px(columns)
    observed = columns["observed"] > 0
    for index in frame_index:
        time_s = index / fps
        # between the frames with rows interpolated, beyond them at the frame rate
        if len(known_frame):
            nearest = np.clip(index, known_frame[0], known_frame[-1])
            time_s = max(
                float(np.interp(nearest, known_frame, known_s) + (index - nearest) / fps), 0.0
            )
        first, last = np.searchsorted(frame, [index, index + 1]).tolist()
        rows = slice(first, last)
        ids = track_id[rows]
        yield FrameResult(
            frame=Frame(
                index, time_s, _NO_IMAGE, None, float(utc_s[first]) if last > first else math.nan
            ),
            tracks=Tracks(ids, boxes[rows], class_id[rows], columns["score"][rows], observed[rows]),
            ranges={
                name: Ranges(
                    ids,
                    columns.get(f"{name}_m", unknown)[rows],
                    columns.get(f"{name}_sigma_m", unknown)[rows],
                    details={key: columns[f"{name}_{key}"][rows] for key in details.get(name, ())},
                )
                for name in measured
            },
            approach=Approach(
                columns["closing_mps"][rows],
                columns["closing_sigma_mps"][rows],
                columns["ttc_s"][rows],
                columns["ttc_sigma_s"][rows],
            ),
            world=World(
                np.stack(
                    [columns["x_m"][rows], columns["y_m"][rows], columns["fused_m"][rows]], axis=1
                ),
                motion.select(rows),
                (None if poses is None else poses.at(index)) or EgoPose(),
            ),
            alarms=Alarms(warnings.select(rows), safety.select(rows), has_warnings, has_safety),
            ego=EgoMotion(float(ego_mps[first]) if last > first else math.nan),
        )
