"""Fixtures of tests with recordings that people own."""

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import pytest


@pytest.fixture(scope="session")
def cut() -> Callable[..., Path]:
    """Copies a video from one frame on, with times from 0: `cut(source, path, first=14)`."""

    def copied(source: Path, path: Path, *, first: int) -> Path:
        with av.open(str(source)) as container, av.open(str(path), "w") as target:
            stream = container.streams.video[0]
            rate = stream.average_rate or Fraction(10)
            copy = target.add_stream("libx264", rate=rate, options={"crf": "16"})
            copy.width, copy.height, copy.pix_fmt = stream.width, stream.height, "yuv420p"
            for number, frame in enumerate(container.decode(stream)):
                if number >= first:
                    shown = frame.reformat(format="yuv420p")
                    shown.pts, shown.time_base = number - first, 1 / rate
                    target.mux(copy.encode(shown))
            target.mux(copy.encode(None))
        return path

    return copied
