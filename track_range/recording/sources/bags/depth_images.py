"""DepthImages: the depth that a stereo or depth camera recorded in a bag, beside its images.

16UC1, mono16                 millimetres (REP 118), or RealSense's depth units if a topic states them
32FC1                         metres
...; compressedDepth png      a header of 12 bytes and a PNG of millimetres, or of quantised inverse depth
                              z = a / (count - b) with a and b of the header
                              (image_transport_plugins)

Depth counts only for the camera whose images are read: aligned to its images by the camera, or from
the same view. A topic of another view is refused with what to record.
"""

import itertools
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray32
from track_range.foundation.files.images import MAX_PIXELS
from track_range.recording.sources.bags import decoding
from track_range.recording.sources.bags.bag import open_bag
from track_range.recording.sources.bags.container import DAMAGE, Bag, DamagedError, Topic
from track_range.recording.sources.bags.topics import N_FIRST, is_depth, stated_camera, words
from track_range.stereo.rig_formats.camera_info import CameraInfo

_NO_DEPTH = {"disparity", "confidence"}  # words of topics with other quantities
_ALIGNED = {"aligned", "registered"}
_INFRARED_1 = ("infra1", "infrared1", "infrared_1", "infra_1")  # RealSense measures depth from it
_COUNTS = {"16UC1": 0.001, "mono16": 0.001, "16SC1": 0.001}  # metres per count, by encoding
_HEADER = struct.Struct("<iff")  # format, a and b of compressedDepth
# relative difference of focal length and centre, as fractions of the width, of the same view
_SAME_VIEW = 0.01
_LATE_FRACTION = 0.5  # largest difference of the times of depth and image, in frames
# medians of a first image of metres and of millimetres, in m, which no camera measures
_FAR_M, _NEAR_M = 300.0, 0.05


@dataclass(frozen=True, slots=True)
class _View:
    """What states which camera the images of a topic belong to."""

    frame_id: str  # "" = not stated
    camera: CameraInfo | None

    def differs(self, other: "_View") -> bool:
        """Whether focal length or centre contradict each other."""
        if self.camera is None or other.camera is None:
            return False
        own_view, other_view = (
            np.array([k[0, 0], k[0, 2], k[1, 2]]) / width
            for k, width in (
                (one.camera.k, one.camera.size_px[0]) for one in (self, other) if one.camera
            )
        )
        return bool(np.abs(own_view - other_view).max() > _SAME_VIEW)


class DepthImages:
    """Depth images of one topic, read forward in time."""

    def __init__(self, path: Path, topic: Topic, *, uses_recorded_times: bool, fps: float) -> None:
        """The images of a topic that `find_depth` found, for images at `fps`."""
        self.topic = topic
        self._bag = open_bag(path)  # of its own, since readers hold the state of their file
        self._parsed = decoding.message_reader(topic)
        self._uses_recorded, self._late_s = uses_recorded_times, _LATE_FRACTION / fps
        self._metres_per_count = _depth_unit(self._bag, topic)
        self._waiting: Iterator[tuple[float, Any]] = iter(())
        self._near: list[tuple[float, Any]] = []  # not decoded: those that the next image may have
        self._last_s = np.inf

    def at(self, time_s: float) -> FloatArray32 | None:
        """(h, w) depth in metres of the image at a time, as seconds of the file, NaN = unknown;
        None = there is none within half a frame, or it is damaged.
        """
        if time_s <= self._last_s:  # a new pass
            self._waiting, self._near = self._messages(time_s - 1.0), []
        self._last_s = time_s
        while not self._near or self._near[-1][0] < time_s + self._late_s:
            following = next(self._waiting, None)
            if following is None:
                break
            self._near.append(following)
        self._near = [one for one in self._near if one[0] >= time_s - self._late_s]
        if not self._near:
            return None
        depth_s, message = min(self._near, key=lambda one: abs(one[0] - time_s))
        if abs(depth_s - time_s) > self._late_s:
            return None
        try:
            return self.decoded(message)
        except DamagedError:
            return None

    def decoded(self, message: Any) -> FloatArray32:
        """(h, w) depth in metres of a message; DamagedError if it cannot be read."""
        try:
            if self.topic.type in decoding.RAW_TYPES:
                return self._in_metres(_raw(message))
            return self._in_metres(_compressed(message))
        except (*DAMAGE, cv2.error, struct.error) as error:
            raise DamagedError(str(error)[:80]) from error

    def _in_metres(self, values: np.ndarray[Any, Any]) -> FloatArray32:
        factor = self._metres_per_count if values.dtype.kind in "iu" else 1.0
        depth = np.asarray(values * np.float32(factor), np.float32)
        return np.where((depth > 0) & np.isfinite(depth), depth, np.float32(np.nan))

    def _messages(self, from_s: float) -> Iterator[tuple[float, Any]]:
        for _, recorded_s, data in self._bag.messages(self.topic.name, max(from_s, 0.0)):
            try:
                message = self._parsed(data)
                stamp_s = decoding.stamp_s(message)
            except Exception:  # noqa: S112 - a damaged message; protobuf's errors are Exceptions
                continue
            yield (recorded_s if self._uses_recorded else stamp_s), message


