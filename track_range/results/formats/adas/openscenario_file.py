"""run.xosc: ASAM OpenSCENARIO 1.2 with the trajectories of the ego vehicle and of the tracks, on the
road of run.xodr.

Positions are in the frame `map`. The reference point of the ego vehicle is the camera, that of an
object the centre of its cuboid, whose size is the mean over the frames of the track, weighted by
its sigmas; parked objects stay at the median of their positions. Objects are added when they are
first seen, and deleted when they were last seen. Times are seconds from the first known pose.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import FloatArray
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.methods.lane_width import LaneWidth, usual_width
from track_range.ranging.world.cuboid_corners import mean_axis_rad, mean_size_m
from track_range.ranging.world.ego_path import EgoPose
from track_range.ranging.world.object_motion import MOTION_STATES
from track_range.results.formats.adas.opendrive_file import ROAD_FILE, write_road
from track_range.results.formats.adas.trajectories import (
    EGO_SIZE_M,
    N_VALUES,
    Trajectories,
    ego_centre_m,
)
from track_range.results.formats.adas.xml_nodes import node, write_nodes
from track_range.results.formats.run_info import RunInfo

SCENARIO_FILE = "run.xosc"
EGO = "ego"
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
        return node("Position", node("WorldPosition", x=x, y=y, z=0, h=f"{heading_rad:.4f}"))

    def timing(self, name: str) -> ElementTree.Element:
        """The time reference of an object's trajectory."""
        scale, offset = self.timings.get(name, ("1", "0"))
        return node("Timing", domainAbsoluteRelative="absolute", scale=scale, offset=offset)

    def declarations(self) -> ElementTree.Element:
        """The declarations of the parameters."""
        nodes = []
        for name, value in self.parameters.items():
            kind, text = ("string", value) if isinstance(value, str) else ("double", f"{value:.3f}")
            nodes.append(node("ParameterDeclaration", name=name, parameterType=kind, value=text))
        return node("ParameterDeclarations", *nodes)


_MEASURED = Variation(parameters={})
# name, category, size, centre relative to the reference point, and time, x, y, heading
_Object = tuple[str, str, Sequence[float], tuple[float, float], FloatArray]


def _at(name: str, time_s: float) -> ElementTree.Element:
    """Trigger at a time of the simulation."""
    value = node("SimulationTimeCondition", rule="greaterOrEqual", value=f"{time_s:.3f}")
    condition = node(
        "Condition", node("ByValueCondition", value), name=name, delay=0, conditionEdge="none"
    )
    return node("StartTrigger", node("ConditionGroup", condition))


class OpenScenarioWriter:
    """Writer of run.xosc and run.xodr; the positions are in memory until the end of the run."""

    files = (SCENARIO_FILE, ROAD_FILE)

    def open(self, info: RunInfo, folder: Path) -> None:
        """Start without frames."""
        self._info, self._folder = info, folder
        self._turn_rad = 0.0 if info.mounting is None else math.radians(info.mounting.yaw_deg)
        self._ego: list[list[float]] = []  # time, x, y, heading and sigma of each frame
        self._tracks: list[FloatArray] = []  # of each of these frames, see `_rows`
        self._n_before = 0  # frames before the last one
        self._lane = usual_width("unknown")

    def write(self, result: FrameResult) -> None:
        """Add a frame."""
        pose, self._n_before = result.ego_pose, len(self._ego)
        if math.isfinite(pose.x_m):
            heading_rad, sigma_m = pose.heading_rad - self._turn_rad, math.hypot(*pose.sigmas[:2])
            self._ego.append([result.time_s, pose.x_m, pose.y_m, heading_rad, sigma_m])
            self._tracks.append(_rows(result, pose))

    def discard_last(self) -> None:
        """Discard the last frame."""
        del self._ego[self._n_before :], self._tracks[self._n_before :]

    def close(self, summary: Mapping[str, Any] | None) -> None:
        """Write the files; a drive without a known position has no road."""
        width_m, sigma_m = (
            (summary or {}).get(name) for name in ("lane_width_m", "lane_width_sigma_m")
        )
        if width_m is not None and sigma_m is not None:
            self._lane = LaneWidth(float(width_m), float(sigma_m) / float(width_m))
        drive = self.drive()
        has_road = write_road(self._folder / ROAD_FILE, drive)
        write_scenario(self._folder / SCENARIO_FILE, drive, road=ROAD_FILE if has_road else "")

    def drive(self) -> Trajectories:
        """The drive so far."""
        ego = np.array(self._ego).reshape(-1, 5)
        rows = np.concatenate([np.zeros((0, N_VALUES)), *self._tracks])
        return Trajectories(
            ego=ego[:, :4],
            rows=rows,
            start_utc_s=self._info.start_utc_s,
            end_sigma_m=float(ego[-1, 4]) if len(ego) else math.nan,
            lane=self._lane,
            ego_centre_m=ego_centre_m(self._info.mounting),
        )


