"""`python -m tests.torture`: damaged inputs, kills, full disks, failing writes, locks, memory, and
a hostile client.

Prints the number of cases by kind and every failure with its command; the files of failures are
kept in `--folder`, with a line about every case in `cases.jsonl`. Exit status 1 if there is any: a
traceback, a hang, a crash, a cut row, too much memory, or a message that is long or does not name
its file.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
from collections import Counter
from pathlib import Path

from tests.torture import mutants, runs
from tests.torture.cases import Case
from tests.torture.processes import load_modules

PARTS = {
    "mutants": (mutants.run_mutants, 400),
    "kills": (runs.run_kills, 10),
    "full-disk": (runs.run_full_disks, 12),
    "failing-writes": (runs.run_failing_writes, 8),
    "locks": (runs.run_locks, 2),
    "memory": (runs.run_memory, 1),
    "determinism": (runs.run_determinism, 1),
    "server": (runs.run_server, 1),
}
"""By the name for --only: function of a new folder, the seed, and the numbers of cases and
processes; usual cases."""


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.torture", description=__doc__)
    parser.add_argument(
        "--only", nargs="+", choices=PARTS, default=list(PARTS), help="parts to run (default: all)"
    )
    parser.add_argument("--seed", type=int, default=0, help="random seed (default: 0)")
    parser.add_argument(
        "--cases", type=int, metavar="N", help="number of cases of each part (default: by part)"
    )
    parser.add_argument(
        "--jobs",
        type=int,
        default=1,
        metavar="N",
        help="number of processes for mutants (default: 1)",
    )
    parser.add_argument(
        "--folder", type=Path, help="new folder for the cases (default: a temporary one)"
    )
    parser.add_argument(
        "--json", type=Path, metavar="FILE", help="JSON file for the numbers of cases"
    )
    options = parser.parse_args()
    folder = (options.folder or Path(tempfile.mkdtemp(prefix="torture-"))).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    load_modules()
    cases: dict[str, list[Case]] = {}
    for name in options.only:
        run, n_cases = PARTS[name]
        place = folder / f"{name}-{options.seed}"
        place.mkdir()
        cases[name] = []
        for case in run(
            place, options.seed, n_cases if options.cases is None else options.cases, options.jobs
        ):
            cases[name].append(case)
            record(case, folder)
    print_counts(cases)
    if options.json:
        options.json.write_text(
            json.dumps({name: counts(part) for name, part in cases.items()}), encoding="utf-8"
        )
    if any(case.problems for part in cases.values() for case in part):
        raise SystemExit(f"Cases failed; their files are in {folder}.")
    if not options.folder:
        shutil.rmtree(folder)


def record(case: Case, folder: Path) -> None:
    """Print a failure, and write a line about the case to cases.jsonl."""
    if case.problems:
        print(case.describe(), flush=True)
    line = {name: getattr(case, name) for name in ("part", "kind", "name", "outcome", "problems")}
    line |= {"message": case.end.stderr.strip()[:600], "seconds": round(case.end.wall_s, 2)}
    with (folder / "cases.jsonl").open("a", encoding="utf-8") as file:
        file.write(json.dumps({**line, "growth_mib": round(case.end.growth_mib)}) + "\n")


def counts(cases: list[Case]) -> dict[str, int]:
    outcomes = Counter("failed" if case.problems else case.outcome for case in cases)
    return {
        "cases": len(cases),
        **{name: outcomes[name] for name in ("refused", "noted", "accepted", "failed")},
    }


def print_counts(cases: dict[str, list[Case]]) -> None:
    rows = {}
    for part, finished in cases.items():
        for kind in dict.fromkeys(case.kind for case in finished):
            rows[f"{part}: {kind}"] = counts([case for case in finished if case.kind == kind])
    rows["all"] = counts([case for finished in cases.values() for case in finished])
    width = max(map(len, rows))
    print(" " * width, *(f"{name:>8}" for name in rows["all"]))
    for name, row in rows.items():
        print(name.ljust(width), *(f"{number:8}" for number in row.values()))


if __name__ == "__main__":
    main()
