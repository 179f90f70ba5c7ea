"""Cost of the result formats: time per frame, time at the end, file size and growth of memory.

Each format writes a synthetic run: 8 tracks a frame with all methods, smooth motion, times at 30 frames per second, no
images. Times are of the process (all threads), median over rounds; each round runs in a new process.
"""

from __future__ import annotations

import tempfile
import time
from argparse import Namespace
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import psutil

from benchmarks.harness import Figures, in_new_process, option, workload
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.ranges import Ranges
from track_range.results.columns import methods_with_sigma
from track_range.results.writers import DEFAULT_WRITERS, WRITERS, OpenWriters, RunInfo
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

N_TRACKS, FPS = 8, 30.0

_LIFETIME = 150  # frames of a track
_FIRST_SAMPLE = 500  # memory is compared after this frame, when libraries are loaded and buffers allocated

_CAMERA = PinholeCamera(1000.0, 1000.0, 620.0, 180.0, 1242, 375)


@workload(
    option("--frames", default=2000, help="number of frames"),
    option("--rounds", default=5, help="rounds, of which the median is printed"),
)
def writers(options: Namespace) -> Figures:
    cases: dict[str, tuple[tuple[str, ...], Figures]] = {name: ((name,), {}) for name in WRITERS.names}
    cases["mcap, ros2"] = (("mcap",), {"mcap_profile": "ros2"})
    cases[f"default: {','.join(DEFAULT_WRITERS)}"] = (DEFAULT_WRITERS, {})
    figures: Figures = {}
    for name, case in cases.items():
        costs = [in_new_process(_cost, *case, options.frames) for _ in range(options.rounds)]
        figures[name] = {key: round(float(np.median([cost[key] for cost in costs])), 3) for key in costs[0]}
    return figures


def _cost(formats: Sequence[str], settings: Figures, n_frames: int) -> dict[str, float]:
    """Process time per frame and of closing the files, size of these, and growth of memory from frame 500 on."""
    process = psutil.Process()
    info = RunInfo(camera=_CAMERA, rig=None, fps=FPS, settings=settings)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        open_writers = OpenWriters(formats, info, folder)
        busy_s, first_bytes = 0.0, 0
        for result in frames(n_frames):
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
    return {"ms_per_frame": frame_ms, "close_ms": 1e3 * close_s, "kb_per_frame": kb, "growth_mib": growth_mib}


def frames(n_frames: int) -> Iterator[FrameResult]:
    """Frames with `N_TRACKS` tracks each, of which one is replaced every `_LIFETIME / N_TRACKS` frames."""
    rng = np.random.default_rng(0)
    place = np.arange(N_TRACKS)
    for index in range(n_frames):
        age = index + place * _LIFETIME / N_TRACKS
        track_id = 1 + place + N_TRACKS * (age // _LIFETIME).astype(np.int64)
        distance_m = 60.0 - 50.0 * (age % _LIFETIME) / _LIFETIME + 0.1 * rng.standard_normal(N_TRACKS)
        centre_x, size = 620.0 + 40.0 * (place - 4) * 30.0 / distance_m, 1600.0 / distance_m
        tracks = Tracks(
            track_id,
            np.stack([centre_x - size / 2, 180 - size / 4, centre_x + size / 2, 180 + size / 2], axis=1),
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
        yield FrameResult(
            frame=Frame(index, index / FPS, np.zeros((0, 0, 3), np.uint8), None),
            tracks=tracks,
            ranges=ranges,
            closing_mps=closing_mps,
            closing_sigma_mps=np.full(N_TRACKS, 0.3),
            ttc_s=distance_m / closing_mps,
            ttc_sigma_s=0.03 * distance_m / closing_mps,
            xyz_m=np.stack([(centre_x - 620) / 1000 * distance_m, np.ones(N_TRACKS), distance_m], axis=1),
        )
