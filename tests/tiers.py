"""A pytest plugin for test tiers: it marks tests, counts them by tier, and prints a table.

`python -m tests.tiers FILE` prints the table of all runs that wrote to FILE and fails if a tier ran
no test.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

TIERS = {
    "fast": "everything else; `make test`",
    "slow": "more than about 1.5 seconds, or a second Python environment",
    "train": "trainings of networks",
    "browser": "the report and the live view in Chromium",
    "real": "recordings of ../shared/data or of $TRACK_RANGE_DATA",
}
"""Tiers and what they hold. All but the first are markers; a test with several belongs to the last
one here."""

TIER_OF_FIXTURE = {"shared_data": "real", "browser": "browser"}
"""Fixtures that put a test into a tier."""

OUTCOMES = ("passed", "failed", "skipped")

_TIER = "tier"


class TierTable:
    """Counts of outcomes by tier, and the reasons of skips."""

    def __init__(self) -> None:
        self._outcomes: dict[str, dict[str, str]] = {}
        self._reasons: dict[str, Counter[str]] = {}

    def add(self, report: pytest.TestReport) -> None:
        """Count a phase of a test; a test fails if one of its phases does."""
        tier = dict(report.user_properties).get(_TIER)
        if tier is None or (report.passed and report.when != "call"):
            return
        outcomes = self._outcomes.setdefault(tier, {})
        if outcomes.get(report.nodeid) != "failed":
            outcomes[report.nodeid] = report.outcome
        if report.skipped and isinstance(report.longrepr, tuple):
            self._reasons.setdefault(tier, Counter())[
                report.longrepr[2].removeprefix("Skipped: ")
            ] += 1

    def counts(self) -> dict[str, dict[str, Any]]:
        """By tier: tests by outcome, and skipped tests by reason."""
        return {
            tier: {
                **{outcome: list(outcomes.values()).count(outcome) for outcome in OUTCOMES},
                "reasons": dict(self._reasons.get(tier, {})),
            }
            for tier, outcomes in self._outcomes.items()
        }


def table_lines(counts: dict[str, dict[str, Any]]) -> list[str]:
    """The table as text: tier, tests run, failed and skipped, and why they were skipped."""
    lines = [f"{'tier':<8} {'run':>5} {'failed':>6} {'skipped':>7}  why skipped"]
    for tier in TIERS:
        if tier not in counts:
            continue
        row = counts[tier]
        why = "; ".join(f"{n} x {reason}" for reason, n in sorted(row["reasons"].items()))
        n_run = row["passed"] + row["failed"]
        lines.append(f"{tier:<8} {n_run:>5} {row['failed']:>6} {row['skipped']:>7}  {why}".rstrip())
    return lines


def empty_tiers(counts: dict[str, dict[str, Any]]) -> list[str]:
    """Tiers of which no test ran."""
    return [
        tier
        for tier in TIERS
        if tier not in counts or not counts[tier]["passed"] + counts[tier]["failed"]
    ]


# --- the plugin
# -------------------------------------------------------------------------------------------------------


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option for the file of counts."""
    parser.addoption(
        "--tiers-file",
        type=Path,
        metavar="FILE",
        help="Update the counts by tier in this JSON file.",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Register the markers."""
    for tier, what in list(TIERS.items())[1:]:
        config.addinivalue_line("markers", f"{tier}: {what}")
    config.pluginmanager.register(TierPlugin(config), "tier-table")


@pytest.hookimpl(tryfirst=True)  # before `-m` selects
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark tests that use a fixture of a tier, and note the tier of every test in its reports."""
    for item in items:
        for fixture in getattr(item, "fixturenames", ()):
            if fixture in TIER_OF_FIXTURE:
                item.add_marker(TIER_OF_FIXTURE[fixture])
        tiers = [tier for tier in TIERS if item.get_closest_marker(tier)]
        item.user_properties.append((_TIER, tiers[-1] if tiers else next(iter(TIERS))))


class TierPlugin:
    """Counts the reports of a run; with pytest-xdist those of all workers arrive in the first
    process."""

    def __init__(self, config: pytest.Config) -> None:
        self._table = TierTable()
        self._file: Path | None = (
            None if hasattr(config, "workerinput") else config.getoption("--tiers-file")
        )

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Count a report."""
        self._table.add(report)

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Print the table and update the file."""
        counts = self._table.counts()
        if counts:
            terminalreporter.section("tiers")
            terminalreporter.write_line("\n".join(table_lines(counts)))
        if self._file is not None:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            before = (
                json.loads(self._file.read_text(encoding="utf-8")) if self._file.exists() else {}
            )
            self._file.write_text(json.dumps(before | counts, indent=1), encoding="utf-8")


def main(arguments: list[str]) -> int:
    """Print the table of a file of counts; the exit status is 1 if a test failed or a tier ran no
    test."""
    parser = argparse.ArgumentParser(prog="python -m tests.tiers", description=main.__doc__)
    parser.add_argument("file", type=Path, help="file that --tiers-file wrote")
    parser.add_argument(
        "--may-be-empty",
        action="append",
        default=[],
        choices=list(TIERS),
        help="tier that may run no test; repeatable",
    )
    options = parser.parse_args(arguments)
    counts = json.loads(options.file.read_text(encoding="utf-8"))
    empty = [tier for tier in empty_tiers(counts) if tier not in options.may_be_empty]
    totals = {outcome: sum(row[outcome] for row in counts.values()) for outcome in OUTCOMES}
    lines = table_lines(counts)
    lines += [
        f"Tier {tier}: no test ran; install what it needs (see why its tests were skipped)."
        for tier in empty
    ]
    lines.append(", ".join(f"{totals[outcome]} {outcome}" for outcome in OUTCOMES))
    sys.stdout.write("\n".join(lines) + "\n")
    return int(bool(empty or totals["failed"]))


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
