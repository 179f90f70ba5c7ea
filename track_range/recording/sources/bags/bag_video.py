"""BagVideo: the images of one topic of an MCAP file or ROS bag as a video; only one chunk of the
file is in memory.
"""

import itertools
import math
from collections.abc import Generator

import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.foundation.files.images import check_size
from track_range.foundation.files.input_files import counted, shortened
from track_range.recording.sources.bags import decoding
from track_range.recording.sources.bags.bag import open_bag, topic_list
from track_range.recording.sources.bags.bag_topic import BagTopic
from track_range.recording.sources.bags.container import DamagedError, Topic
from track_range.recording.sources.bags.depth_images import find_depth
from track_range.recording.sources.bags.image_clock import ImageClock
from track_range.recording.sources.bags.topics import N_FIRST, is_depth, stated_camera, words
from track_range.recording.sources.files.file_state import FileState
from track_range.recording.sources.files.video_file import ZED_SENTENCE
from track_range.recording.video.frame import (
    TIME_EPSILON_S,
    VideoError,
    VideoFrame,
    is_neutral,
)
from track_range.recording.video.recorded_video import RecordedVideo
from track_range.recording.video.utc import UtcStart
from track_range.stereo.rig_formats.camera_info import CameraInfo, is_undistorted

_MAX_LATENCY_S = 5.0  # largest time, s, between the time stamp of an image and its recording
# 1990; smaller times come from a simulation, or count since a computer was started
_FIRST_PLAUSIBLE_S = 631_152_000.0
# of images over the rate of the first ones, above which their times were set back; assumed
_MAX_PACE = 1.02
_UTC_UNCERTAINTY_S = 0.1  # largest delay, s, between exposure and time stamp; assumed
_ZED_ENCODING = "zed_sdk_encoded"  # of the images of .svo2 files
# words in the names of topics: rectified images, and others
_RECTIFIED = {"rect", "rectified", "undistorted"}
_RAW = {"raw", "unrectified", "distorted"}
# relative difference of the focal lengths of K and P from which it matters which one is meant
_FOCAL_DIFFERENCE = 0.01


