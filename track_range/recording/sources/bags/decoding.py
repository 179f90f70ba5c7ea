"""Decoding of the messages of a bag: images and camera calibrations of ROS and of Foxglove."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any, cast

import av
import cv2
import numpy as np
from av.video.codeccontext import VideoCodecContext

from track_range.foundation.arrays import Image
from track_range.foundation.files.images import MAX_PIXELS, decode_image
from track_range.foundation.files.input_files import quoted
from track_range.recording.sources.bags.container import (
    DAMAGE,
    ZSTD_MAGIC,
    DamagedError,
    Topic,
    decompressed,
    library,
)
from track_range.recording.video.frame import FrameError, bgr_image, stated_pixel_aspect
from track_range.recording.video.pixel_formats import decoded_image
from track_range.stereo.rig_formats.camera_info import CameraInfo

COMPRESSED_TYPES = (
    "sensor_msgs/msg/CompressedImage",
    "foxglove.CompressedImage",
    "foxglove_msgs/msg/CompressedImage",
)
RAW_TYPES = ("sensor_msgs/msg/Image", "foxglove.RawImage", "foxglove_msgs/msg/RawImage")
VIDEO_TYPES = ("foxglove.CompressedVideo", "foxglove_msgs/msg/CompressedVideo")
IMAGE_TYPES = (*COMPRESSED_TYPES, *RAW_TYPES, *VIDEO_TYPES)
CALIBRATION_TYPES = (
    "sensor_msgs/msg/CameraInfo",
    "foxglove.CameraCalibration",
    "foxglove_msgs/msg/CameraCalibration",
)
"""Types of messages that are read."""

_DEPTH = ("16UC1", "32FC1", "compressedDepth")  # in the encodings of depth images (REP 118)
_VIDEO_CODECS = {"h264": "h264", "h265": "hevc"}


def is_readable(topic: Topic) -> bool:
    """Whether messages with this encoding can be read; JSON cannot be read."""
    return topic.encoding in ("cdr", "ros1", "protobuf")


class ImageDecoder:
    """Decodes the image messages of one topic, of one of `IMAGE_TYPES`, in order."""

    def __init__(self, topic: Topic) -> None:
        self.is_video = topic.type in VIDEO_TYPES
        self._topic = topic
        self._parsed = message_reader(topic)
        self._codec: VideoCodecContext | None = None

    @property
    def pixel_aspect(self) -> float | None:
        """Width / height of the pixels as a video states it, once an image was decoded; None = not
        stated.
        """
        return None if self._codec is None else stated_pixel_aspect(self._codec.sample_aspect_ratio)

    def message(self, data: bytes) -> tuple[float, Any]:
        """Seconds since 1970, see `stamp_s`, and content of a message; raises DamagedError if it
        cannot be read.
        """
        try:
            message = self._parsed(data)
            return stamp_s(message), message
        except Exception as error:  # protobuf's and rosbags' errors derive from Exception
            raise DamagedError(f"no {self._topic.type}") from error

    def image(self, message: Any) -> Image | None:
        """(H, W, 3) uint8 BGR; None = a video frame without image. Raises DamagedError if
        unreadable.
        """
        try:
            name = str(message.encoding if self._topic.type in RAW_TYPES else message.format)
            if any(part in name for part in _DEPTH):
                raise DamagedError(f"depth images ({quoted(name, 30)})")
            if self._topic.type in RAW_TYPES:
                return _raw_image(message)
            content = bytes(message.data)
            if not self.is_video:
                return _compressed_image(content)
            if self._codec is None:
                codec = _VIDEO_CODECS.get(name.lower())
                if codec is None:
                    raise DamagedError(f"video format {quoted(name)}, expected h264 or h265")
                self._codec = cast(VideoCodecContext, av.CodecContext.create(codec, "r"))
                self._codec.options = {"max_pixels": str(MAX_PIXELS), "flags": "low_delay"}
                self._codec.thread_count = 1
            frames = self._codec.decode(av.Packet(content))
            return bgr_image(frames[-1]) if frames else None
        except FrameError as error:
            raise DamagedError(str(error).rstrip(".")) from error
        except (*DAMAGE, cv2.error, av.FFmpegError) as error:
            raise DamagedError(str(error)[:80]) from error


@cache
def message_reader(topic: Topic) -> Callable[[bytes], Any]:
    """Function that parses the messages of a topic; raises VideoError if a library is missing."""
    name, encoding = topic.type, topic.encoding
    if encoding == "protobuf":
        descriptor_pb2, descriptor_pool, message_factory = (
            library(f"google.protobuf.{part}")
            for part in ("descriptor_pb2", "descriptor_pool", "message_factory")
        )
        pool = descriptor_pool.DescriptorPool()
        try:
            for file in descriptor_pb2.FileDescriptorSet.FromString(topic.definition).file:
                pool.Add(file)
            message: Any = message_factory.GetMessageClass(pool.FindMessageTypeByName(name))
        except Exception as error:  # protobuf raises its own errors, TypeError and KeyError
            raise DamagedError(f"schema of {name}") from error
        return cast(Callable[[bytes], Any], message.FromString)
    typesys = library("rosbags.typesys")
    stores = typesys.Stores
    store = typesys.get_typestore(stores.ROS1_NOETIC if encoding == "ros1" else stores.ROS2_HUMBLE)
    if name not in store.types:
        try:
            store.register(typesys.get_types_from_msg(topic.definition.decode(), name))
        except Exception as error:  # the errors of the parser derive from Exception
            raise DamagedError(f"schema of {name}") from error
    if encoding == "ros1":
        return lambda data: store.deserialize_ros1(data, name)
    return lambda data: store.deserialize_cdr(_uncompressed(data), name)


def _uncompressed(data: bytes) -> bytes:
    """A CDR message, which rosbag2 may have compressed (compression mode MESSAGE); CDR starts with
    a zero byte.
    """
    if not data.startswith(ZSTD_MAGIC):
        return data
    n_bytes = library("zstandard").frame_content_size(data)
    if n_bytes < 0:
        raise DamagedError("compressed message of unknown size")
    return decompressed(data, "zstd", n_bytes)


def stamp_s(message: Any) -> float:
    """Time stamp of a message of ROS (header.stamp) or Foxglove (timestamp) in s; 0 = none, NaN =
    with 1e9 or more nanoseconds, as of drivers that count all nanoseconds in 32 bits.
    """
    header = getattr(message, "header", None)
    stamp = message.timestamp if header is None else header.stamp
    seconds = stamp.sec if hasattr(stamp, "sec") else stamp.seconds
    nanoseconds = next(
        getattr(stamp, name) for name in ("nanosec", "nanos", "nsec") if hasattr(stamp, name)
    )
    return float(seconds) + float(nanoseconds) / 1e9 if nanoseconds < 1e9 else math.nan


def _compressed_image(content: bytes) -> Image:
    image = decode_image(
        content, "message", DamagedError, flags=cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH
    )
    if image.dtype not in (np.uint8, np.uint16):
        raise DamagedError(f"pixels of type {image.dtype}")
    return (image >> 8 if image.dtype == np.uint16 else image).astype(np.uint8, copy=False)


def _raw_image(message: Any) -> Image:
    return decoded_image(
        message.data,
        str(message.encoding),
        int(message.width),
        int(message.height),
        step=int(message.step),
        is_bigendian=bool(getattr(message, "is_bigendian", False)),
    )


def camera_message(topic: Topic, data: bytes) -> CameraInfo:
    """The calibration in a message of one of `CALIBRATION_TYPES`; raises DamagedError if it cannot
    be read.
    """
    try:
        message = message_reader(topic)(data)
        d, k, r, p = (
            np.array(getattr(message, name, getattr(message, name.upper(), ())), float)
            for name in "dkrp"
        )
        k, p = k.reshape(3, 3), (p if p.size else np.zeros(12)).reshape(3, 4)
        if not k.any():  # of rectified images, which P alone describes
            k, d, r = p[:, :3], np.empty(0), np.eye(3)
        roi = getattr(message, "roi", None)
        region = [getattr(roi, name, 0) for name in ("x_offset", "y_offset", "width", "height")]
        return CameraInfo(
            (int(message.width), int(message.height)),
            str(message.distortion_model),
            tuple(d.tolist()),
            k,
            (r if r.any() else np.eye(3)).reshape(3, 3),
            p if p.any() else np.insert(k, 3, 0.0, axis=1),
            (int(region[0]), int(region[1]), int(region[2]), int(region[3])),
            (int(getattr(message, "binning_x", 1)), int(getattr(message, "binning_y", 1))),
        )
    except Exception as error:  # the errors of the parsers derive from Exception
        raise DamagedError(f"no {topic.type}") from error
