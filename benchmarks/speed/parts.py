"""Time of parts of stages on their own: detectors, ranging methods without images, and formats."""

from __future__ import annotations

import tempfile
import time
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np

from benchmarks.harness import Figures, in_new_process, median_ms
from benchmarks.inputs.drives import REAL_DATA, decoded
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.lanes.lines import LaneLine, LaneLines
from track_range.detection.models.onnx_session import Runtime
from track_range.detection.yolo.detector import YoloDetector, YoloSettings
from track_range.foundation.arrays import Image
from track_range.pipeline.alarming import Alarms
from track_range.pipeline.filtering import Approach, noise_shares
from track_range.pipeline.frame_result import FrameResult
from track_range.pipeline.world import World
from track_range.ranging.filtering.distance_filter import DistanceFilters
from track_range.ranging.filtering.observation import Observation
from track_range.ranging.fusion.fusion import Fusion
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.method import MethodContext, Ranger
from track_range.ranging.registry import create_rangers, methods
from track_range.results.formats.run_info import RunInfo
from track_range.results.rows.columns import methods_with_sigma
from track_range.results.writers import DEFAULT_WRITERS, WRITERS, OpenWriters
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

SIZES_PX = (320, 416, 640)  # input sizes of networks with a dynamic input
MODELS = tuple(
    REAL_DATA / f"models/{name}.onnx"
    for name in (
        "yolov5n_coco_640",
        "yolov5n_coco_dyn",
        "yolov4tiny_voc_416",
        "yolox_nano_416",
        "nanodet_m_416",
        "picodet_s_416",
    )
)

Result = TypeVar("Result")

CAMERA = PinholeCamera(721.5, 721.5, 609.6, 172.9, 1242, 375)  # KITTI's

CAMERA_HEIGHT_M, LANE_WIDTH_M = 1.65, 3.5

SIZES_HW_M = {"car": (1.5, 1.8), "person": (1.7, 0.6), "truck": (3.3, 2.5), "bicycle": (1.7, 0.6)}
"""Height and width in m of the objects, by class."""

FRACTIONS = (0.6, 0.2, 0.1, 0.1)  # fraction of each class of `SIZES_HW_M` among the objects
STEP_S = 0.1
# relative sigma of stereo per metre of distance, and its coverage
STEREO_SIGMA_PER_M, STEREO_FRACTION = 0.002, 0.8

N_TRACKS, FPS = 8, 30.0

_LIFETIME = 150  # frames of a track
# memory is compared after this frame, when libraries are loaded and buffers allocated
_FIRST_SAMPLE = 500

WRITTEN_CAMERA = PinholeCamera(1000.0, 1000.0, 620.0, 180.0, 1242, 375)


def detectors_ms(options: Namespace) -> Figures:
    """Time of each detector at each input size: preprocessing, inference and postprocessing, on one
    and two threads.
    """
    cv2.setNumThreads(1)
    frames = decoded(options.video, options.frames or 16)
    detectors: dict[str, YoloDetector] = {}
    for n_threads in options.threads:
        for path in options.models:
            for detector in _detectors(path, n_threads):
                height, width = detector.input_hw
                detectors[f"{path.stem} {width}x{height}, {n_threads} threads"] = detector
    for detector in detectors.values():
        detector.detect(frames[0])
    times_ms: dict[str, list[list[float]]] = {name: [] for name in detectors}
    for _ in range(options.rounds):
        for frame in frames:
            for name, detector in detectors.items():
                times_ms[name].append(_timed_ms(detector, frame))
    figures: Figures = {}
    for name, detector in detectors.items():
        pre, inference, post = np.median(times_ms[name], axis=0).tolist()
        times = {
            "pre_ms": pre,
            "inference_ms": inference,
            "post_ms": post,
            "total_ms": pre + inference + post,
        }
        figures[name] = {
            "family": detector.model.family,
            **times,
            "overhead_fraction": (pre + post) / inference,
        }
    return {"frames": len(frames), "image_hw": list(frames[0].shape[:2]), "detectors": figures}


def _detectors(path: Path, n_threads: int) -> list[YoloDetector]:
    """One detector for a network with a fixed input; for a dynamic one a rectangular and a square
    one of each size.
    """
    runtime = Runtime(device="cpu", n_threads=n_threads)
    fixed = YoloDetector(path, runtime=runtime)
    if None not in fixed.session.input_shape[2:]:
        return [fixed]
    settings = [
        YoloSettings(size_px=size, is_square=square)
        for size in SIZES_PX
        for square in (False, True)
    ]
    return [YoloDetector(path, option, runtime=runtime) for option in settings]


