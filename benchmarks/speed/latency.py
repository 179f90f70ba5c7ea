"""Latency of `Pipeline.step`, and whether a run keeps pace with a camera."""

from __future__ import annotations

import tempfile
import time
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import track_range as tr
from benchmarks.harness import Figures, in_new_process, option, workload
from benchmarks.inputs.drives import DRIVE_OPTIONS, FPS, decoded, ordinary_video
from benchmarks.inputs.run_inputs import opened_run
from track_range.detection.catalogue.lookup import DEFAULT_MODEL
from track_range.foundation.arrays import Image
from track_range.foundation.processes import tuned_process

VIDEO_FPS = 30  # of the camera with which a run keeps pace
PARTS = ("stereo", "mono", "realtime")
_PERCENTILES = {"p50": 50, "p95": 95, "p99": 99, "longest": 100}
_N_LONGEST = 5  # steps that are named


@workload(
    DRIVE_OPTIONS[0],
    option("--parts", default=PARTS, choices=PARTS, help="parts"),
    option("--detector", default=DEFAULT_MODEL, help="name or file of the network"),
    option("--device", default="cpu", help="device of the network"),
    option("--threads", default=0, help="threads of the network; 0 = one per core"),
    option("--steps", default=2000, help="number of steps"),
    option("--paced", default=False, help="frames come at the rate of the video"),
    option("--align", default="auto", choices=("auto", "off"), help="alignment of the pair"),
    option("--deterministic", default=False, help="results do not depend on times"),
    option("--seconds", default=20.0, help="length of the video of `realtime`"),
)
def latency(options: Namespace) -> Figures:
    """Latency of the steps of `tr.Pipeline` in ms, of a pair and of one camera, and of frames that
    a run with --realtime dropped.

    Frames are decoded before; they are played forwards and backwards, so that there is no cut.
    """
    figures: Figures = {}
    measure = {"stereo": stereo_ms, "mono": mono_ms, "realtime": _realtime}
    for part in options.parts:
        figures[part] = in_new_process(measure[part], options)
    return figures


def _pipeline_keywords(options: Namespace) -> dict[str, Any]:
    keywords = {
        "detector": options.detector,
        "device": options.device,
        "threads": options.threads,
    }
    return {**keywords, "deterministic": True} if options.deterministic else keywords


def stereo_ms(options: Namespace) -> Figures:
    """Latency of the steps of a pair."""
    images = [decoded(options.drive / f"{side}.mp4") for side in ("left", "right")]
    pipeline = tr.Pipeline.stereo(
        options.drive / "calib.txt", sgbm=False, align=options.align, **_pipeline_keywords(options)
    )
    return step_figures(pipeline, list(zip(*images, strict=True)), FPS, options)


def mono_ms(options: Namespace) -> Figures:
    """Latency of the steps of one camera."""
    with tempfile.TemporaryDirectory() as name:
        video = ordinary_video(Path(name) / "ordinary.mp4", n_frames=120, fps=VIDEO_FPS)
        images = [(image,) for image in decoded(video)]
    pipeline = tr.Pipeline.mono(focal_px=1150.0, **_pipeline_keywords(options))
    return step_figures(pipeline, images, VIDEO_FPS, options)


def step_figures(
    pipeline: tr.Pipeline, frames: Sequence[tuple[Image, ...]], fps: float, options: Namespace
) -> Figures:
    """Percentiles of the latency of the steps, and the longest ones with their numbers."""
    times_ms = []
    period = [*range(len(frames)), *range(len(frames) - 2, 0, -1)]
    begin_s = time.perf_counter()
    with pipeline, tuned_process(has_dense_stereo=False):
        for step in range(options.steps):
            left, right = (*frames[period[step % len(period)]], None)[:2]
            if options.paced:
                time.sleep(max(0.0, begin_s + step / fps - time.perf_counter()))
            start_s = time.perf_counter()
            pipeline.step(left, right, step / fps)
            times_ms.append(1e3 * (time.perf_counter() - start_s))
    percentiles = np.percentile(times_ms, list(_PERCENTILES.values())).tolist()
    longest = np.argsort(times_ms)[::-1][:_N_LONGEST]
    return {
        **dict(zip(_PERCENTILES, percentiles, strict=True)),
        "first": times_ms[0],
        "p99 / p50": percentiles[2] / percentiles[0],
        "ms_of_longest": [round(times_ms[step], 1) for step in longest],
        "steps_of_longest": longest.tolist(),
        "applied": None if pipeline.alignment is None else pipeline.alignment.is_applied,
    }


def _realtime(options: Namespace) -> Figures:
    """Frames that a run of one camera at 1280x720 px and 30 frames/s dropped, and what it says."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        n_frames = round(options.seconds * VIDEO_FPS)
        video = ordinary_video(folder / "ordinary.mp4", n_frames=n_frames, fps=VIDEO_FPS)
        settings = {
            "mono": str(video),
            "focal_px": 1150.0,
            "out": str(folder / "out"),
            "realtime": True,
            "overlay": False,
        }
        for key in ("detector", "device", "threads"):
            settings[key] = getattr(options, key)
        with opened_run(settings) as run, tuned_process(has_dense_stereo=False):
            for _ in run:
                pass
        summary = run.summary
    dropped = summary.get("frames_dropped", 0)
    return {
        "frames": n_frames,
        "dropped": dropped,
        "dropped_pct": 100 * dropped / n_frames,
        **{f"latency_{key}_ms": ms for key, ms in summary["latency_ms"].items()},
        "note": next((note for note in summary["notes"] if "dropped" in note), "-"),
    }
