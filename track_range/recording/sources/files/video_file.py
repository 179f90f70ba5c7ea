"""VideoFile: the frames of a video file with their timestamps, decoded with PyAV (FFmpeg).

    open -> demux -> skip to the last keyframe before the start -> decode -> index and time -> skip damaged frames

    time_s = pts * time_base,    including the stream's start offset, since the videos of a pair may start apart

Times increase strictly, indices count every frame of the file, and images are upright.
"""

from __future__ import annotations

import codecs
import itertools
import math
import re
from collections import deque
from collections.abc import Generator, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import cast

import av
import numpy as np
from av.container import InputContainer
from av.packet import Packet
from av.sidedata.sidedata import SideDataContainer, Type as SideDataType
from av.stream import Disposition
from av.video.stream import VideoStream

from track_range.foundation.files.images import MAX_PIXELS, check_size, header_size_px
from track_range.foundation.files.input_files import counted
from track_range.recording.sources.files.decode_log import DecodeLog
from track_range.recording.sources.files.file_state import FileState
from track_range.recording.video.clock import ASSUMED_RATE, assumed_rate_note, has_clock, has_origin
from track_range.recording.video.frame import (
    TIME_EPSILON_S,
    UPRIGHT,
    DecodedImage,
    VideoError,
    VideoFrame,
    is_neutral,
    stated_pixel_aspect,
    strictly_later,
)
from track_range.recording.video.layouts import StereoLayout
from track_range.recording.video.recorded_video import RecordedVideo
from track_range.recording.video.threads import DECODER_THREADS
from track_range.recording.video.utc import (
    Stamp,
    UtcStart,
    stamp_in_header,
    stamp_in_name,
    start_of,
)

_FALLBACK_RATE_HZ = 25.0  # frame rate of a file that does not declare one
# frames missing at the end of the header's duration from which a file counts as truncated
_SHORTFALL_FRAMES = 2.5
# range of frame rates; the rate of another header is ignored
_MIN_RATE_HZ, _MAX_RATE_HZ = 1e-4, 1e4

_STILL = Disposition.attached_pic | Disposition.timed_thumbnails  # streams that are no videos

_DEPTH = re.compile(r"(?<![a-z])(depth|disparity|infrared|ir|thermal)(?![a-z])", re.IGNORECASE)
_START_BYTES = 400  # of a file that cannot be read, which show what it is
_MAX_DENOMINATOR = 100_000  # of rates such as 30000/1001
_MAX_STATED_HZ = 500.0  # largest rate of a stream without times; others belong to a clock
# FFmpeg gives the clock of these codecs, 30000/1001 Hz, as the rate
_CLOCKED_CODECS = ("h261", "h263")
_MIN_SHARED = 10  # number of frames per time from which the times of a file are useless
_MAX_ENTRIES = 10_000  # entries of the index of a file that are compared: ten hours have a million
# step back in time from which the clock was set back; frames are stored in another order within
# less
_RESET_S = 1.0
_MAX_GAP_S = 40_000.0  # longest gap; FFmpeg adds 95443 s to transport streams that are set back far
# time between keyframes up to which the images shortly after each of them stand for all
_CLOSE_KEYFRAMES_S = 1.25
# time base of Matroska, and largest error of its rounding, s
_MILLISECOND, _ROUNDING_S = Fraction(1, 1000), 0.0006

_FORMATS = (
    "apng,apv,asf,av1,avi,avs2,avs3,cavsvideo,cine,dhav,dirac,dnxhd,dv,evc,flic,flv,gif,gxf,h261,"
    "h263,h264,hevc,ivf,ivr,kux,lmlm4,m4v,matroska,mjpeg,mjpeg_2000,mov,mpeg,mpegts,mpegvideo,"
    "mpjpeg,mxf,nsv,nut,obu,ogg,rm,ser,ty,vc1,vc1test,vvc,webm,wtv,yuv4mpegpipe,"
    "bmp_pipe,jpeg_pipe,pgm_pipe,png_pipe,ppm_pipe,"  # images one after the other
    "aac,ac3,flac,mp3,wav"  # "contains no video"
)
"""FFmpeg's names of the formats that are read.

No playlists and session descriptions (hls, concat, dash, sdp, ...), which make FFmpeg open other
files or the network.
"""