def find_depth(
    bag: Bag, images: Topic, *, uses_recorded_times: bool, fps: float
) -> tuple[DepthImages | None, tuple[str, ...]]:
    """The depth that belongs to the images of a topic, if any, and notes about it and about depth
    that is left out.
    """
    view = _view(bag, images)
    notes, readers = [], list[DepthImages]()
    for topic in _candidates(bag, images):
        reader = DepthImages(bag.path, topic, uses_recorded_times=uses_recorded_times, fps=fps)
        problem = _problem(reader, bag, images, view)
        if problem:
            notes.append(f"{bag.path}: depth images ({topic.name}) are left out: {problem}.")
        else:
            readers.append(reader)
    # aligned by its name before the same view, and the whole before the compressed image
    readers.sort(key=lambda one: (_ALIGNED.isdisjoint(words(one.topic.name)), len(one.topic.name)))
    if not readers:
        return None, tuple(notes)
    used = f"{bag.path}: the depth in {readers[0].topic.name} is the ranging method `recorded`."
    return readers[0], (used, *notes)


def _candidates(bag: Bag, images: Topic) -> list[Topic]:
    """Topics whose first message is a depth image."""
    listed = [
        topic
        for topic in bag.topics.values()
        if topic.type in (*decoding.RAW_TYPES, *decoding.COMPRESSED_TYPES)
        and topic.name != images.name
        and decoding.is_readable(topic)
        and words(topic.name) & {"depth", "stereo"}
        and not words(topic.name) & _NO_DEPTH
    ]
    return [topic for topic in listed if _is_encoded_depth(bag, topic)]


def _is_encoded_depth(bag: Bag, topic: Topic) -> bool:
    message = _first(bag, topic)
    if message is None:
        return False
    encoding = _encoding(topic, message)
    is_count = encoding.startswith(("16UC1", "16SC1")) or (
        encoding.startswith("mono16") and is_depth(topic.name)
    )
    return is_count or encoding.startswith("32FC1")


def _problem(reader: DepthImages, bag: Bag, images: Topic, view: _View) -> str:
    """Why the depth of a topic cannot be used; "" = it can."""
    name, of_depth = reader.topic.name, _view(bag, reader.topic)
    is_named = not _ALIGNED.isdisjoint(words(name))
    is_infrared = any(part in images.name.lower() for part in _INFRARED_1)
    ids = [one.frame_id.strip("/") for one in (view, of_depth)]
    is_same_frame = ids[0] == ids[1] if all(ids) else is_named
    both_known = view.camera is not None and of_depth.camera is not None
    is_same_view = both_known and not view.differs(of_depth)
    if view.differs(of_depth) or not (is_same_frame or (is_infrared and is_same_view)):
        return (
            "they show the view of another camera than the images"
            + (f" (frame_id {ids[1]}, images {ids[0]})" if all(ids) and ids[0] != ids[1] else "")
            + "; record depth that the camera aligns to the images (RealSense: align_depth, OAK: "
            "align to RGB, ZED: depth_registered), or the images of the camera of the depth"
        )
    return _wrong_unit(reader, bag)


