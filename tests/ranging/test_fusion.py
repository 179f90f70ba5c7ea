import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from track_range.ranging.fusion.fusion import Fusion, ScaleSource
from track_range.ranging.ranges import Ranges

ONE = np.array([1])
METHODS = ("mono", "ground", "lane", "stereo", "sgbm")


def ranges(distance_m, sigma_m):
    return Ranges(ONE, np.array([float(distance_m)]), np.array([float(sigma_m)]))


SILENT = ranges(np.nan, np.nan)


def alone(by_method):
    """A frame without a past."""
    return Fusion().fuse(by_method, ONE, 0.0)


def fused_m(fusion, step, **by_method):
    return float(fusion.fuse(by_method, ONE, step * 0.1).ranges.distance_m[0])


def test_inverse_variance_by_hand():
    found = alone({"mono": ranges(22.0, 2.2), "stereo": ranges(20.0, 1.0)}).ranges
    # In logarithms: sigmas of 0.1 and 0.05, weights 1 and 4.
    assert found.distance_m == pytest.approx([20 * np.exp(np.log(1.1) / 5)])
    assert found.sigma_m / found.distance_m == pytest.approx([np.sqrt(1 / 500)])


def test_one_method_is_left_as_it_is():
    for name in METHODS:
        found = alone({name: ranges(30.0, 3.0)}).ranges
        assert (found.distance_m[0], found.sigma_m[0]) == pytest.approx((30.0, 3.0))


def test_methods_that_share_an_edge_are_worth_less_than_two():
    together = alone({"mono": ranges(30.0, 3.0), "lane": ranges(30.0, 3.0)}).ranges.sigma_m[0]
    apart = alone({"mono": ranges(30.0, 3.0), "stereo": ranges(30.0, 3.0)}).ranges.sigma_m[0]
    assert apart == pytest.approx(3.0 / np.sqrt(2))
    # Correlation 0.4 of the 0.36 that is noise: variance (1 + 0.144) / 2.
    assert together == pytest.approx(3.0 * np.sqrt(0.572))


def test_contradiction_widens_sigma():
    agreed = alone({"mono": ranges(20.0, 1.0), "stereo": ranges(20.0, 1.0)}).ranges
    found = alone({"mono": ranges(40.0, 2.0), "stereo": ranges(20.0, 1.0)}).ranges
    assert found.distance_m == pytest.approx([np.sqrt(800)])
    chi2 = np.log(2) ** 2 / (2 * 0.05**2)
    assert (found.sigma_m / found.distance_m)[0] == pytest.approx(agreed.sigma_m[0] / 20 * np.sqrt(chi2))


def test_a_match_that_no_size_can_explain_is_left_out():
    found = alone({"mono": ranges(75.0, 6.0), "stereo": ranges(15.0, 0.3)})
    assert (found.ranges.distance_m[0], found.ranges.sigma_m[0]) == pytest.approx((75.0, 6.0))
    assert found.scale_source == [ScaleSource.ASSUMED]
    half_hidden = alone({"mono": ranges(30.0, 2.0), "stereo": ranges(15.0, 0.3)})
    assert half_hidden.ranges.distance_m[0] < 17


@pytest.mark.parametrize("foot", ["ground", "lane"])
def test_where_the_foot_stands_by_stereo_it_is_the_size_that_is_another_class(foot):
    """A car at 38 m that the detector takes for a truck: by its size at 98 m."""
    truck = {"mono": ranges(98.0, 13.0), "stereo": ranges(38.0, 0.6)}
    assert alone(truck).ranges.distance_m[0] == pytest.approx(98.0)
    found = alone(truck | {foot: ranges(45.0, 4.0)}).ranges
    assert (found.distance_m[0], found.sigma_m[0]) == pytest.approx((38.0, 0.6))
    assert alone(truck | {foot: ranges(90.0, 9.0)}).ranges.distance_m[0] == pytest.approx(98.0)
    assert alone(truck | {foot: ranges(60.0, 2.0)}).ranges.distance_m[0] == pytest.approx(98.0)  # for neither


def test_lines_of_another_lane_are_left_out_unless_the_foot_of_the_box_is_for_them():
    told = {"mono": ranges(17.0, 1.2), "lane": ranges(9.0, 0.3)}
    assert alone(told).ranges.distance_m[0] == pytest.approx(17.0)
    assert alone(told | {"ground": ranges(16.0, 2.0)}).ranges.distance_m[0] == pytest.approx(17.0)
    assert alone(told | {"ground": ranges(10.0, 1.0)}).ranges.distance_m[0] == pytest.approx(9.0)
    agreeing = alone(told | {"lane": ranges(15.5, 0.5)}).ranges.distance_m[0]
    assert 15.5 < agreeing < 16.0


