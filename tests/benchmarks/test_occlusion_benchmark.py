"""Test of the benchmark of occlusion on one seed."""

import pytest

from benchmarks.accuracy.ranging.occlusion import occlusion
from benchmarks.harness import print_figures

pytestmark = pytest.mark.slow


def test_one_seed(capsys):
    figures = occlusion(*"--first-seed 2 --seeds 1 --matchers patch".split())
    assert set(figures) == {"failure_ratios", "unrelated", "sequences", "all"}
    total, unrelated, sequences = (
        figures[part]["all"]["patch"] for part in ("all", "unrelated", "sequences")
    )
    assert total["n"] == unrelated["n"] + sequences["n"] > 20
    assert total["failures_pct"] < 60
    kinds = [
        group["patch"]["n"] for name, group in figures["all"].items() if name.startswith("occluder")
    ]
    fractions = [
        group["patch"]["n"] for name, group in figures["all"].items() if name.startswith("covered")
    ]
    assert sum(kinds) == sum(fractions) == total["n"]
    free = figures["all"]["occluder none"]["patch"]
    assert free["failures_pct"] <= total["failures_pct"]
    assert free["median_relative_error_pct"] < 1.0
    print_figures("occlusion", figures)
    printed = capsys.readouterr().out
    assert "occlusion, all" in printed
    assert "road user" in printed