_OPTIONS = {  # of FFmpeg, for opening a file
    "format_whitelist": _FORMATS,
    "protocol_whitelist": "file",
    "enable_drefs": "0",  # MP4: no tracks in other files
    "max_pixels": str(MAX_PIXELS),
    **ASSUMED_RATE,
}


class VideoFile(RecordedVideo):
    """A video file; raises VideoError if it cannot be read, contains no video, or nothing can be
    decoded.
    """

    path: Path

    def __init__(self, path: Path, track: int | None = None, fps: float | None = None) -> None:
        """Open a file, and its video track `track`, counted from 0; None = chosen.

        `fps` is the frame rate of a file without times; None = stated, or assumed.
        """
        self.path, self._track, self._given_hz = path, track, fps
        self._state = FileState.of(path)
        self._reading: _Reading | None = _Reading(path, self._state, track, fps)
        container, stream = self._reading.container, self._reading.stream
        self._log = self._reading.log
        self.fps = self._reading.fps
        self.has_origin = has_origin(container)
        if track is None:
            self.tracks_px = self._reading.tracks_px
            self.depth_tracks = self._reading.depth_tracks
        self._file_notes: list[str] = list(self._reading.notes)
        self._has_grown = False
        self._first = next(iter(self._reading), None)
        if self._first is None:
            raise VideoError(
                f"{path}: no frame can be decoded; the video is damaged, truncated, or only the "
                "first file of fragments (.m4s, to be joined), or its images have more than "
                f"{MAX_PIXELS // 10**6} megapixels."
            )
        _, self.first_time_s, frame = self._first
        self.metadata = {**container.metadata, **stream.metadata}
        self._stamps = stamp_in_header(self.metadata), stamp_in_name(path.name)

        declared_s, is_end = self._reading.declared_duration_s()
        self._declared_end_s = declared_s if is_end else self.first_time_s + declared_s
        self.n_total = stream.frames or None
        if self.n_total is None and declared_s:
            self.n_total = max(1, round((self._declared_end_s - self.first_time_s) * self.fps))

        self._axes = _display_axes(frame)
        self.is_upright_file = self._axes == UPRIGHT and stream == container.streams.video[0]
        if self._axes != UPRIGHT:
            self._file_notes.append(
                f"{path}: the images are rotated upright, as the metadata state."
            )
        ratio = stream.sample_aspect_ratio
        self.pixel_aspect = stated_pixel_aspect(ratio, is_turned=self._axes[1] != 0)
        if ratio and self.pixel_aspect is None:
            self._file_notes.append(
                f"{path}: the stated pixel aspect of {float(ratio):.3g} is ignored."
            )
        self.stated_layout = _stated_layout(frame)
        image = DecodedImage(frame, self._axes).to_bgr()
        self.height_px, self.width_px = image.shape[:2]
        self.is_grey, self.first_image = is_neutral(image), image

    @property
    def utc(self) -> UtcStart | None:
        """See `RecordedVideo`."""
        return start_of(*self._stamps, max(0.0, self._declared_end_s - self.first_time_s))

    @property
    def notes(self) -> tuple[str, ...]:
        """See `RecordedVideo`."""
        growth = (
            ["grew while it was read; frames that were added may be missing."]
            if self._has_grown
            else []
        )
        return (
            *self._file_notes,
            *(f"{self.path}: {note}" for note in (*self._log.notes, *growth)),
        )

    def close(self) -> None:
        """See `RecordedVideo`."""
        if self._reading is not None:
            self._reading.close()
            self._reading = self._first = None

    def frames(self, from_s: float, until_s: float) -> Generator[VideoFrame, None, None]:
        """See `RecordedVideo.frames`; reading ends where the file becomes unreadable."""
        if self._reading is None:
            self.check_unchanged()
        reading, first = self._reading, self._first
        if reading is None:
            reading = _Reading(self.path, self._state, self._track, self._given_hz)
        self._reading = self._first = None
        self._log = reading.log
        with closing(reading):
            reading.skip_to(from_s)
            if self.burst_s is not None:
                reading.read_in_bursts(self.burst_s)
            for index, time_s, frame in itertools.chain(() if first is None else (first,), reading):
                if time_s >= until_s - TIME_EPSILON_S:
                    return
                if time_s >= from_s - TIME_EPSILON_S:
                    self._log.n_used += 1
                    decoded = DecodedImage(frame, self._axes)
                    if decoded.size_px != (self.width_px, self.height_px):
                        advice = (
                            f"cut the video after {counted(self._log.n_used - 1, 'frame')}, or use "
                            "--duration"
                        )
                        self.check_size(decoded.size_px, "", advice)
                    image = decoded.to_bgr()
                    yield VideoFrame(index, time_s, image, decoded)
        _check_times(self.path, self._log.n_used + self._log.n_backward, self._log.n_used)
        self._log.note_shortfall(self._declared_end_s, tolerance_s=_SHORTFALL_FRAMES / self.fps)

    def check_unchanged(self) -> None:
        """See `RecordedVideo`."""
        self._state.check_unchanged(self.path)
        self._has_grown = self._state.has_grown(self.path)


