"""VideoWriter: H.264 in a fragmented MP4, which is playable up to its last fragment however the
program ends.

Each frame is a fragment, which is written when the next frame arrives. Every second there is a
keyframe, to which players can seek. Frame times are preserved: pts = (time_s - first time_s) * 90
kHz.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from fractions import Fraction
from pathlib import Path
from typing import Any, Self, cast

import av
import cv2
import numpy as np
import numpy.typing as npt
from av.video.frame import PictureType
from av.video.stream import VideoStream

from track_range.foundation.arrays import Image, check_shape
from track_range.recording.video.frame import VideoError

_ENCODER = "libx264"
# MPEG's clock rate; the frame interval of every common rate is a whole number of its ticks
_TICKS_HZ = 90_000
_KEYFRAME_INTERVAL_S = 1.0
# size of the muxer's buffer: a fragment of one frame fits, and is written with one system call
_BUFFER_BYTES = 1 << 18

_MUXER_OPTIONS = {"movflags": "empty_moov+default_base_moof+frag_every_frame", "flush_packets": "1"}
"""One frame per fragment: 0.1 % larger than 0.2 s per fragment (KITTI 0003 at 10 frames/s), and as
fast."""

_FASTEST = "ultrafast"
_KEPT_BLOCKS = {"x264-params": "dct-decimate=0"}
"""Blocks with few coefficients are kept: at this preset, looking for them takes an eighth to a
fifth of the time, and saves 3 % of the size.
"""

MAX_HELD_FRAMES = 1  # number of frames that the muxer holds, and that a kill therefore loses
# FFmpeg's AVCOL_SPC_BT470BG, the colour space of OpenCV's I420 conversion; players need it in the
# header
_BT601 = 5
_LIMITED_RANGE = 1  # FFmpeg's AVCOL_RANGE_MPEG: luma from 16 to 235
_LAST_BOXES = (b"moov", b"mdat")  # box types that end the header and each fragment of an MP4 file


class VideoWriter:
    """Writes an MP4 file (H.264, yuv420p) frame by frame; a context manager.

    Images with an odd size are extended by a copy of the last column or row, since the codec needs
    even sizes.

    Args:
        path: the file; replaced if it exists.
        width_px: width of the images.
        height_px: height of the images.
        fps: nominal frame rate, for the duration of the last frame.
        crf: x264's constant rate factor, 0 (lossless) to 51; x264's default is 23.
        quantizer: constant quantizer, 0 to 51, instead of `crf`; faster, since x264 need not
            analyse each image first.
        preset: x264's speed preset. A frame of 1242x374 px of KITTI 0003 at crf 23 takes on one
            core: ultrafast 4.2 ms and 73 kB at 32.4 dB, superfast 9 ms and 49 kB at 31.0 dB,
            veryfast 12 ms and 37 kB at 30.1 dB.
        n_threads: number of encoder threads.

    Raises VideoError: the file cannot be written (also raised by `write` and `close`; it is then
    cut back to its last complete frame), or FFmpeg lacks x264.
    """

    def __init__(
        self,
        path: Path,
        *,
        width_px: int,
        height_px: int,
        fps: float,
        crf: int = 23,
        quantizer: int | None = None,
        preset: str = _FASTEST,
        n_threads: int = 1,
    ) -> None:
        self.path = path
        self._shape = (height_px, width_px, 3)
        self._frame_ticks = max(1, round(_TICKS_HZ / fps))
        self._first_s = self._last_s = 0.0
        self._last_tick = self._keyframe_tick = -1
        self._is_open = True
        # Zero latency disables the encoder's look-ahead, so that every frame is in the file as soon
        # as it is written.
        options = {"preset": preset, "tune": "zerolatency", "forced-idr": "1"}
        if preset == _FASTEST:
            options |= _KEPT_BLOCKS
        options |= {"crf": str(crf)} if quantizer is None else {"qp": str(quantizer)}
        try:
            av.Codec(_ENCODER, "w")
        except av.codec.codec.UnknownCodecError as error:
            raise VideoError(
                f"{_ENCODER}: PyAV's FFmpeg lacks this encoder, which writing videos needs; "
                "install the official `av` wheel, or run without the overlay."
            ) from error
        with self._video_errors():
            self._file = FragmentFile(path)
        try:
            with self._video_errors():
                self._start(options, fps, n_threads)
        except BaseException:
            self._file.close()
            raise

    def _start(self, options: dict[str, str], fps: float, n_threads: int) -> None:
        self._container = av.open(
            self._file, mode="w", format="mp4", options=_MUXER_OPTIONS, buffer_size=_BUFFER_BYTES
        )
        stream = self._container.add_stream(
            _ENCODER, rate=Fraction(fps).limit_denominator(1001), options=options
        )
        self._stream = cast(VideoStream, stream)
        height_px, width_px, _ = self._shape
        codec = self._stream.codec_context
        codec.width, codec.height, codec.pix_fmt = (
            width_px + width_px % 2,
            height_px + height_px % 2,
            "yuv420p",
        )
        codec.time_base, codec.thread_count = Fraction(1, _TICKS_HZ), n_threads
        codec.colorspace, codec.color_range = _BT601, _LIMITED_RANGE
        self._container.start_encoding()

    def write(self, image: Image, time_s: float) -> None:
        """Append an image; times in the file count from the first image.

        `image`: (height_px, width_px, 3) uint8 BGR. `time_s`: time of the image, later than the
        time of the previous image. Raises ValueError: another shape, a time that does not increase,
        or a closed writer. Raises VideoError: the file cannot be written.
        """
        check_shape("image", image, self._shape)
        if not self._is_open:
            raise ValueError(f"{self.path}: the writer is closed")
        if self._last_tick < 0:
            self._first_s = time_s
        elif time_s <= self._last_s:
            raise ValueError(f"time_s: expected later than {self._last_s}, got {time_s}")
        self._last_s = time_s
        # Times less than a tick apart still get different ticks.
        self._last_tick = tick = max(
            self._last_tick + 1, round((time_s - self._first_s) * _TICKS_HZ)
        )
        frame = _video_frame(_i420(image))
        frame.pts, frame.time_base, frame.duration = tick, Fraction(1, _TICKS_HZ), self._frame_ticks
        if (
            self._keyframe_tick < 0
            or tick - self._keyframe_tick >= _KEYFRAME_INTERVAL_S * _TICKS_HZ
        ):
            frame.pict_type, self._keyframe_tick = PictureType.I, tick
        with self._video_errors():
            self._container.mux(self._stream.encode(frame))

    def close(self) -> None:
        """Finish the file; a second call does nothing. VideoError if the file cannot be written."""
        if not self._is_open:
            return
        self._is_open = False
        with self._video_errors():
            try:
                if self._last_tick >= 0:
                    self._container.mux(self._stream.encode(None))
            finally:
                try:
                    self._container.close()
                finally:
                    self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    @contextmanager
    def _video_errors(self) -> Iterator[None]:
        try:
            yield
            if self._file.failure is not None:
                raise self._file.failure
        except (av.FFmpegError, OSError) as error:
            reason = error.strerror or str(error)
            raise VideoError(
                f"{self.path}: the video cannot be written ({reason}); choose an existing, "
                "writable folder with free space."
            ) from error


def _i420(image: Image) -> Image:
    """(1.5 * H, W) uint8 planes Y, U, V of a BGR image extended to an even size; 8 times as fast as
    FFmpeg's scaler.
    """
    height_px, width_px = image.shape[:2]
    even: npt.NDArray[Any] = image
    if height_px % 2 or width_px % 2:
        even = cv2.copyMakeBorder(image, 0, height_px % 2, 0, width_px % 2, cv2.BORDER_REPLICATE)
    return cv2.cvtColor(even, cv2.COLOR_BGR2YUV_I420).astype(np.uint8, copy=False)


def _video_frame(planes: Image) -> av.VideoFrame:
    """The frame of planes (1.5 * H, W), without a copy if H is a multiple of 4: PyAV has a wrong
    number of rows for others.
    """
    is_multiple = len(planes) % 6 == 0
    create = av.VideoFrame.from_numpy_buffer if is_multiple else av.VideoFrame.from_ndarray
    return create(planes, format="yuv420p")


class FragmentFile:
    """File object for `av.open`: not seekable, and without further writing after the first error.

    After a failed write FFmpeg continues with the next packets, which would make the file
    unplayable from there on or, if the failure was in a header, altogether. `failure`: the first
    error; None = all data was written. The file then ends with its last complete fragment.
    """

    def __init__(self, path: Path) -> None:
        self.failure: OSError | None = None
        self._file = path.open("wb", buffering=0)
        # in bytes; up to the end of the last complete fragment
        self._size = self._complete_size = 0
        self._header = bytearray()  # of the current box: size and type
        self._box_left = 0  # bytes

    def write(self, data: bytes) -> int:
        """Append data; errors are stored as `failure` instead of raised, so that FFmpeg frees its
        memory as usual.
        """
        if self.failure is None:
            try:
                rest = memoryview(data)
                while rest:
                    # less than all is written shortly before the disk is full
                    rest = rest[self._file.write(rest) :]
            except OSError as error:
                self.failure = error
                with suppress(OSError):  # pipes and devices cannot be cut
                    os.ftruncate(self._file.fileno(), self._complete_size)
            else:
                self._count(data)
        return len(data)

    def close(self) -> None:
        """Close the file; OSError if the file system reports an error only now."""
        self._file.close()

    def _count(self, data: bytes) -> None:
        """Follow the boxes of the file (ISO/IEC 14496-12, 4.2) to the end of the last complete
        fragment.
        """
        start = 0
        while start < len(data):
            if self._box_left == 0:
                # 1 = the size follows the type, as 64 bits
                n_bytes = 16 if self._header[:4] == b"\0\0\0\1" else 8
                part = data[start : start + n_bytes - len(self._header)]
                self._header += part
                start += len(part)
                if len(self._header) < n_bytes or (
                    n_bytes == 8 and self._header[:4] == b"\0\0\0\1"
                ):
                    continue
                size = self._header[8:16] if n_bytes == 16 else self._header[:4]
                self._box_left = int.from_bytes(size, "big") - n_bytes
            else:
                n_bytes = min(self._box_left, len(data) - start)
                start += n_bytes
                self._box_left -= n_bytes
            if self._box_left == 0:
                if bytes(self._header[4:8]) in _LAST_BOXES:
                    self._complete_size = self._size + start
                self._header.clear()
        self._size += len(data)
