"""Correction of disparities by an alignment, its significance, and its sentences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.stereo.geometry.alignment import UNCORRECTED_SIGMA_PX, Alignment, column_from_axis
from track_range.stereo.geometry.camera import PinholeCamera

CAMERA = PinholeCamera(700.0, 700.0, 600.0, 180.0, 1200, 360)


def test_column_from_axis() -> None:
    assert column_from_axis(np.array([600.0, 1200.0, 300.0]), CAMERA).tolist() == [0.0, 1.0, -0.5]


def test_offset_curvature_and_sigma_by_hand() -> None:
    alignment = Alignment(offset_px=0.5, curvature_px=1.0, residual_px=0.3)
    disparity, sigma = alignment.corrected(
        np.array([10.0, 10.0, np.nan]),
        np.array([0.4, 0.0, np.nan]),
        x_px=np.array([600.0, 300.0, 0.0]),
        camera=CAMERA,
    )
    assert disparity[:2].tolist() == [10.5, 10.75]  # u = 0 and -1/2
    assert sigma[:2].tolist() == [0.5, 0.3]
    assert np.isnan(disparity[2])
    assert np.isnan(sigma[2])


def test_default_alignment() -> None:
    disparity, sigma = Alignment().corrected(
        np.array([7.0]), np.zeros(1), x_px=np.zeros(1), camera=CAMERA
    )
    assert (disparity[0], sigma[0]) == (7.0, UNCORRECTED_SIGMA_PX)
    assert not Alignment().is_measured
    assert "not measured" in Alignment().sentence()


def measured(offset_px: float, sigma_px: float, **more: float) -> Alignment:
    return Alignment(
        offset_px=offset_px, offset_sigma_px=sigma_px, source="this drive, 16 frames", **more
    )


def test_sentences() -> None:
    low = measured(0.414, 0.093, residual_px=0.2)
    assert "0.41 ± 0.09 px too small" in low.sentence()
    assert "this drive, 16 frames" in low.sentence()
    high = measured(-0.3, 0.05, curvature_px=-1.2).sentence()
    assert "0.30 ± 0.05 px too large" in high
    assert "1.20 px too large at the image edges" in high
    unclear = measured(0.05, 0.03, residual_px=0.1).if_clear()
    assert "not corrected" in unclear.sentence()


@pytest.mark.parametrize(
    ("alignment", "is_clear"),
    [
        (measured(0.21, 0.1), True),
        (measured(-0.21, 0.1), True),
        (measured(0.19, 0.1), False),
        (measured(0.0, 0.1, curvature_px=1.0, curvature_sigma_px=0.4), True),
        (measured(0.0, 0.1, curvature_px=1.0, curvature_sigma_px=0.6), False),
    ],
)
def test_significance_of_offset_and_curvature(alignment: Alignment, is_clear: bool) -> None:
    assert alignment.is_clear is is_clear
    assert alignment.if_clear().is_correcting is is_clear


@settings(deadline=None)
@given(st.floats(-0.5, 0.5), st.floats(0.01, 0.3), st.floats(0.0, 0.4))
def test_withheld_correction_is_part_of_the_residual(
    offset_px: float, sigma_px: float, residual_px: float
) -> None:
    alignment = measured(offset_px, sigma_px, residual_px=residual_px).if_clear()
    if not alignment.is_correcting:
        assert alignment.residual_px == pytest.approx(
            min(float(np.hypot(offset_px, residual_px)), UNCORRECTED_SIGMA_PX)
        )
        assert alignment.offset_sigma_px == sigma_px


@pytest.mark.parametrize(
    ("row_offset_px", "moved_px"), [(0.0, 0.0), (0.3, 0.0), (-0.31, -0.31), (2.5, 2.5)]
)
def test_small_row_offsets_are_not_corrected(row_offset_px: float, moved_px: float) -> None:
    assert Alignment(row_offset_px=row_offset_px).row_correction_px == moved_px
