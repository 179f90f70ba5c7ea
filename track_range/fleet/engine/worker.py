"""Worker: the actor that processes clips in its own process, one after the other."""

from __future__ import annotations

import ctypes
import gc
import os
import platform
import resource
import shutil
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from track_range.fleet.engine.plan import ClipOutcome, ClipProgress, ClipTask, FleetPlan, Process
from track_range.fleet.engine.scratch import open_scratch
from track_range.fleet.engine.shared_files import SharedFile, with_shared_files
from track_range.foundation.processes import owned_process

_PAGE_BYTES = resource.getpagesize()

_FREE_INTERVAL_S = 3.0
"""Shortest time between two returns of free memory, s; one takes about 0.1 s, as long as a very short clip."""


@dataclass(frozen=True, slots=True)
class WorkerInfo:
    """A worker that has started.

    Attributes:
        pid: its process.
        host: its machine.
        node: id of its node in Ray's cluster.
        version: its version of track-range.
    """

    pid: int
    host: str
    node: str
    version: str


@dataclass(frozen=True, slots=True)
class WorkerState:
    """State of a worker at one moment.

    Attributes:
        clip: name of the clip that it is at; "" = none.
        phase: see `ClipProgress`.
        frames: frames processed of the clip.
        video_s: duration of the clip's video, s; 0 = not known yet.
        fetch_bytes: bytes to download for the clip.
        memory_bytes: resident memory of its process.
    """

    clip: str
    phase: str
    frames: int
    video_s: float
    fetch_bytes: float
    memory_bytes: int


class Worker:
    """Actor of a fleet.

    Args:
        plan: of the fleet.
        process: processes a clip.
        files: files that all clips share, if the driver is on another machine.
    """

    def __init__(self, plan: FleetPlan, process: Process, files: Mapping[str, SharedFile]) -> None:
        limit_threads(plan.threads)
        self._folder = open_scratch(plan.cache_dir)
        self._plan, self._process = with_shared_files(plan, files, self._folder / "shared"), process
        self._progress = ClipProgress()
        self._freed_s = time.monotonic()

    def info(self) -> WorkerInfo:
        """Process, machine and version."""
        from importlib.metadata import version

        import ray

        node = ray.get_runtime_context().get_node_id()
        return WorkerInfo(os.getpid(), platform.node(), node, version("track-range"))

    def run(self, task: ClipTask) -> ClipOutcome:
        """Process a clip."""
        self._progress = ClipProgress(clip=task.clip.name)
        try:
            with owned_process():
                return self._process(task, self._plan, self._progress)
        finally:
            self._progress = ClipProgress()
            if time.monotonic() - self._freed_s > _FREE_INTERVAL_S:
                return_free_memory()
                self._freed_s = time.monotonic()

    def close(self) -> None:
        """Remove the folder of this worker, before its end."""
        shutil.rmtree(self._folder, ignore_errors=True)

    def state(self) -> WorkerState:
        """Progress and memory at this moment; called in another thread while `run` is at work."""
        progress = self._progress
        return WorkerState(
            clip=progress.clip,
            phase=progress.phase,
            frames=progress.frames,
            video_s=progress.video_s,
            fetch_bytes=progress.fetch_bytes,
            memory_bytes=resident_bytes(),
        )


def limit_threads(n_threads: int) -> None:
    """Limit the threads of the libraries in this process; has to be called before they are imported.

    Linear algebra gets one thread whatever the number is: its sums, and with them the last digits of the results,
    depend on the number of threads.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    import cv2

    cv2.setNumThreads(n_threads)


def return_free_memory() -> None:
    """Return the memory that this process no longer needs to the operating system, where the C library is glibc.

    PyAV's frames refer to themselves, so that they and the images beside them stay until Python looks for such cycles,
    which it rarely does by itself; the free parts of the heaps, one for each thread, stay for ever. Together they make
    a worker grow by 20 to 45 MB per clip.
    """
    gc.collect()
    try:
        ctypes.CDLL(None).malloc_trim(0)
    except (OSError, AttributeError, TypeError):  # another C library
        return


def resident_bytes() -> int:
    """Resident memory of this process."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * _PAGE_BYTES
    except (OSError, ValueError, IndexError):
        largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return largest if sys.platform == "darwin" else largest * 1024
