"""Imports between packages, and what every module has."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

import track_range
from tests.repository import rooms

PROJECT = Path(__file__).resolve().parents[2]
PACKAGES = ("detection", "tracking", "stereo", "ranging", "track_range")

VAGUE_NAMES = {"utils", "util", "common", "core", "helpers", "misc", "tools", "base"}


def sources(*packages):
    """Source files of packages; the links in track_range are not followed."""
    return [path for package in packages for path in sorted((PROJECT / package).rglob("*.py"))]


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
    return re.search(
        rf"^\s*(from|import)\s.*\b({'|'.join(names)})\b",
        path.read_text(encoding="utf-8"),
        re.MULTILINE,
    )


@pytest.mark.parametrize("room", rooms.ROOMS)
def test_imports_of_each_room_point_to_rooms_before_it(room):
    graph = {
        name: others for name, others in rooms.imports().items() if rooms.room_of(name) == room
    }
    assert graph
    assert list(rooms.forbidden(graph)) == []


def test_every_module_is_in_a_room():
    assert {rooms.room_of(name) for name in rooms.imports() if name not in rooms.FRONT_DOOR} == set(
        rooms.ROOMS
    )
    folders = {
        path.name
        for path in (PROJECT / "track_range").iterdir()
        if path.is_dir() and path.name[0] != "_"
    }
    assert folders == set(rooms.ROOMS)


def test_the_table_orders_the_rooms():
    names = list(rooms.ROOMS)
    for number, (name, room) in enumerate(rooms.ROOMS.items()):
        assert set(room.may_import) <= set(names[:number]), name


def test_the_table_is_no_looser_than_the_imports():
    imported = {
        room: {name for name in others if name in rooms.ROOMS}
        for room, others in rooms.counts(rooms.imports()).items()
    }
    unused = {
        name: set(room.may_import) - imported.get(name, set())
        for name, room in rooms.ROOMS.items()
        if name not in rooms.FRONT_ROOMS
    }
    assert {name: others for name, others in unused.items() if others} == {}


def test_folders_inside_rooms_are_layers():
    assert rooms.knots(rooms.imports()) == []


def test_names_of_modules_are_written_out():
    computed = {
        module: names
        for module, path in rooms.sources().items()
        if (names := rooms.computed_names(path.read_text(encoding="utf-8")))
    }
    assert computed == {}


def test_computed_names_and_programs_are_seen():
    text = """
A = f"track_range.{room}.app"
B = "track_range." + room
C = f"{folder}.size_regression:MONO"
D = "track_range.%s" % room
E = f"{number:.1f} s; check it: yes"
"""
    assert rooms.computed_names(text) == [
        "f'track_range.{room}.app'",
        "'track_range.' + room",
        "f'{folder}.size_regression:MONO'",
        "'track_range.%s' % room",
    ]
    text = """
subprocess.run([sys.executable, "-m", "track_range.fleet", "run"])
execute(sys.executable, "-m", "track_range", *arguments)
os.system("python -m track_range.cli.app run")
"""
    names = ("fleet", "__main__", "cli.app")
    modules = {f"track_range.{name}": None for name in names}
    assert rooms.imported(text, modules, has_strings=False) == set(modules)


def test_knots_of_folders_are_seen():
    files = {
        "track_range.stereo": Path("stereo/__init__.py"),
        "track_range.stereo.pair": Path("stereo/pair.py"),
        "track_range.stereo.matching": Path("stereo/matching/__init__.py"),
        "track_range.stereo.matching.cost": Path("stereo/matching/cost.py"),
        "track_range.stereo.geometry.rig": Path("stereo/geometry/rig.py"),
    }
    graph = {
        "track_range.stereo": frozenset(),
        "track_range.stereo.pair": frozenset({"track_range.stereo.matching.cost"}),
        "track_range.stereo.matching": frozenset({"track_range.stereo.geometry.rig"}),
        "track_range.stereo.matching.cost": frozenset({"track_range.stereo.matching"}),
        "track_range.stereo.geometry.rig": frozenset(),
    }
    assert rooms.knots(graph, files) == []
    graph["track_range.stereo.geometry.rig"] = frozenset({"track_range.stereo.pair"})
    assert rooms.knots(graph, files) == [
        ["track_range.stereo", "track_range.stereo.geometry", "track_range.stereo.matching"]
    ]


def test_lazy_and_typing_imports_and_names_of_modules_are_seen():
    names = (
        "cli.app",
        "ranging.measurement.ranges",
        "results",
        "views.videos.video_writer",
        "run.run",
    )
    modules = {f"track_range.{name}": None for name in names}
    text = """
