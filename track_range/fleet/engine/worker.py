"""A worker: a process of Ray that processes clips one after the other, each as a task that yields
its state.

Ray replaces a process that dies or is cancelled, and one that has processed `CLIPS_PER_PROCESS`
clips.
"""

from __future__ import annotations

import gc
import os
import platform
import resource
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

from track_range.fleet.engine.plan import ClipOutcome, ClipProgress, ClipTask, FleetPlan, Process
from track_range.fleet.errors import FleetError
from track_range.foundation.files.input_files import read_bytes
from track_range.foundation.processes import is_running, owned_process
from track_range.run.options.paths import NETWORKS, network_files, paths_of
from track_range.run.options.settings import RunSettings

# then a new process: it grows by 20 to 45 MB per clip, and a new one takes 2 s for imports
CLIPS_PER_PROCESS = 20
FOLDER_PREFIX = f"track-range-fleet-{platform.node() or 'host'}-"

_COLLECT_S = 3.0  # shortest clip after which free objects are searched, which takes 0.1 s
_STATE_S = 1.0  # time between two states, s
_MAX_SHARED_BYTES = 2_000_000_000

# name and content of the files that all clips share, by setting
SharedFiles = Mapping[str, list[tuple[str, bytes]]]


@dataclass(frozen=True, slots=True)
class WorkerState:
    """Process, machine, id of the node in Ray, progress and resident memory of a worker that
    processes a clip.
    """

    pid: int
    host: str
    node: str
    progress: ClipProgress
    memory_bytes: int


def process_clip(
    task: ClipTask, plan: FleetPlan, process: Process, files: SharedFiles
) -> Iterator[WorkerState | ClipOutcome]:
    """States of the worker while it processes a clip, then the outcome.

    `files` are the files that all clips share, if the driver is on another machine. Raises
    FleetError if the versions of track-range of worker and driver differ.
    """
    import ray

    if (installed := version("track-range")) != plan.version:
        raise FleetError(
            f"node {platform.node()}: expected track-range {plan.version}, found {installed}; "
            "install the same version on all nodes."
        )
    _limit_threads(plan.settings.threads)
    progress, start_s, node = (
        ClipProgress(),
        time.monotonic(),
        ray.get_runtime_context().get_node_id(),
    )
    with (
        scratch_folder(plan.settings.cache_dir) as folder,
        owned_process(),
        ThreadPoolExecutor(1) as thread,
    ):
        future = thread.submit(
            process, task, with_shared_files(plan, files, folder / "shared"), progress
        )
        is_done = False
        while not is_done:
            yield WorkerState(
                os.getpid(), platform.node(), node, replace(progress), _resident_bytes()
            )
            is_done = bool(wait([future], _STATE_S).done)
        error = future.exception()  # raised here, it would look like a worker that cannot start
        defect = " ".join(str(error).split())[-300:] or repr(error)
        outcome = future.result() if error is None else ClipOutcome({}, defect=defect)
    if time.monotonic() - start_s > _COLLECT_S:
        gc.collect()  # PyAV's frames refer to themselves
    yield outcome  # the driver may not ask for more


def _limit_threads(n_threads: int) -> None:
    """Limit the threads of the libraries in this process.

    Linear algebra gets one thread whatever the number is: its sums, and with them the last digits
    of the results, depend on the number of threads.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    import cv2

    cv2.setNumThreads(n_threads)


def _resident_bytes() -> int:
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
    except (OSError, ValueError, IndexError):
        return peak_memory_bytes()


def reset_peak_memory() -> None:
    """Restart the measurement of the peak memory (Linux, proc_pid_clear_refs(5))."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def peak_memory_bytes() -> int:
    """Largest resident memory of this process since its start, or since `reset_peak_memory`."""
    largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return largest if sys.platform == "darwin" else largest * 1024


@contextmanager
def scratch_folder(cache_dir: Path | None) -> Iterator[Path]:
    """Temporary folder of this process, in `cache_dir` if given; folders of killed processes are
    removed.
    """
    before = tempfile.tempdir
    parent = cache_dir or Path(tempfile.gettempdir())
    remove_dead_folders(parent, FOLDER_PREFIX)
    folder = parent / f"{FOLDER_PREFIX}{os.getpid()}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    tempfile.tempdir = str(folder)
    try:
        yield folder
    finally:
        tempfile.tempdir = before
        shutil.rmtree(folder, ignore_errors=True)


def remove_dead_folders(parent: Path, prefix: str) -> None:
    """Remove the folders PREFIX-PID-... of processes of this machine that were killed."""
    for folder in parent.glob(f"{prefix}*"):
        pid = folder.name.removeprefix(prefix).partition("-")[0]
        if pid.isdigit() and not is_running(int(pid)):
            shutil.rmtree(folder, ignore_errors=True)


def shared_files(plan: FleetPlan) -> SharedFiles:
    """The files in the options of a plan, for workers on other machines; raises FleetError if one
    cannot be read.
    """
    files: dict[str, list[tuple[str, bytes]]] = {}
    for name in plan.shared:
        paths = paths_of(plan.options.get(name))
        flag = RunSettings.flag(name)
        files[name] = [
            (
                path.name,
                read_bytes(path, FleetError, f"a file of {flag}", max_bytes=_MAX_SHARED_BYTES),
            )
            for path in (network_files(paths) if name in NETWORKS else paths)
        ]
    return files


def with_shared_files(plan: FleetPlan, files: SharedFiles, folder: Path) -> FleetPlan:
    """The plan with the paths of copies of the files in a folder; without a copy, the driver's path
    is used.
    """
    options = dict(plan.options)
    for setting, contents in files.items():
        if not contents:
            continue
        parent = folder / setting
        parent.mkdir(parents=True)
        for name, content in contents:
            (parent / name).write_bytes(content)
        copies = [str(parent / path.name) for path in paths_of(options[setting])]
        options[setting] = copies if setting in NETWORKS else copies[0]
    return replace(plan, options=options)
