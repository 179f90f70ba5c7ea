"""OsiMessages: a frame as messages of ASAM OSI 3: what the camera measured as SensorData, the ego
vehicle as HostVehicleData, and the same world as GroundTruth.

SensorData are in the axes of the sensor, which are those of the camera by other names: x along the
optical axis, y to the left, z up. With a mounting, they stand in the vehicle as `mounting_position`
says. HostVehicleData and GroundTruth are in the frame `map`. Positions are the middles of boxes,
angles turn yaw first, then pitch, then roll (ISO 8855), and velocities are the change of the
position per second in the same axes. Values that are not known are not set.
"""

import cmath
import math
from collections.abc import Collection, Iterable, Mapping
from pkgutil import resolve_name
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from track_range.pipeline.frame_result import FrameResult, PointState, TrackedObject
from track_range.results.formats.adas.trajectories import EGO_SIZE_M, ego_centre_m
from track_range.results.formats.run_info import RunInfo
from track_range.results.formats.scene import transforms
from track_range.stereo.geometry.mounting import Mounting

MESSAGES: Mapping[str, str] = {
    "SensorData": "osi3.osi_sensordata_pb2:SensorData",
    "HostVehicleData": "osi3.osi_hostvehicledata_pb2:HostVehicleData",
    "GroundTruth": "osi3.osi_groundtruth_pb2:GroundTruth",
}
HOST_ID = 1_000_000_000  # tracks have smaller identities
_SENSOR_ID, _LINE_IDS = HOST_ID + 1, (HOST_ID + 2, HOST_ID + 3)  # lines: left, right
_CLASSES: Mapping[str, dict[str, Any]] = {  # of moving objects
    "person": {"type": "TYPE_PEDESTRIAN"},
    "bicycle": {"type": "TYPE_VEHICLE", "vehicle_classification": {"type": "TYPE_BICYCLE"}},
    "car": {"type": "TYPE_VEHICLE", "vehicle_classification": {"type": "TYPE_CAR"}},
    "motorcycle": {"type": "TYPE_VEHICLE", "vehicle_classification": {"type": "TYPE_MOTORCYCLE"}},
    "bus": {"type": "TYPE_VEHICLE", "vehicle_classification": {"type": "TYPE_BUS"}},
    "truck": {"type": "TYPE_VEHICLE", "vehicle_classification": {"type": "TYPE_HEAVY_TRUCK"}},
}
_AT_REST = {False: "STATIONARY", True: "STOPPED"}  # by whether the track has moved
# places in BaseMoving of the values of an object; BaseStationary has the first nine
_PLACES = (
    *(("dimension", name) for name in ("length", "width", "height")),
    *(("position", name) for name in "xyz"),
    *(("orientation", name) for name in ("yaw", "pitch", "roll")),
    *(("velocity", name) for name in "xyz"),
    ("orientation_rate", "yaw"),
)
_NAN, _NAN3 = math.nan, (math.nan,) * 3
# from the camera's axes (right, down, forward) to those of the sensor (forward, left, up)
_ORDER, _SIGNS = [2, 0, 1], np.array([1.0, -1.0, -1.0])
_N_LINE_POINTS = 12
# largest relative standard deviation of the distance of a point of a lane line
_MAX_LINE_SIGMA = 0.25


