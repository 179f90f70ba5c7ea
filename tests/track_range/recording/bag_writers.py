"""Bags with images of one or two cameras, written with the libraries mcap and rosbags, and with
Foxglove's schemas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

START_NS = 1_769_869_530_000_000_000
"""Time of the first image, 2026-01-31 14:25:30 UTC."""

STEP_NS = 100_000_000
K = [70.0, 0.0, 31.5, 0.0, 70.0, 23.5, 0.0, 0.0, 1.0]
R = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]


def projection(k: list[float], offset_m: float) -> list[float]:
    return [*k[:3], k[0] * offset_m, *k[3:6], 0.0, *k[6:], 0.0]


def jpeg(image: np.ndarray) -> bytes:
    return bytes(cv2.imencode(".png", image)[1])


Images = Sequence[np.ndarray | tuple[np.ndarray, ...]]
"""Images that all cameras show, or one image of each camera."""


def cameras(names: Sequence[str]) -> list[tuple[str, float]]:
    """Topic prefix and offset of each camera."""
    return [(name, -0.5 * number) for number, name in enumerate(names)]


def ros_messages(
    store: Any,
    names: Sequence[str],
    images: Images,
    *,
    topic: str,
    encoding: str = "",
    info: str = "camera_info",
    k: list[float] = K,
    times: Sequence[tuple[tuple[int, int], int]] = (),
    info_fields: Mapping[str, Any] = {},
    roi: Sequence[int] = (0, 0, 0, 0),
) -> list[tuple[int, str, str, Any]]:
    """(time, topic, type, message) of images and calibrations; raw images if `encoding` is given.

    `times` replace the stamps (seconds, nanoseconds) and recording times, ns; `info_fields` those
    of the calibrations, whose region of interest is `roi` (x, y, height, width)."""
    types, ros1 = (
        store.types,
        "std_msgs/msg/Header" in store.types
        and "seq" in store.types["std_msgs/msg/Header"].__dataclass_fields__,
    )
    messages = []
    for number, shown in enumerate(images):
        stamp_ns = START_NS + number * STEP_NS
        stamp, recorded_ns = divmod(stamp_ns, 10**9), stamp_ns + 20_000_000
        if times:
            stamp, recorded_ns = times[number]
        time = types["builtin_interfaces/msg/Time"](*stamp)
        header = types["std_msgs/msg/Header"](*([number] if ros1 else []), time, "camera")
        for side, (name, offset_m) in enumerate(cameras(names)):
            image = shown if isinstance(shown, np.ndarray) else shown[side]
            if encoding:
                kind = "sensor_msgs/msg/Image"
                rows = np.ascontiguousarray(image).reshape(image.shape[0], -1).view(np.uint8)
                message = types[kind](
                    header, *image.shape[:2], encoding, 0, rows.shape[1], rows.ravel()
                )
            else:
                kind = "sensor_msgs/msg/CompressedImage"
                message = types[kind](header, "png", np.frombuffer(jpeg(image), np.uint8))
            messages.append((recorded_ns, f"{name}/{topic}", kind, message))
            region = types["sensor_msgs/msg/RegionOfInterest"](*roi, False)
            matrices = ([0.0] * 5, k, R, projection(k, offset_m))
            calibration = types["sensor_msgs/msg/CameraInfo"](
                header, 48, 64, "plumb_bob", *map(np.array, matrices), 0, 0, region
            )
            calibration = replace(calibration, **info_fields)
            messages.append(
                (recorded_ns, f"{name}/{info}", "sensor_msgs/msg/CameraInfo", calibration)
            )
        text = types["std_msgs/msg/String"]("nothing")
        messages.append((recorded_ns, "/chatter", "std_msgs/msg/String", text))
    return messages


def write_ros2(
    path: Path, names: Sequence[str], images: Images, *, storage: str, **options: Any
) -> Path:
    """A ROS 2 bag folder written with rosbags; `storage` = sqlite3 or mcap."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    plugin = {"sqlite3": StoragePlugin.SQLITE3, "mcap": StoragePlugin.MCAP}[storage]
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections: dict[str, Any] = {}
        for time_ns, topic, kind, message in ros_messages(store, names, images, **options):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], time_ns, bytes(store.serialize_cdr(message, kind)))
    return path


def write_ros1(
    path: Path, names: Sequence[str], images: Images, *, compression: str = "", **options: Any
) -> Path:
    """A ROS 1 bag written with rosbags."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer(path)
    if compression:
        writer.set_compression(Writer.CompressionFormat[compression])
    with writer:
        connections: dict[str, Any] = {}
        for time_ns, topic, kind, message in ros_messages(store, names, images, **options):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], time_ns, bytes(store.serialize_ros1(message, kind)))
    return path


def write_foxglove(
    path: Path,
    names: Sequence[str],
    images: Images,
    *,
    is_raw: bool = False,
    start_ns: int = START_NS,
    **options: Any,
) -> Path:
    """An MCAP file with Foxglove's messages, encoded by foxglove-sdk and written with the library
    mcap."""
    from foxglove.messages import CameraCalibration, CompressedImage, RawImage, Timestamp
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer: Any = Writer(file, **{"chunk_size": 2000, **options})
        writer.start()
        channels: dict[str, int] = {}

        def add(topic: str, message: Any, time_ns: int) -> None:
            if topic not in channels:
                schema = type(message).get_schema()
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[topic] = writer.register_channel(topic, "protobuf", schema_id)
            writer.add_message(channels[topic], time_ns, message.encode(), time_ns)

        for number, shown in enumerate(images):
            time_ns = start_ns + number * STEP_NS
            stamp = Timestamp(time_ns // 10**9, time_ns % 10**9)
            for side, (name, offset_m) in enumerate(cameras(names)):
                image = shown if isinstance(shown, np.ndarray) else shown[side]
                if is_raw:
                    sizes = {
                        "width": image.shape[1],
                        "height": image.shape[0],
                        "step": 3 * image.shape[1],
                    }
                    raw = RawImage(timestamp=stamp, encoding="bgr8", data=image.tobytes(), **sizes)
                    add(f"{name}/image", raw, time_ns)
                else:
                    add(
                        f"{name}/image",
                        CompressedImage(timestamp=stamp, data=jpeg(image), format="png"),
                        time_ns,
                    )
                add(
                    f"{name}/calibration",
                    CameraCalibration(
                        timestamp=stamp, width=64, height=48, K=K, R=R, P=projection(K, offset_m)
                    ),
                    time_ns,
                )
        writer.finish()
    return path


def write_foxglove_video(path: Path, video: Path) -> Path:
    """An MCAP file with the packets of a stream of H.264 at 10 frames/s in Foxglove's messages."""
    import av
    from foxglove.messages import CompressedVideo, Timestamp
    from mcap.writer import Writer

    with av.open(str(video)) as container:
        packets = [bytes(packet) for packet in container.demux(video=0) if packet.size]
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = CompressedVideo.get_schema()
        channel = writer.register_channel(
            "/video", "protobuf", writer.register_schema(schema.name, schema.encoding, schema.data)
        )
        for number, packet in enumerate(packets):
            time_ns = number * STEP_NS
            stamp = Timestamp(100, time_ns)
            message = CompressedVideo(timestamp=stamp, data=packet, format="h264")
            writer.add_message(channel, time_ns, message.encode(), time_ns)
        writer.finish()
    return path
