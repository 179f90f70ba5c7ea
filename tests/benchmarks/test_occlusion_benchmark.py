"""Test of the benchmark of occlusion on one seed."""

import argparse

import pytest

from benchmarks.accuracy.stereo_matching import occlusion

pytestmark = pytest.mark.slow


def test_one_seed(capsys):
    parser = argparse.ArgumentParser()
    occlusion.add_options(parser)
    options = parser.parse_args(["--first-seed", "2", "--seeds", "1", "--matchers", "patch"])
    figures = occlusion.measure(options)
    assert set(figures) == {"first_seed", "seeds", "ratios", "unrelated", "sequences", "all"}
    total, unrelated, sequences = (figures[part]["all"]["patch"] for part in ("all", "unrelated", "sequences"))
    assert total["n"] == unrelated["n"] + sequences["n"] > 20
    assert total["failures_pct"] < 60
    kinds = [group["patch"]["n"] for name, group in figures["all"].items() if name.startswith("occluder")]
    fractions = [group["patch"]["n"] for name, group in figures["all"].items() if name.startswith("covered")]
    assert sum(kinds) == sum(fractions) == total["n"]
    free = figures["all"]["occluder none"]["patch"]
    assert free["failures_pct"] <= total["failures_pct"]
    assert free["median_relative_error_pct"] < 1.0
    printed = capsys.readouterr().out
    assert "Occlusion, all" in printed
    assert "road user" in printed
