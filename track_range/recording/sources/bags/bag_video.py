"""BagVideo: the images of one topic of an MCAP file or ROS bag as a video; only one chunk of the
file is in memory.
"""

import itertools
import re
from collections.abc import Generator

import numpy as np

from track_range.foundation.arrays import Image
from track_range.foundation.files.images import check_size
from track_range.foundation.files.input_files import counted, shortened
from track_range.recording.sources.bags import decoding
from track_range.recording.sources.bags.bag import open_bag, topic_list
from track_range.recording.sources.bags.bag_topic import BagTopic
from track_range.recording.sources.bags.container import DamagedError, Topic
from track_range.recording.sources.files.file_state import FileState
from track_range.recording.sources.files.video_file import ZED_SENTENCE
from track_range.recording.video.frame import (
    TIME_EPSILON_S,
    VideoError,
    VideoFrame,
    is_neutral,
    strictly_later,
)
from track_range.recording.video.recorded_video import RecordedVideo
from track_range.recording.video.utc import UtcStart
from track_range.stereo.rig_formats.camera_info import CameraInfo

_N_FIRST = 30  # messages from which the frame rate is estimated
_FALLBACK_RATE_HZ = 10.0  # of a topic with a single message
_MAX_LATENCY_S = 5.0  # largest time, s, between the time stamp of an image and its recording
# 1990; smaller times come from a simulation, or count since a computer was started
_FIRST_PLAUSIBLE_S = 631_152_000.0
_UTC_UNCERTAINTY_S = 0.1  # largest delay, s, between exposure and time stamp; assumed
# levels above an image topic in which its calibration is searched: /left/image_raw/compressed ->
# /left
_MAX_LEVELS = 3
_ZED_ENCODING = "zed_sdk_encoded"  # of the images of .svo2 files
# ends of the names of calibration topics
_CALIBRATION_NAMES = ("camera_info", "calibration", "info/camera_info")
"""The last pattern belongs to RealSense's recorder: /device_0/sensor_0/Infrared_1/image/data and
.../info/camera_info."""


def _is_depth(topic: str) -> bool:
    """Whether a topic has depth images by its name, as RealSense, ZED and OAK cameras name them."""
    return re.search(r"(^|[/_])(depth|disparity|confidence)([/_]|$)", topic.lower()) is not None