@dataclass(frozen=True, slots=True)
class VideoHeader:
    """Properties of a video file that can be read without decoding."""

    size_px: tuple[int, int]  # width and height of the images as stored
    fps: float
    first_s: float  # time stamp of the first frame
    duration_s: float  # 0 = not stated
    n_frames: int | None  # None = not stated
    # date and time in the metadata and in the file name; None = none
    stamps: tuple[Stamp | None, Stamp | None]
    state: FileState

    @classmethod
    def read(cls, path: Path, track: int | None = None, fps: float | None = None) -> VideoHeader:
        """The header of a file, which is closed again; raises VideoError if it is unreadable or has
        no video.
        """
        state = FileState.of(path)
        with closing(_Reading(path, state, track, fps)) as reading:
            container, stream = reading.container, reading.stream
            first_s = float((stream.start_time or 0) * reading.time_base)
            declared_s, is_end = reading.declared_duration_s()
            duration_s = max(0.0, declared_s - first_s if is_end else declared_s)
            if not duration_s and reading.has_clock:
                duration_s = (container.duration or 0) / av.time_base
            return cls(
                (stream.codec_context.width, stream.codec_context.height),
                reading.fps,
                first_s,
                duration_s or (stream.frames or 0) / reading.fps,
                stream.frames or None,
                (
                    stamp_in_header({**container.metadata, **stream.metadata}),
                    stamp_in_name(path.name),
                ),
                state,
            )


def count_packets(path: Path, fps: float | None = None) -> tuple[int, float]:
    """Number of frames and duration, s, of a file by its packets, with `fps` as in `VideoFile`;
    raises VideoError if it cannot be read.
    """
    with closing(_Reading(path, FileState.of(path), fps=fps)) as reading:
        n_frames, first, last = 0, math.inf, -math.inf
        for packet in reading.with_frames():
            n_frames += 1
            if packet.pts is not None:
                first, last = min(first, packet.pts), max(last, packet.pts)
        if not reading.has_clock:
            return n_frames, n_frames / reading.fps
        span_s = float(int(last - first) * reading.time_base) if last > first else 0.0
        return n_frames, span_s + 1 / reading.fps


def compressed_frames(
    path: Path, *, last_s: float | None = None
) -> Generator[tuple[float, bytes], None, None]:
    """Time stamp, s, and content of the compressed frames of a file, in its order.

    With `last_s` only about the last seconds, from a keyframe at least that long before the end. A
    VideoError means that the file cannot be read.
    """
    with closing(_Reading(path, FileState.of(path))) as reading:
        container, start_us = reading.container, reading.container.start_time or 0
        if last_s is not None and container.duration:
            with suppress(av.FFmpegError):  # some formats cannot seek
                container.seek(start_us + max(0, container.duration - round(last_s * av.time_base)))
        for packet in reading.with_frames():
            if packet.pts is not None and reading.has_clock:
                yield float(packet.pts * reading.time_base), bytes(packet)


