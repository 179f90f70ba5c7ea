"""What the names of topics in a bag say about their images, and the calibrations beside them."""

import itertools
import re

from track_range.recording.sources.bags import decoding
from track_range.recording.sources.bags.container import Bag, DamagedError, Topic
from track_range.stereo.rig_formats.camera_info import CameraInfo

N_FIRST = 30  # messages from which properties of a topic are read
# levels above an image topic in which its calibration is searched: /left/image_raw/compressed ->
# /left
_MAX_LEVELS = 3
# ends of the names of calibration topics; the last one is of RealSense's recorder:
# /device_0/sensor_0/Infrared_1/image/data and .../info/camera_info
_CALIBRATION_NAMES = ("camera_info", "calibration", "info/camera_info")
_DEPTH = {"depth", "disparity", "confidence"}  # images of RealSense, ZED and OAK, not of the scene


def words(topic: str) -> set[str]:
    """The words in the name of a topic, in lower case: image_rectColor -> image, rect, color."""
    return {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", topic)}


def is_depth(topic: str) -> bool:
    """Whether a topic has depth images by its name."""
    return not _DEPTH.isdisjoint(words(topic))


def stated_camera(bag: Bag, topic: str) -> tuple[str, CameraInfo] | None:
    """Name and first message of the calibration topic beside images, as stated: /left/image_raw ->
    /left/camera_info; None = there is none, or of an uncalibrated camera.
    """
    parts = topic.rstrip("/").split("/")
    levels = ["/".join(parts[:-up]) for up in range(1, min(_MAX_LEVELS, len(parts)) + 1)]
    for level, name in itertools.product(levels, _CALIBRATION_NAMES):
        beside = bag.topics.get(f"{level}/{name}")
        if beside is None or not _is_calibration(beside):
            continue
        for _, _, data in itertools.islice(bag.messages(beside.name, 0.0), N_FIRST):
            try:
                camera = decoding.camera_message(beside, data)
            except DamagedError:
                continue
            if camera.k[0, 0] > 0:  # an uncalibrated camera has K = 0
                return beside.name, camera
    return None


def _is_calibration(topic: Topic) -> bool:
    return topic.type in decoding.CALIBRATION_TYPES and decoding.is_readable(topic)
