"""State of a drive: ground plane from objects that left, roughness, and body types over the views
of an object."""

import numpy as np
import pytest

from track_range.ranging.methods.size_regression import incomplete_sigma
from track_range.ranging.size_models.cuboid import box_of_cuboid
from track_range.ranging.size_models.curve import load_curves
from track_range.ranging.size_models.shared_ground import (
    GroundContacts,
    GroundPrior,
    ground_from_others,
)
from track_range.ranging.size_models.size_model import (
    SIZE_CLASSES,
    BoxExtents,
    DriveState,
    GroundTerms,
)

PACKAGED = load_curves()
HORIZON, HEIGHT_M = 0.02, 1.3
BODY = ("small", "high roof")


def contacts(inverse_depth, *, off_m=0.0, bearing=0.0):
    """Contact points on the plane of the test, `off_m` below it, with sizes that are known to 5
    %."""
    n = len(inverse_depth)
    bottom = HORIZON + (HEIGHT_M + off_m) * inverse_depth
    return GroundContacts(
        bottom,
        np.full(n, bearing),
        inverse_depth,
        np.full(n, 0.05),
        np.full(n, 5e-4),
        np.ones(n, np.bool_),
    )


def drive_past(drive, n_objects, *, off_m=0.0, seed=0):
    """Objects that come one after the other, three in view at a time."""
    rng = np.random.default_rng(seed)
    for first in range(n_objects):
        ids = np.arange(first, first + 3)
        drive.start_frame(ids, 0.5 * first)
        inverse_depth = 1 / rng.uniform(8, 60, 3)
        ground = ground_from_others(
            contacts(inverse_depth, off_m=rng.normal(0, off_m, 3)), GroundPrior(), drive
        )
        drive.add(np.arange(3), ground.terms, np.zeros((1, 3)), np.zeros(3), np.ones(3))


def test_objects_that_left_give_the_ground_of_a_single_object():
    single = contacts(np.array([1 / 30]))
    drive = DriveState()
    drive_past(drive, 40)
    drive.start_frame(np.array([1000]), 21.0)
    known, unknown = (
        ground_from_others(single, GroundPrior(), drive),
        ground_from_others(single, GroundPrior()),
    )
    assert known.height_m[0] == pytest.approx(HEIGHT_M, abs=0.05)
    assert known.horizon[0] == pytest.approx(HORIZON, abs=0.004)
    assert unknown.height_m[0] == pytest.approx(1.5)
    assert known.variance[0] < 0.1 * unknown.variance[0]
    assert (known.is_prior_only[0], unknown.is_prior_only[0]) == (np.False_, np.True_)


def test_objects_in_view_do_not_count_twice():
    drive = DriveState()
    inverse_depth = 1 / np.array([10.0, 20.0, 40.0])
    for k in range(50):
        drive.start_frame(np.array([1, 2, 3]), 0.1 * k)
        ground = ground_from_others(contacts(inverse_depth), GroundPrior(), drive)
        drive.add(np.arange(3), ground.terms, np.zeros((1, 3)), np.zeros(3), np.ones(3))
    np.testing.assert_array_equal(drive.information, 0.0)
    drive.start_frame(np.array([9]), 5.0)
    assert drive.information[0] > 0


def test_objects_are_forgotten():
    drive = DriveState()
    drive_past(drive, 10)
    drive.start_frame(np.array([99]), 10.0)
    near = drive.information[2]
    drive.start_frame(np.array([99]), 70.0)
    assert drive.information[2] == pytest.approx(near * np.exp(-1.0), rel=1e-6)


def test_roughness_follows_the_contact_points():
    flat, hilly = DriveState(), DriveState()
    drive_past(flat, 60)
    drive_past(hilly, 60, off_m=0.5)
    for drive in (flat, hilly):
        drive.start_frame(np.array([999]), 31.0)
    assert flat.roughness < 0.8
    assert hilly.roughness > 2.0


def test_evidence_of_body_types_is_a_limited_mean():
    drive = DriveState()
    terms = GroundTerms(
        np.zeros((5, 1)), np.zeros(1), np.ones(1), np.ones(1), np.zeros(1, np.bool_)
    )
    for log_likelihood in ([0.0, -0.4], [0.0, -9.0], [0.0, -0.4], [-0.2, 0.0]):
        drive.start_frame(np.array([4]), 0.0)
        drive.add(np.array([0]), terms, np.array(log_likelihood)[:, None], np.zeros(1), np.ones(1))
    drive.start_frame(np.array([4, 5]), 0.1)
    np.testing.assert_allclose(drive.body_evidence(2), [[-0.05, 0.0], [-0.45, 0.0]])
    np.testing.assert_allclose(drive.information, 0.0)


