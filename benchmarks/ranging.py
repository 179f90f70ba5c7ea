"""Ranging: time per frame of the methods that need boxes only, of fusing and filtering, and of the lane finders.

Boxes: road users of several classes at 8-80 m on one road, seen by a KITTI-like camera, moved by half a pixel from
frame to frame; every method is asked as a run asks it, lane without stereo to learn from; stereo, which costs
what it costs elsewhere, is drawn at random and matches four boxes of five.
Medians over frames of processor time, in turn method by method, so that all see the same machine; on one thread. Goals
for 50 tracks: mono, ground and lane together under 0.5 ms, fusing and the three filters together under 1 ms.
Lane finders look at the frames of a dash camera's video, where it is there; networks on one thread.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.inputs.drives import REAL_DATA
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.lanes.lines import LaneLine, LaneLines
from track_range.detection.lanes.nets import CLASSICAL, open_lane_finder
from track_range.detection.models.onnx_session import Runtime
from track_range.foundation.arrays import Image
from track_range.ranging.filtering.distance_filter import DistanceFilters
from track_range.ranging.fusion.fusion import Fusion
from track_range.ranging.method import MethodContext
from track_range.ranging.ranges import Ranges
from track_range.ranging.registry import create_rangers, methods
from track_range.run.pipeline import noise_shares
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks
from track_range.video.file import VideoFile

CAMERA = PinholeCamera(721.5, 721.5, 609.6, 172.9, 1242, 375)
CAMERA_HEIGHT_M, LANE_WIDTH_M = 1.65, 3.5
KINDS_HW_M = {"car": (1.5, 1.8), "person": (1.7, 0.6), "truck": (3.3, 2.5), "bicycle": (1.7, 0.6)}
SHARES = (0.6, 0.2, 0.1, 0.1)
STEP_S = 0.1
FUSE_STAGE = ("fuse", "filters")
STEREO_SIGMA_PER_M, STEREO_SHARE = 0.002, 0.8
"""Of stereo: relative sigma per metre of distance, and of how many boxes it has one."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this workload."""
    parser.add_argument("--tracks", type=int, nargs="+", default=[1, 6, 50], help="numbers of tracks")
    parser.add_argument("--frames", type=int, default=600)
    parser.add_argument("--lane-frames", type=int, default=60)
    parser.add_argument("--video", type=Path, default=REAL_DATA / "dashcam" / "solid_white_right.mp4")
    models = REAL_DATA / "models"
    nets = [models / "twinlitenet_360x640.onnx", models / "lstr_tusimple_360x640.onnx"]
    parser.add_argument("--lane-nets", type=Path, nargs="*", default=[path for path in nets if path.is_file()])


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Run all of it, print the tables, and return milliseconds per frame."""
    by_tracks = {str(n): box_only_ms(n, n_frames=options.frames) for n in options.tracks}
    images = _images(options.video, options.lane_frames) if options.video.is_file() else []
    finders = {word: _lanes_ms(word, images) for word in (CLASSICAL, *map(str, options.lane_nets)) if images}
    _print(by_tracks, finders)
    return {"ms_by_tracks": by_tracks, "lane_finders_ms": finders}


def box_only_ms(n_tracks: int, *, n_frames: int) -> dict[str, float]:
    """Median time of each method and of what a run makes of them, for so many tracks."""
    rangers = create_rangers(MethodContext(camera=CAMERA, has_lane_lines=True))
    reads = {method.name: method.reads for method in methods()}
    fusion, filters = Fusion(), DistanceFilters(noise_shares())
    tracks, lines = _tracks(n_tracks), _lines()
    watch = _Watch()
    for index in range(n_frames):
        now, frame = _moved(tracks, index), Frame(index, index * STEP_S, _BLANK, None)
        ranges: dict[str, Ranges] = {}
        for name, ranger in rangers.items():
            others = {other: ranges[other] for other in reads[name] if other in ranges}
            with watch.timing(name):
                ranger.update_lanes(lines)
                ranges[name] = ranger.measure_with(now, frame, others)
        ranges["stereo"] = _stereo(tracks, index)
        with watch.timing(FUSE_STAGE[0]):
            fused = fusion.fuse(ranges, now.track_id, frame.time_s)
        ranges["fused"] = fused.ranges
        with watch.timing(FUSE_STAGE[1]):
            filters.update(ranges, frame.time_s, conditions={"fused": fused.condition})
    median = watch.median_ms
    sums = {"box-only methods": tuple(rangers), "fusing and filtering": FUSE_STAGE}
    return {**median, **{name: sum(median[part] for part in parts) for name, parts in sums.items()}}


class _Watch:
    """Processor time that each job took, time after time."""

    def __init__(self) -> None:
        self._times_s: dict[str, list[float]] = {}

    @contextmanager
    def timing(self, name: str) -> Iterator[None]:
        """Time the with-block."""
        began_s = time.process_time()
        yield
        self._times_s.setdefault(name, []).append(time.process_time() - began_s)

    @property
    def median_ms(self) -> dict[str, float]:
        return {name: 1e3 * statistics.median(values) for name, values in self._times_s.items()}


_BLANK: Image = np.zeros((CAMERA.height_px, CAMERA.width_px, 3), np.uint8)


def _tracks(n: int) -> Tracks:
    rng = np.random.default_rng(0)
    kind = rng.choice(len(KINDS_HW_M), n, p=SHARES)
    class_id = np.array([ROAD_CLASSES.index(name) for name in KINDS_HW_M])[kind]
    height, width = (np.array(list(KINDS_HW_M.values())) * CAMERA.fx_px)[kind].T
    z, x = rng.uniform(8.0, 80.0, n), rng.uniform(-6.0, 6.0, n)
    column, bottom = CAMERA.cx_px + CAMERA.fx_px * x / z, CAMERA.cy_px + CAMERA.fy_px * CAMERA_HEIGHT_M / z
    xyxy_px = np.stack([column - width / z / 2, bottom - height / z, column + width / z / 2, bottom], axis=1)
    return Tracks(np.arange(1, n + 1), xyxy_px, class_id, np.ones(n), np.ones(n, np.bool_))


def _moved(tracks: Tracks, index: int) -> Tracks:
    xyxy_px = tracks.xyxy_px + np.random.default_rng(index).normal(0.0, 0.5, tracks.xyxy_px.shape)
    return Tracks(tracks.track_id, xyxy_px, tracks.class_id, tracks.score, tracks.observed)


def _stereo(tracks: Tracks, index: int) -> Ranges:
    """What stereo might say of boxes that stand on the road."""
    rng = np.random.default_rng(index)
    true_m = CAMERA.fy_px * CAMERA_HEIGHT_M / (tracks.xyxy_px[:, 3] - CAMERA.cy_px)
    sigma = STEREO_SIGMA_PER_M * true_m
    distance_m = np.where(rng.random(len(tracks)) < STEREO_SHARE, true_m * np.exp(rng.normal(0.0, sigma)), np.nan)
    return Ranges(tracks.track_id, distance_m, distance_m * sigma)


def _lines() -> LaneLines:
    """The lane that the camera drives in the middle of."""
    slope = LANE_WIDTH_M / CAMERA_HEIGHT_M / 2
    left, right = (
        LaneLine(
            np.array([CAMERA.cx_px - side * slope * CAMERA.cy_px, side * slope, 0.0]),
            np.diag([1.0, 1e-5, 1e-12]),
            CAMERA.cy_px + 15.0,
            CAMERA.height_px - 1.0,
        )
        for side in (-1.0, 1.0)
    )
    return LaneLines(left, right)


def _images(video: Path, n: int) -> list[Image]:
    with closing(VideoFile(video).frames(0.0, math.inf)) as frames:
        return [frame.image for frame in islice(frames, n)]


def _lanes_ms(word: str, images: Sequence[Image]) -> float:
    finder = open_lane_finder(word, Runtime(n_threads=1, device="cpu"))
    watch = _Watch()
    for index, image in enumerate(images):
        with watch.timing(word):
            finder.find(image, index * STEP_S)
    return watch.median_ms[word]


def _print(by_tracks: dict[str, dict[str, float]], finders: dict[str, float]) -> None:
    table = Table(
        "ms per frame",
        *(f"{n} tracks" for n in by_tracks),
        title="methods that need boxes only, and what is made of them",
    )
    for name in next(iter(by_tracks.values()), {}):
        table.add_row(name, *(f"{row[name]:.3f}" for row in by_tracks.values()))
    Console().print(table)
    if finders:
        lanes = Table("lane finder", "ms per image", title="lane finders, one thread")
        for word, found_ms in finders.items():
            lanes.add_row(Path(word).name, f"{found_ms:.1f}")
        Console().print(lanes)
