"""CameraEstimate: one focal length from several sources, of which each may be a mistake."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from track_range.recording.cameras.camera_estimate import (
    CameraEstimate,
    source_of_curve,
    source_of_guess,
)
from track_range.stereo.geometry.focal_curve import FocalCurve
from track_range.stereo.geometry.focal_guess import FocalGuess

SIZE_PX = (1280, 720)


def source(focal_px, sigma, kind="shapes"):
    return source_of_guess(FocalGuess(focal_px, sigma, f"{kind} of a test"), kind, SIZE_PX)


def estimate(*sources, **values):
    return CameraEstimate(size_px=SIZE_PX, sources=sources, **values)


def test_two_sources_that_agree_by_hand():
    both = estimate(source(1000.0, 0.1), source(1050.0, 0.05, "motion"))
    # precisions 100 and 400
    assert both.focal_px == pytest.approx(
        math.exp((100 * math.log(1000) + 400 * math.log(1050)) / 500), rel=2e-3
    )
    assert both.sigma == pytest.approx(500**-0.5, rel=0.05)
    assert both.weights == pytest.approx((0.2, 0.8), abs=0.01)
    assert both.leading.kind == "motion"


@given(st.floats(600, 1500), st.floats(0.02, 0.2))
def test_one_source_is_the_estimate(focal_px, sigma):
    alone = estimate(source(focal_px, sigma, "motion"))
    assert alone.focal_px == pytest.approx(focal_px, rel=0.02)
    # a little wider, since it may be a mistake
    assert sigma - 1e-3 < alone.sigma < 1.3 * sigma


def test_sigma_widens_with_a_contradiction():
    apart = [estimate(source(1000.0, 0.02), source(1000.0 * math.exp(x), 0.02)) for x in (0, 0.1)]
    far = estimate(source(1000.0, 0.02), source(1400.0, 0.02, "metadata"))
    assert apart[1].sigma > 2 * apart[0].sigma
    # metadata are wrong more often than shapes
    assert far.focal_px < math.sqrt(1000 * 1400)
    assert far.sigma > 0.08


def test_curve_is_continued_beyond_its_ends():
    log_focal = np.log(np.geomspace(800, 1200, 41))
    curve = FocalCurve(log_focal, -0.5 * ((log_focal - math.log(1000)) / 0.05) ** 2)
    by_curve = estimate(source_of_curve("motion", "a turn", curve, SIZE_PX))
    by_guess = estimate(source(1000.0, 0.05, "motion"))
    assert by_curve.focal_px == pytest.approx(by_guess.focal_px, rel=2e-3)
    assert by_curve.sigma == pytest.approx(by_guess.sigma, rel=0.05)
    rising = source_of_curve("motion", "a turn", FocalCurve(log_focal, log_focal), SIZE_PX).curve
    assert rising.log_focal[np.argmax(rising.log_likelihood)] >= math.log(1199)


def test_sentences():
    wide = estimate(source(1000.0, 0.2))
    assert wide.sentence.startswith("Focal length 99")
    assert wide.sentence.endswith("from shapes of a test.")
    (advice,) = wide.advice
    assert "turn" in advice
    assert wide.remedy[1] < 0.02
    narrow = estimate(source(1000.0, 0.01, "motion"))
    assert narrow.sigma < 0.012
    assert not narrow.advice


def test_distortion_is_corrected_where_it_is_significant_and_visible():
    motion = source(900.0, 0.01, "motion")
    assert estimate(motion, coefficients=(-0.2, 0.0, 0.0, 0.0), k1_sigma=0.01).distortion == (
        -0.2,
        0.0,
        0.0,
        0.0,
    )
    assert estimate(motion, coefficients=(-0.2, 0.0, 0.0, 0.0), k1_sigma=0.1).distortion == ()
    assert estimate(motion, coefficients=(-0.001, 0.0, 0.0, 0.0), k1_sigma=0.0001).distortion == ()
    assert estimate(motion).distortion == ()


def test_a_wide_lens_is_named():
    """tan(55 degrees) = 1.428; the fraction of an equidistant lens images it at 640 px / 667 px."""
    coefficients = (0.515, 0.02, 0.0, 0.0, 0.0, 0.85, 0.108, 0.0)
    motion = source(667.0, 0.005, "motion")
    wide = estimate(motion, coefficients=coefficients, k1_sigma=0.01)
    assert wide.k1 == pytest.approx(0.515 - 0.85)
    assert wide.field_deg == pytest.approx(110.0, abs=0.5)
    assert "about 110 degrees" in wide.advice[-1]
    assert estimate(motion).field_deg == pytest.approx(87.7, abs=0.2)  # 2 atan(639.5 / 667)
    assert not estimate(motion).advice


def test_summary_has_curves_for_a_picture():
    summary = estimate(source(1000.0, 0.2), source(1000.0, 0.004, "motion")).summary()
    grid = np.array(summary["curve_px"])
    assert np.all(np.diff(grid) > 0)
    assert len(grid) < 200
    assert max(summary["density"]) == 1.0
    assert [len(part["density"]) for part in summary["sources"]] == [len(grid)] * 2
    near = np.abs(np.log(grid / 1000)) < 0.008
    assert near.sum() >= 4
    assert summary["k1"] is None