def _timed_ms(detector: YoloDetector, frame: Image) -> list[float]:
    """Times of pre, inference and post."""
    times_s = [time.perf_counter()]
    detector.fill(frame)
    times_s.append(time.perf_counter())
    outputs = detector.infer()
    times_s.append(time.perf_counter())
    detector.decode(outputs)
    times_s.append(time.perf_counter())
    return [1e3 * (end_s - start_s) for start_s, end_s in pairwise(times_s)]


def methods_ms(options: Namespace) -> Figures:
    """Time per frame of the box-only ranging methods, and of fusion and filters."""
    return {
        "ms_by_tracks": {
            f"{n} tracks": box_only_ms(n, n_frames=options.frames or 600) for n in options.tracks
        }
    }


def box_only_ms(n_tracks: int, *, n_frames: int) -> dict[str, float]:
    """Median time in ms of each box-only method, of fusion and of the filters, for a number of
    tracks.
    """
    rangers = create_rangers(MethodContext(camera=CAMERA, has_lane_lines=True))
    reads = {method.name: method.reads for method in methods()}
    fusion, filters = Fusion(), DistanceFilters(noise_shares())
    tracks, lines = _tracks(n_tracks), lane_lines()
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
        ranges["stereo"] = stereo_of_boxes(tracks, index)
        fused = timed("fuse", partial(fusion.fuse, ranges, jittered.track_id, frame.time_s))
        ranges["fused"] = fused.ranges
        timed(
            "filters",
            partial(
                filters.update,
                ranges,
                frame.time_s,
                observation=Observation(conditions={"fused": fused.condition}),
            ),
        )
    median = {name: median_ms(times) for name, times in times_s.items()}
    sums = {"box-only methods": tuple(rangers), "fusion and filters": ("fuse", "filters")}
    return {**median, **{name: sum(median[part] for part in parts) for name, parts in sums.items()}}


_BLANK: Image = np.zeros((CAMERA.height_px, CAMERA.width_px, 3), np.uint8)


def _tracks(n: int) -> Tracks:
    rng = np.random.default_rng(0)
    index = rng.choice(len(SIZES_HW_M), n, p=FRACTIONS)
    class_id = np.array([ROAD_CLASSES.index(name) for name in SIZES_HW_M])[index]
    height, width = (np.array(list(SIZES_HW_M.values())) * CAMERA.fx_px)[index].T
    z, x = rng.uniform(8.0, 80.0, n), rng.uniform(-6.0, 6.0, n)
    column, bottom = (
        CAMERA.cx_px + CAMERA.fx_px * x / z,
        CAMERA.cy_px + CAMERA.fy_px * CAMERA_HEIGHT_M / z,
    )
    xyxy_px = np.stack(
        [column - width / z / 2, bottom - height / z, column + width / z / 2, bottom], axis=1
    )
    return Tracks(np.arange(1, n + 1), xyxy_px, class_id, np.ones(n), np.ones(n, np.bool_))


def _jittered(tracks: Tracks, index: int) -> Tracks:
    """The tracks with box jitter of 0.5 px; `index` is the frame number."""
    xyxy_px = tracks.xyxy_px + np.random.default_rng(index).normal(0.0, 0.5, tracks.xyxy_px.shape)
    return Tracks(tracks.track_id, xyxy_px, tracks.class_id, tracks.score, tracks.observed)


def stereo_of_boxes(tracks: Tracks, index: int) -> Ranges:
    """Random distances of stereo for boxes on the road; `index` is the frame number."""
    rng = np.random.default_rng(index)
    true_m = CAMERA.fy_px * CAMERA_HEIGHT_M / (tracks.xyxy_px[:, 3] - CAMERA.cy_px)
    sigma = STEREO_SIGMA_PER_M * true_m
    distance_m = np.where(
        rng.random(len(tracks)) < STEREO_FRACTION, true_m * np.exp(rng.normal(0.0, sigma)), np.nan
    )
    return Ranges(tracks.track_id, distance_m, distance_m * sigma)


def lane_lines() -> LaneLines:
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


