from __future__ import annotations

import gc
import os
import subprocess
import sys
from contextlib import suppress

import cv2
import pytest

from track_range.foundation.processes import is_running, n_usable_cores, one_opencv_thread, tuned_process


def test_processes() -> None:
    ended = subprocess.Popen([sys.executable, "-S", "-c", ""])
    ended.wait()
    assert is_running(os.getpid())
    assert not is_running(ended.pid)


def test_usable_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {3, 8}, raising=False)
    assert n_usable_cores() == 2
    monkeypatch.delattr(os, "sched_getaffinity")  # macOS, Windows
    assert n_usable_cores() == 64
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert n_usable_cores() == 1


def test_switching_interval() -> None:
    before_s = sys.getswitchinterval()
    with tuned_process():
        assert sys.getswitchinterval() < before_s / 2
    assert sys.getswitchinterval() == before_s


def test_opencv_threads_are_restored_after_an_error() -> None:
    before = cv2.getNumThreads()
    cv2.setNumThreads(3)
    try:
        with suppress(KeyError), one_opencv_thread():
            assert cv2.getNumThreads() == 1
            raise KeyError
        assert cv2.getNumThreads() == 3
    finally:
        cv2.setNumThreads(before)


@pytest.mark.parametrize(("n_cores", "has_dense_stereo", "n_threads"), [(2, False, 1), (2, True, 3), (4, False, 3)])
def test_threads_of_opencv(
    n_cores: int, has_dense_stereo: bool, n_threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(n_cores)), raising=False)
    before = cv2.getNumThreads()
    cv2.setNumThreads(3)
    try:
        with tuned_process(has_dense_stereo=has_dense_stereo):
            with tuned_process(has_dense_stereo=has_dense_stereo):
                assert cv2.getNumThreads() == n_threads
            assert cv2.getNumThreads() == n_threads
        assert cv2.getNumThreads() == 3
    finally:
        cv2.setNumThreads(before)


def test_objects_that_exist_before_are_frozen() -> None:
    assert gc.get_freeze_count() == 0
    with tuned_process(has_dense_stereo=False):
        with tuned_process(has_dense_stereo=False):
            assert gc.get_freeze_count() > 1000
        assert gc.get_freeze_count() > 1000
    assert gc.get_freeze_count() == 0


def test_objects_that_the_application_has_frozen_remain_frozen() -> None:
    gc.freeze()
    try:
        n_frozen = gc.get_freeze_count()
        tracked = [[number] for number in range(1000)]
        with tuned_process(has_dense_stereo=False):
            assert gc.get_freeze_count() < n_frozen + len(tracked)
        assert gc.get_freeze_count() < n_frozen + len(tracked)
        with tuned_process(has_dense_stereo=False):
            gc.unfreeze()  # the application's decision
        assert gc.get_freeze_count() == 0
    finally:
        gc.unfreeze()
