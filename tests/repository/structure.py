"""The structure of the product: statements per room, and the sizes of its functions.

    python -m tests.repository.structure            prints both
    python -m tests.repository.structure --write    writes `large_functions.txt`, after a function became smaller

A function is large if it has a cognitive complexity of more than 20 (complexipy, which counts conditional expressions,
boolean operators and conditions in comprehensions), more than 70 lines without its docstring, or more than 8 arguments.
"""

import ast
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import complexipy

PROJECT = Path(__file__).resolve().parents[2]
LIST = Path(__file__).with_name("large_functions.txt")
TOP_ROOMS = ("detection", "tracking", "stereo", "ranging")
MAX_COMPLEXITY, MAX_LINES, MAX_ARGUMENTS = 20, 70, 8


@dataclass(frozen=True, slots=True)
class Function:
    """A function of a file."""

    name: str  # path::class::function
    complexity: int  # cognitive
    lines: int  # without the docstring
    arguments: int  # without self and cls

    @property
    def is_large(self) -> bool:
        """Whether it is above a limit."""
        return (
            self.complexity > MAX_COMPLEXITY
            or self.lines > MAX_LINES
            or self.arguments > MAX_ARGUMENTS
        )

    @property
    def row(self) -> str:
        """A line of the list."""
        return f"{self.name} {self.complexity} {self.lines} {self.arguments}"


def rooms() -> dict[str, list[Path]]:
    """Files of each room, whose links are not followed."""
    package = PROJECT / "track_range"
    folders = [PROJECT / name for name in TOP_ROOMS]
    folders += [
        path for path in sorted(package.iterdir()) if path.is_dir() and not path.is_symlink()
    ]
    files = {folder.name: sorted(folder.rglob("*.py")) for folder in folders}
    files["track_range"] = sorted(package.glob("*.py"))
    return {name: paths for name, paths in files.items() if paths}


def n_statements(tree: ast.AST) -> int:
    """Number of statements without docstrings."""
    is_text = [
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
        for node in ast.walk(tree)
        if isinstance(node, ast.stmt)
    ]
    return is_text.count(False)


def functions(source: str, path: str) -> Iterator[Function]:
    """The functions of a file; nested functions belong to the function around them."""
    measured = {f.line_end: f.complexity for f in complexipy.code_complexity(source).functions}
    for name, node in _definitions(ast.parse(source), path):
        arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
        n_arguments = sum(argument.arg not in ("self", "cls") for argument in arguments)
        lines = node.end_lineno - node.lineno + 1
        if ast.get_docstring(node, clean=False) is not None:
            lines -= node.body[0].end_lineno - node.body[0].lineno + 1
        yield Function(name, measured.get(node.end_lineno, 0), lines, n_arguments)


def _definitions(
    tree: ast.AST, name: str
) -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield f"{name}::{node.name}", node
        else:
            inner = f"{name}::{node.name}" if isinstance(node, ast.ClassDef) else name
            yield from _definitions(node, inner)


def large_functions() -> list[Function]:
    """The functions of the product above a limit, in the order of their names."""
    found = [
        function
        for paths in rooms().values()
        for path in paths
        for function in functions(path.read_text(encoding="utf-8"), str(path.relative_to(PROJECT)))
        if function.is_large
    ]
    return sorted(found, key=lambda function: function.name)


def listed() -> dict[str, Function]:
    """The functions of the list, by name."""
    rows = [line.split() for line in LIST.read_text(encoding="utf-8").splitlines()]
    return {name: Function(name, *map(int, numbers)) for name, *numbers in rows}


def main() -> None:
    """Print the figures, or write the list."""
    large = large_functions()
    if "--write" in sys.argv:
        LIST.write_text("".join(f"{f.row}\n" for f in large), encoding="utf-8")
    for name, paths in rooms().items():
        total = sum(n_statements(ast.parse(path.read_text(encoding="utf-8"))) for path in paths)
        print(f"{name:14}{total:7,}")
    for function in large:
        print(function.row)
    print(f"{len(large)} large functions")


if __name__ == "__main__":
    main()
