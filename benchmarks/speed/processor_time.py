"""Processor time of each step of a run, per frame, and what its threads wait for."""

from __future__ import annotations

import importlib
import resource
import tempfile
import threading
import time
from argparse import Namespace
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import reduce, wraps
from pathlib import Path
from typing import Any

from benchmarks.harness import Figures, in_new_process, option, workload
from benchmarks.inputs.drives import DRIVE_OPTIONS
from benchmarks.inputs.emulated_network import OpenedStoredBoxes
from benchmarks.inputs.run_inputs import RunInputs, opened_run
from track_range.foundation.processes import tuned_process

STEPS: dict[str, tuple[str, ...]] = {
    "decoding": ("recording.sources.files.video_file:_Reading._next_decoded",),
    "colour conversion, read": ("recording.video.frame:DecodedImage.to_bgr",),
    "rectification": ("stereo.geometry.rectification:Rectifier.rectify Undistorter.undistort",),
    "checks of the pair": (
        "recording.pairs.pair_monitor:PairMonitor.add",
        "recording.pairs.sync_monitor:SyncMonitor.add",
    ),
    "lanes": (
        "detection.lanes.edges:EdgeLaneFinder.find",
        "detection.lanes.nets:NetLaneFinder.find",
    ),
    "resize, letterbox": ("detection.yolo.detector:YoloDetector.prepared",),
    "inference": ("detection.models.onnx_session:BoundNetwork.run",),
    "box decoding, NMS": ("detection.yolo.detector:YoloDetector._decoded",),
    "flow of the background": ("foundation.sparse_flow:BackgroundFlow.add BackgroundFlow.tracked",),
    "camera motion": (
        "tracking.camera_motion:CameraMotion.update",
        "stereo.odometry.ground_odometry:GroundOdometry.update",
        "stereo.odometry.stereo_odometry:StereoOdometry.update",
    ),
    "appearance": ("tracking.appearance.embeddings:ColourLayout.embed",),
    "tracking": ("tracking.deepsort:DeepSortTracker.update",),
    "ranging": ("pipeline.ranging:RangingStage.measure",),
    # in a thread of its own, twice in a drive
    "focal length by shapes": ("ranging.cameras.shape_evidence:vehicle_shapes",),
    "fusion, filters, warnings": ("pipeline.frame_pipeline:FramePipeline.step",),
    "drawing": ("views.overlay.annotator:Overlay.draw",),
    "colour conversion, written": ("views.videos.video_writer:_i420",),
    "encoding": ("views.videos.video_writer:VideoWriter.write",),
    "tables": (
        "results.writers:OpenWriters.write",
        "results.table:RunTable.append",
        "results.events.finder:EventFinder.update",
    ),
}
"""Functions of each step."""

_N_FIRST, _N_LAST = 32, 16
"""Numbers of frames that do not count: in the first ones, libraries are initialized and the pair is
checked; during the last ones, which are in the queues, nothing more is decoded."""

Times = list[tuple[str, dict[str, float]]]  # name and times of each thread

WAITS = {
    "input": ("foundation.prefetch:ClosableQueue.wait_for_item",),
    "room": (
        "foundation.prefetch:ClosableQueue.wait_for_room",
        "views.videos.result_video:ResultVideo.wait",
    ),
}
"""Functions in which a thread waits for the thread before it, or for the thread after it."""


def functions_at(path: str) -> Iterator[tuple[Any, Callable[..., Any]]]:
    """The functions of a path as in `STEPS`, each with the module or class that has it."""
    module, _, functions = path.partition(":")
    for names in functions.split():
        *classes, name = names.split(".")
        owner = reduce(getattr, classes, importlib.import_module(f"track_range.{module}"))
        yield owner, getattr(owner, name)


@dataclass(slots=True)
class _Thread:
    """Times of one thread so far, s: processor time by step, and wall time by wait.

    "on a core" and "queued" are counted by the system: processor time, and time in which the thread
    was ready but had no core. `nested_s` is the processor time within each step in progress of the
    steps that it called.
    """

    name: str
    number: int = field(default_factory=threading.get_native_id)
    times_s: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    nested_s: list[float] = field(default_factory=list)

    def read_scheduler(self) -> None:
        """Read the counts of the system; those of a thread that has ended remain the last ones."""
        with suppress(OSError):
            counts = Path(f"/proc/self/task/{self.number}/schedstat").read_text(encoding="ascii")
            on_core_ns, queued_ns, _ = map(int, counts.split())
            self.times_s["on a core"], self.times_s["queued"] = on_core_ns * 1e-9, queued_ns * 1e-9


