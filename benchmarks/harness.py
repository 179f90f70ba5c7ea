"""One harness for all workloads: their options, their results as JSON, and tables printed from
these.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import platform
import subprocess
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

Figures = dict[str, Any]
Measure = Callable[[Namespace], Figures]
Result = TypeVar("Result")

ROOT = Path(__file__).resolve().parents[1]
PROGRAM = (sys.executable, "-m", "track_range")
PROGRESS_S = 20.0

Option = Callable[[argparse.ArgumentParser], object]
"""Adds an option to a parser."""


def option(*flags: str, default: Any = None, help: str, **keywords: Any) -> Option:
    """An option of a workload; the default gives its type: a tuple takes several values, False is a
    switch.

    `keywords` are those of argparse.
    """
    example = next(iter(default), None) if isinstance(default, tuple) else default
    if default is False:
        keywords["action"] = "store_true"
    elif "action" not in keywords:
        if example is not None:
            keywords.setdefault("type", type(example))
        if isinstance(default, tuple):
            keywords.setdefault("nargs", "+")
    return lambda parser: parser.add_argument(*flags, default=default, help=help, **keywords)


@dataclass(frozen=True, slots=True)
class Workload:
    """A function of parsed options that returns figures (JSON values), and the options."""

    measure: Measure
    options: tuple[Option, ...]

    def parsed(self, arguments: Sequence[str], name: str = "") -> Namespace:
        """The options of a command line."""
        description = self.measure.__doc__ or sys.modules[self.measure.__module__].__doc__
        parser = argparse.ArgumentParser(
            f"python -m benchmarks {name}",
            description=description,
            epilog="Protocol and figures: docs/concepts/accuracy.md.",
            formatter_class=argparse.RawDescriptionHelpFormatter,
            conflict_handler="resolve",  # a workload may have another --out
        )
        parser.add_argument(
            "--json", "--out", type=Path, metavar="FILE", help="JSON file for the figures"
        )
        for each in self.options:
            each(parser)
        return parser.parse_args(arguments)

    def __call__(self, *arguments: str) -> Figures:
        return self.measure(self.parsed(arguments))

    def run(self, name: str, arguments: Sequence[str]) -> None:
        """Measure, print the tables, and write the JSON file if asked to; exit with 1 if the figures
        name what `failed`.
        """
        options = self.parsed(arguments, name)
        figures = self.measure(options)
        print_figures(name, figures)
        if options.json:
            # without the file, whose path is of this machine
            given = zip(["", *arguments], arguments, strict=False)
            about = {
                "options": [now for last, now in given if not {"--json", "--out"} & {last, now}],
                **machine(),
            }
            text = json.dumps({name: figures, "about": about}, indent=1, default=json_value)
            options.json.write_text(text + "\n", encoding="utf-8")
        if figures.get("failed"):
            raise SystemExit(1)


def workload(*options: Option) -> Callable[[Measure], Workload]:
    return lambda measure: Workload(measure, options)


def machine() -> dict[str, str]:
    """Date, CPU and commit of a measurement."""
    names = ["unknown"]
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        names = [
            line.partition(":")[2].strip() for line in lines if line.startswith("model name")
        ] or names
    git = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    return {
        "date": datetime.now(UTC).date().isoformat(),
        "cpu": f"{len(names)} x {names[0]} ({platform.machine()})",
        "commit": git.stdout.strip() or "unknown",
    }


def json_value(value: Any) -> Any:
    """The JSON value of an array, a number of numpy or a path."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"{type(value).__name__} is no JSON value")


def _named(figures: Any) -> dict[str, Any]:
    """Values by name; the elements of a list have numbers."""
    items = figures.items() if isinstance(figures, Mapping) else enumerate(figures, start=1)
    return {str(key): value for key, value in items}


def _is_leaf(value: Any) -> bool:
    """Whether a value fills one cell: a number, a text, or a list of them."""
    if isinstance(value, list | tuple):
        return not any(isinstance(item, Mapping | list | tuple) for item in value)
    return not isinstance(value, Mapping)


def _text(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, list | tuple):
        return ", ".join(map(_text, value[:8])) + (", ..." if len(value) > 8 else "")
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def tables(title: str, figures: Any) -> Iterator[tuple[str, dict[str, dict[str, str]]]]:
    """Titles and tables, text by row and column, of nested figures: the innermost names are
    columns.
    """
    named = _named(figures)
    if single := {key: {"": _text(value)} for key, value in named.items() if _is_leaf(value)}:
        yield title, single
    parts = {key: _named(value) for key, value in named.items() if not _is_leaf(value)}
    rows = {
        key: {name: _text(v) for name, v in part.items() if _is_leaf(v)}
        for key, part in parts.items()
    }
    if rows := {key: row for key, row in rows.items() if row}:
        yield title, rows
    for key, part in parts.items():
        if deeper := {name: value for name, value in part.items() if not _is_leaf(value)}:
            yield from tables(f"{title}, {key}", deeper)


