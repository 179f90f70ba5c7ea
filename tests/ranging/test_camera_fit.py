"""Fits of a camera to known metres: hand-worked cameras and exact cuboids."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from track_range.ranging.cameras.camera_fit import fit_camera
from track_range.ranging.cameras.focal_evidence import vehicle_shapes
from track_range.ranging.cameras.measurements import (
    CameraMeasurements,
    HorizonRow,
    KnownLane,
    KnownObject,
    SceneBoxes,
    unhidden,
)
from track_range.ranging.cameras.posterior import posterior
from track_range.ranging.cameras.unknowns import Unknown, camera_priors
from track_range.ranging.size_models.cuboid import box_of_cuboid
from track_range.ranging.size_models.curve import load_curves
from track_range.ranging.size_models.size_model import SIZE_CLASSES
from track_range.stereo.geometry.focal_guess import default_guess, focal_of_field

SIZE_PX = (1280, 720)
CENTRE_PX = (639.5, 359.5)
CAR = SIZE_CLASSES.index("car")
VAGUE = camera_priors(900.0, focal_sigma=0.3)
SIZES = load_curves(region="europe")


def flat_box(distance_m, *, focal_px, height_m, horizon_px, x_px=0.0, hw_m=(1.5, 1.7)):
    """Box of a flat upright object, (4,), for a horizon `horizon_px` below the image centre."""
    scale = focal_px / distance_m
    bottom, half = CENTRE_PX[1] + horizon_px + scale * height_m, scale * hw_m[1] / 2
    centre = CENTRE_PX[0] + x_px
    return (centre - half, bottom - scale * hw_m[0], centre + half, bottom)


def test_known_height_and_distance_give_the_focal_length():
    # 90 px for 1.5 m at 12 m: f = 90 * 12 / 1.5
    box = (600.0, 330.0, 702.0, 420.0)
    known = KnownObject(name="car", xyxy_px=box, size_class=CAR, distance_m=12.0, height_m=1.5)
    fit = fit_camera(SIZE_PX, VAGUE, SIZES, CameraMeasurements(objects=[known]))
    assert fit.camera.fx_px == pytest.approx(720.0, rel=0.02)
    assert 0.01 < fit.focal_sigma < 0.05


def test_lane_width_and_horizon_give_the_height():
    # 350 px for 3.5 m, 140 px below the horizon: H = 3.5 * 140 / 350
    lane = KnownLane(name="lane", x1_px=460.0, x2_px=810.0, y_px=480.0, width_m=3.5)
    horizon = HorizonRow(340.0, 1.0, "lane lines")
    fit = fit_camera(SIZE_PX, VAGUE, SIZES, CameraMeasurements(lanes=[lane], horizon=[horizon]))
    assert fit.height_m == pytest.approx(1.40, abs=0.04)
    assert fit.height_sigma_m < 0.1
    assert fit.gain("focal length") > 0.95  # a lane says nothing about it
    assert fit.pitch_rad(fit.camera) == pytest.approx(math.atan(19.5 / 900), abs=0.002)


def test_contradicting_distances_widen_all_sigmas():
    boxes = [flat_box(d, focal_px=900.0, height_m=1.5, horizon_px=0.0) for d in (10.0, 20.0)]

    def fit(*distances_m):
        known = [
            KnownObject(name=f"{d:g} m", xyxy_px=box, size_class=CAR, distance_m=d)
            for box, d in zip(boxes, distances_m, strict=True)
        ]
        return fit_camera(SIZE_PX, VAGUE, SIZES, CameraMeasurements(objects=known))

    agreeing, contradicting = fit(10.0, 20.0), fit(10.0, 60.0)
    assert agreeing.contradiction == 1.0
    assert contradicting.contradiction > 2.0
    assert contradicting.focal_sigma > 2 * agreeing.focal_sigma
    assert (
        "60 m" in contradicting.largest_deviation[0] or "10 m" in contradicting.largest_deviation[0]
    )


@pytest.mark.parametrize(
    ("factor", "is_contradiction"), [(1.0, False), (1.15, False), (1.45, True), (0.7, True)]
)
def test_one_wrong_distance_among_five(factor, is_contradiction):
    """Its residual of 4 to 6 sigmas is a contradiction, although the rms of all residuals is below
    2."""
    known = [
        KnownObject(
            name=f"{d:g} m",
            xyxy_px=flat_box(d, focal_px=900.0, height_m=1.5, horizon_px=0.0),
            size_class=CAR,
            distance_m=d * (factor if d == 14.0 else 1.0),
        )
        for d in (6.0, 9.0, 14.0, 22.0, 35.0)
    ]
    fit = fit_camera(SIZE_PX, VAGUE, SIZES, CameraMeasurements(objects=known))
    largest = max(abs(residual.value / residual.sigma) for residual in fit.residuals)
    assert (fit.contradiction > 2.0, largest > 3.5) == (is_contradiction, is_contradiction)
    if is_contradiction:
        assert fit.contradiction == pytest.approx(largest / 1.75)
        assert "14 m" in fit.largest_deviation[0]


def test_wrong_horizon_is_an_outlier():
    boxes = [
        flat_box(d, focal_px=900.0, height_m=1.5, horizon_px=0.0) for d in (6.0, 10.0, 20.0, 35.0)
    ]
    known = [
        KnownObject(name=str(d), xyxy_px=box, size_class=CAR, distance_m=d)
        for d, box in zip((6.0, 10.0, 20.0, 35.0), boxes, strict=True)
    ]
    rows = [HorizonRow(359.5, 5.0, "direction of travel"), HorizonRow(300.0, 5.0, "lane lines")]
    fit = fit_camera(SIZE_PX, VAGUE, SIZES, CameraMeasurements(objects=known, horizon=rows))
    assert abs(fit.pitch_rad(fit.camera)) < 0.008
    assert fit.residuals[-1].value < -50


@pytest.mark.parametrize("focal_px", [640.0, 1400.0])
def test_two_distances_and_the_height_give_focal_length_and_pitch(focal_px):
    boxes = [flat_box(d, focal_px=focal_px, height_m=1.4, horizon_px=-25.0) for d in (8.0, 30.0)]
    known = [
        KnownObject(name=str(d), xyxy_px=box, size_class=CAR, distance_m=d)
        for d, box in zip((8.0, 30.0), boxes, strict=True)
    ]
    priors = camera_priors(900.0, focal_sigma=0.3, height_m=1.4)
    fit = fit_camera(SIZE_PX, priors, SIZES, CameraMeasurements(objects=known))
    assert fit.camera.fx_px == pytest.approx(focal_px, rel=0.05)
    assert fit.pitch_rad(fit.camera) == pytest.approx(math.atan(25 / focal_px), abs=0.006)
    assert fit.focal_sigma < 0.06


def test_focal_length_and_height_are_not_separated_by_contact_points_alone():
    boxes = [flat_box(d, focal_px=900.0, height_m=1.5, horizon_px=0.0) for d in (8.0, 12.0, 30.0)]
    known = [
        KnownObject(name=str(d), xyxy_px=box, size_class=CAR, distance_m=d)
        for d, box in zip((8.0, 12.0, 30.0), boxes, strict=True)
    ]
    fit = fit_camera(SIZE_PX, VAGUE, _NoSizes(), CameraMeasurements(objects=known))
    assert fit.correlation("focal length", "camera height") < -0.8
    assert fit.product_sigma < 0.1 < fit.focal_sigma


class _NoSizes:
    """Size model without any class."""

    def measure(self, boxes):
        nan = np.full(len(boxes), np.nan)
        return type(SIZES.measure(boxes))(nan, nan, nan)


def cuboid_scene(focal_px, *, n=60, seed=0):
    """Exact boxes of parked and driving cars of typical size along a road, seen by a camera of this
    focal length."""
    rng = np.random.default_rng(seed)
    prior = SIZES.priors["car"]
    bearing = rng.uniform(-0.85, 0.85, n) * SIZE_PX[0] / 2 / focal_px
    image = box_of_cuboid(
        np.log(prior.hwl_m)[:, None],
        yaw_rad=np.zeros(n),
        bearing=bearing,
        distance_m=rng.uniform(8.0, 30.0, n),
        camera_height_m=1.5,
    )
    width, height = focal_px * np.exp(image.log_width), focal_px * np.exp(image.log_height)
    bottom = CENTRE_PX[1] + focal_px * 1.5 * np.exp(image.log_inverse_depth)
    centre = CENTRE_PX[0] + focal_px * bearing
    xyxy = np.stack([centre - width / 2, bottom - height, centre + width / 2, bottom], axis=1)
    return SceneBoxes(xyxy, np.full(n, CAR), np.arange(n))


@pytest.mark.parametrize("focal_px", [550.0, 800.0, 1200.0])
def test_shapes_of_cars_give_the_focal_length(focal_px):
    shapes = vehicle_shapes(cuboid_scene(focal_px), SIZE_PX, SIZES)
    shown_px, sigma = shapes.curve.estimate
    usual_px = default_guess(SIZE_PX).focal_px
    before, after = (abs(math.log(guess_px / focal_px)) for guess_px in (usual_px, shown_px))
    assert after < 0.16
    assert after < max(before, 0.12)
    assert 0.1 < sigma < 0.25
    assert shapes.n_tracks > 10


def test_without_boxes_or_shapes_nothing_is_known():
    for scene, sizes in ((SceneBoxes(), SIZES), (cuboid_scene(800.0), _NoSizes())):
        shapes = vehicle_shapes(scene, SIZE_PX, sizes)
        assert shapes.n_tracks == 0
        assert np.ptp(shapes.curve.log_likelihood) == 0.0
    assert focal_of_field(90.0, 1280) == pytest.approx(640.0)


def test_hidden_boxes():
    boxes = np.array([[0.0, 0, 50, 50], [40, 10, 90, 60], [200, 0, 220, 20]])
    assert unhidden(boxes).tolist() == [False, True, True]


def test_evidence_and_priors_give_the_fit():
    """In the linear posterior, the evidence beside the priors of the fit is the fit."""
    boxes = [flat_box(d, focal_px=950.0, height_m=1.4, horizon_px=5.0) for d in (8.0, 12.0, 30.0)]
    known = [
        KnownObject(name=str(d), xyxy_px=box, size_class=CAR, distance_m=d)
        for d, box in zip((8.0, 12.0, 30.0), boxes, strict=True)
    ]
    priors = camera_priors(900.0, focal_sigma=0.1, height_m=1.5)
    fit = fit_camera(SIZE_PX, priors, SIZES, CameraMeasurements(objects=known))
    names = (Unknown.FOCAL, Unknown.HEIGHT, Unknown.SIZES)
    plain = {name: replace(priors[name], kind="unknown") for name in names}
    cameras = posterior(plain, fit.evidence)
    of_focal, of_height = ({name: 1.0} for name in names[:2])
    shown = cameras.estimate(of_focal)
    assert 900.0 * math.exp(-shown.mean) == pytest.approx(fit.camera.fx_px, rel=1e-4)
    assert shown.sigma == pytest.approx(fit.focal_sigma, rel=1e-3)
    assert 1.5 * math.exp(cameras.estimate(of_height).mean) == pytest.approx(fit.height_m, rel=1e-4)
    both = {Unknown.FOCAL: 1.0, Unknown.HEIGHT: -1.0}
    assert cameras.estimate(both).sigma == pytest.approx(fit.product_sigma, rel=1e-3)


def test_without_measurements_there_is_no_evidence():
    assert fit_camera(SIZE_PX, VAGUE, SIZES, CameraMeasurements()).evidence == ()
