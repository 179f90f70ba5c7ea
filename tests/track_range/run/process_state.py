"""The settings of the process, before and after something."""

from __future__ import annotations

import gc
import logging
import os
import signal
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2


def process_state() -> dict[str, Any]:
    """Settings that hold for the whole process."""
    return {
        "thread switching interval": sys.getswitchinterval(),
        "OpenCV's threads": cv2.getNumThreads(),
        "OpenCV's optimizations": cv2.useOptimized(),
        "garbage collection": (
            gc.isenabled(),
            gc.get_threshold(),
            gc.get_freeze_count(),
            list(gc.callbacks),
        ),
        "niceness": os.getpriority(os.PRIO_PROCESS, os.getpid()),
        "folders of modules": list(sys.path),
        "log handlers": list(logging.getLogger().handlers),
        "log level": (logging.getLogger().level, logging.root.manager.disable),
        "signal handlers": [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)],
        "output": (sys.stdout, sys.stderr),
    }


_LEAVE_S = 10.0  # time in which joined threads leave the list of the system, on a busy machine


def niceness_of_threads() -> set[int]:
    """Niceness of each thread of this process, also those of libraries (Linux only)."""
    folder = Path("/proc/self/task")
    return (
        {os.getpriority(os.PRIO_PROCESS, int(task.name)) for task in folder.iterdir()}
        if folder.is_dir()
        else set()
    )


def assert_unchanged_by(results: Iterable[Any]) -> None:
    """Check that the settings of the process are the same before, inside the loop of, and after an
    iteration."""
    before, threads_before = process_state(), niceness_of_threads()
    n_results = 0
    for _ in results:
        n_results += 1
        assert process_state() == before
    assert n_results > 0
    assert process_state() == before
    until_s = time.monotonic() + _LEAVE_S
    while not niceness_of_threads() <= threads_before and time.monotonic() < until_s:
        time.sleep(0.05)
    assert niceness_of_threads() <= threads_before
