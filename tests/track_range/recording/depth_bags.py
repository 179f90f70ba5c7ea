"""Bags with images and depth, as the recorders of RealSense, OAK and ZED cameras write them."""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tests.track_range.recording.bag_writers import START_NS, STEP_NS, K, R, projection


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageTopic:
    """Images of a topic, and the calibration beside it."""

    name: str
    encoding: str  # of sensor_msgs/Image, or the format of a compressed image
    images: Sequence[np.ndarray | bytes]
    frame_id: str = "camera"
    info: str = ""  # topic of its calibration; "" = none
    k: Sequence[float] = tuple(K)
    offset_m: float = 0.0  # of the camera, in its projection matrix
    delay_ns: int = 0  # of its time stamps
    first: int = 0  # number of the first frame with an image
    info_fields: Mapping[str, Any] = field(default_factory=dict)


def png(counts: np.ndarray) -> bytes:
    return bytes(cv2.imencode(".png", counts)[1])


def compressed_depth(counts: np.ndarray, a: float = 0.0, b: float = 0.0) -> bytes:
    return struct.pack("<iff", 0, a, b) + png(counts)


def write_bag(
    path: Path, topics: Sequence[ImageTopic], *, is_ros1: bool = False, unit: float = 0.0
) -> Path:
    """A ROS 1 bag, or a ROS 2 bag in MCAP's format; `unit` = RealSense's option of metres per count."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin, Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    writer: Any = (
        Writer1(path) if is_ros1 else Writer2(path, version=9, storage_plugin=StoragePlugin.MCAP)
    )
    serialize = store.serialize_ros1 if is_ros1 else store.serialize_cdr
    messages = [one for topic in topics for one in _messages(store, topic, is_ros1=is_ros1)]
    if unit:
        name = "/device_0/sensor_0/option/Depth_Units/value"
        kind = "std_msgs/msg/Float32"
        messages.append((START_NS, name, kind, store.types[kind](unit)))
    with writer:
        connections: dict[str, Any] = {}
        for time_ns, name, kind, message in sorted(messages, key=lambda one: one[0]):
            if name not in connections:
                connections[name] = writer.add_connection(name, kind, typestore=store)
            writer.write(connections[name], time_ns, bytes(serialize(message, kind)))
    return path


def _messages(store: Any, topic: ImageTopic, *, is_ros1: bool) -> list[tuple[int, str, str, Any]]:
    types, messages = store.types, []
    for number, image in enumerate(topic.images, topic.first):
        stamp_ns = START_NS + number * STEP_NS + topic.delay_ns
        time = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
        header = types["std_msgs/msg/Header"](*([number] if is_ros1 else []), time, topic.frame_id)
        if isinstance(image, bytes):
            kind = "sensor_msgs/msg/CompressedImage"
            message = types[kind](header, topic.encoding, np.frombuffer(image, np.uint8))
        else:
            kind = "sensor_msgs/msg/Image"
            rows = np.ascontiguousarray(image).reshape(image.shape[0], -1).view(np.uint8)
            message = types[kind](
                header, *image.shape[:2], topic.encoding, 0, rows.shape[1], rows.ravel()
            )
        messages.append((stamp_ns + 20_000_000, topic.name, kind, message))
        if topic.info:
            matrices = ([0.0] * 5, topic.k, R, projection(list(topic.k), topic.offset_m))
            region = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
            info = types["sensor_msgs/msg/CameraInfo"](
                header, 48, 64, "plumb_bob", *map(np.array, matrices), 0, 0, region
            )
            for name, value in topic.info_fields.items():
                object.__setattr__(info, name, value)
            messages.append((stamp_ns + 20_000_000, topic.info, "sensor_msgs/msg/CameraInfo", info))
    return messages