def print_figures(title: str, figures: Any) -> None:
    """Print the tables of figures; those with more columns than fit are turned."""
    for heading, rows in tables(title, figures):
        columns = list(dict.fromkeys(name for row in rows.values() for name in row))
        if len(columns) > 9 and len(columns) > len(rows):
            rows = {
                column: {name: row.get(column, "-") for name, row in rows.items()}
                for column in columns
            }
            columns = list(next(iter(rows.values())))
        first = max(map(len, rows))
        widths = [max([len(c), *(len(row.get(c, "-")) for row in rows.values())]) for c in columns]
        print(f"\n{heading}")
        for name, row in {"": {c: c for c in columns}, **rows}.items():
            cells = (row.get(c, "-").rjust(width) for c, width in zip(columns, widths, strict=True))
            if any(row.values()):
                print(f"  {name:<{first}}  {'  '.join(cells)}".rstrip())


def numbers(figures: Any, path: str = "") -> Iterator[tuple[str, float]]:
    """Names, joined by dots, and values of all numbers of figures, without lists of numbers and
    single rounds.
    """
    for key, value in _named(figures).items():
        name = f"{path}.{key}" if path else key
        if isinstance(value, int | float) and not isinstance(value, bool):
            yield name, float(value)
        elif not _is_leaf(value) and key != "rounds":
            yield from numbers(value, name)


def in_new_process(function: Callable[..., Result], *arguments: Any) -> Result:
    """The result of a function in a new process, started without a copy of this one."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(function, *arguments).result()


def median_ms(times_s: Sequence[float]) -> float:
    return 1e3 * float(np.median(times_s))


def median_or_none(values: Any, factor: float = 1.0) -> float | None:
    """Median times a factor; None without values."""
    return factor * float(np.median(values)) if len(values) else None


def quantile_or_none(values: Any, q: float, factor: float = 1.0) -> float | None:
    """Quantile `q` times a factor; None without values."""
    return factor * float(np.quantile(values, q)) if len(values) else None


class StoredResults:
    """Results by case in a file of JSON lines, from which an interrupted benchmark continues.

    Those of another version of the package's source code are ignored.
    """

    def __init__(self, path: Path | None, *, version: str | None = None) -> None:
        """Read a file, which need not exist; None = nothing is stored, or the present version."""
        self._path, self._version = path, version or source_version()
        self._results: Figures = {}
        if path is not None and path.exists():
            for line in path.read_text(encoding="utf-8").splitlines():
                try:
                    stored = json.loads(line)
                except json.JSONDecodeError:  # the last line of an interrupted benchmark
                    continue
                if stored["version"] == self._version:
                    self._results[stored["case"]] = stored["result"]

    def mapped(
        self, label: str, function: Callable[[Any], Figures], cases: Sequence[Any], n_jobs: int
    ) -> Iterator[Figures]:
        """Yield the result of the function for each case, in order, as JSON values; prints the
        progress.

        The label and the case identify a result. With several jobs, the function is called in other
        processes.
        """
        keys = [f"{label} {case}" for case in cases]
        missing = [case for case, key in zip(cases, keys, strict=True) if key not in self._results]
        start_s = last_s = time.monotonic()
        n_done = 0
        with ProcessPoolExecutor(n_jobs) as pool:
            results = iter(pool.map(function, missing) if n_jobs > 1 else map(function, missing))
            for key in keys:
                if key not in self._results:
                    self._add(key, next(results))
                    n_done += 1
                    now_s = time.monotonic()
                    if now_s - last_s > PROGRESS_S or n_done == len(missing):
                        last_s, left_s = now_s, (now_s - start_s) / n_done * (len(missing) - n_done)
                        progress = (
                            f"{label}: {n_done} of {len(missing)}, {left_s / 60:.1f} min left"
                        )
                        print(progress, file=sys.stderr, flush=True)
                yield self._results[key]

    def _add(self, key: str, result: Figures) -> None:
        stored = {"version": self._version, "case": key, "result": result}
        line = json.dumps(stored, default=json_value)
        self._results[key] = json.loads(line)["result"]
        if self._path is not None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a", encoding="utf-8") as file:
                file.write(line + "\n")


@cache
def source_version() -> str:
    digest = hashlib.sha256()
    # links are not followed
    for folder in ("track_range", "detection", "stereo", "tracking", "ranging"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
