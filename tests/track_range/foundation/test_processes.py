from __future__ import annotations

import gc
import math
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import cv2
import pytest

from track_range.foundation.processes import (
    is_running,
    n_limited_cores,
    n_usable_cores,
    one_opencv_thread,
    quota_cores,
    tuned_process,
)


def test_processes() -> None:
    ended = subprocess.Popen([sys.executable, "-S", "-c", ""])
    ended.wait()
    assert is_running(os.getpid())
    assert not is_running(ended.pid)


@pytest.mark.parametrize(
    ("groups", "files", "quota"),
    [
        ("0::/\n", {"cpu.max": "250000 100000"}, 2.5),
        ("0::/\n", {"cpu.max": "max 100000"}, math.inf),
        ("0::/a/b\n", {"a/b/cpu.max": "max 100000", "a/cpu.max": "50000 100000"}, 0.5),
        ("0::/../host\n", {"cpu.max": "300000 100000"}, 3),
        ("5:cpu,cpuacct:/docker/x\n3:cpuset:/\n", {"cpu,cpuacct/cpu.cfs_quota_us": "150000"}, 1.5),
        ("5:cpu:/\n0::/\n", {"cpu/cpu.cfs_quota_us": "-1"}, math.inf),
        ("5:memory:/\n", {"memory/cpu.cfs_quota_us": "100000"}, math.inf),
        ("0::/\n", {"cpu.max": "damaged"}, math.inf),
        ("0::/\n", {}, math.inf),
    ],
)
def test_quota_of_a_container(
    tmp_path: Path, groups: str, files: dict[str, str], quota: float
) -> None:
    """Version 1 has a period of 100 ms in each group."""
    write_groups(tmp_path, groups, files)
    assert quota_cores(tmp_path) == quota


def write_groups(root: Path, groups: str, files: dict[str, str]) -> None:
    """The files of Linux's control groups below `root`."""
    for name, text in {
        "proc/self/cgroup": groups,
        **{f"sys/fs/cgroup/{name}": text for name, text in files.items()},
    }.items():
        file = root / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        if file.name == "cpu.cfs_quota_us":
            file.with_name("cpu.cfs_period_us").write_text("100000\n")


def test_cores_of_a_quota(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(64)), raising=False)
    for quota_us, n_usable, n_limited in (
        ("50000", 1, 1),
        ("250000", 3, 3),
        ("6390000", 64, 0),
        ("10000000", 64, 0),
        ("max", 64, 0),
    ):
        write_groups(tmp_path, "0::/\n", {"cpu.max": f"{quota_us} 100000"})
        assert (n_usable_cores(tmp_path), n_limited_cores(tmp_path)) == (n_usable, n_limited)


def test_usable_cores(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {3, 8}, raising=False)
    assert n_usable_cores(tmp_path) == 2
    monkeypatch.delattr(os, "sched_getaffinity")  # macOS, Windows
    assert n_usable_cores(tmp_path) == 64
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert n_usable_cores(tmp_path) == 1


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


@pytest.mark.skipif(quota_cores(Path("/")) < 4, reason="a container with fewer than four cores")
@pytest.mark.parametrize(
    ("n_cores", "has_dense_stereo", "n_threads"), [(2, False, 1), (2, True, 3), (4, False, 3)]
)
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
    before = gc.get_threshold()
    assert gc.get_freeze_count() == 0
    with tuned_process(has_dense_stereo=False):
        with tuned_process(has_dense_stereo=False):
            assert gc.get_freeze_count() > 1000
        assert gc.get_freeze_count() > 1000
        assert gc.get_threshold() == (10_000, *before[1:])
    assert gc.get_freeze_count() == 0
    assert gc.get_threshold() == before


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