class OsiMessages:
    """Makes the messages of a run, frame by frame; it remembers which tracks have moved."""

    def __init__(self, info: RunInfo) -> None:
        versions: Any = resolve_name("osi3.osi_version_pb2")
        of_file = versions.DESCRIPTOR.GetOptions().Extensions
        self.version = of_file[versions.current_interface_version]
        self.types = {name: resolve_name(place) for name, place in MESSAGES.items()}
        self._info, self._moved = info, set[int]()
        self._mounting = mounting = info.mounting or Mounting()
        # of the middle of the ego vehicle, from its reference point
        self._centre_m = mounting.x_m + ego_centre_m(mounting)[0]
        angles = np.radians([mounting.yaw_deg, mounting.pitch_deg, mounting.roll_deg])
        self._sensor_from_vehicle = Rotation.from_euler("ZYX", angles).inv()
        self._mounted = {
            "mounting_position": _base([*_NAN3, *mounting.place_m, *angles]),
            "mounting_position_rmse": _base(
                [*_NAN3, *_NAN3, *[math.radians(mounting.sigma_deg)] * 3]
            ),
        }

    def of(
        self, result: FrameResult, wanted: Collection[str] = frozenset(MESSAGES)
    ) -> dict[str, Any]:
        """The wanted messages of a frame by name; those in `map` only if the pose of the camera is
        known.
        """
        seconds, nanos = divmod(round(result.time_s * 1e9), 10**9)
        start = {"version": self.version, "timestamp": {"seconds": seconds, "nanos": nanos}}
        contents = (
            {"SensorData": self._sensor_data(result, start["timestamp"])}
            if "SensorData" in wanted
            else {}
        )
        if {*wanted} != {"SensorData"} and math.isfinite(result.ego_pose.x_m):
            contents |= self._in_map(result)
        return {
            name: self.types[name](**start, **contents[name]) for name in contents if name in wanted
        }

    def _sensor_data(self, result: FrameResult, time: dict[str, int]) -> dict[str, Any]:
        """Tracks and lane lines of a frame, as the camera measured them."""
        lists: dict[str, list[dict[str, Any]]] = {
            "moving_object": [],
            "traffic_light": [],
            "traffic_sign": [],
            "lane_boundary": self._lane_boundaries(result),
        }
        tracks = [t for t in result.objects if np.isfinite(t.cuboid_in_camera.centre_m).all()]
        self._moved |= {track.id for track in tracks if track.state not in ("", "parked")}
        for track in tracks:
            header, bases, name = {"header": _header(track)}, self._bases(track), track.class_name
            if name in _CLASSES:
                candidates = [{"probability": 1.0, **_CLASSES[name]}]  # a track has a single class
                at_rest = _AT_REST[track.id in self._moved]
                state = {"parked": at_rest, "": "UNKNOWN"}.get(track.state, "MOVING")
                more = {"movement_state": f"MOVEMENT_STATE_{state}", "candidate": candidates}
                lists["moving_object"].append({**header, **bases, **more})
            elif name == "traffic light":
                lists["traffic_light"].append({**header, **bases})
            else:
                lists["traffic_sign"].append({**header, "main_sign": bases})
        available = {"cycle_counter": result.index, "data_qualifier": "DATA_QUALIFIER_AVAILABLE"}
        return {
            "sensor_id": {"value": _SENSOR_ID},
            "last_measurement_time": time,
            **({} if self._info.mounting is None else self._mounted),
            **lists,
            **{f"{name}_header": {"measurement_time": time, **available} for name in lists},
        }

    def _bases(self, track: TrackedObject) -> dict[str, Any]:
        """What is measured of a track and its standard deviations; of lights and signs without
        velocities.
        """
        place = track.cuboid_in_camera
        velocity = track.in_camera
        if track.class_name not in _CLASSES or not np.isfinite(velocity.velocity_mps).all():
            velocity = PointState()
        yaw, yaw_sigma = math.radians(place.yaw_deg), math.radians(track.yaw_sigma_deg)
        angles: Iterable[float] = (yaw, _NAN, _NAN)
        if self._info.mounting is not None and math.isfinite(yaw):  # it is upright on the road
            upright = Rotation.from_euler("z", yaw + math.radians(self._mounting.yaw_deg))
            angles = (self._sensor_from_vehicle * upright).as_euler("ZYX")
        vectors = np.array([place.centre_m, velocity.velocity_mps])
        centre_m, velocity_mps = vectors[:, _ORDER] * _SIGNS
        covariances = np.array([place.covariance_m2, velocity.velocity_covariance_m2ps2])
        sigma_m, sigma_mps = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))[:, _ORDER]
        rmse = (*track.size_sigma_m, *sigma_m, yaw_sigma, _NAN, _NAN, *sigma_mps)
        base = _base((*track.size_m, *centre_m, *angles, *velocity_mps))
        return {"base": base, "base_rmse": _base(rmse)}

    def _lane_boundaries(self, result: FrameResult) -> list[dict[str, Any]]:
        """The lines of the ego lane on the road, by the height of the camera and the horizon where
        both lines meet; without points whose distance is too uncertain.
        """
        camera, height_m, lanes = self._info.camera, self._mounting.z_m, result.lanes
        horizon, boundaries = lanes.horizon_px(), list[dict[str, Any]]()
        if height_m is None or horizon is None:
            return boundaries
        horizon_px, sigma_px = horizon
        for line_id, line in zip(_LINE_IDS, filter(None, (lanes.left, lanes.right)), strict=True):
            y_px = np.linspace(line.y_bottom_px, line.y_top_px, _N_LINE_POINTS)
            y_px = y_px[(y_px - horizon_px) * _MAX_LINE_SIGMA > sigma_px]
            rays = camera.rays(np.column_stack([line.x_px(y_px), y_px]))[:, _ORDER] * _SIGNS
            below_px = (y_px - horizon_px)[:, None]
            points = camera.fy_px * height_m / below_px * rays
            sigmas = np.abs(points) * sigma_px / below_px
            sigmas[:, 1] = np.hypot(sigmas[:, 1], line.sigma_px(y_px) / camera.fx_px * points[:, 0])
            place, rmse = ([_base([*_NAN3, *row]) for row in rows] for rows in (points, sigmas))
            boundaries.append(
                {
                    "header": {"tracking_id": {"value": line_id}},
                    "boundary_line": place,
                    "boundary_line_rmse": rmse,
                }
            )
        return [boundary for boundary in boundaries if boundary["boundary_line"]]

    def _in_map(self, result: FrameResult) -> dict[str, dict[str, Any]]:
        """The ego vehicle with standard deviations, and with the road users of a frame. The road is a
        plane, on which objects whose height above it is not known stand.
        """
        host, rmse = self._host(result)
        to_reference = {"x": -self._centre_m, "y": 0.0, "z": -EGO_SIZE_M[2] / 2}
        attributes = {} if self._info.mounting is None else {"bbcenter_to_rear": to_reference}
        identity = {"value": HOST_ID}
        objects: list[dict[str, Any]] = [
            {"id": identity, "base": host, **_CLASSES["car"], "vehicle_attributes": attributes}
        ]
        places = result.cuboids.in_world(result.ego_pose, self._info.mounting)
        velocities = result.motion.speed_mps * np.exp(1j * np.radians(result.motion.heading_deg))
        for track, centre_m, yaw_deg, velocity in zip(
            result.objects, places.centre_m, places.yaw_deg, velocities, strict=True
        ):
            z_m = track.size_m[2] / 2 if math.isnan(centre_m[2]) else centre_m[2]
            pose = (*track.size_m, *centre_m[:2], z_m, math.radians(yaw_deg), 0.0, 0.0)
            if track.class_name in _CLASSES and np.isfinite(pose).all():
                base = _base((*pose, velocity.real, velocity.imag, 0.0 * velocity.real))
                kind = _CLASSES[track.class_name]
                if track.class_name != "person":  # OSI wants it, even if nothing in it is known
                    kind = {**kind, "vehicle_attributes": {}}
                objects.append({"id": {"value": track.id}, "base": base, **kind})
        return {
            "HostVehicleData": {
                "host_vehicle_id": identity,
                "location": host,
                "location_rmse": rmse,
                "vehicle_localization": {name: host[name] for name in ("position", "orientation")},
            },
            "GroundTruth": {"host_vehicle_id": identity, "moving_object": objects},
        }

    def _host(self, result: FrameResult) -> tuple[dict[str, Any], dict[str, Any]]:
        """The base of the ego vehicle in `map`, and its standard deviations."""
        pose, ego = result.ego_pose, result.ego
        vehicle, _ = transforms(pose, self._info.mounting)
        yaw = pose.heading_rad - math.radians(self._mounting.yaw_deg)
        # points and velocities of the plane as complex numbers; 1j is a quarter turn to the left
        axis = cmath.exp(1j * pose.heading_rad)
        centre_m = complex(*vehicle.at_m[:2]) + self._centre_m * cmath.exp(1j * yaw)
        of_turn_mps = -1j * np.nan_to_num(ego.yaw_rad_s) * (centre_m - complex(pose.x_m, pose.y_m))
        velocity_mps = axis * complex(ego.speed_mps, -ego.right_mps) + of_turn_mps
        place = (centre_m.real, centre_m.imag, EGO_SIZE_M[2] / 2, math.remainder(yaw, math.tau))
        velocity = (velocity_mps.real, velocity_mps.imag, 0.0 * velocity_mps.real)
        x_sigma_m, y_sigma_m, yaw_sigma = pose.sigmas
        along, right = axis * ego.speed_sigma_mps, axis * ego.right_sigma_mps
        speeds = (math.hypot(along.real, right.imag), math.hypot(along.imag, right.real))
        rmse = (*_NAN3, x_sigma_m, y_sigma_m, _NAN, yaw_sigma, _NAN, _NAN, *speeds)
        return _base((*EGO_SIZE_M, *place, 0.0, 0.0, *velocity, -ego.yaw_rad_s)), _base(rmse)


def _base(values: Iterable[float]) -> dict[str, dict[str, float]]:
    """BaseMoving, or a message with fields of it, of what is known of the first values."""
    parts: dict[str, dict[str, float]] = {}
    for (part, name), value in zip(_PLACES, values, strict=False):
        if math.isfinite(value):
            parts.setdefault(part, {})[name] = float(value)
    return parts


def _header(track: TrackedObject) -> dict[str, Any]:
    """Identity, confidence and age of a track."""
    observed = "MEASURED" if track.is_observed else "PREDICTED"
    return {
        "tracking_id": {"value": track.id},
        "sensor_id": [{"value": _SENSOR_ID}],
        "existence_probability": track.score if 0.0 <= track.score <= 1.0 else None,
        "age": track.age_s if math.isfinite(track.age_s) else None,
        "measurement_state": f"MEASUREMENT_STATE_{observed}",
    }