class _Reading:
    """One reading of a file from its start; iterating gives the intact frames in order of time.

    `packets` were not decoded yet, see `_demuxed`; `notes` are messages about the header. Where the
    file has no clock (`has_clock`), `fps` gives the times.
    """

    def __init__(
        self, path: Path, state: FileState, track: int | None = None, fps: float | None = None
    ) -> None:
        self._path, self._state = path, state
        self.container, tracks = _open(path)
        self.tracks_px = tuple(
            (one.codec_context.width, one.codec_context.height) for one in tracks
        )
        depths = [_is_depth(one) for one in tracks]
        self.depth_tracks = frozenset(
            number for number, is_depth in enumerate(depths) if is_depth and not all(depths)
        )
        try:
            number = self._chosen(track)
            self.stream = _prepared(tracks[number])
            # since PyAV 17
            entries = itertools.islice(getattr(self.stream, "index_entries", ()), _MAX_ENTRIES)
            stamps = [entry.timestamp for entry in entries]
            _check_times(path, len(stamps), len(set(stamps)))
        except VideoError:
            self.container.close()
            raise
        self.log = DecodeLog()
        self.notes: list[str] = [] if track is not None else self._notes_on_tracks(number)
        self.time_base = self.stream.time_base or Fraction(1, 90_000)
        # AVI has a rate, but no timestamps: those that FFmpeg counts are out of order with
        # B-frames.
        is_avi = self.container.format.name == "avi"
        self.has_clock = has_clock(self.container, self.stream)
        self.fps = self._rate_hz(fps, is_counted=is_avi)
        if is_avi:
            self.time_base = 1 / Fraction(self.fps).limit_denominator(_MAX_DENOMINATOR)
        self._is_stamped = self.has_clock and not (
            is_avi and self.stream.codec_context.has_b_frames
        )
        # of the packets so far, in ticks of `time_base`, continued over resets
        self._last_stamp: int | None = None
        self._shift = 0  # from the clock of the file to the continued one, in ticks
        self.packets = self._demuxed()
        if self.container.format.name.endswith("_pipe"):
            self._check_several()
        self._decoded: deque[av.VideoFrame] = deque()
        self._from_s = math.inf  # damaged frames before the requested part do not count

    def _check_several(self) -> None:
        """Raise VideoError for a file of one image."""
        first = list(itertools.islice(self.with_frames(), 2))
        if len(first) < 2:
            self.container.close()
            raise VideoError(f"{self._path}: {_SINGLE_IMAGE}")
        self.packets = itertools.chain(first, self.packets)

    def _chosen(self, track: int | None) -> int:
        """The number of the track that is read, by default the largest one; raises VideoError."""
        numbers = range(len(self.tracks_px))
        if track is None:
            images = (number for number in numbers if number not in self.depth_tracks)
            return max(images, key=lambda number: math.prod(self.tracks_px[number]))
        if track not in numbers:
            raise VideoError(
                f"{self._path}: expected video track {track}, found "
                f"{counted(len(numbers), 'track')}, counted from 0; correct --track (Python: track)."
            )
        return track

    def _notes_on_tracks(self, number: int) -> list[str]:
        """A note on each track but the one that is read."""
        notes = []
        for other, size_px in enumerate(self.tracks_px):
            if other == number:
                continue
            pair = kind = ""
            if other in self.depth_tracks:
                kind = ", depth or infrared by its name or grey values"
            elif size_px == self.tracks_px[number]:
                pair = ", and --stereo FILE uses two of equal size as left and right"
            notes.append(
                f"{self._path}: video track {other} ({size_px[0]}x{size_px[1]} px{kind}) is left "
                f"out, track {number} is used; --track chooses another track{pair}."
            )
        return notes

    def _rate_hz(self, given_hz: float | None, *, is_counted: bool) -> float:
        """Nominal frame rate; notes if the stated one is not plausible, or missing and needed.

        `is_counted`: whether times follow from the stated rate, so that a given one replaces it.
        """
        codec = self.stream.codec_context
        rates = [self.stream.average_rate, self.stream.guessed_rate]
        largest_hz = _MAX_RATE_HZ
        if not self.has_clock:
            rates = [] if codec.name in _CLOCKED_CODECS else [codec.framerate]
        if is_counted or not self.has_clock:
            largest_hz = _MAX_STATED_HZ
            if given_hz is not None:
                return given_hz
        elif given_hz is not None:
            self.notes.append(f"{self._path}: has times, so that --fps is left out.")
        rates_hz = [float(rate) for rate in rates if rate]
        plausible_hz = [rate_hz for rate_hz in rates_hz if _MIN_RATE_HZ <= rate_hz <= largest_hz]
        if plausible_hz:
            return plausible_hz[0]
        if is_counted or not self.has_clock:
            self.notes.append(assumed_rate_note(self._path, _FALLBACK_RATE_HZ))
        elif rates_hz:
            self.notes.append(
                f"{self._path}: states {rates_hz[0]:.4g} frames/s, which is ignored; timestamps "
                "are used."
            )
        return _FALLBACK_RATE_HZ

    def declared_duration_s(self) -> tuple[float, bool]:
        """Duration stated by the header in s, 0 = none; and whether it counts from time 0 instead
        of the first frame.
        """
        container, stream = self.container, self.stream
        if not self.has_clock:
            return 0.0, False
        if container.format.name == "avi" and stream.frames:
            # FFmpeg's duration is not the header's
            return stream.frames / self.fps, False
        is_matroska = container.format.name.startswith("matroska")
        if stream.duration and stream.time_base and not is_matroska:
            return float(stream.duration * stream.time_base), False
        is_alone = len(container.streams) == 1  # otherwise it may be that of an audio stream
        return (container.duration or 0) / av.time_base if is_alone else 0.0, is_matroska

    def close(self) -> None:
        self.container.close()

    def with_frames(self) -> Iterator[Packet[VideoStream]]:
        """The packets that contain frames."""
        return (
            packet
            for packet in self.packets
            if packet is not None and packet.size and not packet.is_discard
        )

    def skip_to(self, from_s: float) -> None:
        """Skip the packets before the last keyframe at or before `from_s`; later frames do not
        depend on them.
        """
        self._from_s = from_s
        if not self._is_stamped:
            return
        stamp = (from_s + TIME_EPSILON_S) / float(self.time_base)
        first = (
            -math.inf
            if self.log.last_s is None
            else (self.log.last_s + TIME_EPSILON_S) / float(self.time_base)
        )
        waiting: list[Packet[VideoStream] | None] = []
        for packet in self.packets:
            is_before = packet is not None and packet.pts is not None and packet.pts <= stamp
            if (
                is_before
                and packet is not None
                and packet.is_keyframe
                and first < (packet.pts or 0)
            ):
                waiting.clear()
                self._decoded.clear()
                self.stream.codec_context.flush_buffers()
                self.log.restart()
            waiting.append(packet)
            if not is_before:
                break
        self.packets = itertools.chain(waiting, self.packets)

    def read_in_bursts(self, burst_s: float) -> None:
        """Skip the packets that come later than `burst_s` after a keyframe, if the next follows it."""
        if self._is_stamped:
            ticks = 1 / float(self.time_base)
            self.packets = in_bursts(self.packets, burst_s * ticks, _CLOSE_KEYFRAMES_S * ticks)

    def __iter__(self) -> Generator[tuple[int, float, av.VideoFrame], None, None]:
        """Number, time and image of the frames that were not read yet."""
        interval_s, log = 1 / self.fps, self.log
        while (frame := self._next_decoded()) is not None:
            stamp = (frame.dts if frame.pts is None else frame.pts) if self._is_stamped else None
            index = log.frame_index(stamp)
            stamp_s = None if stamp is None else float(stamp * self.time_base)
            time_s = strictly_later(self._unrounded(stamp_s), log.last_s, interval_s=interval_s)
            if time_s is None:
                log.n_backward += 1
                continue
            duration_s = float(frame.duration * self.time_base) if self._is_stamped else 0.0
            log.decoded(time_s, duration_s=duration_s or interval_s, interval_s=interval_s)
            if not (frame.is_corrupt or log.is_corrupt(stamp)):
                yield index, time_s, frame
            elif time_s >= self._from_s:
                log.n_damaged += 1

    def _unrounded(self, stamp_s: float | None) -> float | None:
        """The time of a frame at the nominal rate, if a file with whole milliseconds may have
        rounded it.
        """
        if stamp_s is None or self.time_base != _MILLISECOND:
            return stamp_s
        expected_s = round(stamp_s * self.fps) / self.fps
        return expected_s if abs(expected_s - stamp_s) <= _ROUNDING_S else stamp_s

    def _next_decoded(self) -> av.VideoFrame | None:
        """The next frame that can be decoded; None = the end of the file."""
        while not self._decoded:
            try:
                # None flushes the decoder
                self._decoded.extend(self.stream.decode(next(self.packets)))
            except StopIteration:
                return None
            except (av.FFmpegError, MemoryError):
                self._state.check_unchanged(self._path)
                self.log.n_damaged += 1
        return self._decoded.popleft()

    def _demuxed(self) -> Iterator[Packet[VideoStream] | None]:
        """The stream's packets, followed by None if the file cannot be read to its end."""
        packets = self.container.demux(self.stream)
        while True:
            try:
                packet = next(packets, None)
            except av.FFmpegError as error:
                self.log.stopped_by = error.strerror or str(error)
                yield None
                return
            # PyAV does not know a stream that begins later, as in transport streams of dashcams
            except IndexError:
                packets = self.container.demux(self.stream)
                continue
            if packet is None:
                return
            if packet.size and not packet.is_discard:
                self._continue_clock(packet)
                self.log.packet(packet.pts, is_corrupt=packet.is_corrupt)
            yield packet

    def _continue_clock(self, packet: Packet[VideoStream]) -> None:
        """Let the times of a packet follow on where the clock of the file was set back, as in
        joined files.
        """
        stamp, last = packet.dts if packet.dts is not None else packet.pts, self._last_stamp
        if stamp is None or not self._is_stamped:
            return
        tick_s = float(self.time_base)
        if last is not None and self._shift and 0 < (stamp - last) * tick_s < _RESET_S:
            self._shift = 0  # a single wrong time, or the clock continues
        elif last is not None and not (
            -_RESET_S <= (stamp + self._shift - last) * tick_s <= _MAX_GAP_S
        ):
            self._shift = last + round(1 / (self.fps * tick_s)) - stamp
            self.log.resets_s.append(last * tick_s)
        if self._shift:
            packet.dts = None if packet.dts is None else packet.dts + self._shift
            packet.pts = None if packet.pts is None else packet.pts + self._shift
        self._last_stamp = stamp + self._shift