def formats(options: Namespace) -> Figures:
    """Cost of the result formats: time per frame, time at the end, file size and growth of
    memory.
    """
    cases: dict[str, tuple[tuple[str, ...], Figures]] = {
        name: ((name,), {}) for name in WRITERS.names
    }
    cases["mcap, ros2"] = (("mcap",), {"mcap_profile": "ros2"})
    cases[f"default: {','.join(DEFAULT_WRITERS)}"] = (DEFAULT_WRITERS, {})
    figures: Figures = {}
    for name, case in cases.items():
        costs = [
            in_new_process(_writing_cost, *case, options.frames or 2000)
            for _ in range(options.rounds)
        ]
        figures[name] = {
            key: round(float(np.median([cost[key] for cost in costs])), 3) for key in costs[0]
        }
    return figures


def _writing_cost(formats: Sequence[str], settings: Figures, n_frames: int) -> dict[str, float]:
    """Process time per frame and of closing the files, size of these, and growth of memory from
    frame 500 on.
    """
    import psutil  # a local import, since only this workload and `memory` require the extra `bench`

    process = psutil.Process()
    info = RunInfo(camera=WRITTEN_CAMERA, rig=None, fps=FPS, settings=settings)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        open_writers = OpenWriters(formats, info, folder)
        busy_s, first_bytes = 0.0, 0
        for result in written_frames(n_frames):
            start_s = time.process_time()
            open_writers.write(result)
            busy_s += time.process_time() - start_s
            if result.index == min(_FIRST_SAMPLE, n_frames - 1):
                first_bytes = process.memory_info().rss
        growth_mib = (process.memory_info().rss - first_bytes) / 2**20
        start_s = time.process_time()
        open_writers.close({"notes": []})
        close_s = time.process_time() - start_s
        n_bytes = sum(path.stat().st_size for path in folder.iterdir())
    frame_ms, kb = 1e3 * busy_s / n_frames, n_bytes / n_frames / 1000
    return {
        "ms_per_frame": frame_ms,
        "close_ms": 1e3 * close_s,
        "kb_per_frame": kb,
        "growth_mib": growth_mib,
    }


def written_frames(n_frames: int) -> Iterator[FrameResult]:
    """Frames with `N_TRACKS` tracks each, of which one is replaced every `_LIFETIME / N_TRACKS`
    frames.
    """
    rng = np.random.default_rng(0)
    place = np.arange(N_TRACKS)
    for index in range(n_frames):
        age = index + place * _LIFETIME / N_TRACKS
        track_id = 1 + place + N_TRACKS * (age // _LIFETIME).astype(np.int64)
        distance_m = (
            60.0 - 50.0 * (age % _LIFETIME) / _LIFETIME + 0.1 * rng.standard_normal(N_TRACKS)
        )
        centre_x, size = 620.0 + 40.0 * (place - 4) * 30.0 / distance_m, 1600.0 / distance_m
        tracks = Tracks(
            track_id,
            np.stack(
                [centre_x - size / 2, 180 - size / 4, centre_x + size / 2, 180 + size / 2], axis=1
            ),
            place % 6,
            np.full(N_TRACKS, 0.8) + 0.05 * rng.standard_normal(N_TRACKS),
            rng.random(N_TRACKS) > 0.1,
        )
        noise = rng.standard_normal((len(methods_with_sigma()), N_TRACKS))
        ranges = {
            name: Ranges(track_id, distance_m * (1 + 0.02 * noise[i]), 0.02 * distance_m)
            for i, name in enumerate(methods_with_sigma())
        }
        closing_mps = 10.0 + 0.3 * rng.standard_normal(N_TRACKS)
        xyz_m = np.stack(
            [(centre_x - 620) / 1000 * distance_m, np.ones(N_TRACKS), distance_m], axis=1
        )
        yield FrameResult(
            frame=Frame(index, index / FPS, np.zeros((0, 0, 3), np.uint8), None),
            tracks=tracks,
            ranges=ranges,
            approach=Approach(
                closing_mps,
                np.full(N_TRACKS, 0.3),
                distance_m / closing_mps,
                0.03 * distance_m / closing_mps,
                np.zeros(N_TRACKS, np.bool_),
            ),
            world=replace(World.unknown(N_TRACKS), xyz_m=xyz_m),
            alarms=Alarms.none(N_TRACKS),
        )
