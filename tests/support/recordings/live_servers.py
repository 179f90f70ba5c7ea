"""Simulated cameras: local TCP streams of grey images with a level that encodes the image's
number."""

from __future__ import annotations

import socket
import struct
import threading
import wave
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from fractions import Fraction
from io import BytesIO
from typing import Any

import av
import cv2
import numpy as np

RATE_HZ = 100
FIRST_LEVEL, LEVEL_STEP, N_LEVELS = 20, 4, 50


def level_image(number: int) -> np.ndarray:
    return np.full((48, 64, 3), FIRST_LEVEL + LEVEL_STEP * (number % N_LEVELS), np.uint8)


def number_of(image: np.ndarray) -> int:
    """The number of an image, modulo `N_LEVELS`."""
    return round((float(image.mean()) - FIRST_LEVEL) / LEVEL_STEP)


class Camera:
    """Sends an image every 10 ms to the first client until it is unplugged or has sent `n_images`.

    The images are grey with the level of their number, or `images` in turn.

    Attributes:
        url: address of the stream.
        interval_s: time between images.
        is_torn: whether the connection is reset at the end instead of closed.
    """

    def __init__(
        self,
        n_images: int = 10_000,
        *,
        is_torn: bool = False,
        images: Sequence[np.ndarray] = (),
        rate_hz: int = RATE_HZ,
        pixel_aspect: Fraction = Fraction(1),
    ) -> None:
        self.n_images, self.is_torn, self.interval_s = n_images, is_torn, 1 / rate_hz
        self._images, self._rate_hz, self._pixel_aspect = images, rate_hz, pixel_aspect
        self.unplugged = threading.Event()
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.url = f"tcp://127.0.0.1:{self._socket.getsockname()[1]}"
        self.thread = threading.Thread(target=self._serve, daemon=True)
        self.thread.start()

    def _serve(self) -> None:
        with suppress(OSError), self._socket.accept()[0] as connection:
            sent = connection.makefile("wb", 0)
            with suppress(av.FFmpegError, OSError):
                self._send(sent)
            if self.is_torn:
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            sent.close()

    def _send(self, sent: Any) -> None:
        options = {"tune": "zerolatency", "preset": "ultrafast", "crf": "5"}
        with av.open(sent, "w", format="nut") as container:
            stream = container.add_stream("libx264", rate=self._rate_hz, options=options)
            height, width = (self._images[0] if self._images else level_image(0)).shape[:2]
            stream.width, stream.height, stream.pix_fmt, stream.gop_size = (
                width,
                height,
                "yuv420p",
                5,
            )
            stream.codec_context.sample_aspect_ratio = self._pixel_aspect
            for number in range(self.n_images):
                if self.unplugged.wait(self.interval_s):
                    break
                image = (
                    self._images[number % len(self._images)]
                    if self._images
                    else level_image(number)
                )
                planes = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2YUV_I420), np.uint8)
                frame = av.VideoFrame.from_ndarray(planes, format="yuv420p")
                frame.pts, frame.time_base = number, Fraction(1, self._rate_hz)
                container.mux(stream.encode(frame))
            if self.is_torn:
                raise ConnectionAbortedError

    def close(self) -> None:
        self.unplugged.set()
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        self.thread.join(20)


@contextmanager
def cameras(n: int, n_images: int = 10_000, *, is_torn: bool = False) -> Iterator[list[Camera]]:
    """`n` cameras, unplugged at the end."""
    opened = [Camera(n_images, is_torn=is_torn) for _ in range(n)]
    try:
        yield opened
    finally:
        for camera in opened:
            camera.close()


@contextmanager
def served(content: bytes, *, stays: bool = False) -> Iterator[str]:
    """The address of a server that sends `content`, then closes the connection or, with `stays`,
    sends nothing more."""
    over = threading.Event()
    server = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        with suppress(OSError), server.accept()[0] as connection:
            connection.sendall(content)
            if stays:
                over.wait(30)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"
    finally:
        over.set()
        with suppress(OSError):
            server.shutdown(socket.SHUT_RDWR)
        server.close()
        thread.join(20)


def sound() -> bytes:
    """Content of a WAV file, which contains no video."""
    file = BytesIO()
    with wave.open(file, "wb") as written:
        written.setnchannels(1)
        written.setsampwidth(2)
        written.setframerate(8000)
        written.writeframes(bytes(16000))
    return file.getvalue()
