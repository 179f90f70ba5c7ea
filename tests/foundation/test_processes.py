from __future__ import annotations

import os
import subprocess
import sys

from track_range.foundation.processes import is_running


def test_processes() -> None:
    ended = subprocess.Popen([sys.executable, "-S", "-c", ""])
    ended.wait()
    assert is_running(os.getpid())
    assert not is_running(ended.pid)
