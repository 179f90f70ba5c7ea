"""The focal length that a drive shows: its correction, its leading evidence, and since when."""

import math

import numpy as np
import pytest

from track_range.ranging.cameras.doubt import Doubt, errors_of
from track_range.ranging.cameras.evidence import Evidence
from track_range.ranging.cameras.learnt_focal import LearntFocal
from track_range.ranging.cameras.posterior import posterior
from track_range.ranging.cameras.scale_check import ScaleCheck
from track_range.ranging.cameras.unknowns import Unknown, camera_priors
from track_range.ranging.measurement.focal_scale import FocalScale
from track_range.ranging.size_models.drive_scale import DriveScale
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.odometry.ego_motion import EgoMotion

CAMERA = PinholeCamera(1000.0, 1000.0, 640.0, 360.0, 1280, 720)
PRIORS = camera_priors(1000.0, focal_sigma=0.3)
OF_FOCAL = {Unknown.FOCAL: 1.0}
SHAPES = Evidence("the shapes of 9 vehicles", OF_FOCAL, math.log(0.8), 0.2)
TURN = Evidence("the turn at 0:09", OF_FOCAL, math.log(0.9), 0.02)


def learnt(*steps):
    """The estimate after the evidence of each step, one second apart."""
    focal = LearntFocal(PRIORS)
    for k, evidence in enumerate(steps):
        focal.update(PRIORS, evidence, posterior(PRIORS, evidence), float(k))
    return focal


def test_without_evidence_the_focal_length_before_the_drive_stays():
    focal = learnt([], [])
    assert focal.estimate is None
    assert focal.scale.factor == pytest.approx(1.0)


def test_mean_is_weighted_by_the_prior():
    """By hand: 0.3 and 0.02 give a weight of 0.9956 of the turn."""
    estimate = learnt([TURN]).estimate
    weight = 0.3**2 / (0.3**2 + 0.02**2)
    assert estimate.focal_px == pytest.approx(1000 * math.exp(-weight * math.log(0.9)), rel=1e-4)
    assert estimate.sigma == pytest.approx(0.02 * math.sqrt(weight), rel=0.05)


def test_leading_evidence_is_named_since_it_leads():
    assert learnt([], [SHAPES], [SHAPES]).estimate.source == SHAPES.name
    estimate = learnt([], [SHAPES], [SHAPES, TURN], [SHAPES, TURN]).estimate
    assert (estimate.source, estimate.since_s) == (TURN.name, 2.0)
    assert estimate.sentence == (
        "Focal length 1,112 ± 22 px (2.0 %), from the turn at 0:09, in use from 0:02 on."
    )
    assert estimate.summary() == {
        "focal_px": round(estimate.focal_px, 2),
        "focal_sigma": round(estimate.sigma, 5),
        "source": TURN.name,
        "since_s": 2.0,
    }


def test_evidence_that_says_nothing_is_not_named():
    weak = Evidence("the shapes of 1 vehicle", OF_FOCAL, 0.3, 2.0)
    assert learnt([weak]).estimate is None


@pytest.mark.parametrize("rig", [False, True])
def test_sigma_of_distances_is_that_of_what_remains(rig):
    priors = camera_priors(
        1000.0,
        focal_sigma=0.3,
        baseline_m=0.5 if rig else None,
        baseline_sigma=1.0,
    )
    evidence = [TURN]
    if rig:
        evidence.append(Evidence("sizes", {Unknown.BASELINE: 1.0}, 0.5, 0.05))
    cameras = posterior(priors, evidence)
    focal = FocalScale(cameras.correction(OF_FOCAL))
    corrected = Doubt.of(cameras, errors_of(priors), corrected=DriveScale(focal=focal))
    as_assumed = Doubt.of(cameras, errors_of(priors))
    assert corrected.shared_sigma["mono"] == pytest.approx(0.02, abs=0.002)
    assert as_assumed.shared_sigma["mono"] > 0.05  # it contains the error that was found


def test_only_an_unknown_focal_length_is_learnt():
    given = ScaleCheck(CAMERA, camera_priors(1000.0, focal_sigma=0.02), learns_focal=True)
    unknown = ScaleCheck(CAMERA, PRIORS, learns_focal=True)
    of_recording = ScaleCheck(CAMERA, PRIORS)
    assert [check.focal for check in (given, unknown, of_recording)] == [None] * 3
    assert given.focal_scale.log_factor == of_recording.focal_scale.log_factor == 0.0


def test_stretch_affects_only_the_axis():
    focal = FocalScale(math.log(1.25))  # the assumed focal length is 1.25 times too large
    motion = EgoMotion(10.0, 0.5, yaw_rad_s=0.08, noise_mps=0.25)
    true = focal.corrected_motion(motion)
    assert (true.speed_mps, true.speed_sigma_mps) == (pytest.approx(8.0), pytest.approx(0.4))
    assert (true.yaw_rad_s, true.noise_mps) == (pytest.approx(0.1), pytest.approx(0.2))
    assert focal.stretched(true).speed_mps == pytest.approx(10.0)
    camera = focal.camera(CAMERA)
    point = np.array([[800.0, 400.0]])
    # x of the ray at the corrected depth is that at the measured depth
    measured, corrected = CAMERA.rays(point)[0] * 25.0, camera.rays(point)[0] * 20.0
    np.testing.assert_allclose(corrected, [measured[0], measured[1], 20.0])


def test_given_speed_is_reported_as_given_where_the_estimate_changes():
    given = EgoMotion(8.0, 0.2)
    stretched = FocalScale(0.1).stretched(given)
    reported = FocalScale(0.2).corrected_motion(stretched)
    assert (reported.speed_mps, reported.speed_sigma_mps) == pytest.approx((8.0, 0.2))