def _wrong_unit(reader: DepthImages, bag: Bag) -> str:
    """What is wrong with the unit of the first image that shows anything; "" = nothing."""
    for _, _, data in itertools.islice(bag.messages(reader.topic.name, 0.0), N_FIRST):
        try:
            message = decoding.message_reader(reader.topic)(data)
            depth = reader.decoded(message)
        except Exception as error:  # the errors of the parsers derive from Exception
            return f"expected 16-bit millimetres or 32-bit metres, found {str(error)[:60]}"
        if not np.isfinite(depth).any():
            continue
        median_m = float(np.nanmedian(depth))
        is_float = _encoding(reader.topic, message).startswith("32FC1")
        if is_float and median_m > _FAR_M:
            return f"expected metres (32FC1), found a median of {median_m:.0f}, as of millimetres"
        if not is_float and median_m < _NEAR_M:
            return (
                "expected millimetres (16UC1), found a median of "
                f"{1000 * median_m:.0f}, as of another "
                "unit"
            )
        return ""
    return "the first ones are empty"


def _view(bag: Bag, topic: Topic) -> _View:
    message = _first(bag, topic)
    header = getattr(message, "header", message)
    stated = stated_camera(bag, topic.name)
    return _View(str(getattr(header, "frame_id", "") or ""), None if stated is None else stated[1])


def _first(bag: Bag, topic: Topic) -> Any:
    """The first message of a topic that can be parsed; None = there is none."""
    for _, _, data in itertools.islice(bag.messages(topic.name, 0.0), N_FIRST):
        try:
            return decoding.message_reader(topic)(data)
        except Exception:  # noqa: S112 - as in `DepthImages`
            continue
    return None


def _encoding(topic: Topic, message: Any) -> str:
    return str(message.encoding if topic.type in decoding.RAW_TYPES else message.format)


def _raw(message: Any) -> np.ndarray[Any, Any]:
    """(h, w) counts or metres of an uncompressed image."""
    encoding, height, width = str(message.encoding), int(message.height), int(message.width)
    kind = "f4" if encoding == "32FC1" else "i2" if encoding == "16SC1" else "u2"
    dtype = np.dtype(kind).newbyteorder(">" if getattr(message, "is_bigendian", False) else "<")
    if not 0 < height * width <= MAX_PIXELS:
        raise DamagedError(f"an image of {width}x{height} px")
    data = np.frombuffer(bytes(message.data), np.uint8)
    step = int(message.step) or width * dtype.itemsize
    if step < width * dtype.itemsize or len(data) < step * height:
        raise DamagedError("less data than pixels")
    rows = data[: step * height].reshape(height, step)[:, : width * dtype.itemsize]
    return np.ascontiguousarray(rows).view(dtype).reshape(height, width)


def _compressed(message: Any) -> np.ndarray[Any, Any]:
    """(h, w) counts or metres of a compressed image."""
    name, data = str(message.format), bytes(message.data)
    is_transport = "compressedDepth" in name
    if "rvl" in name.lower():
        raise DamagedError("depth compressed by RVL; record it as png")
    content = data[_HEADER.size :] if is_transport else data
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.ndim != 2 or image.dtype != np.uint16:
        raise DamagedError("no 16-bit image")
    if not name.startswith("32FC1"):
        return image
    _, a, b = _HEADER.unpack_from(data)
    with np.errstate(divide="ignore"):
        return np.where(image > 0, a / (image.astype(np.float32) - b), 0.0).astype(np.float32)


def _depth_unit(bag: Bag, topic: Topic) -> float:
    """Metres per count: of RealSense's recorder the option of the sensor, else millimetres."""
    sensor = topic.name.split("/Depth_")[0]
    option = bag.topics.get(f"{sensor}/option/Depth Units/value") or bag.topics.get(
        f"{sensor}/option/Depth_Units/value"
    )
    message = None if option is None or sensor == topic.name else _first(bag, option)
    unit = float(getattr(message, "data", 0.0) or 0.0)
    return unit if 1e-6 < unit < 1.0 else 0.001
