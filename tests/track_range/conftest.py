"""Videos with identifiable frames, each with a grey level given by its number; and a browser."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

FIRST_LEVEL, LEVEL_STEP = 24, 4


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


@pytest.fixture(scope="session")
def film() -> Callable[..., Path]:
    """Writes a video: `film(path, times_s, ...)`, see `write_film`."""
    return write_film


@pytest.fixture(scope="session")
def level() -> Callable[..., np.ndarray]:
    """The image of a number: `level(number, width_px=64, height_px=48)`."""
    return level_image


@pytest.fixture(scope="session")
def number_in() -> Callable[[np.ndarray], int]:
    """Number of an image of such a video, from its grey level."""
    return number_of


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Playwright's own Chromium, else the system's; skipped, with the reason, if there is none."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed (extra dev)"
    )
    with playwright.sync_playwright() as started:
        own = Path(started.chromium.executable_path)
        names = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
        program = str(own) if own.is_file() else next(filter(None, map(shutil.which, names)), None)
        if program is None:
            pytest.skip("no Chromium here: neither playwright's own nor one on the PATH")
        try:
            launched = started.chromium.launch(executable_path=program, args=["--no-sandbox"])
        except playwright.Error as error:
            pytest.skip(f"{program} does not start here: {str(error).splitlines()[0]}")
        yield launched
        launched.close()
