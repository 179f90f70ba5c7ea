"""Mutation testing: the fraction of small changes to the central algorithms that their tests
detect.

A sample of mutants (a comparison, number, arithmetic or logical operator changed; operators of
cosmic-ray) is drawn evenly over the places of the source that can be changed. Each mutant is
imported instead of its module in a separate process, which runs the fast tests of its package until
one fails. A mutant is killed if a test fails, the import fails, or the tests run into the time
limit. Annotations and decorators are left out, since they have no effect at run time here.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import importlib.machinery
import json
import os
import random
import resource
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import CodeType
from typing import Any

ROOT = Path(__file__).resolve().parents[1]


TARGETS: dict[str, tuple[str, ...]] = {
    "tracking/*.py": ("tests/tracking", "tests/detection/test_supervision.py"),
    "stereo/matching/*.py": (
        "tests/stereo/test_*matcher*.py",
        "tests/stereo/test_census.py",
        "tests/stereo/test_confidence.py",
        "tests/stereo/test_window_sgm.py",
        "tests/stereo/test_sgbm.py",
        "tests/stereo/test_subpixel.py",
        "tests/stereo/test_surface*.py",
        "tests/stereo/test_tiles.py",
        "tests/stereo/test_patches.py",
        "tests/ranging/test_triangulation.py",
    ),
    "ranging/fusion/*.py": ("tests/ranging/test_*fus*.py", "tests/ranging/test_filtered_ranges.py"),
    "detection/boxes.py": ("tests/detection/test_*box*.py", "tests/detection/test_yolo*.py"),
    "detection/yolo/letterbox.py": (
        "tests/detection/test_letterbox*.py",
        "tests/detection/test_yolo*.py",
    ),
}
"""Modules that are changed (patterns from the repository's root) and the tests that are run for
them."""

_ARITHMETIC = ("Add", "Sub", "Mul", "Div")
_COMPARISONS = ("Eq", "NotEq", "Lt", "LtE", "Gt", "GtE")
OPERATORS = (
    *(f"ReplaceBinaryOperator_{a}_{b}" for a in _ARITHMETIC for b in _ARITHMETIC if a != b),
    *(
        "ReplaceBinaryOperator_BitAnd_BitOr",
        "ReplaceBinaryOperator_BitOr_BitAnd",
        "ReplaceBinaryOperator_Pow_Mul",
    ),
    *(f"ReplaceComparisonOperator_{a}_{b}" for a in _COMPARISONS for b in _COMPARISONS if a != b),
    *("ReplaceComparisonOperator_Is_IsNot", "ReplaceComparisonOperator_IsNot_Is"),
    *("NumberReplacer", "AddNot", "ReplaceAndWithOr", "ReplaceOrWithAnd", "ReplaceTrueWithFalse"),
    *(
        "ReplaceFalseWithTrue",
        "ReplaceBreakWithContinue",
        "ReplaceContinueWithBreak",
        "ZeroIterationForLoop",
    ),
    *(
        "ReplaceUnaryOperator_USub_UAdd",
        "ReplaceUnaryOperator_Delete_Not",
        "ReplaceUnaryOperator_Delete_Invert",
    ),
)
"""cosmic-ray's operators; those that give a type error for floats (`<<`, `%` of an array) are left
out."""

_MAX_MEMORY_BYTES = 8 << 30
_MIN_TIME_LIMIT_S = 60.0


@dataclass(frozen=True)
class Mutant:
    """One change of one module."""

    path: Path
    operator: str
    occurrence: int
    line: int
    tests: tuple[str, ...]

    def source(self) -> str:
        """The changed source."""
        return mutated(self.path.read_text(encoding="utf-8"), self.operator, self.occurrence)

    def __str__(self) -> str:
        """Path, line, operator and the changed line."""
        old, new = self.path.read_text(encoding="utf-8").splitlines(), self.source().splitlines()
        changed = next((b.strip() for a, b in zip(old, new, strict=False) if a != b), "")
        place = self.path.relative_to(ROOT).as_posix()
        return f"{place}:{self.line} {self.operator} #{self.occurrence}: {changed}"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    parser.add_argument(
        "--mutants", type=int, default=360, help="size of the sample (default: 360)"
    )
    parser.add_argument(
        "--seed", type=int, default=1, help="random seed for the sample (default: 1)"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes at a time")
    parser.add_argument(
        "--only", default="", metavar="TEXT", help="only mutants of paths that contain this"
    )
    parser.add_argument(
        "--survivors", type=Path, metavar="FILE", help="run only the mutants listed in this file"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="JSON file for the figures")
    options = parser.parse_args()
    mutants = sample(options.mutants, options.seed)
    mutants = [mutant for mutant in mutants if options.only in mutant.path.as_posix()]
    if options.survivors:
        listed = set(options.survivors.read_text(encoding="utf-8").splitlines())
        mutants = [mutant for mutant in mutants if str(mutant) in listed]
    _import_libraries()
    limits_s = {}
    for tests in sorted({tuple(sorted(mutant.tests)) for mutant in mutants}):
        start_s = time.perf_counter()
        if (status := _finish(_start(None, tests), 1800.0)) != 0:
            raise SystemExit(
                f"{' '.join(tests)}: the tests fail without a mutant (status {status})."
            )
        limits_s[tests] = max(_MIN_TIME_LIMIT_S, 5 * options.jobs * (time.perf_counter() - start_s))
    killed: dict[str, list[bool]] = {"all": []}
    survivors = []
    for number, (mutant, is_killed) in enumerate(_run(mutants, limits_s, options.jobs), start=1):
        for package in (mutant.path.relative_to(ROOT).parts[0], "all"):
            killed.setdefault(package, []).append(is_killed)
        if not is_killed:
            survivors.append(str(mutant))
            print(f"survived: {mutant}", flush=True)
        if number % 20 == 0:
            print(f"{number} of {len(mutants)}, {sum(killed['all'])} killed", flush=True)
    figures = {
        package: {"mutants": len(flags), "killed": sum(flags)} for package, flags in killed.items()
    }
    for package, row in figures.items():
        print(
            f"{package:<12}{row['killed']:>6} of {row['mutants']}, "
            f"{100 * row['killed'] / max(row['mutants'], 1):.1f} %"
        )
    if options.json:
        options.json.write_text(
            json.dumps({**figures, "survivors": survivors}, indent=1) + "\n", encoding="utf-8"
        )


def sample(n: int, seed: int) -> list[Mutant]:
    """`n` mutants, drawn evenly over the places that can be changed, one of each place."""
    by_place: dict[tuple[Path, tuple[int, int]], list[Mutant]] = {}
    for pattern, test_patterns in TARGETS.items():
        for path in sorted(ROOT.glob(pattern)):
            tests = _tests(path, test_patterns)
            for operator, occurrence, place in positions(path.read_text(encoding="utf-8")):
                mutant = Mutant(path, operator, occurrence, place[0], tests)
                by_place.setdefault((path, place), []).append(mutant)
    generator = random.Random(seed)  # noqa: S311
    places = sorted(by_place)
    chosen = generator.sample(places, min(n, len(places)))
    return [generator.choice(by_place[place]) for place in chosen]


def positions(source: str) -> Iterator[tuple[str, int, tuple[int, int]]]:
    """Operator, its occurrence in the source, and the (line, column) of every change that can have
    an effect."""
    from cosmic_ray.ast import ast_nodes, get_ast

    nodes = list(ast_nodes(get_ast(source)))
    without_effect = _annotations_and_decorators(source)
    for name in OPERATORS:
        operator = _operator(name)
        places = [tuple(start) for node in nodes for start, _ in operator.mutation_positions(node)]
        for occurrence, place in enumerate(places):
            if not any(first <= place < last for first, last in without_effect):
                yield name, occurrence, place


def mutated(source: str, operator: str, occurrence: int) -> str:
    """The source with one change."""
    from cosmic_ray.mutating import mutate_code

    changed: str = mutate_code(source, _operator(operator), occurrence)
    return changed


def _operator(name: str) -> Any:
    from cosmic_ray.plugins import get_operator

    return get_operator(f"core/{name}")()


def _annotations_and_decorators(source: str) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """The (line, column) of the start and end of each annotation and decorator."""
    nodes: list[ast.expr | None] = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.arg | ast.AnnAssign):
            nodes.append(node.annotation)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            nodes += [node.returns, *node.decorator_list]
        if isinstance(node, ast.ClassDef):
            nodes += node.decorator_list
    return [
        ((node.lineno, node.col_offset), (node.end_lineno or 0, node.end_col_offset or 0))
        for node in nodes
        if node
    ]


def _tests(path: Path, patterns: tuple[str, ...]) -> tuple[str, ...]:
    """The test files of a module, those of its name first."""
    files: dict[str, None] = {}
    for pattern in patterns:
        where = [ROOT / pattern] if (ROOT / pattern).is_dir() else sorted(ROOT.glob(pattern))
        for place in where:
            inside = sorted(place.glob("test_*.py")) if place.is_dir() else [place]
            files.update(dict.fromkeys(file.relative_to(ROOT).as_posix() for file in inside))
    return tuple(sorted(files, key=lambda name: path.stem not in name))


def _import_libraries() -> None:
    """Import the slow libraries once, before the processes are forked."""
    # track_range.detection.models disables the telemetry of onnxruntime, before it is imported.
    for name in (
        "numpy",
        "cv2",
        "scipy.optimize",
        "scipy.ndimage",
        "track_range.detection.models",
        "onnxruntime",
    ):
        importlib.import_module(name)
    importlib.import_module("cv2").setNumThreads(1)


def _run(
    mutants: list[Mutant], limits_s: dict[tuple[str, ...], float], n_jobs: int
) -> Iterator[tuple[Mutant, bool]]:
    """Each mutant with whether it was killed, as they end."""
    waiting, running = list(reversed(mutants)), dict[int, tuple[Mutant, float]]()
    while waiting or running:
        while waiting and len(running) < n_jobs:
            mutant = waiting.pop()
            running[_start(mutant, mutant.tests)] = (
                mutant,
                time.perf_counter() + limits_s[tuple(sorted(mutant.tests))],
            )
        for process, (mutant, until_s) in list(running.items()):
            ended, status = os.waitpid(process, os.WNOHANG)
            if not ended and time.perf_counter() > until_s:
                os.killpg(process, signal.SIGKILL)
                ended, status = os.waitpid(process, 0)
            if ended:
                del running[process]
                yield mutant, status != 0
        time.sleep(0.02)


def _finish(process: int, limit_s: float) -> int:
    until_s = time.perf_counter() + limit_s
    while time.perf_counter() < until_s:
        ended, status = os.waitpid(process, os.WNOHANG)
        if ended:
            return status
        time.sleep(0.02)
    os.killpg(process, signal.SIGKILL)
    return os.waitpid(process, 0)[1]


def _start(mutant: Mutant | None, tests: tuple[str, ...]) -> int:
    """A new process that runs the tests with the mutant instead of its module; it ends with 0 if
    all pass."""
    process = os.fork()
    if process:
        return process
    status = 3
    try:
        os.setsid()
        resource.setrlimit(resource.RLIMIT_AS, (_MAX_MEMORY_BYTES, _MAX_MEMORY_BYTES))
        silent = os.open(os.devnull, os.O_RDWR)
        for descriptor in (0, 1, 2):
            os.dup2(silent, descriptor)
        os.chdir(ROOT)
        sys.path.insert(0, str(ROOT))
        os.environ["TRACK_RANGE_DATA"] = os.devnull
        for name in [name for name in sys.modules if name.partition(".")[0] == "track_range"]:
            del sys.modules[name]
        if mutant is not None:
            _replace_module(mutant.path, mutant.source())
        import pytest

        options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-m", "not real"]
        status = int(pytest.main([*options, *tests]))
    finally:
        os._exit(status)


def _replace_module(path: Path, source: str) -> None:
    """Let every later import of the file at `path` see `source`."""
    original = importlib.machinery.SourceFileLoader.get_code

    def get_code(loader: importlib.machinery.SourceFileLoader, fullname: str) -> CodeType | None:
        if Path(loader.path).resolve() == path.resolve():
            return compile(source, loader.path, "exec", dont_inherit=True)
        return original(loader, fullname)

    importlib.machinery.SourceFileLoader.get_code = get_code  # type: ignore[method-assign,assignment]


if __name__ == "__main__":
    main()
