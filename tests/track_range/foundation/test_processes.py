from __future__ import annotations

import os
import subprocess
import sys

import pytest

from track_range.foundation.processes import is_running, n_usable_cores


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
