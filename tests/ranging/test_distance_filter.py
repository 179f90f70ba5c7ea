from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter
from hypothesis import given, settings, strategies as st

from track_range.ranging.filtering.distance_filter import DistanceFilters, FilterSettings
from track_range.ranging.filtering.observation import Observation
from track_range.ranging.measurement.ranges import Ranges
from track_range.stereo.odometry.ego_motion import EgoMotion


class OneFilter:
    """Filter of a single method."""

    def __init__(self, noise_share=0.6, **settings):
        self.filters = DistanceFilters({"a": noise_share}, FilterSettings(**settings))

    @property
    def noise_share(self):
        return self.filters.noise_shares["a"]

    def update(
        self,
        measured,
        time_s,
        *,
        condition=None,
        ego_speed_mps=np.nan,
        ego_sigma_mps=np.nan,
        **observed,
    ):
        conditions = {} if condition is None else {"a": condition}
        return self.filters.update(
            {"a": measured},
            time_s,
            observation=Observation(conditions=conditions, **observed),
            ego=EgoMotion(ego_speed_mps, ego_sigma_mps),
        )["a"]


def measured(ids, distance_m, sigma_m=1.0):
    distance_m = np.array(distance_m, float)
    return Ranges(np.array(ids), distance_m, np.where(np.isnan(distance_m), np.nan, sigma_m))


def test_equals_filterpy_with_uneven_steps():
    rng = np.random.default_rng(1)
    actual = OneFilter(noise_share=1.0, outlier_sigma=np.inf, learns_noise=False)
    oracle = ExtendedKalmanFilter(dim_x=2, dim_z=1)
    time_s = np.cumsum(rng.uniform(0.03, 0.3, 40))
    for i, t in enumerate(time_s):
        z = 90 - 8 * t + rng.normal()
        result = actual.update(measured([7], [z]), t)
        oracle.R = np.array([[1 / z**2]])
        if i == 0:
            oracle.x, oracle.P = np.array([[z], [0.0]]), np.diag([1.0, 144.0])
        else:
            dt = t - time_s[i - 1]
            oracle.F = np.array([[1, dt], [0, 1]])
            oracle.Q = 1.5**2 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
            oracle.predict()
            oracle.update(
                np.array([[np.log(z)]]),
                lambda x: np.array([[1 / x[0, 0], 0]]),
                lambda x: np.log(x[:1]),
            )
        assert result.ranges.distance_m[0] == pytest.approx(oracle.x[0, 0])
        assert result.ranges.sigma_m[0] == pytest.approx(np.sqrt(oracle.P[0, 0]))
    assert result.rate_mps[0] == pytest.approx(oracle.x[1, 0])
    assert result.rate_sigma_mps[0] == pytest.approx(np.sqrt(oracle.P[1, 1]))
    assert result.rate_mps[0] == pytest.approx(-8, abs=1.5)


def simulated(rng, *, n, steps, dt=0.1):
    """Distances and rates (steps, n) of targets with speeds that follow the motion model of the
    filter."""
    distance, rate = rng.uniform(80, 120, n), rng.normal(0, 8, n)
    for _ in range(steps):
        kick = rng.normal(0, 1.5 * np.sqrt(dt), n)
        distance, rate = distance + rate * dt + kick * dt / 2, rate + kick
        yield distance, rate


def test_errors_are_consistent_with_the_covariance():
    rng = np.random.default_rng(2)
    tracker = OneFilter(noise_share=1.0, learns_noise=False, max_rate_sigma_mps=9.0)
    of_distance, of_rate = [], []
    for step, (distance, rate) in enumerate(simulated(rng, n=300, steps=40)):
        result = tracker.update(
            measured(np.arange(300), distance + rng.normal(0, 0.5, 300), 0.5), step * 0.1
        )
        if step > 20:
            of_distance.append(((result.ranges.distance_m - distance) / result.ranges.sigma_m) ** 2)
            of_rate.append(((result.rate_mps - rate) / result.rate_sigma_mps) ** 2)
    # normalised squared error of a one-dimensional estimate
    assert 0.85 < np.mean(of_distance) < 1.15
    assert 0.85 < np.mean(of_rate) < 1.15


