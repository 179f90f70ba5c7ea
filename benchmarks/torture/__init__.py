"""Robustness: damaged inputs, kills, full disks, failing writes, locks, memory, determinism, and a hostile client.

Prints the number of cases by kind and every failure with its command; the files of failures are kept. Exit status 1
if there is any: a traceback, a hang, a crash, a cut row, too much memory, or a message that is long or does not name
its file.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks.plain_tables import plain_table
from benchmarks.torture import failing_disks, kills, live_page, long_runs, mutants
from benchmarks.torture.cases import Case
from benchmarks.torture.processes import load_modules


@dataclass(frozen=True, slots=True)
class Part:
    """A part of the benchmark.

    Attributes:
        run: function of a new folder, the seed, the number of cases and the number of processes; yields cases.
        n_cases: default number of cases.
    """

    run: Callable[[Path, int, int, int], Iterator[Case]]
    n_cases: int


PARTS = {
    "mutants": Part(mutants.run_mutants, 400),
    "kills": Part(kills.run_kills, 10),
    "full-disk": Part(failing_disks.run_full_disks, 12),
    "failing-writes": Part(failing_disks.run_failing_writes, 8),
    "locks": Part(kills.run_locks, 2),
    "memory": Part(long_runs.run_memory, 1),
    "determinism": Part(long_runs.run_determinism, 1),
    "server": Part(live_page.run_server, 1),
}
"""Parts by the name for --only."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this workload."""
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), help="parts to run (default: all)")
    parser.add_argument("--seed", type=int, default=0, help="random seed (default: 0)")
    parser.add_argument("--cases", type=int, metavar="N", help="number of cases of each part (default: by part)")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="number of processes for mutants (default: 1)")
    parser.add_argument("--folder", type=Path, help="new folder for the cases (default: a temporary one)")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Counts of cases by part and kind; prints them.

    Raises:
        SystemExit: a case has a problem; status 1.
    """
    folder = options.folder or Path(tempfile.mkdtemp(prefix="torture-"))
    folder.mkdir(parents=True, exist_ok=True)
    load_modules()
    cases = []
    for name in options.only:
        part = PARTS[name]
        place = folder.resolve() / f"{name}-{options.seed}"
        place.mkdir()
        for case in part.run(
            place, options.seed, part.n_cases if options.cases is None else options.cases, options.jobs
        ):
            cases.append(case)
            _record(case, folder)
    _print_counts(cases)
    failures = [case for case in cases if case.problems]
    if not failures and not options.folder:
        shutil.rmtree(folder)
    figures = {name: _counts([case for case in cases if case.part == name]) for name in options.only}
    if options.json:
        options.json.write_text(json.dumps({"torture": figures}, indent=2) + "\n", encoding="utf-8")
    if failures:
        print(f"{len(failures)} of {len(cases)} cases failed; their files are in {folder}.")
        raise SystemExit(1)
    return figures


def _record(case: Case, folder: Path) -> None:
    """Print a failure, and write a line about the case to cases.jsonl."""
    if case.problems:
        print(case.describe(), flush=True)
    line = {
        "part": case.part, "kind": case.kind, "name": case.name, "outcome": case.outcome, "problems": case.problems,
        "message": case.end.stderr.strip()[:600], "seconds": round(case.end.wall_s, 2),
        "growth_mib": round(case.end.growth_mib),
    }  # fmt: skip
    with (folder / "cases.jsonl").open("a", encoding="utf-8") as file:
        file.write(json.dumps(line) + "\n")


def _counts(cases: list[Case]) -> dict[str, int]:
    """Number of cases, by outcome and in all."""
    outcomes = Counter("failed" if case.problems else case.outcome for case in cases)
    return {"cases": len(cases), **{name: outcomes[name] for name in ("refused", "noted", "accepted", "failed")}}


def _print_counts(cases: list[Case]) -> None:
    table = plain_table(
        "Cases by outcome", "part", "kind", "cases", "refused", "noted", "accepted", "failed", n_words=2
    )
    for part, kind in dict.fromkeys((case.part, case.kind) for case in cases):
        counts = _counts([case for case in cases if (case.part, case.kind) == (part, kind)])
        table.add_row(part, kind, *map(str, counts.values()))
    table.add_row("all", "", *map(str, _counts(cases).values()))
    Console().print(table)
