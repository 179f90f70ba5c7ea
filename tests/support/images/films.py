"""Videos with identifiable frames, each with a grey level given by its number; and noise."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np

FIRST_LEVEL, LEVEL_STEP = 24, 4
N_NOISE_FRAMES = 20


def level_image(number: int, *, width_px: int = 64, height_px: int = 48) -> np.ndarray:
    return np.full((height_px, width_px, 3), FIRST_LEVEL + LEVEL_STEP * number, np.uint8)


def number_of(image: np.ndarray) -> int:
    return round((float(image.mean()) - FIRST_LEVEL) / LEVEL_STEP)


def write_film(
    path: Path,
    times_s: Sequence[float],
    *,
    images: Sequence[np.ndarray] | None = None,
    codec: str = "libx264",
    gop: int = 6,
    rotation: tuple[float, bool, bool] | None = None,
    options: dict[str, str] | None = None,
    aspect: Fraction = Fraction(1),
    rate: int = 10,
    metadata: dict[str, str] | None = None,
) -> Path:
    """A video with one image per time; H.264 with B-frames by default."""
    images = [level_image(number) for number in range(len(times_s))] if images is None else images
    clock = Fraction(1, rate if path.suffix == ".avi" else 90_000)  # AVI has frames, not times
    with av.open(str(path), "w", options=options or {}) as container:
        container.metadata.update(metadata or {})
        stream: Any = container.add_stream(codec, rate=rate)
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.codec_context.time_base, stream.codec_context.gop_size = clock, gop
        stream.codec_context.sample_aspect_ratio = aspect
        if rotation is not None:
            stream.set_display_rotation(*rotation)
        for time_s, image in zip(times_s, images, strict=True):
            frame = av.VideoFrame.from_ndarray(
                cv2.cvtColor(image, cv2.COLOR_BGR2YUV_I420), format="yuv420p"
            )
            frame.pts, frame.time_base = round(time_s / clock), clock
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def noise(n: int) -> list[np.ndarray]:
    """n images of 64x48, the same ones in each call."""
    return list(np.random.default_rng(3).integers(0, 256, (n, 48, 64, 3), np.uint8))