def in_bursts(
    packets: Iterator[Packet[VideoStream] | None], burst: float, longest: float
) -> Iterator[Packet[VideoStream] | None]:
    """The packets up to `burst` after each keyframe in the order of decoding, or all of them if the
    next keyframe does not follow within `longest`; both in ticks.

    No packet depends on one that was left out; those before the first keyframe are all read.
    """
    key, first = -math.inf, -math.inf
    waiting: list[Packet[VideoStream] | None] = []
    for packet in packets:
        stamp, shown = _stamps(packet)
        if packet is not None and packet.is_keyframe:
            # pictures of earlier times that follow a keyframe depend on those before it
            first = shown if waiting else -math.inf
            key = stamp
            waiting.clear()
        elif not stamp <= key + longest:  # also without a time
            yield from waiting
            waiting.clear()
            key = math.inf
        if waiting or stamp > key + burst:
            waiting.append(packet)
        elif not shown < first:
            yield packet
    yield from waiting


def _stamps(packet: Packet[VideoStream] | None) -> tuple[float, float]:
    """Times of decoding and of the picture, in ticks; NaN = unknown."""
    if packet is None:
        return math.nan, math.nan
    shown = math.nan if packet.pts is None else packet.pts
    return shown if packet.dts is None else packet.dts, shown


