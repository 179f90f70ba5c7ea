"""VideoFile: the frames of a video file by its timestamps; with `video_writer.py` all that knows PyAV (FFmpeg).

    time_s = pts * time_base,    kept with the stream's start offset, since left and right of a pair may start apart

Time increases strictly, indices count every frame of the file, images are upright, and what is damaged is left out.
"""

from __future__ import annotations

import math
import os
from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager
from fractions import Fraction
from pathlib import Path
from typing import cast

import av
import numpy as np
from av.container import InputContainer
from av.packet import Packet
from av.sidedata.sidedata import SideDataContainer
from av.sidedata.sidedata import Type as SideDataType
from av.stream import Disposition
from av.video.stream import VideoStream

from track_range.foundation.arrays import Image
from track_range.video.decode_log import ReadingLog
from track_range.video.frame import TIME_EPSILON_S, VideoError, VideoFrame, counted, is_neutral, strictly_later

DECODER_THREADS = 1 if (os.cpu_count() or 1) <= 2 else 2  # left and right decode beside each other and a detector
_FALLBACK_RATE_HZ = 25.0  # where a file states no rate at all
_SHORTFALL_FRAMES = 2.5  # a file that ends so much before its header's duration was cut short
_UPRIGHT = (1, 0, 0, 1)
_STILL_FORMATS = ("image2", "_pipe")  # FFmpeg's names for single images end so


class VideoFile:
    """A video file, read from any time, as often as wanted; attributes as in `VideoReader`.

    Raises:
        VideoError: not to be read, no video, or nothing in it decodes.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._log = ReadingLog()
        self._file_notes: list[str] = []
        with _opened(path) as (container, stream):
            rate_hz = stream.average_rate or stream.guessed_rate
            self.fps = float(rate_hz) if rate_hz else _FALLBACK_RATE_HZ
            declared_s, is_end = _declared_duration_s(container, stream)
            self.n_frames: int | None = stream.frames or None
            if stream.sample_aspect_ratio not in (None, 0, 1):
                self._file_notes.append(f"{path}: its pixels are not square; the images are used as they are stored.")
        with closing(self._timed(-math.inf)) as timed:
            first = next(timed, None)
        if first is None:
            raise VideoError(f"{path}: no frame of this video can be decoded: it is damaged or cut short, record anew.")
        _, self.first_time_s, frame = first
        self._declared_end_s = declared_s if is_end else self.first_time_s + declared_s
        if self.n_frames is None and declared_s:
            self.n_frames = max(1, round((self._declared_end_s - self.first_time_s) * self.fps))
        self._axes = _display_axes(frame)
        if self._axes != _UPRIGHT:
            self._file_notes.append(f"{path}: turned upright, as its metadata says.")
        image = self._upright(frame)
        self.height_px, self.width_px = image.shape[:2]
        self.is_grey = is_neutral(image)

    @property
    def notes(self) -> list[str]:
        """What the user should know, with what the latest reading has met."""
        return [*self._file_notes, *(f"{self.path}: {note}" for note in self._log.notes)]

    def frames(self, from_s: float, until_s: float) -> Generator[VideoFrame, None, None]:
        """The frames of the times from `from_s` up to, not including, `until_s`.

        Damaged frames are left out, and reading ends where the file cannot be read on; `notes` says so.

        Raises:
            VideoError: a frame has another size than the first.
        """
        with closing(self._timed(from_s)) as timed:
            for index, time_s, frame in timed:
                if time_s >= until_s - TIME_EPSILON_S:
                    return
                if time_s >= from_s - TIME_EPSILON_S:
                    self._log.n_used += 1
                    yield VideoFrame(index, time_s, self._checked(self._upright(frame)))
        self._log.note_shortfall(self._declared_end_s, tolerance_s=_SHORTFALL_FRAMES / self.fps)

    def _timed(self, from_s: float) -> Generator[tuple[int, float, av.VideoFrame], None, None]:
        """(index, time_s, frame) by time, from the last keyframe before `from_s`."""
        self._log = log = ReadingLog()
        interval_s = 1 / self.fps
        with _opened(self.path) as (container, stream):
            # AVI knows no timestamps, and with B-frames those that FFmpeg guesses are in disorder.
            is_stamped = not (container.format.name == "avi" and stream.codec_context.has_b_frames)
            time_base = stream.time_base or Fraction(1, 90_000)
            packets = _demuxed(container, stream, log)
            if is_stamped:
                packets = _from_last_keyframe(packets, (from_s + TIME_EPSILON_S) / float(time_base))
            for frame in _decoded(packets, stream, log):
                stamp = (frame.dts if frame.pts is None else frame.pts) if is_stamped else None
                index = log.frame_index(stamp)
                stamp_s = None if stamp is None else float(stamp * time_base)
                time_s = strictly_later(stamp_s, log.last_s, interval_s=interval_s)
                if time_s is None:
                    log.n_backward += 1
                    continue
                duration_s = float(frame.duration * time_base) if is_stamped else 0.0
                log.decoded(time_s, duration_s=duration_s or interval_s, interval_s=interval_s)
                if not (frame.is_corrupt or log.is_corrupt(stamp)):
                    yield index, time_s, frame
                elif time_s >= from_s:
                    log.n_damaged += 1

    def _upright(self, frame: av.VideoFrame) -> Image:
        image = frame.to_ndarray(format="bgr24").astype(np.uint8, copy=False)
        if self._axes == _UPRIGHT:
            return image
        x_from_x, y_from_x, x_from_y, y_from_y = self._axes
        if y_from_x:
            return np.ascontiguousarray(image.swapaxes(0, 1)[::y_from_x, ::x_from_y])
        return np.ascontiguousarray(image[::y_from_y, ::x_from_x])

    def _checked(self, image: Image) -> Image:
        height_px, width_px = image.shape[:2]
        if (width_px, height_px) != (self.width_px, self.height_px):
            raise VideoError(
                f"{self.path}: its images change from {self.width_px}x{self.height_px} to {width_px}x{height_px} after "
                f"{counted(self._log.n_used - 1, 'frame')}: cut the video there, or use --duration."
            )
        return image


@contextmanager
def _opened(path: Path) -> Iterator[tuple[InputContainer, VideoStream]]:
    """The file and its video stream, ready to decode."""
    try:
        container = av.open(f"file:{path}", mode="r", metadata_errors="replace")  # a name may look like a protocol
    except av.FFmpegError as error:
        raise VideoError(f"{path}: {_why_unreadable(path)}") from error
    with container:
        if container.format.name.endswith(_STILL_FORMATS):
            raise VideoError(f"{path}: a single image; name a video, or the folder that holds the numbered images.")
        stream = _video_stream(container)
        if stream is None or container.format.name == "tty":  # FFmpeg takes any text for terminal art
            raise VideoError(f"{path}: holds no video: name a video file, or a folder of numbered images.")
        stream.thread_type = "AUTO"
        stream.thread_count = DECODER_THREADS
        yield container, stream


def _why_unreadable(path: Path) -> str:
    try:
        with path.open("rb") as file:
            start = file.read(12)
    except OSError as error:
        return f"cannot be read ({error.strerror}): check it and its permissions."
    if not start:
        return "the file is empty: copy or record it anew."
    if start[4:8] == b"ftyp":
        return "an MP4 without its index, so cut short while recording or copying: copy it anew, or repair it."
    return "not a video, or damaged from its start: name a video file, or a folder of numbered images."


def _video_stream(container: InputContainer) -> VideoStream | None:
    """The first stream that is a film, not a cover picture, and that this FFmpeg can decode."""
    films = (stream for stream in container.streams.video if not stream.disposition & Disposition.attached_pic)
    return next((stream for stream in films if stream.codec_context is not None), None)


def _declared_duration_s(container: InputContainer, stream: VideoStream) -> tuple[float, bool]:
    """How long the header says that the video is, 0 = it does not say; and whether that counts from time 0."""
    if container.format.name == "avi" and stream.frames and stream.average_rate:
        return float(stream.frames / stream.average_rate), False  # its duration is what FFmpeg found, not the promise
    is_matroska = container.format.name.startswith("matroska")
    if stream.duration and stream.time_base and not is_matroska:
        return float(stream.duration * stream.time_base), False
    is_alone = len(container.streams) == 1  # else it may be the sound that lasts so long
    return (container.duration or 0) / av.time_base if is_alone else 0.0, is_matroska


def _demuxed(container: InputContainer, stream: VideoStream, log: ReadingLog) -> Iterator[Packet[VideoStream] | None]:
    """The stream's packets, then None if the file cannot be read to its end."""
    packets = container.demux(stream)
    while True:
        try:
            packet = next(packets, None)
        except av.FFmpegError as error:
            log.stopped_by = error.strerror or str(error)
            yield None
            return
        if packet is None:
            return
        if packet.size and not packet.is_discard:
            log.packet(packet.pts, is_corrupt=packet.is_corrupt)
        yield packet