@pytest.mark.parametrize("true_sigma_m", [0.2, 0.5, 1.5])
def test_noise_scale_is_learnt(true_sigma_m):
    rng = np.random.default_rng(3)
    tracker = OneFilter()
    for step, (distance, _) in enumerate(simulated(rng, n=40, steps=60)):
        tracker.update(
            measured(np.arange(40), distance + rng.normal(0, true_sigma_m, 40), 1.0), step * 0.1
        )
    assert tracker.noise_share == pytest.approx(true_sigma_m, rel=0.25)


def test_box_jitter_does_not_bias_the_distance():
    """A height of 20 px with a jitter of 3 px: a filter in metres would be biased by 7 % of the
    distance."""
    rng = np.random.default_rng(4)
    tracker, ids, last = OneFilter(), np.arange(200), []
    for step in range(60):
        height_px = 20 + rng.normal(0, 3, 200)
        distance_m = 1000 / height_px
        result = tracker.update(measured(ids, distance_m, distance_m * 3 / height_px), step * 0.1)
        last.append(result.ranges.distance_m)
    assert np.mean(last[30:]) == pytest.approx(50.0, rel=0.04)


def test_ego_braking_is_not_target_motion():
    """A parked car 40 m ahead, while the ego vehicle brakes from 15 m/s at 8 m/s^2."""
    errors = {}
    for name in ("known", "unknown"):
        tracker, distance_m = OneFilter(max_rate_sigma_mps=9.0), 40.0
        for step in range(18):
            speed_mps = 15.0 - 0.8 * max(step - 6, 0)
            result = tracker.update(
                measured([1], [distance_m], 0.4),
                step * 0.1,
                ego_speed_mps=speed_mps if name == "known" else np.nan,
            )
            distance_m -= (speed_mps + max(15.0 - 0.8 * max(step - 5, 0), 0)) / 2 * 0.1
        errors[name] = abs(result.rate_mps[0] + speed_mps)
    assert errors["known"] < 0.1 < 1.0 < errors["unknown"]


def test_ego_sigma_widens_the_rate_sigma():
    """With a noisy ego speed, errors of the rate agree with its sigma only if the filter gets the
    ego sigma."""
    ratio = {}
    for ego_sigma_mps in (np.nan, 2.0):
        rng, errors2 = np.random.default_rng(5), []
        for _ in range(12):
            tracker, ego_error_mps = (
                OneFilter(noise_share=1.0, learns_noise=False, max_rate_sigma_mps=9.0),
                0.0,
            )
            for step, (distance, rate) in enumerate(simulated(rng, n=5, steps=30)):
                ego_error_mps = (
                    np.exp(-0.1) * ego_error_mps + 2.0 * np.sqrt(-np.expm1(-0.2)) * rng.normal()
                )
                result = tracker.update(
                    measured(np.arange(5), distance + rng.normal(0, 0.5, 5), 0.5),
                    step * 0.1,
                    ego_speed_mps=10.0 + ego_error_mps,
                    ego_sigma_mps=ego_sigma_mps,
                )
                if step > 15:
                    errors2.append(((result.rate_mps - rate) / result.rate_sigma_mps) ** 2)
        ratio[ego_sigma_mps] = np.mean(errors2)
    assert ratio[2.0] < 1.2 < 1.5 < ratio[np.nan]


def test_constant_ego_speed_needs_no_sigma():
    results = []
    for ego_sigma_mps in (np.nan, 1.0):
        tracker = OneFilter(max_rate_sigma_mps=9.0)
        for step in range(10):
            result = tracker.update(
                measured([1], [40.0 - step], 0.4),
                step * 0.1,
                ego_speed_mps=10.0,
                ego_sigma_mps=ego_sigma_mps,
                may_be_static=np.array([False]),  # a static object has the sigma of the ego speed
            )
        results.append(np.array([*result.state.columns, result.rate_mps, result.rate_sigma_mps]))
    assert np.array_equal(results[0], results[1])