@pytest.mark.parametrize("n_frames", [0, 1, 60])
def test_frames_without_a_measurement_are_forgotten_by_time_and_not_each_anew(n_frames):
    fusion = Fusion()
    for step in range(30):
        fusion.fuse({"mono": ranges(24.0, 2.4), "stereo": ranges(20.0, 0.2)}, ONE, step * 0.1)
    for time_s in np.linspace(2.9, 4.9, n_frames + 2)[1:-1]:
        fusion.fuse({"mono": SILENT}, ONE, time_s)
    assert fused_m(fusion, 49, mono=ranges(24.0, 2.4)) == pytest.approx(20.1, abs=0.2)


def test_dense_stands_in_for_patches_only_where_they_are_silent():
    dense = ranges(30.0, 1.0)
    for by_method, expected_m in (
        ({"stereo": SILENT, "sgbm": dense}, 30.0),
        ({"stereo": ranges(20.0, 1.0), "sgbm": dense}, 20.0),
        ({"sgbm": dense}, 30.0),
    ):
        assert alone(by_method).ranges.distance_m == pytest.approx([expected_m])
        assert alone(by_method).scale_source == [ScaleSource.REFERENCE]


def test_nobody_measured():
    for by_method in ({}, {"mono": SILENT}):
        found = alone(by_method)
        assert np.isnan(found.ranges.distance_m).all()
        assert np.isnan(found.ranges.sigma_m).all()
        assert found.scale_source == [ScaleSource.ASSUMED]
    assert len(Fusion().fuse({}, np.zeros(0, np.int64), 0.0).ranges) == 0


def test_stereo_teaches_mono_the_tracks_size_and_mono_carries_on():
    """A car 10 % smaller than its class: mono says 22 m for 20."""
    rng, fusion = np.random.default_rng(8), Fusion()
    errors = {True: [], False: []}
    for step in range(40):
        true_m = 30 - 0.3 * step
        mono_m = 1.1 * true_m * np.exp(rng.normal(0, 0.01))
        sees = step < 20
        stereo = ranges(true_m * np.exp(rng.normal(0, 0.003)), 0.01 * true_m) if sees else SILENT
        found = fusion.fuse({"mono": ranges(mono_m, 0.08 * mono_m), "stereo": stereo}, ONE, step * 0.1)
        errors[sees].append(found.ranges.distance_m[0] / true_m - 1)
        assert found.scale_source == [ScaleSource.REFERENCE]
    assert np.max(np.abs(errors[True][5:])) < 0.01
    assert np.mean(np.abs(errors[False])) < 0.025  # 10 % without having learnt
    assert 0.01 * 18.3 < found.ranges.sigma_m[0] < 0.07 * 18.3  # and it knows so, but not that stereo was that good


def test_what_stereo_taught_is_no_surer_than_stereo():
    fusion = Fusion()
    for step in range(200):
        fusion.fuse({"mono": ranges(20.0, 2.0), "stereo": ranges(20.0, 1.0)}, ONE, step * 0.1)
    found = fusion.fuse({"mono": ranges(20.0, 2.0)}, ONE, 20.0).ranges
    assert found.sigma_m[0] > 1.0


def test_mono_is_forgotten_to_be_taught_with_time_and_a_long_absence():
    fusion = Fusion()
    for step in range(30):
        fusion.fuse({"mono": ranges(22.0, 1.7), "stereo": ranges(20.0, 0.2)}, ONE, step * 0.1)
    assert fused_m(fusion, 31, mono=ranges(22.0, 1.7)) == pytest.approx(20.0, rel=0.03)
    nobody = np.zeros(0, np.int64)
    fusion.fuse({}, nobody, 4.0)
    fusion.fuse({}, nobody, 9.0)
    assert fused_m(fusion, 91, mono=ranges(22.0, 1.7)) == pytest.approx(22.0)


def test_one_wrong_match_of_a_well_known_track_is_left_out():
    fusion = Fusion()
    for step in range(10):
        fused_m(fusion, step, mono=ranges(41.0, 4.0), stereo=ranges(40.0, 1.0))
    assert fused_m(fusion, 10, mono=ranges(41.0, 4.0), stereo=ranges(20.0, 0.3)) == pytest.approx(40.0, rel=0.03)
    assert fused_m(fusion, 11, mono=ranges(41.0, 4.0), stereo=ranges(40.0, 1.0)) == pytest.approx(40.0, rel=0.02)


def test_a_box_cut_by_what_stands_before_it_is_left_out_too():
    fusion = Fusion()
    for step in range(10):
        fused_m(fusion, step, mono=ranges(21.0, 1.7), stereo=ranges(20.0, 0.3))
    assert fused_m(fusion, 10, mono=ranges(42.0, 3.4), stereo=ranges(20.0, 0.3)) == pytest.approx(20.0, rel=0.02)