def _from_last_keyframe(
    packets: Iterator[Packet[VideoStream] | None], stamp: float
) -> Iterator[Packet[VideoStream] | None]:
    """The packets without those that no frame from `stamp` on is built from; None and the last packet are kept."""
    waiting: list[Packet[VideoStream] | None] = []
    for packet in packets:
        if packet is not None and packet.pts is not None and packet.pts <= stamp:
            if packet.is_keyframe:
                waiting.clear()
            waiting.append(packet)
            continue
        yield from waiting
        yield packet
        yield from packets
        return
    yield from waiting


def _decoded(
    packets: Iterator[Packet[VideoStream] | None], stream: VideoStream, log: ReadingLog
) -> Iterator[av.VideoFrame]:
    """What decodes; None and an empty packet flush the decoder."""
    for packet in packets:
        try:
            frames = stream.decode(packet)
        except av.FFmpegError:
            log.n_damaged += 1
            continue
        yield from frames


def _display_axes(frame: av.VideoFrame) -> tuple[int, int, int, int]:
    """Signs (a, b, c, d) of x' = a x + c y, y' = b x + d y that turn the stored image upright, as players do."""
    try:
        side = cast(SideDataContainer, frame.side_data)[SideDataType.DISPLAYMATRIX]  # PyAV's own hint is too narrow
    except KeyError:
        return _UPRIGHT
    a, b, _, c, d = (int(sign) for sign in np.sign(np.frombuffer(bytes(side), np.int32)[:5]))
    is_right_angle = (a == d == 0 and b and c) or (b == c == 0 and a and d)
    return (a, b, c, d) if is_right_angle else _UPRIGHT
