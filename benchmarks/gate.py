"""Baselines of the fast workloads, and ratios of the figures of two recordings."""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
from argparse import Namespace
from collections.abc import Mapping
from pathlib import Path

from benchmarks.harness import ROOT, Figures, numbers, option, workload

BASELINES = Path(__file__).with_name("baselines")

FAST = {
    "startup": "--runs 5",
    "stages": "--parts methods writers --tracks 1 6 50 --frames 600",
    "formats": "--frames 500",
    "stereo": "--scenes 1 --rounds 3 --seeds 1 --pairs none",
    "tracking": "--sets --rounds 2",
    "fusion": "--scenarios town",
    "alignment": "--seeds 240 241 242",
    "self_calibration": "--parts boxes --seeds 2",
    "horizon": "--scenarios town --seeds 221 --known height none",
    "warnings": "--only hours --hours 0.1 --first-seed 120 --errors 2",
}
"""Options of the workloads with baselines: they need no data, and a few minutes together."""

COSTS = re.compile(r"(^|_)(s|ms|us|mib|mb|kb)(_|$)")
"""Last names of times, memory and sizes, which depend on the machine."""

ACCURACY = {
    "larger": re.compile(
        r"(^|_)(error|edges|distance|score|bias|worst|mean|median|p90|p95|90|95|remaining|failures"
        r"|false|not_found|other_lane|chosen_wrong)(_|$)"
    ),
    "smaller": re.compile(
        r"(^|_)(hota|idf1|mota|coverage|recall|hits|measured|noticed|named|corrected|kept|ids"
        r"|classes|predicted|within_2)(_|$)"
    ),
}
"""Last names of the figures of accuracy, by which direction is worse; signs do not count."""


@workload(
    option("--only", default=tuple(FAST), choices=FAST, help="workloads"),
    option("--folder", default=BASELINES, metavar="DIR", help="folder of the recordings"),
)
def baseline(options: Namespace) -> Figures:
    """Record the fast workloads, each in a new process, one file each: the baselines, or what to
    compare with.
    """
    options.folder.mkdir(parents=True, exist_ok=True)
    failed = []
    for name in options.only:
        command = [sys.executable, "-m", "benchmarks", name, *FAST[name].split()]
        file = (options.folder / f"{name}.json").resolve()
        if subprocess.run([*command, "--json", str(file)], cwd=ROOT, check=False).returncode:
            failed.append(name)
    return {"recorded": len(options.only) - len(failed), "failed": failed}


@workload(
    option("first", type=Path, metavar="A", help="JSON file, or folder of JSON files"),
    option(
        "second",
        type=Path,
        nargs="?",
        metavar="B",
        help="to compare with A; default: A with the baselines",
    ),
    option(
        "--tolerance",
        default=0.1,
        metavar="FRACTION",
        help="largest deviation of a ratio from 1",
    ),
    option(
        "--all", default=False, help="show all figures, not only those outside of the tolerance"
    ),
)
def compare(options: Namespace) -> Figures:
    """Ratios B / A of all figures that both recordings have. The exit status is 1 if a figure of
    accuracy is worse by more than the tolerance, or missing in a workload of B, or if A has no
    workload of B; times, memory and sizes do not change it.

    With one recording, A is the committed baselines and B this recording.
    """
    pair = (options.first, options.second) if options.second else (BASELINES, options.first)
    before, after = map(recorded, pair)
    shown: Figures = {}
    for name in (name for name in before if name in after):
        a, b = before[name], after[name]
        ratio = b / a if a else (1.0 if a == b else math.inf)
        is_outside = not abs(ratio - 1) <= options.tolerance
        if is_outside or options.all:
            shown[name] = {"A": a, "B": b, "B/A": ratio, "outside": "*" if is_outside else ""}
    n_common, n_outside = (
        len(before.keys() & after.keys()),
        sum(row["outside"] == "*" for row in shown.values()),
    )
    counts = {"figures in both": n_common, "outside of the tolerance": n_outside}
    return {
        **counts,
        "only in A": len(before) - n_common,
        "only in B": len(after) - n_common,
        "figures": shown,
        "failed": failures(before, after, options.tolerance),
    }


def failures(
    before: Mapping[str, float], after: Mapping[str, float], tolerance: float
) -> dict[str, str]:
    """Why `after` is refused, by the name of a figure or workload."""
    workloads = {name.partition(".")[0] for name in after}
    missing = workloads - {name.partition(".")[0] for name in before}
    failed = dict.fromkeys(sorted(missing), "no baseline")
    for name, a in before.items():
        direction = worse_direction(name)
        if direction is None or name.partition(".")[0] not in workloads:
            continue
        if name not in after:
            failed[name] = "missing"
            continue
        change = abs(after[name]) - abs(a)
        if (change if direction == "larger" else -change) > tolerance * abs(a):
            failed[name] = f"worse: {a:.4g} -> {after[name]:.4g}"
    return failed


def worse_direction(name: str) -> str | None:
    """Which direction of a figure is worse, "larger" or "smaller"; None: it is no figure of
    accuracy.
    """
    last = name.rpartition(".")[2].replace(" ", "_")
    if COSTS.search(last):
        return None
    return next((key for key, pattern in ACCURACY.items() if pattern.search(last)), None)


def recorded(path: Path) -> dict[str, float]:
    """Figures by name of a JSON file of a workload, or of all such files in a folder."""
    files = sorted(path.glob("*.json")) if path.is_dir() else [path]
    figures: dict[str, float] = {}
    for file in files:
        try:
            content = json.loads(file.read_text(encoding="utf-8"))
            figures |= dict(
                numbers({name: value for name, value in content.items() if name != "about"})
            )
        except (OSError, ValueError, AttributeError) as error:
            raise SystemExit(
                f"{file}: expected a JSON file of `python -m benchmarks`: {error}"
            ) from None
    if not figures:
        raise SystemExit(f"{path}: expected figures of `python -m benchmarks WORKLOAD --json FILE`")
    return figures
