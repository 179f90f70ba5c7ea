"""The inner halves of boxes, by hand."""

import numpy as np
import pytest

from track_range.stereo.matching.sgbm import inner_halves

IMAGE_HW = (100, 200)


def half(box, *, margin_px=2, min_side_px=4):
    (patch,) = inner_halves(
        np.array([box], float), IMAGE_HW, margin_px=margin_px, min_side_px=min_side_px
    )
    return None if patch is None else (patch.left, patch.top, patch.right, patch.bottom)


def test_inner_half():
    assert half([40, 20, 80, 60]) == (50, 30, 70, 50)


def test_clipped_at_the_margin():
    assert half([-40, -40, 20, 20]) == (2, 2, 5, 5)
    assert half([150, 60, 230, 120]) == (170, 75, 197, 97)


@pytest.mark.parametrize(("width", "expected"), [(7, (22, 23, 25, 27)), (6, None)])
def test_smallest_patch(width, expected):
    assert half([20, 20, 20 + width, 30]) == expected


@pytest.mark.parametrize("box", [[np.nan, 0, 10, 10], [0, 0, np.inf, 10], [50, 20, 20, 60]])
def test_unusable_boxes(box):
    assert half(box) is None