def object_name(class_id: FloatArray, track_id: float) -> str:
    """Name of a track in a scenario, by its most frequent class."""
    return f"{ROAD_CLASSES[int(np.bincount(class_id.astype(int)).argmax())]}-{track_id:.0f}"


def write_scenario(
    path: Path,
    drive: Trajectories,
    variation: Variation = _MEASURED,
    description: str = "Trajectories measured with track-range",
    road: str = "",
) -> None:
    """Write a drive as a scenario, atomically; `road` is the name of the file of its road, in the
    same folder, "" = none.
    """
    write_nodes(path, _scenario(drive, variation, description, road))


def _scenario(
    drive: Trajectories, variation: Variation, description: str, road: str
) -> ElementTree.Element:
    start_s = drive.start_s
    path, rows = drive.ego - [start_s, 0, 0, 0], drive.rows - [start_s, *[0] * (N_VALUES - 1)]
    ego = (EGO, "car", EGO_SIZE_M, drive.ego_centre_m, path)
    objects: list[_Object] = [ego] if len(path) else []
    for track_id in dict.fromkeys(rows[:, 6].tolist()):
        track = rows[rows[:, 6] == track_id]
        name = object_name(track[:, 7], track_id)
        category = _CATEGORIES[name.rpartition("-")[0]]
        size_m = mean_size_m(track[:, 12:15], track[:, 15:])
        objects.append((name, category, size_m, (0.0, 0.0), _placed(track)))
    init = [_private(name, table[0], variation) for name, *_, table in objects if table[0, 0] <= 0]
    groups = [_maneuvers(name, table, variation) for name, *_, table in objects]
    story = (
        [node("Story", node("Act", *groups, _at("start", 0.0), name="drive"), name="drive")]
        if groups
        else []
    )
    roads = [node("LogicFile", filepath=road)] if road else []
    return node(
        "OpenSCENARIO",
        node(
            "FileHeader",
            revMajor=1,
            revMinor=2,
            date=drive.date,
            author="track-range",
            description=f"{description}; x forward, y left of the first camera pose, m",
        ),
        variation.declarations(),
        node("CatalogLocations"),
        node("RoadNetwork", *roads),
        node("Entities", *(_entity(*given[:-1]) for given in objects)),
        node("Storyboard", node("Init", node("Actions", *init)), *story, node("StopTrigger")),
    )


def _rows(result: FrameResult, pose: EgoPose) -> FloatArray:
    """(N, N_VALUES) rows of `Trajectories`."""
    tracks, n = result.tracks, len(result.tracks)
    motion, cuboids = result.motion, result.cuboids
    x_m, y_m = cuboids.world_m[:, :2].T
    heading_rad = np.radians(cuboids.yaw_deg) + pose.heading_rad
    is_parked = np.where(
        np.isnan(motion.state), math.nan, motion.state == MOTION_STATES.index("parked")
    )
    place = (np.full(n, result.time_s), x_m, y_m, heading_rad, cuboids.front_known)
    known = (result.safety.gap_m, result.warnings.path_offset_m, motion.speed_mps)
    identity = (is_parked, tracks.track_id, tracks.class_id)
    others = (np.full(n, result.ego_mps), cuboids.lwh_m, cuboids.lwh_sigma_m)
    rows = np.column_stack([*place, *identity, *known, *others])
    is_known = np.isfinite(rows[:, [1, 2, 3, 12, 13, 14]]).all(axis=1)
    return np.asarray(rows[is_known & _IS_WRITTEN[tracks.class_id]])


