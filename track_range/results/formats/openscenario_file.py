"""run.xosc: ASAM OpenSCENARIO 1.2 with the trajectories of the camera's vehicle and of the tracks, without a road.

Positions are those of the frame `map`. The reference point of the ego vehicle is the camera, that of an object the
middle of a box of nominal size behind its visible side; parked objects stay at the median of their positions. Objects
are added when they are first seen, and deleted when they were last seen. Times are seconds from the first known pose.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import FloatArray
from track_range.foundation.files import atomic_files
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.warning.settings import WarningSettings
from track_range.ranging.world.object_motion import MOTION_STATES
from track_range.results.writers import RunInfo

SCENARIO_FILE = "run.xosc"
_EGO = "ego"
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)  # of recordings without UTC, so that the same run gives the same file
_CATEGORIES: Mapping[str, tuple[str, tuple[float, float, float]]] = {
    "person": ("pedestrian", (0.5, 0.6, 1.75)),
    "bicycle": ("bicycle", (1.7, 0.6, 1.7)),
    "car": ("car", (4.2, 1.8, 1.5)),
    "motorcycle": ("motorbike", (2.1, 0.8, 1.6)),
    "bus": ("bus", (11.0, 2.5, 3.1)),
    "truck": ("truck", (8.0, 2.5, 3.3)),
}
"""Category, and nominal length, width and height in m, by class; others are not written."""

Row = tuple[float, float, float, float, float, bool]  # time, x, y, heading (NaN = unknown), bearing, whether parked


def _node(tag: str, *children: ElementTree.Element, **attributes: Any) -> ElementTree.Element:
    node = ElementTree.Element(tag, {name: str(value) for name, value in attributes.items()})
    node.extend(children)
    return node


def _position(x_m: float, y_m: float, heading_rad: float) -> ElementTree.Element:
    return _node("Position", _node("WorldPosition", x=f"{x_m:.3f}", y=f"{y_m:.3f}", z=0, h=f"{heading_rad:.4f}"))


def _at(name: str, time_s: float) -> ElementTree.Element:
    """Trigger at a time of the simulation."""
    value = _node("SimulationTimeCondition", rule="greaterOrEqual", value=f"{time_s:.3f}")
    condition = _node("Condition", _node("ByValueCondition", value), name=name, delay=0, conditionEdge="none")
    return _node("StartTrigger", _node("ConditionGroup", condition))


class OpenScenarioWriter:
    """Writer of run.xosc; the positions are in memory until the end of the run."""

    files = (SCENARIO_FILE,)

    def open(self, info: RunInfo, folder: Path) -> None:
        """Start without frames."""
        self._info, self._path = info, folder / SCENARIO_FILE
        self._ego: list[Row] = []
        self._tracks: dict[int, list[Row]] = {}
        self._classes: dict[int, list[int]] = {}
        self._held: FrameResult | None = None

    def write(self, result: FrameResult) -> None:
        """Add the frame before this one, and hold this one."""
        self._release()
        self._held = result

    def discard_last(self) -> None:
        """Discard the frame that is held."""
        self._held = None

    def close(self, summary: Mapping[str, Any] | None) -> None:
        """Write the file."""
        self._release()
        root = self._scenario()
        ElementTree.indent(root)
        content = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
        atomic_files.write_bytes(self._path, content + b"\n")

    def _release(self) -> None:
        result, self._held = self._held, None
        pose = None if result is None else result.ego_pose
        if result is None or pose is None or math.isnan(pose.x_m):
            return
        time_s = result.time_s
        self._ego.append((time_s, pose.x_m, pose.y_m, pose.heading_rad, 0.0, False))
        if result.motion is None:
            return
        motion, parked = result.motion, MOTION_STATES.index("parked")
        x_m, y_m = motion.world_x_m, motion.world_y_m
        bearing_rad = np.arctan2(y_m - pose.y_m, x_m - pose.x_m)
        columns = (x_m, y_m, np.radians(motion.heading_deg), bearing_rad, motion.state == parked)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        for track_id, class_id, row in zip(
            result.tracks.track_id.tolist(), result.tracks.class_id.tolist(), rows, strict=True
        ):
            if ROAD_CLASSES[class_id] in _CATEGORIES and math.isfinite(row[0]):
                self._tracks.setdefault(track_id, []).append((time_s, *row))
                self._classes.setdefault(track_id, []).append(class_id)

    def _scenario(self) -> ElementTree.Element:
        start_s = self._ego[0][0] if self._ego else 0.0
        utc_s = self._info.start_utc_s
        date = _EPOCH if utc_s is None else datetime.fromtimestamp(utc_s + start_s, UTC)
        ego_m = (WarningSettings().ego_length_m, WarningSettings().ego_width_m, 1.5)
        objects = [(_EGO, "car", ego_m, WarningSettings().front_m - ego_m[0] / 2, _table(self._ego, start_s))]
        for track_id, rows in self._tracks.items():
            name = ROAD_CLASSES[int(np.bincount(self._classes[track_id]).argmax())]
            category, size_m = _CATEGORIES[name]
            objects.append((f"{name}-{track_id}", category, size_m, 0.0, _placed(_table(rows, start_s), size_m)))
        objects = [given for given in objects if len(given[-1])]
        init = [_private(name, table[0]) for name, *_, table in objects if table[0, 0] <= 0]
        groups = [_maneuvers(name, table) for name, *_, table in objects]
        story = [_node("Story", _node("Act", *groups, _at("start", 0.0), name="drive"), name="drive")] if groups else []
        return _node(
            "OpenSCENARIO",
            _node(
                "FileHeader",
                revMajor=1,
                revMinor=2,
                date=date.strftime("%Y-%m-%dT%H:%M:%S"),
                author="track-range",
                description="Trajectories measured with track-range; x forward, y left of the first camera pose, m",
            ),
            _node("ParameterDeclarations"),
            _node("CatalogLocations"),
            _node("RoadNetwork"),
            _node("Entities", *(_entity(*given[:-1]) for given in objects)),
            _node("Storyboard", _node("Init", _node("Actions", *init)), *story, _node("StopTrigger")),
        )


def _table(rows: Sequence[Row], start_s: float) -> FloatArray:
    """(N, 6) rows with times from `start_s`."""
    table = np.array(rows, np.float64).reshape(-1, 6)
    table[:, 0] -= start_s
    return table


def _placed(table: FloatArray, size_m: tuple[float, float, float]) -> FloatArray:
    """Rows (N, 6) of a track with the middle of its box as position, and a heading in every row."""
    time_s, x_m, y_m, heading_rad, bearing_rad, is_parked = table.T.copy()
    known = np.flatnonzero(np.isfinite(heading_rad))
    if len(known):  # the last known one, before it the first
        last = np.maximum(np.searchsorted(known, np.arange(len(table)), side="right") - 1, 0)
        heading_rad = heading_rad[known[last]]
    else:
        heading_rad = np.full(len(table), bearing_rad[0])
    is_along = np.abs(np.cos(heading_rad - bearing_rad)) > math.sqrt(0.5)
    half_m = np.where(is_along, size_m[0], size_m[1]) / 2
    x_m, y_m = x_m + half_m * np.cos(bearing_rad), y_m + half_m * np.sin(bearing_rad)
    if is_parked.mean() > 0.5:
        x_m, y_m = np.full_like(x_m, np.median(x_m)), np.full_like(y_m, np.median(y_m))
    return np.stack([time_s, x_m, y_m, heading_rad, bearing_rad, is_parked], axis=1)


def _entity(name: str, category: str, size_m: tuple[float, float, float], centre_x_m: float) -> ElementTree.Element:
    length, width, height = size_m
    box = _node(
        "BoundingBox",
        _node("Center", x=f"{centre_x_m:.2f}", y=0, z=f"{height / 2:.2f}"),
        _node("Dimensions", width=width, length=length, height=height),
    )
    common = {"name": category}
    if category == "pedestrian":
        body = _node("Pedestrian", box, _node("Properties"), mass=75, model="", pedestrianCategory=category, **common)
    else:
        axle = {"maxSteering": 0.5, "wheelDiameter": 0.6, "trackWidth": width, "positionZ": 0.3}
        axles = (_node("FrontAxle", positionX=f"{0.6 * length:.2f}", **axle), _node("RearAxle", positionX=0, **axle))
        performance = _node("Performance", maxSpeed=70, maxAcceleration=10, maxDeceleration=10)
        parts = (box, performance, _node("Axles", *axles), _node("Properties"))
        body = _node("Vehicle", *parts, vehicleCategory=category, **common)
    return _node("ScenarioObject", body, name=name)


def _private(name: str, row: FloatArray) -> ElementTree.Element:
    teleport = _node("PrivateAction", _node("TeleportAction", _position(*row[1:4].tolist())))
    return _node("Private", teleport, entityRef=name)


def _maneuvers(name: str, table: FloatArray) -> ElementTree.Element:
    """What an object does: it appears, follows its trajectory, and disappears if the ego vehicle remains."""
    first_s, last_s = float(table[0, 0]), float(table[-1, 0])
    if len(table) == 1:  # a trajectory has two vertices
        table = np.concatenate([table, table + np.eye(1, 6) * 0.001])
    vertices = [_node("Vertex", _position(*row[1:4]), time=f"{row[0]:.3f}") for row in table.tolist()]
    trajectory = _node("Trajectory", _node("Shape", _node("Polyline", *vertices)), name=f"{name} path", closed="false")
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
            actions.insert(0, ("appears", first_s, _node("GlobalAction", _node("EntityAction", added, entityRef=name))))
        gone = _node("EntityAction", _node("DeleteEntityAction"), entityRef=name)
        actions.append(("disappears", last_s, _node("GlobalAction", gone)))
    events = []
    for what, time_s, action in actions:
        label = f"{name} {what}"
        parts = _node("Action", action, name=label), _at(label, time_s)
        events.append(_node("Event", *parts, priority="parallel", maximumExecutionCount=1, name=label))
    actors = _node("Actors", _node("EntityRef", entityRef=name), selectTriggeringEntities="false")
    maneuver = _node("Maneuver", *events, name=name)
    return _node("ManeuverGroup", actors, maneuver, maximumExecutionCount=1, name=name)
