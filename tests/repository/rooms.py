"""The rooms of the package, what passes through each, and the imports that are allowed between
them.

`python -m tests.repository.rooms` prints the table of docs/project/architecture.md and the number
of imports between rooms.
"""

from __future__ import annotations

import ast
import re
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

PROJECT = Path(__file__).resolve().parents[2]
PRODUCT = ("detection", "tracking", "stereo", "ranging", "track_range")
"""Folders of the product at the top of the repository; all but the last are imported as
`track_range.NAME`."""


@dataclass(frozen=True, slots=True)
class Room:
    """One folder of track_range.

    Attributes:
        passes: what comes in, and what goes out.
        may_import: the rooms that its modules may import besides their own, in words and by name.
    """

    passes: str
    may_import: tuple[str, ...]
    words: str


def _rooms() -> dict[str, Room]:
    rooms: dict[str, Room] = {}

    def add(
        name: str, passes: str, *, only: tuple[str, ...] = (), but: tuple[str, ...] = ()
    ) -> None:
        names = only or tuple(room for room in rooms if room not in but)
        words = f"all rooms above but {', '.join(but)}" if but else "all rooms above"
        rooms[name] = Room(passes, names, ", ".join(only) or words)

    rooms["foundation"] = Room(
        "arrays, errors, options, registry, threads, files, robust statistics", (), "no other room"
    )
    add("detection", "images -> boxes, classes, lane lines; models; training", only=("foundation",))
    add(
        "stereo",
        "cameras, rigs, rectification, disparity, alignment, odometry",
        only=("foundation",),
    )
    add("tracking", "boxes -> identities; metrics", only=("foundation", "detection"))
    add("ranging", "tracks, geometry -> distances with sigma; fusion, filters, warning")
    add(
        "recording",
        "files, bags, streams, telemetry, calibration files -> frames",
        only=("foundation", "stereo"),
    )
    add("calibration", "boards and drives -> rigs, alignment files, focal lengths")
    apart = ("recording", "calibration")
    add("pipeline", "`Frame` -> `FrameResult`", but=apart)
    add(
        "results",
        "`FrameResult` -> `Rows`, files of each format, events; finished run folders",
        but=apart,
    )
    add(
        "views",
        "overlay, event clips, report, live view, anonymization, video files",
        but=("tracking", "calibration"),
    )
    add("run", "settings; recording + pipeline + results + views: `Run`, `Pipeline`, export")
    add("evaluation", "labelled data -> figures", but=("views",))
    add(
        "simulation",
        "worlds -> drives with exact truth",
        but=("tracking", "calibration", "pipeline", "results", "run", "evaluation"),
    )
    add(
        "fleet",
        "many recordings -> one data set",
        but=("tracking", "evaluation", "simulation"),
    )
    add("api", "the names of the Python API")
    add("cli", "the command line, one file per command")
    return rooms


ROOMS: Mapping[str, Room] = _rooms()
"""All rooms; each imports only rooms before it."""

FRONT_ROOMS = ("api", "cli")
"""Rooms that may import all others, whether they do so or not."""

_LAZY_NAMES = {"track_range", "track_range.errors", "track_range.evaluate"}
FRONT_DOOR = _LAZY_NAMES | {"track_range.__main__"}
"""Modules in no room: the lazy names of `import track_range`, and `python -m track_range`."""


def table() -> str:
    """Markdown table of the rooms, for docs/project/architecture.md."""
    rows = [f"| `{name}` | {room.passes} | {room.words} |" for name, room in ROOMS.items()]
    return "\n".join(["| room | input -> output | may import |", "|---|---|---|", *rows])


@cache
def sources(project: Path = PROJECT) -> Mapping[str, Path]:
    """File of each module of the product by its full name; the links in track_range are not
    followed."""
    found = {}
    for folder in PRODUCT:
        for path in sorted((project / folder).rglob("*.py")):
            parts = path.relative_to(project).with_suffix("").parts
            if parts[0] != "track_range":
                parts = ("track_range", *parts)
            elif parts[1] in PRODUCT:
                continue
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imported(text: str, modules: Mapping[str, object], *, has_strings: bool = True) -> set[str]:
    """Those of `modules` that a file imports anywhere: also inside functions and under `if
    TYPE_CHECKING`.

    With `has_strings`, also those named by a string with a dot, with or without "track_range." and
    ":ATTRIBUTE", and those that a command line runs with `-m`.
    """
    found = set()
    for node in ast.walk(ast.parse(text)):
        found |= _run_as_program(node)
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names if alias.name in modules}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"relative import of {node.module}"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            found |= {name if name in modules else str(node.module) for name in names}
        elif (
            has_strings
            and isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and "." in node.value
        ):
            name = node.value.partition(":")[0]
            found |= {name, f"track_range.{name}"}
    return found & modules.keys()