class BagVideo(RecordedVideo):
    """Images of one topic, in the order of their times, which are seconds since 1970.

    `camera` is the calibration in a topic beside it, if any, of the part of the sensor that the
    images show; `is_rectified` follows from the words in the topic's name. Raises VideoError if the
    bag has no such topic or no image can be read, and, while iterating, if an image differs in
    size, and RigError if the calibration states another size.
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
        self._n_damaged = 0
        try:
            first, self._first_s = self._first_image()
        except DamagedError as error:
            raise VideoError(
                f"{name}: expected images ({self._topic.type}), found other messages: "
                f"{shortened(str(error), 100)}."
            ) from error
        try:
            self._clock = ImageClock(self._first_s)
        except ValueError as error:
            raise VideoError(f"{name}: expected {error}.") from error
        if self._clock.fault:
            self._setup_notes.append(
                f"{name}: {self._clock.fault}; the times of recording are used."
            )
        self.first_time_s, self.fps = self._clock.first_time_s, self._clock.fps
        self.height_px, self.width_px = first.shape[:2]
        check_size(name, (self.width_px, self.height_px), VideoError)
        self.is_grey, self.first_image = is_neutral(first), first
        self.n_total = self._topic.n_messages
        self.is_rectified = not _RECTIFIED.isdisjoint(words(self._topic.name))
        self.camera = self._calibration()
        self.depth, notes = find_depth(
            self._bag, self._topic, uses_recorded_times=bool(self._clock.fault), fps=self.fps
        )
        others = [
            topic.name
            for topic in self._bag.topics.values()
            if topic.type in decoding.IMAGE_TYPES
            and is_depth(topic.name)
            and not any(topic.name in note for note in notes)
        ]
        if others and self._topic.name not in others:
            notes = (*notes, f"{name.path}: depth images ({', '.join(others)}) are left out.")
        self.depth_notes = notes
        self._setup_notes += notes

    @property
    def utc(self) -> UtcStart | None:
        """See `RecordedVideo`."""
        if self.first_time_s < _FIRST_PLAUSIBLE_S:
            return None
        source = "recording times of the bag" if self._clock.fault else "time stamps of the images"
        return UtcStart(self.first_time_s, source, _UTC_UNCERTAINTY_S)

    @property
    def notes(self) -> tuple[str, ...]:
        """See `RecordedVideo`."""
        skipped = (
            (self._bag.n_damaged, "damaged part", " of the file"),
            (self._n_damaged, "damaged image", ""),
            (self._clock.n_backward, "image", " with a repeated or backward time"),
        )
        set_back = [
            f"the clock of the images is set back by {step_s:.1f} s at {time_s:.1f} s; the times "
            "go on from there by the usual interval."
            for time_s, step_s in self._clock.set_back[:3]
        ]
        end = (
            [f"{self._bag.end_problem}; all earlier images were used."]
            if self._bag.end_problem
            else []
        )
        notes = end + set_back
        notes += [f"skipped {counted(n, noun)}{clause}." for n, noun, clause in skipped if n]
        return (*self._setup_notes, *(f"{self.path}: {note}" for note in notes))

    def frames(self, from_s: float, until_s: float) -> Generator[VideoFrame, None, None]:
        """See `RecordedVideo.frames`; reading ends where the file is cut off."""
        self._n_damaged = 0
        self._clock = clock = ImageClock(self._first_s)
        self.check_unchanged()
        decoder = decoding.ImageDecoder(self._topic)
        # a video is decoded from its start
        is_whole = decoder.is_video or from_s <= self.first_time_s or self._is_set_before(from_s)
        recorded_from_s = 0.0 if is_whole else from_s - _MAX_LATENCY_S
        for number, recorded_s, data in self._bag.messages(self._topic.name, recorded_from_s):
            try:
                stamp_s, message = decoder.message(data)
                time_s = clock.time_s(stamp_s, recorded_s)
                if time_s is None:
                    continue
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

    def _is_set_before(self, from_s: float) -> bool:
        """Whether a clock was set back before an image at this time, or that of the recorder runs
        behind, so that the times of recording do not show which messages are needed.
        """
        messages = self._bag.messages(self._topic.name, from_s - _MAX_LATENCY_S)
        number, recorded_s, data = next(iter(messages), (0, math.nan, b""))
        try:
            stamp_s, _ = decoding.ImageDecoder(self._topic).message(data)
        except DamagedError:
            return True
        time_s = recorded_s if self._clock.fault else stamp_s
        n_usual = _MAX_PACE * (time_s - self.first_time_s) * self.fps + self.fps
        return number > n_usual or (number > 0 and time_s > from_s)

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
            images = [one for one in images if not is_depth(one)]
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

    def _first_image(self) -> tuple[Image, FloatArray]:
        """The first image, and (N, 2) time stamps and recording times of the first messages."""
        decoder, first = decoding.ImageDecoder(self._topic), None
        times_s: list[tuple[float, float]] = []
        problem = "no messages"
        for _, recorded_s, data in itertools.islice(
            self._bag.messages(self._topic.name, 0.0), N_FIRST
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
        return first, np.array(times_s)

    def _calibration(self) -> CameraInfo | None:
        """The first message of the calibration topic beside the images: /left/image_raw ->
        /left/camera_info.
        """
        stated = stated_camera(self._bag, self._topic.name)
        if stated is None:
            return None
        name, camera = stated
        self._setup_notes.append(
            f"Using calibration {name} of {self.path.path}{self._matrix_used(camera)}."
        )
        return camera.of_images((self.width_px, self.height_px), f"{self.path.path} ({name})")

    def _matrix_used(self, camera: CameraInfo) -> str:
        """The matrix that describes the images, as the end of a note, where the names of topics do
        not say it, or say that it is not K; "" = it is clear.
        """
        focal_px, rectified_px = float(camera.k[0, 0]), float(camera.p[0, 0])
        if is_undistorted(camera) or abs(rectified_px / focal_px - 1) <= _FOCAL_DIFFERENCE:
            return ""
        if self.is_rectified:
            return f": P, {rectified_px:.0f} px, since the images are rectified by their name"
        if not _RAW.isdisjoint(words(self._topic.name)):
            return ""
        return (
            f": K and D, {focal_px:.0f} px, as of raw images; if they are rectified, give "
            f"--focal-px {rectified_px:.0f}"
        )
