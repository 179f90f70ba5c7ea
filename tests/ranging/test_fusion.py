import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ranging.fusion import contributors, fuse
from ranging.ranges import Ranges

ONE = np.array([1])


def ranges(distance_m, sigma_m):
    return Ranges(ONE, np.array([distance_m]), np.array([sigma_m]))


def test_inverse_variance_by_hand():
    fused = fuse({"mono": ranges(22.0, 2.0), "stereo": ranges(20.0, 1.0)}, ONE)
    assert fused.distance_m == pytest.approx([20.4])  # weights 1/4 and 1
    assert fused.sigma_m == pytest.approx([np.sqrt(0.8)])


def test_contradiction_widens_sigma():
    fused = fuse({"mono": ranges(40.0, 1.0), "stereo": ranges(20.0, 1.0)}, ONE)
    assert fused.distance_m == pytest.approx([30.0])
    assert fused.sigma_m == pytest.approx([np.sqrt(200 / 2)])  # chi^2 = 200, one degree of freedom


def test_a_match_that_no_size_can_explain_is_left_out():
    fused = fuse({"mono": ranges(75.0, 6.0), "stereo": ranges(15.0, 0.3)}, ONE)
    assert (fused.distance_m[0], fused.sigma_m[0]) == (75.0, 6.0)
    assert fuse({"mono": ranges(30.0, 2.0), "stereo": ranges(15.0, 0.3)}, ONE).distance_m[0] < 17  # half hidden: may be


def test_dense_stands_in_for_patches_only_where_they_are_silent():
    silent, dense = ranges(np.nan, np.nan), ranges(30.0, 1.0)
    assert fuse({"stereo": silent, "sgbm": dense}, ONE).distance_m == pytest.approx([30.0])
    assert fuse({"stereo": ranges(20.0, 1.0), "sgbm": dense}, ONE).distance_m == pytest.approx([20.0])
    assert fuse({"sgbm": dense}, ONE).distance_m == pytest.approx([30.0])


def test_contributors_are_those_that_count():
    mono, stereo, dense, silent = ranges(20.0, 2.0), ranges(21.0, 1.0), ranges(22.0, 1.0), ranges(np.nan, np.nan)
    assert contributors({"mono": mono, "stereo": stereo, "sgbm": dense}, ONE) == 5
    assert contributors({"mono": mono, "stereo": stereo, "sgbm": silent}, ONE) == 5  # dense has no say beside patches
    assert contributors({"mono": mono, "stereo": silent, "sgbm": dense}, ONE) == 9
    assert contributors({"mono": mono, "sgbm": dense}, ONE) == 9
    assert contributors({"mono": mono, "stereo": ranges(5.0, 0.1)}, ONE) == 1  # left out: no size explains it
    assert contributors({"mono": silent}, ONE) == 0


def test_nobody_measured():
    for by_method in ({}, {"mono": ranges(np.nan, np.nan)}):
        fused = fuse(by_method, ONE)
        assert np.isnan(fused.distance_m).all()
        assert np.isnan(fused.sigma_m).all()
    assert len(fuse({}, np.zeros(0, np.int64))) == 0


@given(st.floats(20, 45), st.floats(20, 45), st.floats(0.1, 10), st.floats(0.1, 10))
def test_fused_lies_between_and_is_no_less_certain_than_agreement_allows(a, b, sigma_a, sigma_b):
    fused = fuse({"mono": ranges(a, sigma_a), "stereo": ranges(b, sigma_b)}, ONE)
    assert min(a, b) - 1e-9 <= fused.distance_m[0] <= max(a, b) + 1e-9
    assert fused.sigma_m[0] >= (sigma_a**-2 + sigma_b**-2) ** -0.5 - 1e-9
