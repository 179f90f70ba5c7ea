import numpy as np
import pytest

from track_range.detection.lanes.lines import LaneLine, LaneLines, points


def line(*coefficients, covariance=None, rows=(200.0, 350.0)):
    return LaneLine(
        np.array(coefficients), np.zeros((3, 3)) if covariance is None else covariance, *rows
    )


def test_line_by_hand():
    curved = line(100.0, 2.0, 0.01)
    assert curved.x_px(np.array([0.0, 10.0])) == pytest.approx([100.0, 121.0])


def test_sigma_follows_from_the_covariance():
    covariance = np.diag([9.0, 0.04, 0.0])  # x = c0 + c1 y, sigma^2 = 9 + 0.04 y^2
    sigma = line(0, 0, 0, covariance=covariance).sigma_px(np.array([0.0, 20.0]))
    assert sigma == pytest.approx([3.0, 5.0])


def test_lines_meet_at_the_vanishing_point():
    left, right = line(490.0, -1.0, 0.0), line(150.0, 1.0, 0.0)
    assert LaneLines(left, right).vanishing_point_px() == pytest.approx((320.0, 170.0))
    assert LaneLines(right, left).vanishing_point_px() is None  # they meet below
    assert LaneLines(left, line(590.0, -1.0, 0.0)).vanishing_point_px() is None  # parallel
    assert LaneLines(left, None).vanishing_point_px() is None
    assert LaneLines().vanishing_point_px() is None


def test_parallel_curves_meet():
    left, right = line(490.0, -1.0, 0.002), line(150.0, 1.0, 0.002)
    assert LaneLines(left, right).vanishing_point_px() == pytest.approx(
        (320 + 0.002 * 170**2, 170.0)
    )
    assert LaneLines(left, line(150.0, 1.0, 0.003)).vanishing_point_px() is None


def test_sigma_of_the_horizon_row():
    """Sigmas of 3 and 4 px, 5 px together, and a width that grows by 2 px per row give 2.5 px."""
    lines = [
        LaneLine(np.array([c0, c1, 0.0]), np.diag([sigma_px**2, 0.0, 0.0]), 200.0, 350.0)
        for c0, c1, sigma_px in ((490.0, -1.0, 3.0), (150.0, 1.0, 4.0))
    ]
    assert LaneLines(*lines).horizon_px() == pytest.approx((170.0, 2.5))
    assert LaneLines(lines[0], None).horizon_px() is None
    assert LaneLines(*lines[::-1]).horizon_px() is None


def test_points_to_draw():
    drawn = points(line(10.0, 1.0, 0.0), n=4)
    assert drawn == pytest.approx(np.array([[210, 200], [260, 250], [310, 300], [360, 350]], float))


def test_invalid_shapes_and_rows():
    with pytest.raises(ValueError, match="coefficients"):
        LaneLine(np.zeros(2), np.zeros((3, 3)), 0.0, 1.0)
    with pytest.raises(ValueError, match="covariance"):
        LaneLine(np.zeros(3), np.zeros((2, 2)), 0.0, 1.0)
    with pytest.raises(ValueError, match="y_top_px"):
        line(0, 0, 0, rows=(2.0, 1.0))