def _placed(rows: FloatArray) -> FloatArray:
    """(N, 4) time, x, y and heading of a track; a heading whose front is not known is the nearer one
    to the last known, before it to the first.
    """
    time_s, x_m, y_m, heading_rad, front_known, is_parked = rows[:, :6].T
    if (is_parked == 1).mean() > 0.5:
        x_m, y_m = np.full_like(x_m, np.median(x_m)), np.full_like(y_m, np.median(y_m))
        heading_rad = np.full_like(x_m, mean_axis_rad(heading_rad))
        return np.stack([time_s, x_m, y_m, heading_rad], axis=1)
    known = np.flatnonzero(front_known)
    reference_rad = heading_rad[:1]
    if len(known):
        last = np.maximum(np.searchsorted(known, np.arange(len(rows)), side="right") - 1, 0)
        reference_rad = heading_rad[known[last]]
    is_turned = np.cos(heading_rad - reference_rad) < 0
    return np.stack([time_s, x_m, y_m, heading_rad + math.pi * is_turned], axis=1)


def _entity(
    name: str, category: str, size_m: Sequence[float], centre_m: tuple[float, float]
) -> ElementTree.Element:
    (length, width, height), (centre_x_m, centre_y_m) = size_m, centre_m
    box = node(
        "BoundingBox",
        node("Center", x=f"{centre_x_m:.2f}", y=f"{centre_y_m:.2f}", z=f"{height / 2:.2f}"),
        node("Dimensions", width=f"{width:.2f}", length=f"{length:.2f}", height=f"{height:.2f}"),
    )
    if category == "pedestrian":
        body = node(
            "Pedestrian",
            box,
            node("Properties"),
            mass=75,
            model="",
            pedestrianCategory=category,
            name=category,
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
            node("FrontAxle", positionX=f"{centre_x_m + to_axle_m:.2f}", **axle),
            node("RearAxle", positionX=f"{centre_x_m - to_axle_m:.2f}", **axle),
        )
        performance = node("Performance", maxSpeed=70, maxAcceleration=10, maxDeceleration=10)
        parts = (box, performance, node("Axles", *axles), node("Properties"))
        body = node("Vehicle", *parts, vehicleCategory=category, name=category)
    return node("ScenarioObject", body, name=name)


def _private(name: str, row: FloatArray, variation: Variation) -> ElementTree.Element:
    position = variation.position(name, *row[1:4].tolist())
    teleport = node("PrivateAction", node("TeleportAction", position))
    return node("Private", teleport, entityRef=name)


def _maneuvers(name: str, table: FloatArray, variation: Variation) -> ElementTree.Element:
    """The actions of an object: it appears, follows its trajectory, and disappears if the ego
    vehicle remains.
    """
    first_s, last_s = float(table[0, 0]), float(table[-1, 0])
    if len(table) == 1:  # a trajectory has two vertices
        table = np.concatenate([table, table + np.eye(1, 4) * 0.001])
    vertices = [
        node("Vertex", variation.position(name, *row[1:4]), time=f"{row[0]:.3f}")
        for row in table.tolist()
    ]
    trajectory = node(
        "Trajectory",
        node("Shape", node("Polyline", *vertices)),
        name=f"{name} path",
        closed="false",
    )
    follow = node(
        "FollowTrajectoryAction",
        node("TimeReference", variation.timing(name)),
        node("TrajectoryFollowingMode", followingMode="position"),
        node("TrajectoryRef", trajectory),
    )
    actions = [("follows", first_s, node("PrivateAction", node("RoutingAction", follow)))]
    if name != EGO:
        if first_s > 0:
            added = node("AddEntityAction", variation.position(name, *table[0, 1:4].tolist()))
            actions.insert(
                0,
                (
                    "appears",
                    first_s,
                    node("GlobalAction", node("EntityAction", added, entityRef=name)),
                ),
            )
        gone = node("EntityAction", node("DeleteEntityAction"), entityRef=name)
        actions.append(("disappears", last_s, node("GlobalAction", gone)))
    events = []
    for what, time_s, action in actions:
        label = f"{name} {what}"
        parts = node("Action", action, name=label), _at(label, time_s)
        events.append(
            node("Event", *parts, priority="parallel", maximumExecutionCount=1, name=label)
        )
    actors = node("Actors", node("EntityRef", entityRef=name), selectTriggeringEntities="false")
    maneuver = node("Maneuver", *events, name=name)
    return node("ManeuverGroup", actors, maneuver, maximumExecutionCount=1, name=name)
