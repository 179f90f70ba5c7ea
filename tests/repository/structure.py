"""The structure of the product: statements per room, and the sizes of its functions.

    python -m tests.repository.structure [FOLDER ...]    prints the figures, of other code too

A function is large if it has a cognitive complexity of more than 20 (complexipy, which counts
conditional expressions, boolean operators and conditions in comprehensions), more than 70 lines
without its docstring, or more than 8 arguments.
"""

import ast
import io
import sys
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import complexipy

PROJECT = Path(__file__).resolve().parents[2]
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
        """Its name and sizes."""
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


def _is_text(node: ast.AST) -> bool:
    """Whether a node is a docstring, or a text that stands for itself."""
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def n_statements(tree: ast.AST) -> int:
    """Number of statements without docstrings."""
    return sum(isinstance(node, ast.stmt) and not _is_text(node) for node in ast.walk(tree))


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


def n_tokens(source: str) -> int:
    """Number of tokens without comments, line breaks and docstrings."""
    ignored = {
        *(tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT),
        *(tokenize.ENDMARKER, tokenize.ENCODING),
    }
    tokens = list(tokenize.generate_tokens(io.StringIO(source).readline))
    docstrings = _docstring_lines(ast.parse(source))
    return sum(token.type not in ignored and token.start[0] not in docstrings for token in tokens)


def _docstring_lines(tree: ast.AST) -> set[int]:
    lines = set[int]()
    for node in ast.walk(tree):
        if _is_text(node):
            lines |= set(range(node.lineno, node.end_lineno + 1))
    return lines


def figures(paths: list[Path]) -> dict[str, float]:
    """Sizes of the code of files, and numbers of their complex functions."""
    sources = [path.read_text(encoding="utf-8") for path in paths]
    trees = [ast.parse(source) for source in sources]
    code = [
        line.strip()
        for source, tree in zip(sources, trees, strict=True)
        for number, line in enumerate(source.splitlines(), start=1)
        if line.strip()
        and not line.strip().startswith("#")
        and number not in _docstring_lines(tree)
    ]
    n_conditional = sum(isinstance(node, ast.IfExp) for tree in trees for node in ast.walk(tree))
    measured = [
        f for source, path in zip(sources, paths, strict=True) for f in functions(source, str(path))
    ]
    over = {
        f"functions over {limit}": sum(f.complexity > limit for f in measured)
        for limit in (15, 25, 40)
    }
    return {
        "tokens": sum(map(n_tokens, sources)),
        "statements": sum(map(n_statements, trees)),
        "code lines": len(code),
        "characters per code line": sum(map(len, code)) / len(code),
        "conditional expressions per 1000 code lines": 1000 * n_conditional / len(code),
        "functions": len(measured),
        **over,
        f"functions over {MAX_LINES} lines": sum(f.lines > MAX_LINES for f in measured),
        f"functions over {MAX_ARGUMENTS} arguments": sum(
            f.arguments > MAX_ARGUMENTS for f in measured
        ),
    }


def main(arguments: list[str]) -> None:
    """Print the figures."""
    if arguments:
        for folder in map(Path, arguments):
            links = [path for path in folder.rglob("*") if path.is_symlink()]
            paths = [
                path
                for path in sorted(folder.rglob("*.py"))
                if not any(path.is_relative_to(link) for link in links)
            ]
            for name, value in figures(paths).items():
                print(f"{value:12,.1f}  {name}")
        return
    large = large_functions()
    for name, paths in rooms().items():
        total = sum(n_statements(ast.parse(path.read_text(encoding="utf-8"))) for path in paths)
        print(f"{name:14}{total:7,}")
    for function in large:
        print(function.row)
    print(f"{len(large)} large functions")
    for name, value in figures([path for paths in rooms().values() for path in paths]).items():
        print(f"{value:12,.1f}  {name}")


if __name__ == "__main__":
    main(sys.argv[1:])