def test_views_decide_between_body_types():
    """A high-roof van on the axis with noisy boxes: the type is that of the mean over its views."""
    rng = np.random.default_rng(3)
    body = next(body for body in PACKAGED.priors["van"].bodies if body.name == "high roof")
    with_state, without = [], []
    for _ in range(20):
        drive = DriveState()
        for k in range(12):
            size = np.array([[body.hwl_m[1], body.hwl_m[0]]]) / 40.0 + rng.normal(0, 0.004, (1, 2))
            one = np.ones(1)
            van = np.array([SIZE_CLASSES.index("van")])
            boxes = BoxExtents(
                size, 0 * one, 0 * one, van, one > 0, one < 0, np.full((1, 2), 0.0028), 0 * size
            )
            drive.start_frame(np.array([1]), 0.1 * k)
            with_state.append(abs(PACKAGED.measure(boxes, drive).distance_m[0] / 40.0 - 1))
            without.append(abs(PACKAGED.measure(boxes).distance_m[0] / 40.0 - 1))
    assert np.mean(with_state) < 0.95 * np.mean(without)


def test_sizes_of_views_are_averaged_by_their_variances_and_forgotten():
    drive = DriveState()
    for time_s, log_size, variance in ((0.0, 0.0, 0.04), (3.0, 0.2, 0.01)):
        drive.start_frame(np.array([4]), time_s)
        mean = drive.add(
            np.zeros(1, np.int64),
            None,
            np.zeros((1, 1)),
            np.array([log_size]),
            np.array([variance]),
        )
    assert mean[0] == pytest.approx(0.2 * 100 / (100 + 25 * np.exp(-1.0)))


def test_a_parked_car_that_is_passed_in_a_turn_keeps_its_size():
    """Exact boxes of a cuboid of usual size: yaw and bearing change, and the aspect ratio with them."""
    n, one, car = 40, np.ones(1), np.array([SIZE_CLASSES.index("car")])
    yaw, bearing = np.radians(np.linspace(0, 40, n)), np.linspace(0.1, 0.7, n)
    distance_m = np.linspace(20, 10, n)
    box = box_of_cuboid(
        np.log([1.5, 1.65, 4.1]),
        yaw_rad=yaw,
        bearing=bearing,
        distance_m=distance_m,
        camera_height_m=1.65,
    )
    size = np.exp(np.stack([box.log_width, box.log_height], axis=1))
    drive, with_state, without = DriveState(), [], []
    for k in range(n):
        boxes = BoxExtents(
            size[k : k + 1],
            bearing[k] * one,
            0 * one,
            car,
            one > 0,
            one < 0,
            np.full((1, 2), 1e-4),
            np.zeros((1, 2)),
        )
        drive.start_frame(np.array([1]), 0.1 * k)
        with_state.append(np.log(PACKAGED.measure(boxes, drive).distance_m[0] / distance_m[k]))
        without.append(np.log(PACKAGED.measure(boxes).distance_m[0] / distance_m[k]))
    assert 0.25 * np.std(without) < np.std(with_state) < 0.55 * np.std(without)


def test_cut_and_covered_boxes_have_a_larger_sigma():
    boxes = np.array([[10.0, 10, 50, 40], [10, 20, 50, 60], [200, 10, 240, 40], [300, 10, 340, 40]])
    sigma = incomplete_sigma(boxes, np.array([False, False, True, False]))
    np.testing.assert_allclose(sigma, [0.06 * 2 / 3, 0.0, 0.085, 0.0])
    assert incomplete_sigma(np.zeros((0, 4)), np.zeros(0, np.bool_)).shape == (0,)


def test_unusual_shapes_have_a_larger_sigma():
    """A box of a car that is three times as high as wide: a pole, or the part of a car beside
    it."""
    ones = np.ones(2)
    size = np.array([[1.7 / 30, 1.5 / 30], [0.5 / 30, 1.5 / 30]])
    boxes = BoxExtents(
        size, 0 * ones, 0 * ones, np.full(2, 2), ones > 0, ones < 0, np.full((2, 2), 1e-3), 0 * size
    )
    usual, unusual = PACKAGED.measure(boxes).sigma_m / PACKAGED.measure(boxes).distance_m
    assert unusual > 1.5 * usual
