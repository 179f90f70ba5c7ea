"""run.xosc: ASAM OpenSCENARIO 1.2 with the trajectories of the ego vehicle and of the tracks,
without a road.

Positions are in the frame `map`. The reference point of the ego vehicle is the camera, the
reference point of an object is the middle of a box of nominal size behind its visible side; parked
objects stay at the median of their positions. Objects are added when they are first seen, and
deleted when they were last seen. Times are seconds from the first known pose.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import FloatArray
from track_range.foundation.files import atomic_files
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.warning.safety import HALF_WIDTH_M
from track_range.ranging.warning.settings import WarningSettings
from track_range.ranging.world.ego_path import EgoPose
from track_range.ranging.world.object_motion import MOTION_STATES
from track_range.results.formats.run_info import RunInfo
from track_range.results.formats.scene import LENGTH_M

SCENARIO_FILE = "run.xosc"
_EGO = "ego"
# of recordings without UTC, so that the same run gives the same file
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
# category and nominal height in m; others are not written
_KINDS: Mapping[str, tuple[str, float]] = {
    "person": ("pedestrian", 1.75),
    "bicycle": ("bicycle", 1.7),
    "car": ("car", 1.5),
    "motorcycle": ("motorbike", 1.6),
    "bus": ("bus", 3.1),
    "truck": ("truck", 3.3),
}
_IS_WRITTEN = np.array([name in _KINDS for name in ROAD_CLASSES])


def _node(tag: str, *children: ElementTree.Element, **attributes: Any) -> ElementTree.Element:
    node = ElementTree.Element(tag, {name: str(value) for name, value in attributes.items()})
    node.extend(children)
    return node


def _position(x_m: float, y_m: float, heading_rad: float) -> ElementTree.Element:
    return _node(
        "Position",
        _node("WorldPosition", x=f"{x_m:.3f}", y=f"{y_m:.3f}", z=0, h=f"{heading_rad:.4f}"),
    )


def _at(name: str, time_s: float) -> ElementTree.Element:
    """Trigger at a time of the simulation."""
    value = _node("SimulationTimeCondition", rule="greaterOrEqual", value=f"{time_s:.3f}")
    condition = _node(
        "Condition", _node("ByValueCondition", value), name=name, delay=0, conditionEdge="none"
    )
    return _node("StartTrigger", _node("ConditionGroup", condition))


class OpenScenarioWriter:
    """Writer of run.xosc; the positions are in memory until the end of the run."""

    files = (SCENARIO_FILE,)

    def open(self, info: RunInfo, folder: Path) -> None:
        """Start without frames."""
        self._info, self._path = info, folder / SCENARIO_FILE
        self._ego: list[list[float]] = []  # time, x, y and heading of each frame
        self._tracks: list[FloatArray] = []  # of each of these frames, see `_rows`
        self._n_before = 0  # frames before the last one

    def write(self, result: FrameResult) -> None:
        """Add a frame."""
        pose, self._n_before = result.ego_pose, len(self._ego)
        if math.isfinite(pose.x_m):
            self._ego.append([result.time_s, pose.x_m, pose.y_m, pose.heading_rad])
            self._tracks.append(_rows(result, pose))

    def discard_last(self) -> None:
        """Discard the last frame."""
        del self._ego[self._n_before :], self._tracks[self._n_before :]

    def close(self, summary: Mapping[str, Any] | None) -> None:
        """Write the file."""
        root = self._scenario()
        ElementTree.indent(root)
        content = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
        atomic_files.write_bytes(self._path, content + b"\n")

    def _scenario(self) -> ElementTree.Element:
        start_s = self._ego[0][0] if self._ego else 0.0
        utc_s = self._info.start_utc_s
        date = _EPOCH if utc_s is None else datetime.fromtimestamp(utc_s + start_s, UTC)
        ego_m = (WarningSettings().ego_length_m, WarningSettings().ego_width_m, 1.5)
        path = np.array(self._ego).reshape(-1, 4) - [start_s, 0, 0, 0]
        objects = (
            [(_EGO, "car", ego_m, WarningSettings().front_m - ego_m[0] / 2, path)]
            if len(path)
            else []
        )
        rows = np.concatenate([np.zeros((0, 8)), *self._tracks]) - [start_s, *[0] * 7]
        for track_id in dict.fromkeys(rows[:, 6].tolist()):
            track = rows[rows[:, 6] == track_id]
            class_id = int(np.bincount(track[:, 7].astype(int)).argmax())
            name = ROAD_CLASSES[class_id]
            category, height_m = _KINDS[name]
            size_m = (LENGTH_M[name], 2 * float(HALF_WIDTH_M[class_id]), height_m)
            objects.append(
                (f"{name}-{track_id:.0f}", category, size_m, 0.0, _placed(track, size_m))
            )
        init = [_private(name, table[0]) for name, *_, table in objects if table[0, 0] <= 0]
        groups = [_maneuvers(name, table) for name, *_, table in objects]
        story = (
            [_node("Story", _node("Act", *groups, _at("start", 0.0), name="drive"), name="drive")]
            if groups
            else []
        )
        return _node(
            "OpenSCENARIO",
            _node(
                "FileHeader",
                revMajor=1,
                revMinor=2,
                date=date.strftime("%Y-%m-%dT%H:%M:%S"),
                author="track-range",
                description="Trajectories measured with track-range; x forward, y left of the "
                "first camera pose, m",
            ),
            _node("ParameterDeclarations"),
            _node("CatalogLocations"),
            _node("RoadNetwork"),
            _node("Entities", *(_entity(*given[:-1]) for given in objects)),
            _node(
                "Storyboard", _node("Init", _node("Actions", *init)), *story, _node("StopTrigger")
            ),
        )


def _rows(result: FrameResult, pose: EgoPose) -> FloatArray:
    """(N, 8) time, x, y, heading (NaN = unknown), bearing, whether parked, track ID and class of
    tracks in a frame.
    """
    tracks, n = result.tracks, len(result.tracks)
    motion = result.motion
    x_m, y_m, is_parked = (
        motion.world_x_m,
        motion.world_y_m,
        motion.state == MOTION_STATES.index("parked"),
    )
    place = (np.full(n, result.time_s), x_m, y_m, np.radians(motion.heading_deg))
    bearing_rad = np.arctan2(y_m - pose.y_m, x_m - pose.x_m)
    rows = np.column_stack([*place, bearing_rad, is_parked, tracks.track_id, tracks.class_id])
    return np.asarray(rows[np.isfinite(x_m) & _IS_WRITTEN[tracks.class_id]])


def _placed(rows: FloatArray, size_m: tuple[float, float, float]) -> FloatArray:
    """(N, 4) time, x and y of the middle of the box of a track, and a heading in every row."""
    time_s, x_m, y_m, heading_rad, bearing_rad, is_parked = rows[:, :6].T
    known = np.flatnonzero(np.isfinite(heading_rad))
    if len(known):  # the last known one, before it the first
        last = np.maximum(np.searchsorted(known, np.arange(len(rows)), side="right") - 1, 0)
        heading_rad = heading_rad[known[last]]
    else:
        heading_rad = np.full(len(rows), bearing_rad[0])
    is_along = np.abs(np.cos(heading_rad - bearing_rad)) > math.sqrt(0.5)
    half_m = np.where(is_along, size_m[0], size_m[1]) / 2
    x_m, y_m = x_m + half_m * np.cos(bearing_rad), y_m + half_m * np.sin(bearing_rad)
    if is_parked.mean() > 0.5:
        x_m, y_m = np.full_like(x_m, np.median(x_m)), np.full_like(y_m, np.median(y_m))
    return np.stack([time_s, x_m, y_m, heading_rad], axis=1)


def _entity(
    name: str, category: str, size_m: tuple[float, float, float], centre_x_m: float
) -> ElementTree.Element:
    length, width, height = size_m
    box = _node(
        "BoundingBox",
        _node("Center", x=f"{centre_x_m:.2f}", y=0, z=f"{height / 2:.2f}"),
        _node("Dimensions", width=width, length=length, height=height),
    )
    common = {"name": category}
    if category == "pedestrian":
        body = _node(
            "Pedestrian",
            box,
            _node("Properties"),
            mass=75,
            model="",
            pedestrianCategory=category,
            **common,
        )
    else:
        axle = {"maxSteering": 0.5, "wheelDiameter": 0.6, "trackWidth": width, "positionZ": 0.3}
        axles = (
            _node("FrontAxle", positionX=f"{0.6 * length:.2f}", **axle),
            _node("RearAxle", positionX=0, **axle),
        )
        performance = _node("Performance", maxSpeed=70, maxAcceleration=10, maxDeceleration=10)
        parts = (box, performance, _node("Axles", *axles), _node("Properties"))
        body = _node("Vehicle", *parts, vehicleCategory=category, **common)
    return _node("ScenarioObject", body, name=name)


def _private(name: str, row: FloatArray) -> ElementTree.Element:
    teleport = _node("PrivateAction", _node("TeleportAction", _position(*row[1:4].tolist())))
    return _node("Private", teleport, entityRef=name)


def _maneuvers(name: str, table: FloatArray) -> ElementTree.Element:
    """The actions of an object: it appears, follows its trajectory, and disappears if the ego
    vehicle remains.
    """
    first_s, last_s = float(table[0, 0]), float(table[-1, 0])
    if len(table) == 1:  # a trajectory has two vertices
        table = np.concatenate([table, table + np.eye(1, 4) * 0.001])
    vertices = [
        _node("Vertex", _position(*row[1:4]), time=f"{row[0]:.3f}") for row in table.tolist()
    ]
    trajectory = _node(
        "Trajectory",
        _node("Shape", _node("Polyline", *vertices)),
        name=f"{name} path",
        closed="false",
    )
    timing = _node("Timing", domainAbsoluteRelative="absolute", scale=1, offset=0)
    follow = _node(
        "FollowTrajectoryAction",
        _node("TimeReference", timing),
        _node("TrajectoryFollowingMode", followingMode="position"),
        _node("TrajectoryRef", trajectory),
    )
    actions = [("follows", first_s, _node("PrivateAction", _node("RoutingAction", follow)))]
    if name != _EGO:
        if first_s > 0:
            added = _node("AddEntityAction", _position(*table[0, 1:4].tolist()))
            actions.insert(
                0,
                (
                    "appears",
                    first_s,
                    _node("GlobalAction", _node("EntityAction", added, entityRef=name)),
                ),
            )
        gone = _node("EntityAction", _node("DeleteEntityAction"), entityRef=name)
        actions.append(("disappears", last_s, _node("GlobalAction", gone)))
    events = []
    for what, time_s, action in actions:
        label = f"{name} {what}"
        parts = _node("Action", action, name=label), _at(label, time_s)
        events.append(
            _node("Event", *parts, priority="parallel", maximumExecutionCount=1, name=label)
        )
    actors = _node("Actors", _node("EntityRef", entityRef=name), selectTriggeringEntities="false")
    maneuver = _node("Maneuver", *events, name=name)
    return _node("ManeuverGroup", actors, maneuver, maximumExecutionCount=1, name=name)
