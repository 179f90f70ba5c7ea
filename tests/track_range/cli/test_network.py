"""Nothing leaves the machine: commands make no connection, and write nothing into the home folder
but our cache."""

import ast
import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from track_range.foundation.library_telemetry import TELEMETRY_SWITCHES

PROJECT = Path(__file__).resolve().parents[3]
TRACK_RANGE = Path(sys.executable).with_name("track-range")
FOLDERS = ("detection", "tracking", "stereo", "ranging", "track_range")
VARIABLES = {variable for variable, _ in TELEMETRY_SWITCHES.values()}

BOXES = "class,x1,y1,x2,y2,distance_m,fx\n" + "".join(
    f"car,100,100,{100 + 1760 / z_m:.2f},{100 + 1650 / z_m:.2f},{z_m},1100\n"
    for z_m in np.linspace(5, 65, 200)
)

COMMANDS = [
    pytest.param(["demo", "--seconds", "0.5", "--out", "results"], {"results"}, set(), id="demo"),
    # matplotlib stores its list of fonts
    pytest.param(
        [
            "fit",
            "--csv",
            "boxes.csv",
            "--out",
            "curves.json",
            "--compare",
            "--picture",
            "curves.png",
        ],
        {"curves.json", "curves.png"},
        {".cache/track-range/matplotlib"},
        id="fit",
    ),
]
"""Commands that import all third-party packages between them, their results, and folders of the
home folder with files.

A command of an optional package is added with `marks=pytest.mark.skipif(not is_installed(...))`.
"""


def is_installed(package):
    return importlib.util.find_spec(package) is not None


@pytest.fixture
def fresh_environment(tmp_path):
    """An environment with an empty home folder, and without settings of onnxruntime's telemetry or
    of caches."""
    (tmp_path / "home").mkdir()
    kept = {
        name: value
        for name, value in os.environ.items()
        if name not in VARIABLES and not name.startswith(("XDG_", "MPL", "TRACK_RANGE_CACHE"))
    }
    return kept | {"HOME": str(tmp_path / "home")}


@pytest.mark.slow
@pytest.mark.parametrize(("arguments", "results", "folders"), COMMANDS)
def test_commands_stay_on_the_machine(tmp_path, fresh_environment, arguments, results, folders):
    """No socket, no file outside of the results and the cache, and no import from the current
    folder."""
    work, temporary = tmp_path / "work", tmp_path / "temporary"
    work.mkdir()
    temporary.mkdir()
    inputs = {"boxes.csv": BOXES} | {
        f"{name}.py": "raise SystemExit(9)" for name in ("json", "numpy", "detection")
    }
    for name, text in inputs.items():
        (work / name).write_text(text, encoding="utf-8")
    strace, trace = shutil.which("strace"), tmp_path / "trace.txt"
    tracing = [] if strace is None else [strace, "-f", "-qq", "-e", "trace=network", "-o", trace]
    done = subprocess.run(
        [*tracing, TRACK_RANGE, *arguments],
        capture_output=True,
        text=True,
        env=fresh_environment | {"TMPDIR": str(temporary)},
        cwd=work,
        check=False,
    )
    if tracing and (not trace.is_file() or "ptrace" in done.stderr):
        pytest.skip("strace may not trace processes here")
    assert done.returncode == 0, done.stderr
    assert {path.name for path in work.iterdir()} == results | set(inputs)
    assert list(temporary.iterdir()) == []
    home = tmp_path / "home"
    assert {
        path.parent.relative_to(home).as_posix() for path in home.rglob("*") if path.is_file()
    } <= folders
    if not tracing:
        pytest.skip("strace is not installed; files were checked")
    assert [line for line in trace.read_text().splitlines() if "AF_INET" in line] == []


@pytest.mark.slow
def test_trace_shows_connections(tmp_path):
    """The trace of a program that opens a connection names the address family."""
    strace = shutil.which("strace")
    if strace is None:
        pytest.skip("strace is not installed")
    code = (
        "import socket; socket.socket(socket.AF_INET, socket.SOCK_DGRAM).connect(('127.0.0.1', 9))"
    )
    command = [strace, "-f", "-qq", "-e", "trace=network", sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if "ptrace" in done.stderr:
        pytest.skip("strace may not trace processes here")
    assert any("connect(" in line and "AF_INET" in line for line in done.stderr.splitlines())


def importers_of(package):
    """Folders of the modules that import a package anywhere, relative to the project, as posix
    paths."""
    importers = set()
    for folder in (*FOLDERS, "benchmarks"):
        for path in (PROJECT / folder).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            if package not in text:
                continue
            for node in ast.walk(ast.parse(text)):
                names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
                names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
                if any(name.split(".")[0] == package for name in names):
                    importers.add(path.resolve().parent.relative_to(PROJECT).as_posix())
    return sorted(importers)


def module_of(folder):
    """Name under which a folder of the project is imported."""
    is_outside = folder.split("/")[0] in ("track_range", "benchmarks")
    return folder.replace("/", ".") if is_outside else f"track_range.{folder.replace('/', '.')}"


def variable_after_import(module, variable, environment):
    code = f"import os, {module}; print(os.environ.get({variable!r}))"
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env=environment,
        cwd=PROJECT,
        check=True,
    )
    return done.stdout.strip()


@pytest.mark.parametrize(
    "package",
    [
        pytest.param(package, marks=pytest.mark.slow if package == "ray" else ())
        for package in TELEMETRY_SWITCHES
    ],
)
def test_importers_disable_telemetry(fresh_environment, package):
    """Each package of ours that imports one with telemetry disables it, and a user's own setting is
    kept."""
    if not is_installed(package):
        pytest.skip(f"{package} is not installed")
    variable, value = TELEMETRY_SWITCHES[package]
    for folder in importers_of(package):
        module = module_of(folder)
        assert variable_after_import(module, variable, fresh_environment) == value
        own = fresh_environment | {variable: "own"}
        assert variable_after_import(module, variable, own) == "own"


def test_importers_of_onnxruntime():
    assert importers_of("onnxruntime") == ["detection/models"]


@pytest.mark.parametrize("given", [None, "/own"])
def test_matplotlib_folder(fresh_environment, given):
    environment = fresh_environment | ({} if given is None else {"MPLCONFIGDIR": given})
    importers = [
        folder for folder in importers_of("matplotlib") if not folder.startswith("benchmarks")
    ]
    # the first imports it in a function
    assert importers == ["track_range/calibration", "track_range/views/report"]
    expected = f"{environment['HOME']}/.cache/track-range/matplotlib" if given is None else given
    if sys.platform == "linux" or given:
        assert (
            variable_after_import("track_range.views.report", "MPLCONFIGDIR", environment)
            == expected
        )
