"""Time per frame of the box-only ranging methods, of fusion and filters, and of lane detection.

Protocol: boxes of road users of several classes at 8-80 m on one road in a KITTI-like camera, with a jitter of half a
pixel; methods are called as in a run, the lane width without learning from stereo. Stereo is not timed; its distances
are random, for four of five boxes. Figures are medians over frames of processor time on one thread, alternating between
the methods. Goals for 50 tracks: mono, ground and lane together under 0.5 ms, fusion and the three filters together
under 1 ms. Lane detection runs on the frames of a dash camera video, if available; networks use one thread.
"""

from __future__ import annotations

import time
from argparse import Namespace
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from benchmarks.harness import Figures, median_ms, option, workload
from benchmarks.inputs.drives import REAL_DATA, decoded
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.lanes.lines import LaneLine, LaneLines
from track_range.detection.lanes.nets import CLASSICAL, open_lane_finder
from track_range.detection.models.onnx_session import Runtime
from track_range.foundation.arrays import Image
from track_range.pipeline.frame_pipeline import noise_fractions
from track_range.ranging.filtering.distance_filter import DistanceFilters
from track_range.ranging.fusion.fusion import Fusion
from track_range.ranging.method import MethodContext
from track_range.ranging.ranger import Ranger
from track_range.ranging.ranges import Ranges
from track_range.ranging.registry import create_rangers, methods
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

Result = TypeVar("Result")

CAMERA = PinholeCamera(721.5, 721.5, 609.6, 172.9, 1242, 375)  # KITTI's

CAMERA_HEIGHT_M, LANE_WIDTH_M = 1.65, 3.5

SIZES_HW_M = {"car": (1.5, 1.8), "person": (1.7, 0.6), "truck": (3.3, 2.5), "bicycle": (1.7, 0.6)}
"""Height and width in m of the objects, by class."""

FRACTIONS = (0.6, 0.2, 0.1, 0.1)
"""Fraction of each class of `SIZES_HW_M` among the objects."""

STEP_S = 0.1

STEREO_SIGMA_PER_M, STEREO_FRACTION = 0.002, 0.8
"""Relative sigma of stereo per metre of distance, and its coverage."""


NETS = tuple(REAL_DATA / "models" / name for name in ("twinlitenet_360x640.onnx", "lstr_tusimple_360x640.onnx"))


@workload(
    option("--tracks", default=(1, 6, 50), help="numbers of tracks"),
    option("--frames", default=600, help="number of frames for the methods"),
    option("--lane-frames", default=60, help="number of frames for lane detection"),
    option("--video", default=REAL_DATA / "dashcam" / "solid_white_right.mp4", help="video for lane detection"),
    option("--lane-nets", default=NETS, nargs="*", help="ONNX files of lane networks"),
)
def ranging(options: Namespace) -> Figures:
    by_tracks = {f"{n} tracks": box_only_ms(n, n_frames=options.frames) for n in options.tracks}
    images = decoded(options.video, options.lane_frames) if options.video.is_file() else []
    nets = [str(path) for path in options.lane_nets if path.is_file()]
    finders = {Path(name).name: _lanes_ms(name, images) for name in (CLASSICAL, *nets) if images}
    return {"ms_by_tracks": by_tracks, "lane_finders_ms": finders}


def box_only_ms(n_tracks: int, *, n_frames: int) -> dict[str, float]:
    """Median time in ms of each box-only method, of fusion and of the filters, for a number of tracks."""
    rangers = create_rangers(MethodContext(camera=CAMERA, has_lane_lines=True))
    reads = {method.name: method.reads for method in methods()}
    fusion, filters = Fusion(), DistanceFilters(noise_fractions())
    tracks, lines = _tracks(n_tracks), _lines()
    times_s: dict[str, list[float]] = {}

    def timed(name: str, function: Callable[[], Result]) -> Result:
        start_s = time.process_time()
        result = function()
        times_s.setdefault(name, []).append(time.process_time() - start_s)
        return result

    def measured(ranger: Ranger, *arguments: Any) -> Ranges:
        ranger.update_lanes(lines)
        return ranger.measure_with(*arguments)

    for index in range(n_frames):
        jittered, frame = _jittered(tracks, index), Frame(index, index * STEP_S, _BLANK, None)
        ranges: dict[str, Ranges] = {}
        for name, ranger in rangers.items():
            others = {other: ranges[other] for other in reads[name] if other in ranges}
            ranges[name] = timed(name, partial(measured, ranger, jittered, frame, others))
        ranges["stereo"] = _stereo(tracks, index)
        fused = timed("fuse", partial(fusion.fuse, ranges, jittered.track_id, frame.time_s))
        ranges["fused"] = fused.ranges
        timed("filters", partial(filters.update, ranges, frame.time_s, conditions={"fused": fused.condition}))
    median = {name: median_ms(times) for name, times in times_s.items()}
    sums = {"box-only methods": tuple(rangers), "fusion and filters": ("fuse", "filters")}
    return {**median, **{name: sum(median[part] for part in parts) for name, parts in sums.items()}}


_BLANK: Image = np.zeros((CAMERA.height_px, CAMERA.width_px, 3), np.uint8)


def _tracks(n: int) -> Tracks:
    """N tracks of objects on a flat road."""
    rng = np.random.default_rng(0)
    index = rng.choice(len(SIZES_HW_M), n, p=FRACTIONS)
    class_id = np.array([ROAD_CLASSES.index(name) for name in SIZES_HW_M])[index]
    height, width = (np.array(list(SIZES_HW_M.values())) * CAMERA.fx_px)[index].T
    z, x = rng.uniform(8.0, 80.0, n), rng.uniform(-6.0, 6.0, n)
    column, bottom = CAMERA.cx_px + CAMERA.fx_px * x / z, CAMERA.cy_px + CAMERA.fy_px * CAMERA_HEIGHT_M / z
    xyxy_px = np.stack([column - width / z / 2, bottom - height / z, column + width / z / 2, bottom], axis=1)
    return Tracks(np.arange(1, n + 1), xyxy_px, class_id, np.ones(n), np.ones(n, np.bool_))


def _jittered(tracks: Tracks, index: int) -> Tracks:
    """The tracks with box jitter of 0.5 px; `index` is the frame number."""
    xyxy_px = tracks.xyxy_px + np.random.default_rng(index).normal(0.0, 0.5, tracks.xyxy_px.shape)
    return Tracks(tracks.track_id, xyxy_px, tracks.class_id, tracks.score, tracks.observed)


def _stereo(tracks: Tracks, index: int) -> Ranges:
    """Random distances of stereo for boxes on the road; `index` is the frame number."""
    rng = np.random.default_rng(index)
    true_m = CAMERA.fy_px * CAMERA_HEIGHT_M / (tracks.xyxy_px[:, 3] - CAMERA.cy_px)
    sigma = STEREO_SIGMA_PER_M * true_m
    distance_m = np.where(rng.random(len(tracks)) < STEREO_FRACTION, true_m * np.exp(rng.normal(0.0, sigma)), np.nan)
    return Ranges(tracks.track_id, distance_m, distance_m * sigma)


def _lines() -> LaneLines:
    """Lines of a straight ego lane with the camera in its middle."""
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


def _lanes_ms(name: str, images: Sequence[Image]) -> float:
    finder = open_lane_finder(name, Runtime(n_threads=1, device="cpu"))
    times_s = []
    for index, image in enumerate(images):
        start_s = time.process_time()
        finder.find(image, index * STEP_S)
        times_s.append(time.process_time() - start_s)
    return median_ms(times_s)
