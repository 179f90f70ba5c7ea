"""Rules on the source: which package may import which, names and docstrings of files, assert and bare except."""

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

VAGUE_NAMES = {"utils", "util", "common", "core", "helpers", "misc", "tools", "base"}


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


@pytest.mark.parametrize("path", sources(*PACKAGES), ids=lambda p: p.relative_to(PROJECT).as_posix())
def test_files_have_a_specific_name_and_a_module_docstring(path):
    text = path.read_text(encoding="utf-8")
    assert path.stem not in VAGUE_NAMES
    assert ast.get_docstring(ast.parse(text)), "no module docstring"


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
