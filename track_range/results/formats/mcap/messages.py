"""Messages of an MCAP file, and the protocol of the profiles that make them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from track_range.foundation.arrays import Image
from track_range.results.formats.scene import TrackObject
from track_range.stereo.geometry.camera import PinholeCamera

CALIBRATION, IMAGE, ANNOTATIONS, DETECTIONS_2D = (
    "/camera/calibration",
    "/camera/image",
    "/camera/annotations",
    "/camera/detections",
)
SCENE, DETECTIONS_3D, RANGES = "/tracks/scene", "/tracks/detections", "/tracks/ranges"
TRANSFORMS = "/tf"

NANOSECONDS = 1_000_000_000
"""Nanoseconds per second."""

JPEG_QUALITY = 85
"""Quality of images, 0 to 100: about a tenth of a byte per pixel."""


class SchemaText(NamedTuple):
    """Schema of a topic: its name, encoding (protobuf, jsonschema, ros2msg) and text."""

    name: str
    encoding: str
    data: bytes


class Message(NamedTuple):
    """An encoded message."""

    topic: str
    data: bytes


class Profile(Protocol):
    """Message types of a family of readers.

    Attributes:
        name: profile in the header of the file.
    """

    name: str

    def __init__(self, camera: PinholeCamera) -> None: ...

    def schema(self, topic: str) -> SchemaText:
        """Schema of the messages of a topic."""
        ...

    def encoding(self, topic: str) -> str:
        """Encoding of the messages of a topic: protobuf, json or cdr."""
        ...

    def frame(self, objects: Sequence[TrackObject], time_ns: int) -> Iterator[Message]:
        """Messages of a frame, without its image."""
        ...

    def image(self, jpeg: bytes, time_ns: int) -> Message:
        """Message of an image."""
        ...

    def note(self, text: str, time_ns: int) -> Message:
        """Message of a note of the run."""
        ...


def jpeg(image: Image) -> bytes:
    """A (H, W, 3) uint8 BGR image as JPEG."""
    import cv2

    _, content = cv2.imencode(".jpg", np.ascontiguousarray(image), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return content.tobytes()


def calibration_matrices(camera: PinholeCamera) -> tuple[list[float], list[float], list[float]]:
    """K, R and P of a rectified camera, row by row."""
    fx, fy, cx, cy = camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px
    k = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    return k, r, [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
