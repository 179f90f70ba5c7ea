"""run.xosc: ASAM OpenSCENARIO 1.2 with the trajectories of the ego vehicle and of the tracks.

Positions are in the frame `map`. The reference point of the ego vehicle is the camera, that of an
object the centre of its cuboid, whose size is the mean over the frames of the track, weighted by
its sigmas; parked objects stay at the median of their positions. Objects are added when they are
first seen, and deleted when they were last seen. Times are seconds from the first known pose.
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
from track_range.ranging.warning.settings import WarningSettings
from track_range.ranging.world.ego_path import EgoPose
from track_range.ranging.world.object_motion import MOTION_STATES
from track_range.results.formats.run_info import RunInfo

SCENARIO_FILE = "run.xosc"
EGO = "ego"
N_VALUES = 18  # of a row
_LEAST_M = 0.01  # standard deviation of a size that is given
# of recordings without UTC, so that the same run gives the same file
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
# categories; objects of other classes are not written
_CATEGORIES: Mapping[str, str] = {
    "person": "pedestrian",
    "bicycle": "bicycle",
    "car": "car",
    "motorcycle": "motorbike",
    "bus": "bus",
    "truck": "truck",
}
_IS_WRITTEN = np.array([name in _CATEGORIES for name in ROAD_CLASSES])
_AXLE_FRACTION = 0.3  # of the length of a vehicle, from its middle to an axle: usual


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
        category = _CATEGORIES[name.rpartition("-")[0]]
        objects.append((name, category, _size_m(track), 0.0, _placed(track)))
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
    """(N, N_VALUES) time, x, y and heading of the cuboid, whether its front is known, whether
    parked, track ID, class, gap to the front, lateral offset from the path of the ego vehicle, speed
    over ground, its speed, length, width and height with their sigmas.
    """
    tracks, n = result.tracks, len(result.tracks)
    motion, cuboids = result.motion, result.cuboids
    x_m, y_m = cuboids.world_m[:, :2].T
    heading_rad = np.radians(cuboids.yaw_deg) + pose.heading_rad
    is_parked = motion.state == MOTION_STATES.index("parked")
    place = (np.full(n, result.time_s), x_m, y_m, heading_rad, cuboids.front_known)
    known = (result.safety.gap_m, result.warnings.path_offset_m, motion.speed_mps)
    identity = (is_parked, tracks.track_id, tracks.class_id)
    ego_mps = np.full(n, result.ego_mps)
    sizes = (cuboids.lwh_m, cuboids.lwh_sigma_m)
    rows = np.column_stack([*place, *identity, *known, ego_mps, *sizes])
    is_known = np.isfinite(rows[:, [1, 2, 3, 12, 13, 14]]).all(axis=1)
    return np.asarray(rows[is_known & _IS_WRITTEN[tracks.class_id]])


def _size_m(rows: FloatArray) -> tuple[float, float, float]:
    """Length, width and height of a track, by all its rows: sure ones count more."""
    weights = 1 / np.maximum(np.nan_to_num(rows[:, 15:], nan=np.inf), _LEAST_M) ** 2
    known = weights.sum(axis=0) > 0
    weights = np.where(known, weights, 1.0)
    length_m, width_m, height_m = np.average(rows[:, 12:15], axis=0, weights=weights).tolist()
    return length_m, width_m, height_m


def _placed(rows: FloatArray) -> FloatArray:
    """(N, 4) time, x, y and heading of a track; a heading whose front is not known is the nearer one
    to the last known, before it to the first.
    """
    time_s, x_m, y_m, heading_rad, front_known, is_parked = rows[:, :6].T
    if is_parked.mean() > 0.5:
        x_m, y_m = np.full_like(x_m, np.median(x_m)), np.full_like(y_m, np.median(y_m))
        axis_rad = np.angle(np.exp(2j * heading_rad).sum()) / 2
        is_turned = np.mean(np.cos(heading_rad - axis_rad) < 0) > 0.5
        return np.stack(
            [time_s, x_m, y_m, np.full_like(x_m, axis_rad + math.pi * is_turned)], axis=1
        )
    known = np.flatnonzero(front_known)
    reference_rad = heading_rad[:1]
    if len(known):
        last = np.maximum(np.searchsorted(known, np.arange(len(rows)), side="right") - 1, 0)
        reference_rad = heading_rad[known[last]]
    is_turned = np.cos(heading_rad - reference_rad) < 0
    return np.stack([time_s, x_m, y_m, heading_rad + math.pi * is_turned], axis=1)


def _entity(
    name: str, category: str, size_m: tuple[float, float, float], centre_x_m: float
) -> ElementTree.Element:
    length, width, height = size_m
    box = _node(
        "BoundingBox",
        _node("Center", x=f"{centre_x_m:.2f}", y=0, z=f"{height / 2:.2f}"),
        _node("Dimensions", width=f"{width:.2f}", length=f"{length:.2f}", height=f"{height:.2f}"),
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
        to_axle_m = _AXLE_FRACTION * length
        axle = {
            "maxSteering": 0.5,
            "wheelDiameter": 0.6,
            "trackWidth": f"{width:.2f}",
            "positionZ": 0.3,
        }
        axles = (
            _node("FrontAxle", positionX=f"{centre_x_m + to_axle_m:.2f}", **axle),
            _node("RearAxle", positionX=f"{centre_x_m - to_axle_m:.2f}", **axle),
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
