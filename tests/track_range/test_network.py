"""Nothing leaves the machine: the demo makes no connection, and writes nothing into the home folder."""

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]
TRACK_RANGE = Path(sys.executable).with_name("track-range")


@pytest.fixture
def fresh_environment(tmp_path):
    """An environment with an empty home folder, and without settings of onnxruntime's telemetry or of caches."""
    (tmp_path / "home").mkdir()
    kept = {
        name: value
        for name, value in os.environ.items()
        if name != "ORT_DISABLE_TELEMETRY" and not name.startswith(("XDG_", "MPL"))
    }
    return kept | {"HOME": str(tmp_path / "home")}


@pytest.mark.slow
def test_demo_makes_no_connection(tmp_path, fresh_environment):
    strace = shutil.which("strace")
    if strace is None:
        pytest.skip("strace is not installed")
    trace = tmp_path / "trace.txt"
    command = [strace, "-f", "-qq", "-e", "trace=network", "-o", trace, TRACK_RANGE, "demo", "--seconds", "0.5"]
    done = subprocess.run(command, capture_output=True, text=True, env=fresh_environment, cwd=tmp_path, check=False)
    if not trace.is_file() or "ptrace" in done.stderr:
        pytest.skip("strace may not trace processes here")
    assert done.returncode == 0, done.stderr
    assert [line for line in trace.read_text().splitlines() if "AF_INET" in line] == []
    assert [str(file) for file in (tmp_path / "home").rglob("*") if file.is_file()] == []


@pytest.mark.slow
def test_trace_shows_connections(tmp_path):
    """The trace of a program that opens a connection names the address family."""
    strace = shutil.which("strace")
    if strace is None:
        pytest.skip("strace is not installed")
    code = "import socket; socket.socket(socket.AF_INET, socket.SOCK_DGRAM).connect(('127.0.0.1', 9))"
    command = [strace, "-f", "-qq", "-e", "trace=network", sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if "ptrace" in done.stderr:
        pytest.skip("strace may not trace processes here")
    assert any("connect(" in line and "AF_INET" in line for line in done.stderr.splitlines())


@pytest.mark.parametrize(("given", "expected"), [(None, "1"), ("0", "0")])
def test_telemetry_setting(fresh_environment, given, expected):
    environment = fresh_environment | ({} if given is None else {"ORT_DISABLE_TELEMETRY": given})
    code = "import os, track_range.detection.models; print(os.environ['ORT_DISABLE_TELEMETRY'])"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, cwd=PROJECT, check=True
    )
    assert done.stdout.strip() == expected


def test_importers_of_onnxruntime():
    """Only `detection/models`, whose `__init__` disables the telemetry, imports onnxruntime."""
    importers = set()
    for folder in ("detection", "tracking", "stereo", "ranging", "track_range", "benchmarks"):
        for path in (PROJECT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
                names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
                if any(name.split(".")[0] == "onnxruntime" for name in names):
                    importers.add(path.resolve().parent.relative_to(PROJECT).as_posix())
    assert importers == {"detection/models"}
