"""Cost of the result formats: time per frame, time at the end, file size and growth of memory.

Each format writes a synthetic run: 8 tracks a frame with all methods, smooth motion, times at 30 frames per second, no
images. Times are of the process (all threads), median over rounds; each round runs in a new process.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from rich.console import Console

from benchmarks.plain_tables import plain_table
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.ranges import Ranges
from track_range.results.columns import methods_with_sigma
from track_range.results.writers import DEFAULT_WRITERS, WRITERS, OpenWriters, RunInfo
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

N_TRACKS, FPS = 8, 30.0

_LIFETIME = 150
"""Number of frames of a track."""

_FIRST_SAMPLE = 500
"""Frame after which memory is compared, so that libraries are loaded and buffers allocated."""

_CAMERA = PinholeCamera(1000.0, 1000.0, 620.0, 180.0, 1242, 375)


@dataclass(frozen=True, slots=True)
class Cost:
    """Cost of one round.

    Attributes:
        frame_ms: process time per frame.
        close_ms: process time of closing the files.
        n_bytes: size of the files.
        growth_mib: growth of resident memory from frame 500 to the last.
    """

    frame_ms: float
    close_ms: float
    n_bytes: int
    growth_mib: float


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this workload."""
    parser.add_argument("--frames", type=int, default=2000, metavar="N", help="number of frames")
    parser.add_argument("--rounds", type=int, default=5, metavar="N", help="rounds, of which the median is printed")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Measure each format, the default ones together and ROS 2's profile, and print the table."""
    cases: dict[str, tuple[tuple[str, ...], dict[str, Any]]] = {name: ((name,), {}) for name in WRITERS.names}
    cases["mcap, ros2"] = (("mcap",), {"mcap_profile": "ros2"})
    cases[f"default: {','.join(DEFAULT_WRITERS)}"] = (DEFAULT_WRITERS, {})
    table = plain_table(
        f"Writing {options.frames} frames of {N_TRACKS} tracks",
        *("format", "ms per frame", "ms at the end", "kB per frame", "MiB growth"),
    )
    figures = {}
    for name, (formats, settings) in cases.items():
        costs = [_in_new_process(formats, settings, options.frames) for _ in range(options.rounds)]
        row = {
            field: round(statistics.median(getattr(cost, field) for cost in costs), 3)
            for field in ("frame_ms", "close_ms", "n_bytes", "growth_mib")
        }
        figures[name] = row
        table.add_row(
            name,
            f"{row['frame_ms']:.2f}",
            f"{row['close_ms']:.0f}",
            f"{row['n_bytes'] / options.frames / 1000:.2f}",
            f"{row['growth_mib']:.1f}",
        )
    Console(width=100).print(table)
    return figures


def _in_new_process(formats: Sequence[str], settings: dict[str, Any], n_frames: int) -> Cost:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(_cost, formats, settings, n_frames).result()


def _cost(formats: Sequence[str], settings: dict[str, Any], n_frames: int) -> Cost:
    process = psutil.Process()
    info = RunInfo(camera=_CAMERA, rig=None, fps=FPS, settings=settings)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        writers = OpenWriters(formats, info, folder)
        busy_s, first_bytes = 0.0, 0
        for result in frames(n_frames):
            start_s = time.process_time()
            writers.write(result)
            busy_s += time.process_time() - start_s
            if result.index == min(_FIRST_SAMPLE, n_frames - 1):
                first_bytes = process.memory_info().rss
        last_bytes = process.memory_info().rss
        start_s = time.process_time()
        writers.close({"notes": []})
        close_s = time.process_time() - start_s
        n_bytes = sum(path.stat().st_size for path in folder.iterdir())
    return Cost(1e3 * busy_s / n_frames, 1e3 * close_s, n_bytes, (last_bytes - first_bytes) / 2**20)


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
