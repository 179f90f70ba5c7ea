"""Processes and processor cores of this machine."""

from __future__ import annotations

import os


def is_running(pid: int) -> bool:
    """Whether a process with this id exists, also one of another user."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def n_usable_cores() -> int:
    """Number of logical cores that this process may use: those of its affinity, which containers and `taskset` limit.

    Where the system has no affinity (macOS, Windows), all cores.
    """
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
