"""Imports between packages, and what every module has."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]
PACKAGES = ("detection", "tracking", "stereo", "ranging", "track_range")

MAY_IMPORT = {
    "foundation": {"foundation"},
    "detection": {"foundation", "detection"},
    "stereo": {"foundation", "stereo"},
    "tracking": {"foundation", "tracking", "detection"},
    "ranging": {"foundation", "ranging", "tracking", "stereo", "detection"},
}
"""Packages under track_range. and the ones that they may import; the rest of track_range imports all of them."""

VAGUE_NAMES = {"utils", "util", "common", "core", "helpers", "misc", "tools", "base"}


def folder_of(package):
    return PROJECT / ("track_range/foundation" if package == "foundation" else package)


def sources(*packages):
    """Source files of packages; the links in track_range are not followed."""
    return [path for package in packages for path in sorted(folder_of(package).rglob("*.py"))]


def nodes_of(path):
    """All nodes of the syntax tree of a file; the first is the module."""
    return ast.walk(ast.parse(path.read_text(encoding="utf-8")))


@cache
def imported_modules(path):
    """Full names of the modules that a file imports, also inside functions."""
    return tuple(_imported_modules(path))


def _imported_modules(path):
    for node in nodes_of(path):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield node.module or ""
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def may_import(path, names):
    """Whether the text of a file has a line that may import one of these top-level packages."""
    return re.search(rf"^\s*(from|import)\s.*\b({'|'.join(names)})\b", path.read_text(encoding="utf-8"), re.MULTILINE)


def forbidden_imports(package, path):
    """Modules of track_range that `package` may not import."""
    allowed = MAY_IMPORT[package]
    ours = (name.split(".") for name in imported_modules(path) if name.startswith("track_range."))
    return sorted({".".join(parts[:2]) for parts in ours if parts[1] not in allowed})


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_imports_between_packages(package):
    files = sources(package)
    assert files
    assert {str(path): wrong for path in files if (wrong := forbidden_imports(package, path))} == {}


def test_forbidden_import_is_seen(tmp_path):
    wrong = tmp_path / "wrong.py"
    wrong.write_text("def f():\n    from track_range.ranging.ranges import Ranges\n    from track_range import cli\n")
    assert forbidden_imports("detection", wrong) == ["track_range.cli", "track_range.ranging"]


def test_nothing_imports_tests_or_benchmarks():
    outside = {"tests", "benchmarks", *PACKAGES[:4]}
    files = [path for path in sources(*PACKAGES) if may_import(path, outside)]
    users = [str(path) for path in files for name in imported_modules(path) if name.split(".")[0] in outside]
    assert users == []


def test_only_tests_of_benchmarks_import_them():
    tests = PROJECT / "tests"
    files = [path for path in sorted(tests.rglob("*.py")) if not path.is_relative_to(tests / "benchmarks")]
    assert len(files) > 100
    files = [path for path in files if may_import(path, ["benchmarks"])]
    users = [str(path) for path in files for name in imported_modules(path) if name.split(".")[0] == "benchmarks"]
    assert users == []


@pytest.mark.parametrize("package", PACKAGES)
def test_modules_have_a_docstring_and_a_telling_name(package):
    for path in sources(package):
        assert path.stem not in VAGUE_NAMES, path
        text = path.read_text(encoding="utf-8").lstrip()
        assert text.startswith(('"""', 'r"""')), f"{path}: no module docstring"


@pytest.mark.parametrize("package", PACKAGES)
def test_packages_are_typed(package):
    assert (PROJECT / package / "py.typed").exists()


def test_track_range_holds_at_most_23_entries():
    entries = [path.name for path in (PROJECT / "track_range").iterdir() if path.name != "__pycache__"]
    assert len(entries) <= 23, sorted(entries)


def test_packages_neither_assert_nor_swallow_everything():
    wrong = []
    words = re.compile(r"^\s*(assert\b|except\s*:)", re.MULTILINE)
    for path in sources(*PACKAGES):
        for node in nodes_of(path) if words.search(path.read_text(encoding="utf-8")) else ():
            if isinstance(node, ast.Assert):
                wrong.append(f"{path}:{node.lineno} assert")
            if isinstance(node, ast.ExceptHandler) and node.type is None:
                wrong.append(f"{path}:{node.lineno} bare except")
    assert wrong == []


READS_YAML_OR_JSON = {
    "track_range/foundation/files/structured_text.py": "the reader of all YAML and JSON files",
    "track_range/foundation/files/folder_lock.py": "lock files, at most a few hundred bytes, ignored if damaged",
    "detection/models/metadata.py": "Ultralytics writes class names as a Python literal; the size is limited",
}
"""Files that call a parser of YAML, JSON or Python literals, and the reason."""

_PARSERS = {"yaml": {"load", "safe_load", "load_all", "parse"}, "json": {"load", "loads"}, "ast": {"literal_eval"}}


def calls_parser(path):
    """Whether a file calls a parser of YAML, JSON or Python literals."""
    if not re.search(r"\b(yaml|json|ast)\.", path.read_text(encoding="utf-8")):
        return False
    return any(
        isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and node.attr in _PARSERS.get(node.value.id, ())
        for node in nodes_of(path)
    )


def test_one_reader_of_yaml_and_json():
    users = {str(path.relative_to(PROJECT)) for path in sources(*PACKAGES) if calls_parser(path)}
    assert users == set(READS_YAML_OR_JSON)


def test_links_are_followed_by_real_path():
    """`Path.resolve` raises RuntimeError for a loop of links (Python 3.11); `real_path` does not."""
    users = [str(path) for path in sources(*PACKAGES) if ".resolve(" in path.read_text(encoding="utf-8")]
    assert users == []