def test_a_history_that_was_wrong_is_given_up():
    """Stereo matched what stands before the car for a second, and then the car."""
    fusion = Fusion()
    for step in range(10):
        fused_m(fusion, step, mono=ranges(40.0, 4.0), stereo=ranges(33.0, 0.7))
    later = [fused_m(fusion, step, mono=ranges(40.0, 4.0), stereo=ranges(60.0, 1.2)) for step in range(10, 22)]
    assert later[-1] == pytest.approx(60.0, rel=0.05)


def test_tracks_share_nothing_and_keep_their_order():
    two, fusion = np.array([5, 2]), Fusion()
    for step in range(20):
        mono = Ranges(two, np.array([22.0, 36.0]), np.array([1.8, 3.0]))
        fusion.fuse(
            {"mono": mono, "stereo": Ranges(two, np.array([20.0, 40.0]), np.array([0.2, 0.4]))}, two, step * 0.1
        )
    three = np.array([2, 7, 5])
    found = fusion.fuse({"mono": Ranges(three, np.array([36.0, 50.0, 22.0]), np.ones(3) * 2)}, three, 2.0).ranges
    assert found.track_id.tolist() == [2, 7, 5]
    assert found.distance_m == pytest.approx([40.0, 50.0, 20.0], rel=0.05)


@pytest.mark.parametrize(
    ("names", "shares", "shared"), [(("mono", "lane"), (0.6, 0.6), 0.4), (("mono", "stereo"), (0.6, 0.3), 0.0)]
)
def test_fused_is_the_least_squares_solution(names, shares, shared):
    """Against the joint normal equations of a frame: log d and the methods' biases."""
    sigma, log_m = np.array([0.1, 0.07]), np.log([31.0, 28.0])
    by_method = {n: ranges(np.exp(z), s * np.exp(z)) for n, z, s in zip(names, log_m, sigma, strict=True)}
    share = np.array(shares)
    noise = np.outer(share * sigma, share * sigma) * np.array([[1.0, shared], [shared, 1.0]])
    design = np.hstack([np.ones((2, 1)), np.diag(np.sqrt(1 - share**2) * sigma)])
    information = design.T @ np.linalg.inv(noise) @ design + np.diag([0, 1, 1])
    solution = np.linalg.solve(information, design.T @ np.linalg.inv(noise) @ log_m)
    found = alone(by_method).ranges
    assert np.log(found.distance_m[0]) == pytest.approx(solution[0])
    assert (found.sigma_m / found.distance_m)[0] == pytest.approx(np.sqrt(np.linalg.inv(information)[0, 0]))


@pytest.mark.parametrize(("silent", "heard"), [("ground", "mono"), ("lane", "stereo")])
def test_what_knows_no_more_counts_only_where_the_other_is_silent(silent, heard):
    both = alone({silent: ranges(20.0, 1.0), heard: ranges(24.0, 1.0)}).ranges
    assert both.distance_m[0] == pytest.approx(24.0)
    assert alone({silent: ranges(20.0, 1.0), heard: ranges(np.nan, np.nan)}).ranges.distance_m[0] == pytest.approx(20.0)


@settings(deadline=None)
@given(st.floats(20, 45), st.floats(20, 45), st.floats(0.1, 10), st.floats(0.1, 10))
def test_fused_lies_between_and_is_no_less_certain_than_agreement_allows(a, b, sigma_a, sigma_b):
    found = alone({"mono": ranges(a, sigma_a), "stereo": ranges(b, sigma_b)}).ranges
    assert min(a, b) - 1e-6 <= found.distance_m[0] <= max(a, b) + 1e-6
    relative = ((a / sigma_a) ** 2 + (b / sigma_b) ** 2) ** -0.5
    assert found.sigma_m[0] / found.distance_m[0] >= relative - 1e-9


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(*[st.one_of(st.none(), st.tuples(st.floats(1, 150), st.floats(0.005, 0.5)))] * 5),
        min_size=1,
        max_size=8,
    )
)
def test_whatever_is_measured_fused_is_finite_where_anybody_measured(frames):
    fusion = Fusion()
    for step, frame in enumerate(frames):
        by_method = {
            name: SILENT if told is None else ranges(told[0], told[0] * told[1])
            for name, told in zip(METHODS, frame, strict=True)
        }
        found = fusion.fuse(by_method, ONE, step * 0.1).ranges
        assert np.isfinite(found.distance_m[0]) == any(told is not None for told in frame)
        assert np.isnan(found.distance_m[0]) or (found.distance_m[0] > 0 and found.sigma_m[0] > 0)
