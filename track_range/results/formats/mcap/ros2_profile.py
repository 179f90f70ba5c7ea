"""Ros2Profile: CDR messages of ROS 2 (Humble and later), encoded with rosbags.

/camera/camera_info sensor_msgs/CameraInfo, /camera/image/compressed sensor_msgs/CompressedImage,
/camera/detections vision_msgs/Detection2DArray, /tracks/detections vision_msgs/Detection3DArray,
/tracks/objects autoware_perception_msgs/TrackedObjects,
/tracks/ranges diagnostic_msgs/DiagnosticArray (for plots), /tf tf2_msgs/TFMessage, /rosout
rcl_interfaces/Log
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any
from uuid import NAMESPACE_OID, uuid5

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from track_range.foundation.arrays import FloatArray
from track_range.ranging.world.ego_path import EgoPose
from track_range.results.formats import scene
from track_range.results.formats.mcap import (
    DETECTIONS_2D,
    DETECTIONS_3D,
    NANOSECONDS,
    RANGES,
    TRACKED_OBJECTS,
    TRANSFORMS,
    Message,
    calibration_matrices,
)
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.mounting import Mounting

CALIBRATION, IMAGE, LOG = "/camera/camera_info", "/camera/image/compressed", "/rosout"
"""Topics where image_transport, RViz and other nodes of ROS expect them."""

_DETECTION = (
    "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\nvision_msgs/{} "
    "bbox\nstring id"
)

VISION_MESSAGES = {  # of vision_msgs 4 (ROS 2 Humble and later), which rosbags does not contain
    "Point2D": "float64 x\nfloat64 y",
    "Pose2D": "vision_msgs/Point2D position\nfloat64 theta",
    "BoundingBox2D": "vision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y",
    "BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "ObjectHypothesis": "string class_id\nfloat64 score",
    "ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis "
    "hypothesis\ngeometry_msgs/PoseWithCovariance pose",
    "Detection2D": _DETECTION.format("BoundingBox2D"),
    "Detection3D": _DETECTION.format("BoundingBox3D"),
    "Detection2DArray": "std_msgs/Header header\nvision_msgs/Detection2D[] detections",
    "Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
}

AUTOWARE_MESSAGES = {  # of autoware_perception_msgs, which rosbags does not contain
    "ObjectClassification": "uint8 label\nfloat32 probability",
    "Shape": "uint8 type\ngeometry_msgs/Polygon footprint\ngeometry_msgs/Vector3 dimensions",
    "TrackedObjectKinematics": "geometry_msgs/PoseWithCovariance pose_with_covariance\n"
    "geometry_msgs/TwistWithCovariance twist_with_covariance\n"
    "geometry_msgs/AccelWithCovariance acceleration_with_covariance\n"
    "uint8 orientation_availability\nbool is_stationary",
    "TrackedObject": "unique_identifier_msgs/UUID object_id\nfloat32 existence_probability\n"
    "autoware_perception_msgs/ObjectClassification[] classification\n"
    "autoware_perception_msgs/TrackedObjectKinematics kinematics\n"
    "autoware_perception_msgs/Shape shape",
    "TrackedObjects": "std_msgs/Header header\nautoware_perception_msgs/TrackedObject[] objects",
}
# numbers of classes in ObjectClassification; others are not written
_AUTOWARE_LABELS = {"car": 1, "truck": 2, "bus": 3, "motorcycle": 5, "bicycle": 6, "person": 7}
# orientation_availability by whether the front is known
_SIGN_UNKNOWN, _AVAILABLE = 1, 2
_BOUNDING_BOX = 0  # type of a Shape
_AUTOWARE = "autoware_perception_msgs/msg"

_TYPES = {
    CALIBRATION: "sensor_msgs/msg/CameraInfo",
    IMAGE: "sensor_msgs/msg/CompressedImage",
    DETECTIONS_2D: "vision_msgs/msg/Detection2DArray",
    DETECTIONS_3D: "vision_msgs/msg/Detection3DArray",
    TRACKED_OBJECTS: "autoware_perception_msgs/msg/TrackedObjects",
    RANGES: "diagnostic_msgs/msg/DiagnosticArray",
    TRANSFORMS: "tf2_msgs/msg/TFMessage",
    LOG: "rcl_interfaces/msg/Log",
}

_INFO = 20  # level of information in rcl_interfaces/Log
_UNKNOWN_VARIANCE = -1.0  # of a position, as ROS drivers mark it
_UNKNOWN_VARIANCES = [1e6] * 3  # of a rotation or a speed that is not measured
_UPRIGHT_RAD2 = 0.03**2  # variance of roll and pitch of an upright cuboid: slopes of 3 %
# variance of a yaw that may as well be turned by 180 degrees
_ANY_FRONT_RAD2 = math.pi**2 / 2


class Ros2Profile:
    """Messages for ROS 2."""

    name = "ros2"

    def __init__(self, camera: PinholeCamera, mounting: Mounting | None = None) -> None:
        self._camera, self._mounting = camera, mounting
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        for name, text in VISION_MESSAGES.items():
            self._store.register(get_types_from_msg(text, f"vision_msgs/msg/{name}"))
        for name, text in AUTOWARE_MESSAGES.items():
            self._store.register(get_types_from_msg(text, f"{_AUTOWARE}/{name}"))

    def schema(self, topic: str) -> tuple[str, str, bytes, str]:
        """Name, encoding and text of the schema of a topic, and the encoding of its messages."""
        text, _ = self._store.generate_msgdef(_TYPES[topic], ros_version=2)
        return _TYPES[topic], "ros2msg", text.encode(), "cdr"

    def frame(
        self, objects: Sequence[scene.TrackObject], time_ns: int, pose: EgoPose | None = None
    ) -> Iterator[Message]:
        """Messages of a frame, without its image."""
        header = self._header(time_ns)
        yield self._message(CALIBRATION, header=header, **self._calibration())
        parts = scene.transforms(pose, self._mounting)
        transforms = [self._transform(time_ns, *part) for part in parts]
        yield self._message(TRANSFORMS, transforms=transforms)
        in_image = [self._detection_2d(shown, header) for shown in objects]
        yield self._message(DETECTIONS_2D, header=header, detections=in_image)
        in_space = [self._detection_3d(shown, header) for shown in objects if shown.has_cuboid]
        yield self._message(DETECTIONS_3D, header=header, detections=in_space)
        in_vehicle = self._header(time_ns, scene.VEHICLE_FRAME)
        road_users = [o for o in objects if o.has_cuboid and o.class_name in _AUTOWARE_LABELS]
        tracked = [self._tracked(shown, parts[1]) for shown in road_users]
        yield self._message(TRACKED_OBJECTS, header=in_vehicle, objects=tracked)
        yield self._message(
            RANGES, header=header, status=[self._status(shown) for shown in objects]
        )

    def image(self, jpeg: bytes, time_ns: int) -> Message:
        """Message of an image."""
        return self._message(
            IMAGE, header=self._header(time_ns), format="jpeg", data=np.frombuffer(jpeg, np.uint8)
        )

    def note(self, text: str, time_ns: int) -> Message:
        """Message of a note of the run."""
        values = {
            "level": _INFO,
            "name": "track_range",
            "msg": text,
            "file": "",
            "function": "",
            "line": 0,
        }
        return self._message(LOG, stamp=self._stamp(time_ns), **values)

    def _new(self, message_type: str, **values: Any) -> Any:
        return self._store.types[message_type](**values)

    def _message(self, topic: str, **values: Any) -> Message:
        message = self._new(_TYPES[topic], **values)
        return topic, bytes(self._store.serialize_cdr(message, _TYPES[topic]))

    def _stamp(self, time_ns: int) -> Any:
        sec, nanosec = divmod(time_ns, NANOSECONDS)
        return self._new("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)

    def _header(self, time_ns: int, frame_id: str = scene.CAMERA_FRAME) -> Any:
        return self._new("std_msgs/msg/Header", stamp=self._stamp(time_ns), frame_id=frame_id)

    def _vector(self, kind: str, x: float, y: float, z: float) -> Any:
        return self._new(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)

    def _rotation(self, x: float = 0.0, y: float = 0.0, z: float = 0.0, w: float = 1.0) -> Any:
        return self._new("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def _pose(self, at_m: Iterable[float], xyzw: Iterable[float]) -> Any:
        return self._new(
            "geometry_msgs/msg/Pose",
            position=self._vector("Point", *at_m),
            orientation=self._rotation(*xyzw),
        )

    def _calibration(self) -> dict[str, Any]:
        k, r, p = (np.array(matrix) for matrix in calibration_matrices(self._camera))
        region = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
        return {
            "height": self._camera.height_px,
            "width": self._camera.width_px,
            "distortion_model": "plumb_bob",
            "d": np.zeros(5),
            "k": k,
            "r": r,
            "p": p,
            "binning_x": 0,
            "binning_y": 0,
            "roi": self._new("sensor_msgs/msg/RegionOfInterest", **region),
        }

    def _transform(
        self,
        time_ns: int,
        parent: str,
        child: str,
        at_m: tuple[float, float, float],
        xyzw: tuple[float, float, float, float],
    ) -> Any:
        transform = self._new(
            "geometry_msgs/msg/Transform",
            translation=self._vector("Vector3", *at_m),
            rotation=self._rotation(*xyzw),
        )
        return self._new(
            "geometry_msgs/msg/TransformStamped",
            header=self._header(time_ns, parent),
            child_frame_id=child,
            transform=transform,
        )

    def _detection_2d(self, shown: scene.TrackObject, header: Any) -> Any:
        x1, y1, x2, y2 = shown.xyxy_px
        position = self._new("vision_msgs/msg/Point2D", x=(x1 + x2) / 2, y=(y1 + y2) / 2)
        centre = self._new("vision_msgs/msg/Pose2D", position=position, theta=0.0)
        box = self._new(
            "vision_msgs/msg/BoundingBox2D", center=centre, size_x=x2 - x1, size_y=y2 - y1
        )
        return self._detection("Detection2D", shown, header, box)

    def _detection_3d(self, shown: scene.TrackObject, header: Any) -> Any:
        size = self._vector("Vector3", *shown.lwh_m)
        centre = self._pose(shown.centre_m, shown.xyzw)
        box = self._new("vision_msgs/msg/BoundingBox3D", center=centre, size=size)
        return self._detection("Detection3D", shown, header, box)

    def _detection(self, kind: str, shown: scene.TrackObject, header: Any, box: Any) -> Any:
        """Box with its class and score, and the pose of the cuboid."""
        result = self._new(
            "vision_msgs/msg/ObjectHypothesisWithPose",
            hypothesis=self._new(
                "vision_msgs/msg/ObjectHypothesis", class_id=shown.class_name, score=shown.score
            ),
            pose=self._pose_of(shown),
        )
        return self._new(
            f"vision_msgs/msg/{kind}",
            header=header,
            results=[result],
            bbox=box,
            id=str(shown.track_id),
        )

    def _tracked(self, shown: scene.TrackObject, vehicle: scene.Transform) -> Any:
        """Autoware's message of a track, in the axes of the `vehicle`, of which it is given where
        the camera is; its twist is in its own axes.
        """
        turn = Rotation.from_quat(vehicle.xyzw)
        at_m = turn.apply(shown.centre_m) + vehicle.at_m
        xyzw = (turn * Rotation.from_quat(shown.xyzw)).as_quat()
        R = turn.as_matrix()
        rotation_rad2 = [_UPRIGHT_RAD2, _UPRIGHT_RAD2, shown.yaw_sigma_rad**2]
        covariance = np.diag([_UNKNOWN_VARIANCE] * 3 + rotation_rad2)
        covariance[:3, :3] = R @ shown.covariance_m2 @ R.T
        unknown, zero = np.diag(_UNKNOWN_VARIANCES * 2), self._vector("Vector3", 0.0, 0.0, 0.0)
        accel = self._new("geometry_msgs/msg/Accel", linear=zero, angular=zero)
        rates, speed_mps = unknown.copy(), 0.0
        if "speed_mps" in shown.figures:
            speed_mps = shown.figures["speed_mps"]
            rates[0, 0] = shown.figure("speed_sigma_mps") ** 2
        linear = self._vector("Vector3", speed_mps, 0.0, 0.0)
        twist = self._new("geometry_msgs/msg/Twist", linear=linear, angular=zero)
        kinematics = self._new(
            f"{_AUTOWARE}/TrackedObjectKinematics",
            pose_with_covariance=self._with_covariance(
                "Pose", self._pose(at_m.tolist(), xyzw.tolist()), covariance
            ),
            twist_with_covariance=self._with_covariance("Twist", twist, rates),
            acceleration_with_covariance=self._with_covariance("Accel", accel, unknown),
            orientation_availability=_AVAILABLE if shown.front_known else _SIGN_UNKNOWN,
            is_stationary=shown.is_parked,
        )
        classification = self._new(
            f"{_AUTOWARE}/ObjectClassification",
            label=_AUTOWARE_LABELS[shown.class_name],
            probability=shown.score,
        )
        shape = self._new(
            f"{_AUTOWARE}/Shape",
            type=_BOUNDING_BOX,
            footprint=self._new("geometry_msgs/msg/Polygon", points=[]),
            dimensions=self._vector("Vector3", *shown.lwh_m),
        )
        name = uuid5(NAMESPACE_OID, f"track-range track {shown.track_id}")
        return self._new(
            f"{_AUTOWARE}/TrackedObject",
            object_id=self._new(
                "unique_identifier_msgs/msg/UUID", uuid=np.array([*name.bytes], np.uint8)
            ),
            existence_probability=shown.score,
            classification=[classification],
            kinematics=kinematics,
            shape=shape,
        )

    def _pose_of(self, shown: scene.TrackObject) -> Any:
        """Pose of the cuboid in the axes of the camera; at the origin, with large variances, if it
        is unknown.
        """
        pose = self._pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        covariance = np.diag([_UNKNOWN_VARIANCE] * 3 + _UNKNOWN_VARIANCES)
        if shown.has_cuboid:
            pose = self._pose(shown.centre_m, shown.xyzw)
            yaw_rad2 = shown.yaw_sigma_rad**2 + (0.0 if shown.front_known else _ANY_FRONT_RAD2)
            covariance[range(3, 6), range(3, 6)] = _UPRIGHT_RAD2, yaw_rad2, _UPRIGHT_RAD2
        if np.isfinite(shown.covariance_m2).all():
            covariance[:3, :3] = shown.covariance_m2
        return self._with_covariance("Pose", pose, covariance)

    def _with_covariance(self, kind: str, value: Any, covariance: FloatArray) -> Any:
        values = {kind.lower(): value, "covariance": covariance.ravel()}
        return self._new(f"geometry_msgs/msg/{kind}WithCovariance", **values)

    def _status(self, shown: scene.TrackObject) -> Any:
        """Figures of a track as text, which PlotJuggler converts to curves."""
        figures = {"observed": float(shown.is_observed), **shown.figures}
        values = [
            self._new("diagnostic_msgs/msg/KeyValue", key=name, value=f"{value:.6g}")
            for name, value in figures.items()
        ]
        return self._new(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=0,
            name=f"track {shown.track_id}",
            message=shown.class_name,
            hardware_id="",
            values=values,
        )