def _check_times(path: Path, n_frames: int, n_times: int) -> None:
    """Raise a VideoError if nearly all of `n_frames` frames have a time that another frame has
    already.
    """
    if n_frames >= _MIN_SHARED * n_times > 0:
        raise VideoError(
            f"{path}: expected a time for each frame, found {counted(n_times, 'time')} for "
            f"{n_frames} frames; copy the video again, or store it with its frame rate (ffmpeg -r "
            "RATE -i IN OUT.mp4)."
        )


def _display_axes(frame: av.VideoFrame) -> tuple[int, int, int, int]:
    """Axes of `DecodedImage`, which rotate the stored image upright as players do."""
    try:
        # PyAV's type hint is too narrow
        side = cast(SideDataContainer, frame.side_data)[SideDataType.DISPLAYMATRIX]
    except KeyError:
        return UPRIGHT
    a, b, _, c, d = (int(sign) for sign in np.sign(np.frombuffer(bytes(side), np.int32)[:5]))
    is_right_angle = (a == d == 0 and b and c) or (b == c == 0 and a and d)
    return (a, b, c, d) if is_right_angle else UPRIGHT


# by the type and the flag `inverted` of FFmpeg's AVStereo3D
_STEREO_3D: dict[tuple[int, int], StereoLayout] = {
    (1, 0): "side-by-side",
    (1, 1): "right-left",
    (2, 0): "top-bottom",
    (2, 1): "bottom-top",
}


def _stated_layout(frame: av.VideoFrame) -> StereoLayout | None:
    """The layout of a stereo image that a file states; None if it states none."""
    try:
        side = cast(SideDataContainer, frame.side_data)[SideDataType.STEREO3D]
    except KeyError:
        return None
    kind, flags = (int(value) for value in np.frombuffer(bytes(side), np.int32)[:2])
    return _STEREO_3D.get((kind, flags & 1))