def test_new_track_starts_as_a_static_target():
    tracker, moves = (
        OneFilter(min_steady_s=0.0, max_rate_sigma_mps=99.0),
        {"may_be_static": np.array([False])},
    )
    assert tracker.update(measured([1], [40.0]), 0.0, ego_speed_mps=12.0).rate_mps == [-12.0]
    unknown_ego = tracker.update(measured([1, 2], [np.nan, 30.0]), 0.1)
    assert unknown_ego.rate_mps == pytest.approx([-12.0, 0.0])
    # a change while unknown is not braking, of objects that are not static
    again = tracker.update(measured([1], [np.nan]), 0.2, ego_speed_mps=5.0, **moves)
    assert (again.rate_mps[0], again.ranges.distance_m[0]) == pytest.approx((-12.0, 37.6))


def test_ttc_sigma_is_consistent_and_without_size_error():
    """A constant size error of 20 %: distance and speed have the same relative error, the time has
    none."""
    rng = np.random.default_rng(5)
    tracker, ids, off = OneFilter(noise_share=0.1, max_rate_sigma_mps=9.0), np.arange(300), 1.2
    for step in range(20):
        true_m = 60 - 12 * step * 0.1
        noise = rng.normal(0, 0.02, 300)
        result = tracker.update(
            measured(ids, off * true_m * np.exp(noise), 0.2 * true_m), step * 0.1
        )
    in_sigmas = (result.ttc_s - true_m / 12) / result.ttc_sigma_s
    assert abs(np.mean(in_sigmas)) < 0.3
    assert 0.5 < np.std(in_sigmas) < 1.2
    assert np.median(result.rate_mps) == pytest.approx(-14.4, rel=0.03)
    # sigma includes the size error
    assert np.mean(np.abs(result.rate_mps + 12) < 2 * result.rate_sigma_mps) > 0.9


def test_tracks_come_go_and_survive_short_gaps():
    tracker = OneFilter()
    for step in range(10):
        tracker.update(measured([1, 2], [30 - step, 50.0]), step * 0.1)
    assert len(tracker.update(measured([], []), 1.0).rate_mps) == 0
    back = tracker.update(measured([3, 1], [10.0, np.nan]), 1.3)
    assert back.ranges.distance_m[0] == pytest.approx(10.0)
    # 10 m/s closing, 4 steps after 21 m
    assert back.ranges.distance_m[1] == pytest.approx(17, abs=1.5)
    gone = tracker.update(measured([1], [np.nan]), 2.5)
    assert np.isnan(gone.ranges.distance_m).all()
    assert np.isnan(gone.ranges.sigma_m).all()


def test_single_outlier_has_little_effect():
    tracker = OneFilter()
    for step in range(20):
        tracker.update(measured([1], [30.0]), step * 0.1)
    assert tracker.update(measured([1], [60.0]), 2.0).ranges.distance_m[0] == pytest.approx(
        30, abs=2
    )


def test_three_outliers_restart_the_filter():
    tracker = OneFilter()
    for step in range(20):
        tracker.update(measured([1], [15.0]), step * 0.1)
    moved = [
        tracker.update(measured([1], [60.0]), 2.0 + step * 0.1).ranges.distance_m[0]
        for step in range(4)
    ]
    assert max(moved[:2]) < 20
    assert moved[2:] == pytest.approx([60.0, 60.0])


def test_two_outliers_do_not_restart_the_filter():
    tracker = OneFilter()
    for step in range(30):
        tracker.update(measured([1], [50 - step]), step * 0.1)
    for step, distance_m in ((30, 60.0), (31, 60.0), (32, 18.0), (33, 60.0), (34, 16.0)):
        result = tracker.update(measured([1], [distance_m]), step * 0.1)
    assert result.rate_mps[0] == pytest.approx(-10, abs=2.5)


def test_step_at_a_change_of_condition_is_not_speed():
    """6.6 m by mono, then 4.4 m by stereo, without motion."""
    rates = {}
    for name, numbers in (("given", (0, 1)), ("not given", (0, 0))):
        tracker = OneFilter()
        for step in range(16):
            number, distance_m = (numbers[0], 6.6) if step < 8 else (numbers[1], 4.4)
            result = tracker.update(
                measured([1], [distance_m], 0.6), step * 0.1, condition=np.array([number])
            )
            rates.setdefault(name, []).append(abs(result.rate_mps[0]))
    assert np.nanmax(rates["given"]) < 0.5 < 2.0 < np.nanmax(rates["not given"])
    assert np.isnan(rates["given"][8:11]).all()  # no rate for a third of a second
    assert np.isfinite(rates["given"][12:]).all()


