"""Distances by size priors: calibration of sigma on samples of the priors, and the effect of the
ground plane."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st

from track_range.ranging.size_models.cuboid import box_of_cuboid
from track_range.ranging.size_models.cuboid_sizes import CuboidSizes
from track_range.ranging.size_models.curve import load_curves
from track_range.ranging.size_models.prior import YAW_DEG
from track_range.ranging.size_models.shared_ground import (
    GroundContacts,
    GroundPrior,
    ground_from_others,
)
from track_range.ranging.size_models.size_model import SIZE_CLASSES, BoxExtents

PACKAGED = load_curves()
NOISE = 1.5 / 720


def world(name, n, *, seed, noise=NOISE, on_ground=True):
    """Boxes with edge noise of objects drawn from the packaged prior of a class, and their
    distances."""
    rng, prior = np.random.default_rng(seed), PACKAGED.priors[name]
    fraction, bodies = zip(*prior.components, strict=True)
    drawn = np.stack(
        [rng.multivariate_normal(np.log(body.hwl_m), body.covariance, n) for body in bodies]
    )
    log_hwl = drawn[
        rng.choice(len(bodies), n, p=np.array(fraction) / sum(fraction)), np.arange(n)
    ].T
    weights = np.array(prior.turn_weights) / sum(prior.turn_weights)
    yaw = np.radians(rng.choice(YAW_DEG, n, p=weights)) * rng.choice([-1, 1], n)
    bearing, distance_m = rng.uniform(-0.4, 0.4, n), np.exp(rng.uniform(np.log(10), np.log(70), n))
    box = box_of_cuboid(
        log_hwl, yaw_rad=yaw, bearing=bearing, distance_m=distance_m, camera_height_m=1.65
    )
    size = np.exp(np.stack([box.log_width, box.log_height], axis=1) + np.array(prior.offset)[::-1])
    size = np.maximum(
        size * np.exp(rng.normal(0, np.array(prior.scatter)[::-1], (n, 2)))
        + rng.normal(0, np.sqrt(2) * noise, (n, 2)),
        1e-3,
    )
    boxes = BoxExtents(
        wh_over_f=size,
        bearing=bearing,
        bottom=0.01 + 1.65 * np.exp(box.log_inverse_depth) + rng.normal(0, 0.1, n) / distance_m,
        size_class=np.full(n, SIZE_CLASSES.index(name)),
        uses_width=np.ones(n, np.bool_),
        uses_bottom=np.full(n, on_ground),
        edge_sigma=np.full((n, 2), noise),
        systematic_sigma=np.zeros((n, 2)),
    )
    return boxes, distance_m


@pytest.mark.parametrize("name", ["car", "van", "person", "bicycle", "truck"])
def test_sigma_is_calibrated_for_the_prior(name):
    boxes, distance_m = world(name, 1500, seed=4, on_ground=False)
    result = PACKAGED.measure(boxes)
    off = np.abs(result.distance_m - distance_m) / result.sigma_m
    assert 0.60 < (off < 1).mean() < 0.84
    assert (off < 2).mean() > 0.92
    assert (result.sigma_systematic_m <= result.sigma_m).all()


def test_common_ground_reduces_the_error():
    """Eight cars on ones road with an unknown horizon, measured together and separately."""
    together, alone = [], []
    for seed in range(60):
        boxes, distance_m = world("car", 8, seed=seed)
        one_by_one = np.concatenate(
            [PACKAGED.measure(boxes.select(np.array([k]))).distance_m for k in range(8)]
        )
        together.append(np.abs(PACKAGED.measure(boxes).distance_m / distance_m - 1).mean())
        alone.append(np.abs(one_by_one / distance_m - 1).mean())
    assert np.mean(together) < 0.93 * np.mean(alone)
    assert np.mean(together) > 0.02  # the sizes are still unknown


def test_width_adds_information():
    """Two boxes of the same height and different widths have different distances."""
    ones = np.ones(2)
    sizes = np.stack([np.array([1.60, 1.80]) / 30, 1.5 / 30 * ones], axis=1)
    boxes = BoxExtents(
        sizes,
        0 * ones,
        0 * ones,
        np.full(2, 2),
        ones > 0,
        ones < 0,
        np.full((2, 2), 1e-4),
        0 * sizes,
    )
    narrow, wide = CuboidSizes({"car": PACKAGED.priors["car"]}).measure(boxes).distance_m
    assert wide < narrow - 0.5 or wide > narrow + 0.5
    assert 27 < min(narrow, wide) < max(narrow, wide) < 34


def test_ground_distinguishes_car_and_van():
    """A box of a van, detected as a car: its bottom edge on the road of the others gives a larger
    distance."""
    boxes, _ = world("car", 9, seed=1, noise=0.3 / 720)
    van_m = 30.0
    size, bottom = boxes.wh_over_f.copy(), boxes.bottom.copy()
    size[0], bottom[0] = np.array([2.5, 2.3]) / van_m, 0.01 + 1.65 / van_m
    van = replace(boxes, wh_over_f=size, bottom=bottom)
    on_ground = PACKAGED.measure(van).distance_m[0]
    by_size = PACKAGED.measure(van.select(np.array([0]))).distance_m[0]
    assert by_size < 0.75 * van_m
    assert on_ground > 1.01 * by_size


def test_errors_of_a_detector_are_systematic():
    boxes, _ = world("car", 200, seed=3)
    exact, unknown = (
        PACKAGED.measure(replace(boxes, systematic_sigma=np.full((200, 2), sigma)))
        for sigma in (0.0, 0.06)
    )
    variance = [np.median((r.sigma_m / r.distance_m) ** 2) for r in (exact, unknown)]
    systematic = [np.median((r.sigma_systematic_m / r.distance_m) ** 2) for r in (exact, unknown)]
    # limited by the ground plane and the width of the box
    assert 0.03**2 < variance[1] - variance[0] < 0.06**2
    assert variance[1] - systematic[1] == pytest.approx(variance[0] - systematic[0], rel=0.1)


@given(st.integers(0, 200), st.permutations(range(6)))
@settings(deadline=None, max_examples=25)
def test_order_of_boxes_does_not_matter(seed, order):
    boxes, _ = world("car", 6, seed=seed)
    order = np.array(order)
    result, turned = PACKAGED.measure(boxes), PACKAGED.measure(boxes.select(order))
    np.testing.assert_allclose(turned.distance_m, result.distance_m[order], rtol=1e-9)
    np.testing.assert_allclose(turned.sigma_m, result.sigma_m[order], rtol=1e-9)


# Classes whose most probable view or body type changes with the size at a constant aspect ratio:
# near, a box of a pickup seen from the side is one of a larger truck seen from ahead.
SEVERAL_VIEWS = ("bus", "van", "truck")


def with_aspect_of_class(name, height, side, bearing, noise):
    """Boxes (N,) of heights / f whose aspect ratios are those of the class, from its front (side 0)
    to its side (1)."""
    high, wide, long = PACKAGED.priors[name].hwl_m
    aspect = np.exp(
        (1 - side) * np.log(min(wide, long) / high) + side * np.log(max(wide, long) / high)
    )
    edge_sigma = (noise * np.minimum(1.0, aspect) * height)[:, None] * np.ones(2)
    sizes, class_id = (
        np.stack([aspect * height, height], axis=1),
        np.full(len(height), SIZE_CLASSES.index(name)),
    )
    no, yes = np.zeros(len(height), np.bool_), np.ones(len(height), np.bool_)
    return BoxExtents(
        sizes, bearing, np.zeros(len(height)), class_id, yes, no, edge_sigma, 0 * sizes
    )


@given(
    st.sampled_from([name for name in SIZE_CLASSES if name not in SEVERAL_VIEWS]),
    st.floats(1e-4, 0.4),
    st.floats(0.0, 1.0),
    st.floats(1.1, 3.0),
    st.floats(-0.7, 0.7),
    st.floats(0.0, 0.06),
)
@settings(deadline=None)
def test_distance_decreases_with_box_size(name, height, side, ratio, bearing, noise):
    """For boxes with aspect ratios of the class, within 35 degrees of the axis; farther off, nodes
    differ by 0.2 %."""
    heights, ones = np.array([height, height * ratio]), np.ones(2)
    noise = noise / np.array([1.0, ratio])  # the same edges' noise for both boxes
    result = PACKAGED.measure(
        with_aspect_of_class(name, heights, side * ones, bearing * ones, noise)
    )
    assert np.isfinite(result.sigma_m).all()
    assert 0 < result.distance_m[1] < result.distance_m[0]


@given(
    st.sampled_from(SEVERAL_VIEWS),
    st.floats(1e-4, 0.4),
    st.floats(0.0, 1.0),
    st.floats(1.1, 3.0),
    st.floats(-0.7, 0.7),
    st.floats(0.0, 0.06),
)
@example("truck", 0.375, 0.4375, 1.5, 0.3125, 0.0)  # 5.5 +- 2.2 m, then 6.4 +- 2.1 m
@settings(deadline=None)
def test_sigma_covers_an_increase_where_the_view_changes(name, height, side, ratio, bearing, noise):
    heights, ones = np.array([height, height * ratio]), np.ones(2)
    noise = noise / np.array([1.0, ratio])
    result = PACKAGED.measure(
        with_aspect_of_class(name, heights, side * ones, bearing * ones, noise)
    )
    increase_m = result.distance_m[1] - result.distance_m[0]
    assert increase_m < 0.8 * np.hypot(*result.sigma_m)  # at most 0.5 of 40,000 random pairs


@pytest.mark.parametrize(
    ("name", "most", "most_increase"),
    [("bus", 4, 0.11), ("van", 75, 0.2), ("truck", 175, 0.27)],
)
def test_distance_increases_rarely_where_the_view_changes(name, most, most_increase):
    """Of 10,000 pairs of exact boxes that differ by 10 to 30 %: noise makes the change of the view
    smoother."""
    rng, n = np.random.default_rng(5), 10_000
    height, side, bearing = (
        rng.uniform(1e-4, 0.4, n),
        rng.uniform(0, 1, n),
        rng.uniform(-0.7, 0.7, n),
    )
    ratio, noise = rng.uniform(1.1, 1.3, n), np.zeros(n)
    small = PACKAGED.measure(with_aspect_of_class(name, height, side, bearing, noise)).distance_m
    large = PACKAGED.measure(
        with_aspect_of_class(name, height * ratio, side, bearing, noise)
    ).distance_m
    is_larger = large >= small
    assert np.count_nonzero(is_larger) <= most
    assert (large / small).max() < 1 + most_increase


@given(
    st.sampled_from(SIZE_CLASSES),
    st.floats(1e-5, 50.0),
    st.floats(0.01, 100.0),
    st.floats(-5, 5),
    st.floats(-2, 2),
    st.floats(0.0, 3.0),
)
@settings(deadline=None)
def test_any_box_has_a_positive_distance_and_sigma(name, height, aspect, bearing, bottom, noise):
    ones = np.ones(1)
    boxes = BoxExtents(
        np.array([[aspect * height, height]]),
        bearing * ones,
        bottom * ones,
        np.full(1, SIZE_CLASSES.index(name)),
        ones > 0,
        ones > 0,
        np.full((1, 2), noise * height),
        np.zeros((1, 2)),
    )
    result = PACKAGED.measure(boxes)
    assert 0 < result.distance_m[0] < np.inf
    assert 0 < result.sigma_systematic_m[0] <= result.sigma_m[0] < np.inf


def test_class_without_a_prior_is_not_measured():
    boxes, _ = world("car", 3, seed=0)
    assert np.isnan(
        CuboidSizes({"person": PACKAGED.priors["person"]}).measure(boxes).distance_m
    ).all()


class TestSharedGround:
    """Ground plane estimated from the other objects."""

    inverse_depth = 1 / np.array([8.0, 15.0, 25.0, 40.0, 60.0, 70.0])

    def contacts(self, bottom, is_on_ground=True):
        n = len(bottom)
        zeros, is_on_ground = np.zeros(n), np.full(n, is_on_ground)
        return GroundContacts(
            bottom, zeros, self.inverse_depth[:n], np.full(n, 0.05), np.full(n, 0.001), is_on_ground
        )

    def test_exact_objects_give_horizon_and_height(self):
        ground = ground_from_others(
            self.contacts(0.02 + 1.8 * self.inverse_depth), GroundPrior(camera_height_m=1.8)
        )
        np.testing.assert_allclose(ground.horizon, 0.02, atol=0.002)
        np.testing.assert_allclose(ground.height_m, 1.8, atol=0.05)
        assert not ground.is_prior_only.any()

    def test_a_bent_road_leaves_the_plane(self):
        """By 1.5e-4 / m z^2 / 2 = 0.48 m at 80 m; a cross slope of 0.05 by 0.01 m at 0.2 m aside."""
        inverse_depth, bearing = np.array([1 / 80, 1.0]), np.array([0.0, 0.2])
        sigma_m = np.sqrt(GroundPrior().rough_variance(inverse_depth, bearing)) / inverse_depth
        np.testing.assert_allclose(sigma_m, [0.48, 0.01], rtol=1e-3)

    def test_own_measurement_is_excluded(self):
        bottom = 0.02 + 1.5 * self.inverse_depth
        moved = bottom.copy()
        moved[5] += 0.004
        first, other = (
            ground_from_others(self.contacts(bottom), GroundPrior()),
            ground_from_others(self.contacts(moved), GroundPrior()),
        )
        assert other.horizon[5] == pytest.approx(first.horizon[5], abs=2e-4)
        assert other.horizon[0] > first.horizon[0] + 5e-4

    def test_outliers_are_down_weighted(self):
        bottom = -0.01 + 1.5 * self.inverse_depth
        bottom[5] += 0.2  # on a balcony, or a false alarm
        ground = ground_from_others(self.contacts(bottom), GroundPrior())
        np.testing.assert_allclose(ground.horizon[:5], -0.01, atol=0.006)

    def test_only_the_prior_without_other_objects(self):
        prior = GroundPrior(horizon=0.03, camera_height_m=1.4)
        for contacts in (
            self.contacts(np.array([0.2])),
            self.contacts(1.4 * self.inverse_depth, is_on_ground=False),
        ):
            ground = ground_from_others(contacts, prior)
            assert ground.is_prior_only.all()
            np.testing.assert_allclose(ground.horizon, 0.03)
            np.testing.assert_allclose(ground.height_m, 1.4)
