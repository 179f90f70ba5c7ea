"""Processes and processor cores of this machine, and settings that hold for a whole process.

The library changes none of these settings by itself. Only the command line and the workers of a
fleet, whose processes serve nothing else, and programs that call `tuned_process` change them.
"""

import gc
import math
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path

# longest wait for the GIL; Python's default, 5 ms, is a tenth of the time per frame
_SWITCH_INTERVAL_S = 0.0005
# New objects after which unreachable ones are searched for. A frame makes and drops more than
# Python's default, 700, whose searches take 0.5 ms per frame and find next to nothing.
_N_NEW_OBJECTS = 10_000
_FEW_CORES = 2  # up to which inference and the other stages need all of them

_is_owned = False  # whether the process serves track-range alone


def is_running(pid: int) -> bool:
    """Whether a process with this id exists, even if it belongs to another user."""
    try:
        os.kill(pid, 0)
    except OSError as error:
        return not isinstance(error, ProcessLookupError)
    return True


def n_usable_cores(root: Path = Path("/")) -> int:
    """Cores that this process may use by its affinity (`taskset`), at most the quota of its
    container, which is read below `root`.
    """
    n_cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    return max(1, math.ceil(min(n_cores, quota_cores(root))))


def n_limited_cores(root: Path = Path("/")) -> int:
    """`n_usable_cores` if they are fewer than the machine has, else 0: libraries then choose by the
    physical cores.
    """
    return n_cores if (n_cores := n_usable_cores(root)) < (os.cpu_count() or 1) else 0


def quota_cores(root: Path) -> float:
    """Processor time per time that the control groups of this process and their parents allow, in
    cores.

    Version 1 has cpu.cfs_quota_us and cpu.cfs_period_us, version 2 both in cpu.max (Linux's
    cgroup-v1 and cgroup-v2 documentation). A container sees its own group at the top, under
    whatever name the host has for it. inf = no limit.
    """
    quotas = [math.inf]
    for folder, names in _control_groups(root):
        with suppress(OSError, ValueError):  # no such file, or "max" or -1: no limit
            texts = [text for name in names for text in (folder / name).read_text().split()]
            quota_us, period_us = map(int, texts)
            if quota_us > 0 and period_us > 0:
                quotas.append(quota_us / period_us)
    return min(quotas)


def _control_groups(root: Path) -> Iterator[tuple[Path, tuple[str, ...]]]:
    """Folders of the control groups of this process and their parents, and the names of the files
    with their quotas.
    """
    try:
        lines = (root / "proc/self/cgroup").read_text().splitlines()
    except OSError:  # not Linux
        return
    for line in lines:
        _, controllers, name = line.split(":", 2)
        if controllers and "cpu" not in controllers.split(","):
            continue
        names = ("cpu.cfs_quota_us", "cpu.cfs_period_us") if controllers else ("cpu.max",)
        top = root / "sys/fs/cgroup" / controllers
        group = top / name.lstrip("/")
        for folder in (group, *group.parents):
            yield folder, names
            if folder == top:
                break


@contextmanager
def tuned_process(*, has_dense_stereo: bool = False) -> Iterator[None]:
    """Context for the loop over a run in a process that serves only this run, as on the command
    line.

    Threads wait at most 0.5 ms for the GIL. Garbage collections are rarer, and leave out the
    objects that exist before, since searching them takes 60 ms; if the program has frozen objects
    itself, they are not changed. On two cores or fewer, OpenCV uses one thread, since further
    threads would interrupt inference. The end of the context restores the settings.

    Example:
        >>> import track_range as tr
        >>> run = tr.Run.mono("dashcam.mp4", focal_px=1150, duration=0.3).open()
        >>> with tr.tuned_process():
        ...     n_frames = sum(1 for frame in run)

    Args:
        has_dense_stereo: whether the run matches each image densely (`sgbm`), which is then the
            bottleneck and has all of OpenCV's threads.
    """
    interval_s, is_frozen = sys.getswitchinterval(), gc.get_freeze_count() > 0
    n_new_objects, *older = gc.get_threshold()
    is_single = n_usable_cores() <= _FEW_CORES and not has_dense_stereo
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    if not is_frozen:
        gc.freeze()
        gc.set_threshold(_N_NEW_OBJECTS, *older)
    try:
        with one_opencv_thread() if is_single else nullcontext():
            yield
    finally:
        sys.setswitchinterval(interval_s)
        if not is_frozen:
            gc.set_threshold(n_new_objects, *older)
            gc.unfreeze()


@contextmanager
def one_opencv_thread() -> Iterator[None]:
    """Context in which OpenCV uses one thread; the number of threads is restored afterwards."""
    import cv2

    n_before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(n_before)


@contextmanager
def owned_process() -> Iterator[None]:
    """Context of the command line and of a fleet's worker, in which `search_current_folder` has an
    effect.
    """
    global _is_owned
    before, _is_owned = _is_owned, True
    try:
        yield
    finally:
        _is_owned = before


def search_current_folder() -> None:
    """Let modules be imported from the current folder too, after installed modules, if the process
    is ours.
    """
    if _is_owned and os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
