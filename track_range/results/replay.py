"""Frame results reconstructed from the rows of a run, without images, for writing files after the
run.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Set
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from track_range.detection.classes import map_to_road_classes
from track_range.pipeline.alarming import Alarms
from track_range.pipeline.filtering import Approach
from track_range.pipeline.frame_result import FrameResult
from track_range.pipeline.world import World
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.registry import methods as ranging_methods
from track_range.ranging.warning.safety import SafetyMeasures
from track_range.ranging.warning.warnings import Warnings
from track_range.ranging.world.cuboids import Cuboids
from track_range.ranging.world.ego_path import EgoPose
from track_range.ranging.world.object_motion import ObjectMotion
from track_range.ranging.world.placement import Placement
from track_range.results.formats.poses_file import Poses
from track_range.results.rows.columns import methods_with_sigma
from track_range.results.rows.rows import Rows
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.mounting import Mounting
from track_range.stereo.odometry.ego_motion import EgoMotion
from track_range.tracking.tracks import Tracks

_NO_IMAGE = np.zeros((0, 0, 3), np.uint8)
_LEAST_ALONG = 0.1  # fraction of a speed along the axis, from which the part across it is known


def frames_of_rows(
    rows: Rows,
    frame_index: Iterable[int],
    methods: Iterable[str],
    fps: float,
    poses: Poses | None = None,
    mounting: Mounting | None = None,
) -> Iterator[FrameResult]:
    """One result per frame; numbers have the precision of the rows, and the UTC of frames without
    tracks is unknown.

    `rows` are in the order of their frames; `frame_index` are the numbers of all frames of the
    run, in order; `methods` are the distances that were measured; `fps` is the frame rate of the
    video; `poses` are the camera's, and `mounting` tells the part of the speed across its axis, which
    is unknown beside a camera that looks more than 84 degrees aside.
    """
    frames = _Frames(rows, set(methods), fps, mounting or Mounting())
    for index in frame_index:
        pose = None if poses is None else poses.at(index)
        yield frames.result(index, pose or EgoPose())


PARTS = (
    *("tracks", "frame", "ego", "approach"),
    *("world.motion", "world.placement", "world.cuboids", "alarms.warnings", "alarms.safety"),
)
"""Places in a `FrameResult` of the parts that are made from columns; distances and positions are made
besides."""


def cuboids_of(rows: Rows) -> Cuboids:
    """The cuboids of all rows of a run."""
    return Cuboids(**_part(rows, "world.cuboids"))


def _part(rows: Rows, place: str, *, is_written: bool = False) -> dict[str, npt.NDArray[Any]]:
    """Values of all rows by attribute of the part of a `FrameResult` at `place`; with `is_written`,
    only of columns that the rows have.
    """
    values: dict[str, npt.NDArray[Any]] = {}
    axes: dict[str, list[npt.NDArray[Any]]] = {}
    for column in rows.declared.values():
        parent, _, attribute = column.place.rpartition(".")
        if is_written and column.name not in rows:
            continue
        if parent == place:
            values[attribute] = column.codes(rows[column.name])
        elif attribute.isdigit() and parent.rpartition(".")[0] == place:
            axes.setdefault(parent.rpartition(".")[2], []).append(rows[column.name])
    return values | {name: np.stack(parts, axis=1) for name, parts in axes.items()}


class _Frames:
    """The rows of a run as parts of `FrameResult`, each by the places of its columns."""

    def __init__(self, rows: Rows, methods: Set[str], fps: float, mounting: Mounting) -> None:
        self._rows, self._frame, self._fps = rows, rows["frame"], fps
        right, _, forward = mounting.velocity_mps(1.0).tolist()
        self._across = right / forward if abs(forward) >= _LEAST_ALONG else math.nan
        self._known_frame, first_row = np.unique(self._frame, return_index=True)
        self._known_s = rows["time_s"][first_row]
        measured = [name for name in methods_with_sigma() if name in methods]
        measured += [one.name for one in ranging_methods() if not one.measures_distance]
        self._parts = {place: _part(rows, place) for place in PARTS}
        self._parts["tracks"]["class_id"] = map_to_road_classes([str(n) for n in rows["class"]])
        self._xyz_m = np.stack([rows[name] for name in ("x_m", "y_m", "fused_m")], axis=1)
        self._xy_sigma_m = np.stack([rows[name] for name in ("x_sigma_m", "y_sigma_m")], axis=1)
        self._has_warnings = "contact_probability" in rows and "warning" in rows
        self._has_safety = "gap_m" in rows
        self._distances = {name: rows.distance(name) for name in measured}
        self._details = {
            name: _part(rows, f"ranges.{name}.details", is_written=True) for name in measured
        }

    def result(self, index: int, pose: EgoPose) -> FrameResult:
        """The result of the frame with this number."""
        first, last = np.searchsorted(self._frame, [index, index + 1]).tolist()
        rows, has_rows = slice(first, last), last > first
        parts = {name: _selected(part, rows) for name, part in self._parts.items()}
        utc_s = float(parts["frame"]["utc_s"][0]) if has_rows else math.nan
        ego: dict[str, Any] = {
            name: float(values[0]) for name, values in parts["ego"].items() if has_rows
        }
        motion = EgoMotion(**ego)
        tracks = Tracks(**parts["tracks"])
        columns: dict[str, Any] = parts["world.placement"]
        ranges = {
            name: Ranges(
                tracks.track_id,
                distance_m[rows],
                sigma_m[rows],
                details=_selected(self._details[name], rows),
            )
            for name, (distance_m, sigma_m) in self._distances.items()
        }
        return FrameResult(
            frame=Frame(index, self._time_s(index), _NO_IMAGE, None, utc_s),
            tracks=tracks,
            ranges=ranges,
            approach=Approach(**parts["approach"]),
            world=World(
                self._xyz_m[rows],
                self._xy_sigma_m[rows],
                ObjectMotion(**parts["world.motion"]),
                pose,
                replace(Placement.unknown(last - first), **columns),
                Cuboids(**parts["world.cuboids"]),
            ),
            alarms=Alarms(
                Warnings(**parts["alarms.warnings"]),
                SafetyMeasures(**parts["alarms.safety"]),
                self._has_warnings,
                self._has_safety,
            ),
            ego=replace(motion, right_mps=self._across * motion.speed_mps),
        )

    def _time_s(self, index: int) -> float:
        """Time of a frame: between frames with rows interpolated, beyond them at the frame rate."""
        if not len(self._known_frame):
            return index / self._fps
        nearest = np.clip(index, self._known_frame[0], self._known_frame[-1])
        known_s = float(np.interp(nearest, self._known_frame, self._known_s))
        return max(float(known_s + (index - nearest) / self._fps), 0.0)


def _selected(part: Mapping[str, npt.NDArray[Any]], rows: slice) -> dict[str, npt.NDArray[Any]]:
    return {name: values[rows] for name, values in part.items()}
