"""Test of the benchmark of wide lenses on one short drive."""

import pytest

from benchmarks.accuracy.ranging.simulated_runs import wide_lenses

pytestmark = pytest.mark.slow


def test_one_drive():
    figures = wide_lenses(*"--scenarios town --seeds 7 --seconds 1".split())
    stereo = figures["all"]["stereo"]
    assert stereo["pinhole"]["n"] == stereo["fisheye"]["n"] > 20
    assert stereo["pinhole"]["median_relative_error_pct"] < 2
    assert 0.5 < stereo["ratios"]["median"] < 2
    assert figures["all"]["mono"]["ratios"]["median"] == pytest.approx(1, abs=0.1)
    assert "farther out" in figures