class BagVideo(RecordedVideo):
    """Images of one topic, in the order of their time stamps, which are seconds since 1970.

    `camera` is the calibration in a topic beside it, if any; `is_rectified` follows from the
    topic's name. Raises VideoError if the bag has no such topic or no image can be read, and, while
    iterating, if an image differs in size.
    """

    path: BagTopic
    parts = ()

    def __init__(self, name: BagTopic) -> None:
        self.path = name
        self._bag = open_bag(name.path)
        files = name.path.iterdir() if name.path.is_dir() else [name.path]
        self._states = {file: FileState.of(file) for file in files if file.is_file()}
        self._topic = self._chosen_topic()
        self._setup_notes: list[str] = []
        self._n_backward = self._n_damaged = 0
        self._uses_headers = True
        try:
            first, times_s = self._first_image()
        except DamagedError as error:
            raise VideoError(
                f"{name}: expected images ({self._topic.type}), found other messages: "
                f"{shortened(str(error), 100)}."
            ) from error
        self.first_time_s = times_s[0]
        self.height_px, self.width_px = first.shape[:2]
        check_size(name, (self.width_px, self.height_px), VideoError)
        self.is_grey, self.first_image = is_neutral(first), first
        steps_s = np.diff(times_s)
        steps_s = steps_s[steps_s > TIME_EPSILON_S]
        self.fps = float(1 / np.median(steps_s)) if steps_s.size else _FALLBACK_RATE_HZ
        self.n_total = self._topic.n_messages
        self.is_rectified = "rect" in self._topic.name.lower().replace("direct", "")
        self.camera = self._calibration()
        depth = [
            topic.name
            for topic in self._bag.topics.values()
            if topic.type in decoding.IMAGE_TYPES and _is_depth(topic.name)
        ]
        if depth and self._topic.name not in depth:
            self._setup_notes.append(
                f"{name.path}: depth images ({', '.join(depth)}) are left out."
            )

    @property
    def utc(self) -> UtcStart | None:
        """See `RecordedVideo`."""
        if self.first_time_s < _FIRST_PLAUSIBLE_S:
            return None
        source = "time stamps of the images" if self._uses_headers else "recording times of the bag"
        return UtcStart(self.first_time_s, source, _UTC_UNCERTAINTY_S)

    @property
    def notes(self) -> tuple[str, ...]:
        """See `RecordedVideo`."""
        skipped = (
            (self._bag.n_damaged, "damaged part", " of the file"),
            (self._n_damaged, "damaged image", ""),
            (self._n_backward, "image", " with a repeated or backward time"),
        )
        end = (
            [f"{self._bag.end_problem}; all earlier images were used."]
            if self._bag.end_problem
            else []
        )
        notes = end + [f"skipped {counted(n, noun)}{clause}." for n, noun, clause in skipped if n]
        return (*self._setup_notes, *(f"{self.path}: {note}" for note in notes))

    def frames(self, from_s: float, until_s: float) -> Generator[VideoFrame, None, None]:
        """See `RecordedVideo.frames`; reading ends where the file is cut off."""
        self._n_backward = self._n_damaged = 0
        self.check_unchanged()
        decoder, last_s = decoding.ImageDecoder(self._topic), None
        # a video is decoded from its start
        recorded_from_s = 0.0 if decoder.is_video else from_s - _MAX_LATENCY_S
        for number, recorded_s, data in self._bag.messages(self._topic.name, recorded_from_s):
            try:
                stamp_s, message = decoder.message(data)
                time_s = strictly_later(
                    stamp_s if self._uses_headers else recorded_s, last_s, interval_s=1 / self.fps
                )
                if time_s is None:
                    self._n_backward += 1
                    continue
                last_s = time_s
                if time_s >= until_s - TIME_EPSILON_S:
                    return
                is_before = time_s < from_s - TIME_EPSILON_S
                if is_before and not decoder.is_video:
                    continue
                image = decoder.image(message)
            except DamagedError:
                self._n_damaged += 1
                continue
            if image is not None and not is_before:
                self.check_size(image.shape[1::-1], " like the first one", "use --duration")
                yield VideoFrame(number, time_s, image)

    def check_unchanged(self) -> None:
        """See `RecordedVideo`."""
        for file, state in self._states.items():
            state.check_unchanged(file)

    def _chosen_topic(self) -> Topic:
        topics, listed = self._bag.topics, topic_list(self._bag, decoding.IMAGE_TYPES)
        if (
            any(topic.encoding == _ZED_ENCODING for topic in topics.values())
            or "svo_header" in topics
        ):
            raise VideoError(f"{self.path}: {ZED_SENTENCE}")
        name = self.path.topic
        if name is None:
            images = [topic.name for topic in topics.values() if topic.type in decoding.IMAGE_TYPES]
            images = [one for one in images if not _is_depth(one)] or images
            if len(images) != 1:
                raise VideoError(
                    f"{self.path}: expected --topics with the topics of the images, found {listed}."
                )
            name = images[0]
        if name not in topics:
            end = f", {self._bag.end_problem}" if self._bag.end_problem else ""
            raise VideoError(f"{self.path}: no such topic; found {listed}{end}.")
        topic = topics[name]
        if topic.type not in decoding.IMAGE_TYPES:
            raise VideoError(f"{self.path}: expected images, found {topic.type}; found {listed}.")
        if not decoding.is_readable(topic):
            raise VideoError(
                f"{self.path}: expected messages encoded in CDR, ROS 1 or protobuf, got "
                f"{shortened(topic.encoding)}; convert the bag."
            )
        return topic

    def _first_image(self) -> tuple[Image, list[float]]:
        decoder, first = decoding.ImageDecoder(self._topic), None
        times_s: list[tuple[float, float]] = []
        problem = "no messages"
        for _, recorded_s, data in itertools.islice(
            self._bag.messages(self._topic.name, 0.0), _N_FIRST
        ):
            try:
                stamp_s, message = decoder.message(data)
                first = decoder.image(message) if first is None else first
                times_s.append((stamp_s, recorded_s))
            except DamagedError as error:
                problem = str(error) if problem == "no messages" else problem
        if first is None:
            raise DamagedError(problem)
        self.pixel_aspect = decoder.pixel_aspect
        # a simulation may begin at 0
        self._uses_headers = any(stamp_s > 0 for stamp_s, _ in times_s)
        if not self._uses_headers:
            self._setup_notes.append(
                f"{self.path}: images have no time stamps; the times of recording are used."
            )
        return first, [
            stamp_s if self._uses_headers else recorded_s for stamp_s, recorded_s in times_s
        ]

    def _calibration(self) -> CameraInfo | None:
        """The first message of the calibration topic beside the images: /left/image_raw ->
        /left/camera_info.
        """
        parts = self._topic.name.rstrip("/").split("/")
        levels = ["/".join(parts[:-up]) for up in range(1, min(_MAX_LEVELS, len(parts)) + 1)]
        for level, name in itertools.product(levels, _CALIBRATION_NAMES):
            topic = self._bag.topics.get(f"{level}/{name}")
            if (
                topic is None
                or topic.type not in decoding.CALIBRATION_TYPES
                or not decoding.is_readable(topic)
            ):
                continue
            for _, _, data in itertools.islice(self._bag.messages(topic.name, 0.0), _N_FIRST):
                try:
                    camera = decoding.camera_message(topic, data)
                except DamagedError:
                    continue
                if camera.k[0, 0] > 0:  # an uncalibrated camera has K = 0
                    self._setup_notes.append(f"Using calibration {topic.name} of {self.path.path}.")
                    return camera
        return None