class _Probe:
    """Times of all threads of this process, in which it wraps the functions of all steps."""

    def __init__(self) -> None:
        self._threads: list[_Thread] = []
        self._local = threading.local()
        for wrap, groups in ((self._timed, STEPS), (self._waiting, WAITS)):
            for key, functions in groups.items():
                for owner, function in (pair for path in functions for pair in functions_at(path)):
                    setattr(owner, function.__name__, wrap(function, key))

    def times_s(self) -> Times:
        """Name and times so far of each thread; "process" is the processor time of all threads."""
        for thread in self._threads:
            thread.read_scheduler()
        used = resource.getrusage(resource.RUSAGE_SELF)
        now = {"wall": time.perf_counter(), "on a core": used.ru_utime + used.ru_stime}
        return [
            ("process", now),
            *((thread.name, thread.times_s.copy()) for thread in self._threads),
        ]

    @property
    def _thread(self) -> _Thread:
        if not hasattr(self._local, "thread"):
            self._local.thread = _Thread(threading.current_thread().name)
            self._threads.append(self._local.thread)
        thread: _Thread = self._local.thread
        return thread

    def _timed(self, function: Callable[..., Any], step: str) -> Callable[..., Any]:
        @wraps(function)
        def timed(*args: Any, **kwargs: Any) -> Any:
            thread = self._thread
            thread.nested_s.append(0.0)
            start_s = time.thread_time()
            try:
                return function(*args, **kwargs)
            finally:
                spent_s = time.thread_time() - start_s
                thread.times_s[step] += spent_s - thread.nested_s.pop()
                if thread.nested_s:
                    thread.nested_s[-1] += spent_s

        return timed

    def _waiting(self, function: Callable[..., Any], wait: str) -> Callable[..., Any]:
        @wraps(function)
        def waiting(*args: Any) -> Any:
            start_s = time.perf_counter()
            try:
                return function(*args)
            finally:
                self._thread.times_s[wait] += time.perf_counter() - start_s

        return waiting


@workload(
    *DRIVE_OPTIONS,
    option("--frames", default=150, help="number of frames of each run"),
    option("--network-ms", default=0.0, help="time of a network with stored boxes; 0 = detector"),
    option("--no-overlay", default=False, help="write no overlay"),
)
def processor_time(options: Namespace) -> Figures:
    with tempfile.TemporaryDirectory() as name:
        inputs = RunInputs.written(
            Path(name), options.drive, options.detector, options.frames, options.network_ms
        )
        threads = {
            key: in_new_process(
                _times_ms,
                {**given, "overlay": not options.no_overlay},
                inputs.stored.get(key),
                options.frames,
            )
            for key, given in inputs.settings.items()
        }
    steps: Figures = {step: {} for step in (*STEPS, "other", "sum", "wall time")}
    waits: Figures = {}
    for name, by_thread in threads.items():
        process = by_thread.pop("process")
        for step in STEPS:
            steps[step][name] = sum(times_ms.get(step, 0.0) for times_ms in by_thread.values())
        steps["other"][name] = process["on a core"] - sum(steps[step][name] for step in STEPS)
        steps["sum"][name], steps["wall time"][name] = process["on a core"], process["wall"]
        keys = ("on a core", "queued", "input", "room")
        waits[name] = {
            thread: {key: ms.get(key, 0.0) for key in keys}
            | {"other": ms["on a core"] - sum(ms.get(step, 0.0) for step in STEPS)}
            for thread, ms in by_thread.items()
            if "on a core" in ms  # else it ended, and the system forgot its counts
        }
    return {"steps_ms": steps, "threads_ms": waits}


def _times_ms(
    settings: dict[str, Any], stored: OpenedStoredBoxes | None, n_frames: int
) -> dict[str, dict[str, float]]:
    """Milliseconds per frame of each thread of a run, by step and wait."""
    probe = _Probe()
    begin = end = probe.times_s()
    with opened_run(settings, stored) as run, tuned_process(has_dense_stereo=run.settings.sgbm):
        for number, _ in enumerate(run, 1):
            if number == _N_FIRST:
                begin = probe.times_s()
            if number == n_frames - _N_LAST:
                end = probe.times_s()
    return _per_frame(begin, end, n_frames - _N_FIRST - _N_LAST)


def _per_frame(begin: Times, end: Times, n_frames: int) -> dict[str, dict[str, float]]:
    """Milliseconds per frame between two readings of the probe, by thread and step."""
    times_ms: dict[str, dict[str, float]] = {}
    for index, (name, until) in enumerate(end):
        since = begin[index][1] if index < len(begin) else {}
        spent = {
            key: 1e3 * (value - since.get(key, 0.0)) / n_frames for key, value in until.items()
        }
        times_ms[name if name not in times_ms else f"{name} {index}"] = {
            key: ms for key, ms in spent.items() if ms > 0
        }
    return times_ms
