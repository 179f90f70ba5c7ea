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
from dataclasses import dataclass, field, replace
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
EGO = "ego"
N_VALUES = 12  # of a row
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Variation:
    """Parameters of a scenario, by which the trajectories of some objects vary.

    With the declared values, everything is as measured.
    """

    parameters: Mapping[str, str | float]  # declared values
    # what is added to x and y of an object, and scale and offset of its times, as expressions
    shifts: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    timings: Mapping[str, tuple[str, str]] = field(default_factory=dict)

    def position(
        self, name: str, x_m: float, y_m: float, heading_rad: float
    ) -> ElementTree.Element:
        """A position of an object."""
        x, y = f"{x_m:.3f}", f"{y_m:.3f}"
        if name in self.shifts:
            x, y = (
                f"${{{value} + {shift}}}"
                for value, shift in zip((x, y), self.shifts[name], strict=True)
            )
        return _node("Position", _node("WorldPosition", x=x, y=y, z=0, h=f"{heading_rad:.4f}"))

    def timing(self, name: str) -> ElementTree.Element:
        """The time reference of an object's trajectory."""
        scale, offset = self.timings.get(name, ("1", "0"))
        return _node("Timing", domainAbsoluteRelative="absolute", scale=scale, offset=offset)

    def declarations(self) -> ElementTree.Element:
        """The declarations of the parameters."""
        nodes = []
        for name, value in self.parameters.items():
            kind, text = ("string", value) if isinstance(value, str) else ("double", f"{value:.3f}")
            nodes.append(_node("ParameterDeclaration", name=name, parameterType=kind, value=text))
        return _node("ParameterDeclarations", *nodes)


_MEASURED = Variation(parameters={})


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
        write_scenario(self._path, self.drive())

    def drive(self) -> Trajectories:
        """The drive so far."""
        ego = np.array(self._ego).reshape(-1, 4)
        rows = np.concatenate([np.zeros((0, N_VALUES)), *self._tracks])
        return Trajectories(ego=ego, rows=rows, start_utc_s=self._info.start_utc_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class Trajectories:
    """Poses of the ego vehicle and rows of the tracks, see `_rows`."""

    ego: FloatArray  # (N, 4) time, x, y and heading
    rows: FloatArray  # (M, N_VALUES)
    start_utc_s: float | None  # of time 0; None = unknown

    def between(self, start_s: float, end_s: float) -> Trajectories:
        """The part between two times."""
        ego, rows = (
            table[(table[:, 0] >= start_s) & (table[:, 0] <= end_s)]
            for table in (self.ego, self.rows)
        )
        return replace(self, ego=ego, rows=rows)


def object_name(class_id: FloatArray, track_id: float) -> str:
    """Name of a track in a scenario, by its most frequent class."""
    return f"{ROAD_CLASSES[int(np.bincount(class_id.astype(int)).argmax())]}-{track_id:.0f}"


def write_scenario(
    path: Path,
    drive: Trajectories,
    variation: Variation = _MEASURED,
    description: str = "Trajectories measured with track-range",
) -> None:
    """Write a drive as a scenario, atomically."""
    root = _scenario(drive, variation, description)
    ElementTree.indent(root)
    content = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    atomic_files.write_bytes(path, content + b"\n")


def _scenario(drive: Trajectories, variation: Variation, description: str) -> ElementTree.Element:
    start_s, utc_s = float(drive.ego[0, 0]) if len(drive.ego) else 0.0, drive.start_utc_s
    date = _EPOCH if utc_s is None else datetime.fromtimestamp(utc_s + start_s, UTC)
    ego_m = (WarningSettings().ego_length_m, WarningSettings().ego_width_m, 1.5)
    path, rows = drive.ego - [start_s, 0, 0, 0], drive.rows - [start_s, *[0] * (N_VALUES - 1)]
    centre_x_m = WarningSettings().front_m - ego_m[0] / 2
    objects = [(EGO, "car", ego_m, centre_x_m, path)] if len(path) else []
    for track_id in dict.fromkeys(rows[:, 6].tolist()):
        track = rows[rows[:, 6] == track_id]
        name = object_name(track[:, 7], track_id)
        class_name = name.rpartition("-")[0]
        category, height_m = _KINDS[class_name]
        half_width_m = float(HALF_WIDTH_M[ROAD_CLASSES.index(class_name)])
        size_m = (LENGTH_M[class_name], 2 * half_width_m, height_m)
        objects.append((name, category, size_m, 0.0, _placed(track, size_m)))
    init = [_private(name, table[0], variation) for name, *_, table in objects if table[0, 0] <= 0]
    groups = [_maneuvers(name, table, variation) for name, *_, table in objects]
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
            description=f"{description}; x forward, y left of the first camera pose, m",
        ),
        variation.declarations(),
        _node("CatalogLocations"),
        _node("RoadNetwork"),
        _node("Entities", *(_entity(*given[:-1]) for given in objects)),
        _node("Storyboard", _node("Init", _node("Actions", *init)), *story, _node("StopTrigger")),
    )


def _rows(result: FrameResult, pose: EgoPose) -> FloatArray:
    """(N, N_VALUES) time, x, y, heading (NaN = unknown), bearing, whether parked, track ID, class,
    gap to the front, lateral offset from the path of the ego vehicle, speed over ground, its speed.
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
    known = (result.safety.gap_m, result.warnings.path_offset_m, motion.speed_mps)
    identity = (tracks.track_id, tracks.class_id)
    ego_mps = np.full(n, result.ego_mps)
    rows = np.column_stack([*place, bearing_rad, is_parked, *identity, *known, ego_mps])
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


def _private(name: str, row: FloatArray, variation: Variation) -> ElementTree.Element:
    position = variation.position(name, *row[1:4].tolist())
    teleport = _node("PrivateAction", _node("TeleportAction", position))
    return _node("Private", teleport, entityRef=name)


def _maneuvers(name: str, table: FloatArray, variation: Variation) -> ElementTree.Element:
    """The actions of an object: it appears, follows its trajectory, and disappears if the ego
    vehicle remains.
    """
    first_s, last_s = float(table[0, 0]), float(table[-1, 0])
    if len(table) == 1:  # a trajectory has two vertices
        table = np.concatenate([table, table + np.eye(1, 4) * 0.001])
    vertices = [
        _node("Vertex", variation.position(name, *row[1:4]), time=f"{row[0]:.3f}")
        for row in table.tolist()
    ]
    trajectory = _node(
        "Trajectory",
        _node("Shape", _node("Polyline", *vertices)),
        name=f"{name} path",
        closed="false",
    )
    follow = _node(
        "FollowTrajectoryAction",
        _node("TimeReference", variation.timing(name)),
        _node("TrajectoryFollowingMode", followingMode="position"),
        _node("TrajectoryRef", trajectory),
    )
    actions = [("follows", first_s, _node("PrivateAction", _node("RoutingAction", follow)))]
    if name != EGO:
        if first_s > 0:
            added = _node("AddEntityAction", variation.position(name, *table[0, 1:4].tolist()))
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