def test_systematic_sigma_does_not_average_out():
    rng, ids = np.random.default_rng(10), np.arange(50)
    tracker = OneFilter(noise_share=0.6)
    for step in range(50):
        result = tracker.update(measured(ids, 30.0 + rng.normal(0, 1.2, 50), 2.0), step * 0.1)
    assert 0.8 * 2.0 < np.mean(result.ranges.sigma_m) < 0.9 * 2.0


def test_systematic_sigma_per_box():
    """Sigma 2 with a systematic part of sqrt(3) has a noise share of one half; the other track has
    noise only."""
    rng, ids = np.random.default_rng(11), np.array([1, 2])
    per_box = OneFilter(noise_share=0.9, learns_noise=False)
    half, whole = (OneFilter(noise_share=fraction, learns_noise=False) for fraction in (0.5, 1.0))
    for step in range(20):
        now = measured(ids, 30.0 + rng.normal(0, 1.0, 2), 2.0)
        result = per_box.update(
            replace(now, sigma_systematic_m=np.array([np.sqrt(3.0), 0.0])), step * 0.1
        ).ranges
        expected = [filters.update(now, step * 0.1).ranges for filters in (half, whole)]
        for k in (0, 1):
            assert result.distance_m[k] == pytest.approx(expected[k].distance_m[k])
            assert result.sigma_m[k] == pytest.approx(expected[k].sigma_m[k])
    assert result.sigma_m[0] > 1.05 * result.sigma_m[1]


def test_zero_independent_sigma_is_still_filtered():
    tracker = OneFilter()
    for step in range(3):  # the first two at the same time
        now = replace(measured([1], [30.0], 2.0), sigma_systematic_m=np.array([2.0]))
        result = tracker.update(now, max(step - 1, 0) * 0.1).ranges
    assert result.distance_m == pytest.approx([30.0])
    assert result.sigma_m == pytest.approx([2.0], rel=0.02)


def test_sigma_without_observed_noise_is_systematic():
    tracker = OneFilter(noise_share=0.6)
    for step in range(200):
        result = tracker.update(measured([1], [30.0], 2.0), step * 0.1)
    assert result.ranges.sigma_m[0] == pytest.approx(2.0, rel=0.05)


def test_filters_have_separate_state():
    first, second = OneFilter(), OneFilter()
    first.update(measured([1], [30.0]), 0.0)
    assert np.isnan(second.update(measured([1], [np.nan]), 0.1).ranges.distance_m).all()


def test_methods_are_filtered_independently():
    """Measurements, noise and condition of one method do not affect the other methods."""
    rng, fractions = np.random.default_rng(12), {"a": 0.6, "b": 0.3, "c": 0.35}
    together, alone = (
        DistanceFilters(fractions),
        {n: OneFilter(noise_share=s) for n, s in fractions.items()},
    )
    ids, last = np.arange(6), {}
    for step in range(40):
        present = rng.permutation(ids)[: 5 if step % 3 else 4]
        by_method = {
            name: measured(
                present,
                np.where(
                    rng.random(len(present)) < 0.2, np.nan, (30 + present) * rng.normal(1.0, 0.05)
                ),
            )
            for name in fractions
        }
        by_method["b"] = replace(by_method["b"], sigma_systematic_m=0.8 * by_method["b"].sigma_m)
        condition = rng.integers(0, 2, len(present))
        result = together.update(
            {**by_method, "other": by_method["a"]},
            step * 0.1,
            observation=Observation(conditions={"c": condition}),
            ego=EgoMotion(3.0),
        )
        assert list(result) == ["a", "b", "c"]
        for name, tracker in alone.items():
            last[name] = tracker.update(
                by_method[name],
                step * 0.1,
                condition=condition if name == "c" else None,
                ego_speed_mps=3.0,
            )
            for actual, separate in (
                (result[name].ranges.distance_m, last[name].ranges.distance_m),
                (result[name].ranges.sigma_m, last[name].ranges.sigma_m),
                (result[name].rate_mps, last[name].rate_mps),
                (result[name].ttc_sigma_s, last[name].ttc_sigma_s),
            ):
                assert actual == pytest.approx(separate, nan_ok=True)
    assert together.noise_shares == pytest.approx(
        {name: tracker.noise_share for name, tracker in alone.items()}
    )
    assert len(set(together.noise_shares.values())) == 3