def _open(path: Path) -> tuple[InputContainer, list[VideoStream]]:
    """The container and its video tracks that can be decoded, without cover art."""
    try:
        # "file:", since a name may look like a URL
        container = av.open(f"file:{path}", mode="r", options=_OPTIONS, metadata_errors="replace")
    except (av.FFmpegError, ValueError, MemoryError) as error:
        raise VideoError(f"{path}: {_unreadable_reason(path)}") from error
    try:
        videos = (stream for stream in container.streams.video if not stream.disposition & _STILL)
        tracks = [stream for stream in videos if stream.codec_context is not None]  # can be decoded
        tracks = [stream for stream in tracks if stream.frames != 1] or tracks
        if not tracks:
            raise VideoError(
                f"{path}: contains no video; give a video file or a folder of numbered images."
            )
        for stream in tracks:
            check_size(path, (stream.codec_context.width, stream.codec_context.height), VideoError)
    except VideoError:
        container.close()
        raise
    return container, tracks


def _is_depth(stream: VideoStream) -> bool:
    """Whether the name of a track says so, or its pixels are one grey value of more than 8 bits."""
    if any(_DEPTH.search(stream.metadata.get(key, "")) for key in ("title", "handler_name")):
        return True
    pixels = stream.codec_context.format
    return pixels is not None and [part.bits > 8 for part in pixels.components] == [True]


def _prepared(stream: VideoStream) -> VideoStream:
    """The stream with the options for decoding it."""
    stream.thread_type = "AUTO"
    stream.thread_count = DECODER_THREADS
    stream.codec_context.options = {**stream.codec_context.options, "max_pixels": str(MAX_PIXELS)}
    return stream


ZED_SENTENCE = (
    "a recording of a ZED camera (SVO), which only its SDK can read; export it with ZED's sample "
    "SVO Export as an AVI of both images beside each other, give this file with --stereo FILE "
    "--stereo-layout side-by-side (Python: stereo_layout), and the camera's factory calibration "
    "SN*.conf with --rig."
)


_NO_VIDEO = (
    "not a video, or damaged at its start; give a video file or a folder of numbered images."
)
_SINGLE_IMAGE = (
    "expected a video, got a single image; give a video file or a folder of numbered images."
)
# of the suffix of a file, a new line and its start: what it is, and what to do
_NO_VIDEOS = (
    (
        rb"[^\n]*\n\s*(#EXTM3U|\[playlist\]|ffconcat|(<\?xml[^>]*>\s*)?<MPD)",
        "expected a video, found a playlist, which names other files; give these files, or the "
        "folder that contains them (join fragments .m4s behind their first file).",
    ),
    (
        rb"[^\n]*\nv=0\s+o=",
        "expected a video, found the description of a stream (SDP); give the address of the "
        "stream.",
    ),
    (
        rb"\.(yuv|i420|nv12|nv21|yuyv|uyvy|rgb|bgr|rgba|gray|grey)\n",
        "expected a video, found pixels without a header, of unknown size and rate; store them as "
        "one (ffmpeg -f rawvideo -pixel_format yuv420p -video_size WxH -framerate RATE -i IN "
        "OUT.mkv).",
    ),
    (rb"\.svo2?\n", ZED_SENTENCE),
    (
        rb"[^\n]*\n.{4}(styp|moof|sidx)",
        "expected a video, found a fragment of one, as of HLS or DASH; join the first file of the "
        "stream and its fragments in their order (cat init.mp4 *.m4s > drive.mp4).",
    ),
    (
        rb"[^\n]*\n.{4}ftyp",
        "this MP4 file has no index, since recording or copying was cut off; copy it again, or "
        "repair it.",
    ),
)


def _unreadable_reason(path: Path) -> str:
    try:
        with path.open("rb") as file:
            is_image = header_size_px(file) is not None
            file.seek(0)
            start = file.read(_START_BYTES).removeprefix(codecs.BOM_UTF8)
    except OSError as error:
        return f"cannot be read ({error.strerror}); check its permissions."
    if is_image:
        return _SINGLE_IMAGE
    if not start:
        return "the file is empty; copy or record it again."
    shown = path.suffix.lower().encode() + b"\n" + start
    kinds = (sentence for pattern, sentence in _NO_VIDEOS if re.match(pattern, shown, re.DOTALL))
    return next(kinds, _NO_VIDEO)
