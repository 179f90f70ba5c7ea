"""The network alone, whole runs and steps of a pipeline on each device."""

from __future__ import annotations

import math
import tempfile
import time
import warnings
from argparse import Namespace
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import Figures, in_new_process, option, workload
from benchmarks.inputs.drives import DRIVE_OPTIONS
from benchmarks.inputs.run_inputs import RunInputs, run_ms
from benchmarks.speed.latency import mono_ms, stereo_ms
from track_range.detection.catalogue.lookup import DEFAULT_MODEL, find_model
from track_range.detection.models.devices import Device
from track_range.detection.models.onnx_session import Runtime
from track_range.detection.models.providers import why_missing
from track_range.detection.yolo.detector import YoloDetector

DEVICES: tuple[Device, ...] = ("cpu", "cuda")
_N_TIMED, _N_FIRST = 100, 10  # runs of the network that are timed, and runs before them


@workload(
    DRIVE_OPTIONS[0],
    option("--devices", default=DEVICES, choices=DEVICES, help="devices"),
    option("--detector", default=DEFAULT_MODEL, help="name or file of the network"),
    option("--threads", default=0, help="threads of the network on a CPU; 0 = one per core"),
    option("--batches", default=(1, 2, 4), help="images per run of the network alone"),
    option("--frames", default=300, help="number of frames of each run"),
    option("--steps", default=300, help="number of steps of `tr.Pipeline`"),
    option("--network-ms", default=0.0, help="also with a network of this time and stored boxes"),
)
def devices(options: Namespace) -> Figures:
    """Milliseconds of the network alone by size of the batch, of runs per frame and of steps, on
    each device that onnxruntime offers.
    """
    figures: Figures = {}
    with tempfile.TemporaryDirectory() as name:
        for device in options.devices:
            reason = "" if device == "cpu" else why_missing(device)
            if reason:
                warnings.warn(f"{device}: {reason}", stacklevel=1)
                continue
            figures[device] = _of_device(device, options, Path(name))
        if options.network_ms:
            figures["emulated network"] = _emulated(options, Path(name))
    return figures


def _of_device(device: Device, options: Namespace, folder: Path) -> Figures:
    detector = find_model(options.detector).path
    network_ms = in_new_process(network_alone_ms, detector, device, options)
    alone_ms = network_ms["1 per run"] or math.nan
    inputs = RunInputs.written(folder, options.drive, detector, options.frames)
    on_device = {"device": device, "threads": options.threads}
    runs = _runs(inputs, on_device, alone_ms)
    stepped = Namespace(
        **{**vars(options), "device": device, "align": "off", "paced": False},
        deterministic=False,
    )
    steps = {"stereo": in_new_process(stereo_ms, stepped), "mono": in_new_process(mono_ms, stepped)}
    return {"network_ms_per_image": network_ms, "runs": runs, "steps_ms": steps}


def _emulated(options: Namespace, folder: Path) -> Figures:
    """Runs with stored boxes and a network of a given time on the CPU."""
    inputs = RunInputs.written(folder, options.drive, Path(), options.frames, options.network_ms)
    return {"network_ms": inputs.network_ms, "runs": _runs(inputs, {}, inputs.network_ms)}


def _runs(inputs: RunInputs, changed: dict[str, Any], network_ms: float) -> Figures:
    """Milliseconds per frame of runs with and without overlay, alone and relative to the
    network.
    """
    figures: Figures = {}
    for kind, settings in inputs.settings.items():
        for has_overlay in (True, False):
            given = {**settings, **changed, "overlay": has_overlay}
            ms = in_new_process(run_ms, given, inputs.stored.get(kind))
            name = kind if has_overlay else f"{kind}, no overlay"
            figures[name] = {**ms, "wall / network": ms["wall_ms"] / network_ms}
    return figures


def network_alone_ms(detector: Path, device: Device, options: Namespace) -> dict[str, float | None]:
    """Median time per image of the network as in a run, and in larger batches; None = it does not
    take them.
    """
    network = YoloDetector(detector, runtime=Runtime(device=device, n_threads=options.threads))
    network.detect(np.zeros((720, 1280, 3), np.uint8))
    session, input_hw = network.session, network.input_hw
    figures: dict[str, float | None] = {"1 per run": _median_ms(session.bound(input_hw).run)}
    for n_images in (n for n in options.batches if n > 1):
        name = f"{n_images} per run"
        if session.input_shape[0] is None:
            blob = np.zeros((n_images, 3, *input_hw), session.input_dtype)
            figures[name] = _median_ms(partial(session.run, blob)) / n_images
        else:
            figures[name] = None
    return figures


def _median_ms(run: Callable[[], object]) -> float:
    times_s = []
    for _ in range(_N_FIRST + _N_TIMED):
        start_s = time.perf_counter()
        run()
        times_s.append(time.perf_counter() - start_s)
    return 1e3 * float(np.median(times_s[_N_FIRST:]))