@pytest.mark.parametrize("is_told", [True, False])
def test_step_to_a_hidden_box_is_not_motion(is_told):
    """A standing target whose distance steps by 8 % when a nearer box hides a part of it."""
    tracker, rates = OneFilter(noise_share=0.3), []
    for step in range(30 if is_told else 36):  # an apparent motion is followed slowly
        is_hidden = np.array([step >= 15])
        z = 30.0 * (1.08 if is_hidden[0] else 1.0)
        options = {"is_hidden": is_hidden} if is_told else {}
        options["may_be_static"] = np.array([False])  # otherwise it is static in spite of the step
        result = tracker.update(
            measured([1], [z], sigma_m=0.08 * z), step * 0.1, ego_speed_mps=0.0, **options
        )
        rates.append(result.rate_mps[0])
    assert np.isfinite(rates[10:]).all()  # it is known all the time
    largest = np.abs(rates[15:]).max()
    assert 0.02 < largest < 0.3 if is_told else 0.8 < largest < 3
    assert result.ranges.distance_m[0] == pytest.approx(30.0 * 1.08, rel=0.01)


def test_missing_method_has_measured_nothing():
    tracker = DistanceFilters({"a": 0.6, "b": 0.6})
    assert tracker.update({}, 0.0) == {}
    for step in range(10):
        tracker.update(
            {"a": measured([1], [40.0 - step]), "b": measured([1], [40.0 - step])}, step * 0.1
        )
    assert list(tracker.update({"a": measured([1], [30.0])}, 1.0)) == ["a"]
    carried_on = tracker.update({"a": measured([1], [29.0]), "b": measured([1], [np.nan])}, 1.1)[
        "b"
    ]
    assert carried_on.ranges.distance_m == pytest.approx([29.0], abs=0.3)


@settings(deadline=None)
@given(
    st.lists(st.one_of(st.just(np.nan), st.floats(0.1, 500)), min_size=1, max_size=12),
    st.floats(-40, 40),
)
def test_any_input_gives_positive_distances_and_sigmas(distances_m, ego_mps):
    tracker = OneFilter()
    for step, distance_m in enumerate(distances_m):
        result = tracker.update(measured([1], [distance_m]), step * 0.1, ego_speed_mps=ego_mps)
        is_known = np.isfinite(result.ranges.distance_m)
        assert (result.ranges.distance_m[is_known] > 0).all()
        assert (result.ranges.sigma_m[is_known] > 0).all()
        assert np.isfinite(result.rate_sigma_mps[np.isfinite(result.rate_mps)]).all()
        assert is_known[0] or np.isnan(distance_m)


def test_times_to_collision_do_not_depend_on_the_focal_length():
    """A focal length that is wrong by a factor stretches all distances and their sigmas. The rate of
    a far car is then too uncertain to be reported in m/s, but its time to collision is as known.
    Only the prior of the speed, which a new track has for some frames, is in m/s."""
    noise = np.random.default_rng(3).normal(size=25)
    times_s = {}
    for factor in (1.0, 1.7):
        filters, times_s[factor] = OneFilter(), []
        for k in range(25):
            true_m = 90.0 - 2.0 * k
            z, sigma_m = factor * (true_m + 1.2 * noise[k]), 2.0 * factor
            result = filters.update(measured([1], [z], sigma_m), 0.1 * k)
            is_known = result.ttc_sigma_s[0] <= 0.5 * result.ttc_s[0]
            times_s[factor].append(result.ttc_s[0] if is_known else np.nan)
    usual, stretched = np.array(times_s[1.0]), np.array(times_s[1.7])
    is_known = np.isfinite(usual) & np.isfinite(stretched)
    assert (np.isfinite(usual) == np.isfinite(stretched)).mean() > 0.9
    assert is_known.sum() > 12
    np.testing.assert_allclose(stretched[is_known], usual[is_known], rtol=0.2)
    np.testing.assert_allclose(stretched[8:], usual[8:], rtol=0.05)