if TYPE_CHECKING:
    from track_range.ranging.measurement.ranges import Ranges
def f():
    from track_range.cli import app
    import track_range.results
TABLE = {"a": "track_range.views.videos.video_writer:Writer", "b": "run.run"}
"""
    assert rooms.imported(text, modules) == set(modules)


def test_forbidden_imports_are_seen():
    graph = {
        "track_range.detection.boxes": frozenset({"track_range.ranging.registry"}),
        "track_range.ranging.registry": frozenset({"track_range.tracking.tracks"}),
        "track_range.tracking.tracks": frozenset(),
    }
    assert list(rooms.forbidden(graph)) == [
        "track_range.detection.boxes imports track_range.ranging.registry"
    ]


def test_documented_table_is_the_tested_one():
    assert rooms.table() in (PROJECT / "docs/project/architecture.md").read_text(encoding="utf-8")


def test_modules_of_public_names_exist():
    for front in (track_range, track_range.errors, track_range.evaluate):
        assert front._NAMES.modules <= rooms.sources().keys()


def test_nothing_imports_tests_or_benchmarks():
    outside = {"tests", "benchmarks", *PACKAGES[:4]}
    files = [path for path in sources(*PACKAGES) if may_import(path, outside)]
    users = [
        str(path)
        for path in files
        for name in imported_modules(path)
        if name.split(".")[0] in outside
    ]
    assert users == []


def test_only_tests_of_benchmarks_import_them():
    tests = PROJECT / "tests"
    files = [
        path
        for path in sorted(tests.rglob("*.py"))
        if not path.is_relative_to(tests / "benchmarks")
    ]
    assert len(files) > 100
    files = [path for path in files if may_import(path, ["benchmarks"])]
    users = [
        str(path)
        for path in files
        for name in imported_modules(path)
        if name.split(".")[0] == "benchmarks"
    ]
    assert users == []


def test_modules_that_tests_import_exist():
    """Also those of tests that are not in the fast tier."""
    pattern = re.compile(
        r"^ *(?:from|import) +((?:track_range|tests|benchmarks)[\w.]*)", re.MULTILINE
    )
    missing = {
        f"{path.relative_to(PROJECT)}: {name}"
        for path in sources("tests", "benchmarks")
        for name in pattern.findall(path.read_text(encoding="utf-8"))
        if not any((PROJECT / f"{name.replace('.', '/')}{end}").exists() for end in (".py", ""))
    }
    assert missing == set()


def test_no_test_imports_another_one():
    """What tests share is a module beside them, in tests/support, or a fixture of a conftest.py."""
    pattern = re.compile(r"(from|import) +tests(\.\w+)*(\.| +import +)test_|noqa: F811")
    users = [
        str(path)
        for path in sources("tests", "benchmarks")
        if path != Path(__file__) and pattern.search(path.read_text(encoding="utf-8"))
    ]
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


@pytest.mark.parametrize("package", PACKAGES)
def test_folders_are_small_enough_to_read(package):
    for folder in {path.parent for path in sources(package)}:
        entries = [
            path.name
            for path in folder.iterdir()
            if path.name not in ("__pycache__", "__init__.py")
        ]
        assert len(entries) <= (20 if folder.name == "track_range" else 18), (
            folder,
            sorted(entries),
        )


def test_no_two_public_classes_share_a_name():
    modules: dict[str, list[str]] = {}
    for module, path in rooms.sources().items():
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                modules.setdefault(node.name, []).append(module)
    assert {name: found for name, found in modules.items() if len(found) > 1} == {}


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
    "track_range/foundation/files/folder_lock.py": "lock files, at most a few hundred bytes, "
    "ignored if damaged",
    "detection/yolo/metadata.py": "Ultralytics writes class names as a Python literal; the size "
    "is limited",
}
"""Files that call a parser of YAML, JSON or Python literals, and the reason."""

_PARSERS = {
    "yaml": {"load", "safe_load", "load_all", "parse"},
    "json": {"load", "loads"},
    "ast": {"literal_eval"},
}


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
    """`Path.resolve` raises RuntimeError for a loop of links (Python 3.11); `real_path` does
    not."""
    users = [
        str(path) for path in sources(*PACKAGES) if ".resolve(" in path.read_text(encoding="utf-8")
    ]
    assert users == []
