"""Lengths by a pair with the scale that a drive shows, by hand."""

import math

import numpy as np
import pytest

from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.measurement.rig_scale import (
    CALIBRATED,
    UNKNOWN_SCALE,
    DisparityOffset,
    RigScale,
)
from track_range.ranging.size_models.drive_scale import ScaleEvidence
from track_range.stereo.odometry.ego_motion import EgoMotion

RANGES = Ranges(np.array([1, 2]), np.array([20.0, np.nan]), np.array([0.4, np.nan]))
TWICE = RigScale(math.log(2.0), 0.1)  # all lengths are twice the true ones, +- 10 %


def test_calibrated_lengths_stay():
    motion = EgoMotion(10.0, 0.2)
    assert CALIBRATED.corrected(RANGES) is RANGES
    assert CALIBRATED.measured(RANGES) is RANGES
    assert CALIBRATED.corrected_motion(motion) is motion


def test_distances_are_corrected_without_the_common_error():
    corrected = TWICE.corrected(RANGES)
    np.testing.assert_allclose(corrected.distance_m, [10.0, np.nan])
    np.testing.assert_allclose(corrected.sigma_m, [0.2, np.nan])


def test_true_distances_as_the_pair_measures_them_have_its_error():
    measured = TWICE.measured(RANGES)
    np.testing.assert_allclose(measured.distance_m, [40.0, np.nan])
    np.testing.assert_allclose(measured.sigma_m, [np.hypot(0.8, 4.0), np.nan])


def test_speed_has_the_error_of_the_scale():
    motion = TWICE.corrected_motion(EgoMotion(10.0, 0.4, yaw_rad_s=0.1))
    assert (motion.speed_mps, motion.yaw_rad_s) == (pytest.approx(5.0), 0.1)
    assert motion.speed_sigma_mps == pytest.approx(math.hypot(0.2, 0.5))


def test_without_a_scale_nothing_is_measured_but_the_turn():
    assert not UNKNOWN_SCALE.is_known
    assert np.isnan(UNKNOWN_SCALE.corrected(RANGES).distance_m).all()
    motion = UNKNOWN_SCALE.corrected_motion(EgoMotion(10.0, 0.4, yaw_rad_s=0.1, is_still=True))
    assert math.isnan(motion.speed_mps)
    assert math.isnan(motion.speed_sigma_mps)
    assert (motion.yaw_rad_s, motion.is_still) == (0.1, True)


def test_references_of_a_pair_have_the_error_of_its_scale():
    evidence = ScaleEvidence(np.array([2, 2]), reference=RANGES, reference_sigma=0.01)
    of_rig = evidence.of_rig(TWICE)
    assert of_rig.reference is not None
    assert of_rig.reference.distance_m[0] == pytest.approx(10.0)
    assert of_rig.reference_sigma == pytest.approx(math.hypot(0.01, 0.1))


def test_offset_of_disparities_is_corrected_by_distance():
    """40 px m: 2 m is 20 px, of which 4 are missing; 10 m is 4 px, of which no sense can be made."""
    offset = DisparityOffset(4.0, 0.5, 3.0, 40.0)
    ranges = Ranges(np.array([1, 2]), np.array([2.0, 10.0]), np.array([0.31, 8.0]))
    corrected = RigScale(offset=offset).corrected(ranges)
    np.testing.assert_allclose(corrected.distance_m, [40 / 24, 40 / 8])
    # sigma: of the match, without the 3 px of the offset as known before, and of the offset now
    own = np.sqrt(np.maximum((ranges.sigma_m / ranges.distance_m) ** 2 - [0.15**2, 0.75**2], 0))
    expected = np.hypot(own / [1.2, 2.0], 0.5 / np.array([24.0, 8.0]))
    np.testing.assert_allclose(corrected.sigma_m / corrected.distance_m, expected)


def test_distances_beyond_the_offset_are_not_measured():
    offset = DisparityOffset(-4.0, 0.5, 3.0, 40.0)
    ranges = Ranges(np.array([1]), np.array([12.0]), np.array([1.0]))
    assert np.isnan(RigScale(offset=offset).corrected(ranges).distance_m).all()


def test_measured_distances_are_the_inverse_of_corrected_ones():
    scale = RigScale(math.log(1.3), 0.1, DisparityOffset(2.0, 0.5, 3.0, 40.0))
    again = scale.measured(scale.corrected(RANGES))
    np.testing.assert_allclose(again.distance_m, RANGES.distance_m)
    assert again.sigma_m[0] > RANGES.sigma_m[0]


def test_error_of_the_offset_is_least_where_the_scale_is_known_best():
    offset = DisparityOffset(0.0, 1.0, 1.0, 40.0, centre=0.05)
    ranges = Ranges(np.arange(3), np.array([2.0, 4.0, 1.0]), np.array([0.1, 0.4, 0.025]))
    corrected = offset.corrected(ranges)
    np.testing.assert_allclose(
        corrected.sigma_m / corrected.distance_m, [0.0, 0.05, 0.025], atol=1e-9
    )
