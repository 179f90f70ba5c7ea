"""The house as a table: who may import whom, and which file alone may open which library."""

import ast
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]
PACKAGES = ("detection", "tracking", "stereo", "ranging", "track_range")

ARROWS = {
    "detection": {"detection"},
    "stereo": {"stereo"},
    "tracking": {"tracking", "detection"},
    "ranging": {"ranging", "tracking", "stereo", "detection"},
    "track_range": set(PACKAGES),
    "benchmarks": {*PACKAGES, "benchmarks"},
}

DOORS = {
    "onnxruntime": {"detection/onnx_session.py", "detection/quantize.py"},
    "onnx": {
        "detection/darknet.py",
        "detection/quantize.py",
        "detection/training/export.py",
        "detection/training/onnx_weights.py",
    },
    "torch": {"detection/training/"},
    "motmetrics": set(),  # the oracle of tests
    "av": {"track_range/video_file.py", "track_range/video_writer.py", "track_range/live_stream.py"},
    "filterpy": set(),  # the oracle of tests; where there is one filter, it may come in
    "pydantic": {"stereo/rig_files.py", "track_range/config.py"},
    "matplotlib": {"track_range/charts.py"},
    "jinja2": {"track_range/report.py"},
    "typer": {
        "track_range/cli.py",
        "track_range/cli_calibration.py",
        "track_range/cli_alignment.py",
        "track_range/cli_models.py",
        "track_range/cli_report.py",
        "track_range/cli_ranging.py",
        "track_range/cli_run.py",
        "track_range/cli_simulation.py",
        "track_range/cli_tracking.py",
        "track_range/cli_training.py",
    },
    "rich": {
        "track_range/cli.py",
        "track_range/cli_calibration.py",
        "track_range/cli_alignment.py",
        "track_range/cli_models.py",
        "track_range/cli_report.py",
        "track_range/cli_ranging.py",
        "track_range/cli_run.py",
        "track_range/cli_simulation.py",
        "track_range/cli_tracking.py",
        "track_range/cli_training.py",
        "track_range/terminal_tables.py",
        "track_range/commands/",
    },
}

VAGUE_NAMES = {"utils", "util", "common", "core", "helpers", "misc", "tools", "base"}
MAX_LINES = 300


def sources(*folders):
    return [path for folder in folders for path in sorted((PROJECT / folder).rglob("*.py"))]


def imported(path):
    """Top-level names that a file imports, also inside functions."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield (node.module or "").split(".")[0]


def breaches(package, path):
    house = set(ARROWS)
    return sorted((set(imported(path)) & house) - ARROWS[package])


@pytest.mark.parametrize("package", ARROWS)
def test_imports_follow_the_arrows(package):
    files = sources(package)
    assert files
    assert {str(path): found for path in files if (found := breaches(package, path))} == {}


def test_an_arrow_against_the_stream_would_be_seen(tmp_path):
    wrong = tmp_path / "wrong.py"
    wrong.write_text("def f():\n    from ranging.ranges import Ranges\n    import track_range\n")
    assert breaches("detection", wrong) == ["ranging", "track_range"]


@pytest.mark.parametrize("library", DOORS)
def test_one_door_per_library(library):
    users = {path.relative_to(PROJECT).as_posix() for path in sources(*PACKAGES) if library in set(imported(path))}
    doors = DOORS[library]
    assert {
        user for user in users if not any(user == d or (d.endswith("/") and user.startswith(d)) for d in doors)
    } == set()


@pytest.mark.parametrize("path", sources(*PACKAGES), ids=lambda p: p.relative_to(PROJECT).as_posix())
def test_files_have_a_name_a_sentence_and_a_size(path):
    text = path.read_text(encoding="utf-8")
    assert path.stem not in VAGUE_NAMES
    assert ast.get_docstring(ast.parse(text)), "no module docstring"
    assert len(text.splitlines()) <= MAX_LINES


@pytest.mark.parametrize("package", PACKAGES)
def test_packages_are_typed_and_their_init_only_names_things(package):
    assert (PROJECT / package / "py.typed").exists()
    tree = ast.parse((PROJECT / package / "__init__.py").read_text(encoding="utf-8"))
    assert all(isinstance(node, ast.Expr | ast.Import | ast.ImportFrom | ast.Assign) for node in tree.body)


def test_packages_neither_assert_nor_swallow_everything():
    wrong = []
    for path in sources(*PACKAGES):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Assert):
                wrong.append(f"{path}:{node.lineno} assert")
            if isinstance(node, ast.ExceptHandler) and node.type is None:
                wrong.append(f"{path}:{node.lineno} bare except")
    assert wrong == []