def _run_as_program(node: ast.AST) -> set[str]:
    """Modules of the package that a node runs as a program: `[..., "-m", "track_range.x"]`, also as
    arguments of a call, or "-m track_range.x" in one text."""
    values = getattr(node, "elts", getattr(node, "args", ()))
    texts = [
        value.value
        for value in (values if isinstance(values, list) else ())
        if isinstance(value, ast.Constant) and isinstance(value.value, str)
    ]
    names = [name for option, name in pairwise(texts) if option == "-m"]
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        names += re.findall(r"-m\s+(track_range[\w.]*)", node.value)
    return {f"{name}.__main__" if name == "track_range" else name for name in names}


def computed_names(text: str) -> list[str]:
    """Names of modules in a file that are put together from parts, so that neither this test nor a
    tool can follow them: "track_range." before a computed part, ".module:attribute" after one."""
    found = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.JoinedStr):
            first, last = node.values[0], node.values[-1]
        elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Mod):
            first, last = node.left, node.right
        else:
            continue
        begins = re.match(r"track_range\.([a-z_]\w*\.)*(%|$)", _text(first))
        ends = re.fullmatch(r"(\.[a-z_]\w*)+:[A-Za-z_][\w.]*", _text(last))
        if begins or ends:
            found.append(ast.unparse(node))
    return found


def _text(node: ast.AST) -> str:
    """A node's text, "" if it is no text."""
    is_text = isinstance(node, ast.Constant) and isinstance(node.value, str)
    return str(node.value) if is_text else ""


@cache
def imports(project: Path = PROJECT, *, has_strings: bool = True) -> Mapping[str, frozenset[str]]:
    """Modules that each module imports; with `has_strings` also those of its tables of names."""
    modules = sources(project)
    texts = {name: path.read_text(encoding="utf-8") for name, path in modules.items()}
    return {
        name: frozenset(imported(text, modules, has_strings=has_strings) - {name})
        for name, text in texts.items()
    }


def room_of(module: str) -> str:
    """Second part of a module's name; "" for `track_range` itself."""
    return module.partition(".")[2].partition(".")[0]


def forbidden(graph: Mapping[str, frozenset[str]]) -> Iterator[str]:
    """Imports that the table does not allow, as "MODULE imports MODULE"."""
    for module, others in graph.items():
        room = room_of(module)
        allowed = None if module in FRONT_DOOR else {room, *ROOMS[room].may_import}
        for other in others:
            if allowed is not None and room_of(other) not in allowed:
                yield f"{module} imports {other}"


def _strong(graph: Mapping[str, Collection[str]]) -> list[list[str]]:
    """Strongly connected components of a graph, each in order of the names."""
    names = sorted(graph)
    number = {name: index for index, name in enumerate(names)}
    pairs = [
        (number[name], number[other]) for name in names for other in graph[name] if other in number
    ]
    rows, columns = np.array(pairs, int).reshape(-1, 2).T
    matrix = csr_array((np.ones(len(rows)), (rows, columns)), shape=(len(names), len(names)))
    _, component = connected_components(matrix, connection="strong")
    groups: dict[int, list[str]] = defaultdict(list)
    for name, group in zip(names, component.tolist(), strict=True):
        groups[group].append(name)
    return list(groups.values())


def knots(
    graph: Mapping[str, frozenset[str]], files: Mapping[str, Path] | None = None
) -> list[list[str]]:
    """Folders that import each other in a circle, of one room or of several; a folder and its own
    sub-folder are two.

    `files`: of each module; None = those of the product.
    """
    files = sources() if files is None else files
    folder = {
        name: name if path.stem == "__init__" else name.rpartition(".")[0]
        for name, path in files.items()
    }
    folders: dict[str, set[str]] = defaultdict(set)
    for name, others in graph.items():
        folders[folder[name]] |= {folder[other] for other in others}
    return [sorted(group) for group in _strong(folders) if len(group) > 1]


def counts(graph: Mapping[str, frozenset[str]]) -> Mapping[str, Counter[str]]:
    """Number of imports from each room to each other one."""
    found: dict[str, Counter[str]] = defaultdict(Counter)
    for module, others in graph.items():
        found[room_of(module)].update(
            room_of(other) for other in others if room_of(other) != room_of(module)
        )
    return found


if __name__ == "__main__":
    print(table())  # noqa: T201
    for name, targets in counts(imports()).items():
        if name in ROOMS:
            print(f"{name} -> {dict(sorted(targets.items()))}")  # noqa: T201
