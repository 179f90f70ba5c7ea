"""Synthetic results of one frame for the tests of the overlay."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.support.results.frame_results import frame_result
from track_range.foundation.arrays import BoolArray, Image
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.measurement.ranges import Ranges
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

HEIGHT, WIDTH = 374, 1242
BOX = [500.0, 200.0, 620.0, 280.0]


def grey(height: int = HEIGHT, width: int = WIDTH) -> Image:
    return np.full((height, width, 3), 128, np.uint8)


def result(
    boxes: list[list[float]],
    *,
    image: Image | None = None,
    observed: bool = True,
    ranges: dict[str, tuple[float, float]] | None = None,
    closing: tuple[float, float] = (np.nan, np.nan),
    index: int = 7,
    time_s: float = 0.723,
    **more: Any,
) -> FrameResult:
    """Cars 1, 2, ... in these boxes, all at the same distance; `ranges`: metres and sigma by
    method."""
    n = len(boxes)
    ids = np.arange(1, n + 1)
    tracks = Tracks(
        ids, np.array(boxes).reshape(-1, 4), np.full(n, 2), np.ones(n), np.full(n, observed)
    )
    distances = (
        {"mono": (23.1, 1.5), "stereo": (22.4, 0.5), "fused": (22.5, 0.45)}
        if ranges is None
        else ranges
    )
    ranges_by_name = {
        name: Ranges(ids, np.full(n, metres), np.full(n, sigma))
        for name, (metres, sigma) in distances.items()
    }
    given = {
        "closing_mps": np.full(n, closing[0]),
        "closing_sigma_mps": np.full(n, np.nan),
        "ttc_s": np.full(n, closing[1]),
        "ttc_sigma_s": np.full(n, np.nan),
        "xyz_m": np.full((n, 3), np.nan),
    }
    frame = Frame(index, time_s, grey() if image is None else image, None)
    return frame_result(frame, tracks, ranges_by_name, **(given | more))


def painted(image: Image, colour: tuple[int, int, int]) -> BoolArray:
    """Mask of the pixels of exactly this colour."""
    return np.asarray((image == np.array(colour, np.uint8)).all(axis=2))
