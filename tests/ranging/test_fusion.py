import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.ranging.fusion.fusion import Fusion, ScaleSource
from track_range.ranging.measurement.ranges import Ranges

ONE = np.array([1])
METHODS = ("mono", "ground", "lane", "stereo", "sgbm")


def ranges(distance_m, sigma_m):
    return Ranges(ONE, np.array([float(distance_m)]), np.array([float(sigma_m)]))


UNMEASURED = ranges(np.nan, np.nan)


def single_frame(by_method):
    """Fusion of one frame without history."""
    return Fusion().fuse(by_method, ONE, 0.0)


def fused_m(fusion, step, **by_method):
    return float(fusion.fuse(by_method, ONE, step * 0.1).ranges.distance_m[0])


def test_inverse_variance_by_hand():
    result = single_frame({"mono": ranges(22.0, 2.2), "stereo": ranges(20.0, 1.0)}).ranges
    # In logarithms the sigmas are 0.1 and 0.05, the weights 1 and 4.
    assert result.distance_m == pytest.approx([20 * np.exp(np.log(1.1) / 5)])
    assert result.sigma_m / result.distance_m == pytest.approx([np.sqrt(1 / 500)])


def test_single_method_is_unchanged():
    for name in METHODS:
        result = single_frame({name: ranges(30.0, 3.0)}).ranges
        assert (result.distance_m[0], result.sigma_m[0]) == pytest.approx((30.0, 3.0))


def test_correlated_methods_narrow_sigma_less():
    together = single_frame({"mono": ranges(30.0, 3.0), "lane": ranges(30.0, 3.0)}).ranges.sigma_m[
        0
    ]
    apart = single_frame({"mono": ranges(30.0, 3.0), "stereo": ranges(30.0, 3.0)}).ranges.sigma_m[0]
    assert apart == pytest.approx(3.0 / np.sqrt(2))
    # Common are the contact point, 0.36 * 2 / 7 and 0.25 of the variances, and the scale of the
    # drive, 0.24 and 0.15.
    common = np.sqrt(0.36 * 2 / 7 * 0.25) + np.sqrt(0.24 * 0.15)
    assert together == pytest.approx(3.0 * np.sqrt((1 + common) / 2))


def test_errors_that_change_are_no_biases_without_a_reference():
    """A car comes nearer; the lines are 15 % wrong at first. In the end all methods agree, and
    fusion with them."""
    fusion = Fusion()
    for k, true_m in enumerate(np.geomspace(80.0, 20.0, 60)):
        lane_m = true_m * (1.15 - 0.15 * k / 59)
        by_method = {
            "mono": ranges(0.97 * true_m, 0.08 * true_m),
            "lane": ranges(lane_m, 0.08 * lane_m),
        }
        fused = fusion.fuse(by_method, np.array([1]), 0.1 * k).ranges
        assert 0.97 * true_m - 1e-6 <= fused.distance_m[0] <= lane_m + 1e-6
    assert fused.distance_m[0] == pytest.approx(20.0, rel=0.03)


def test_conflict_widens_sigma():
    agreed = single_frame({"mono": ranges(20.0, 1.0), "stereo": ranges(20.0, 1.0)}).ranges
    result = single_frame({"mono": ranges(40.0, 2.0), "stereo": ranges(20.0, 1.0)}).ranges
    assert result.distance_m == pytest.approx([np.sqrt(800)])
    chi2 = np.log(2) ** 2 / (2 * 0.05**2)
    assert (result.sigma_m / result.distance_m)[0] == pytest.approx(
        agreed.sigma_m[0] / 20 * np.sqrt(chi2)
    )


def test_match_inconsistent_with_size_is_rejected():
    result = single_frame({"mono": ranges(75.0, 6.0), "stereo": ranges(15.0, 0.3)})
    assert (result.ranges.distance_m[0], result.ranges.sigma_m[0]) == pytest.approx((75.0, 6.0))
    assert result.scale_source == [ScaleSource.ASSUMED]
    half_occluded = single_frame({"mono": ranges(30.0, 2.0), "stereo": ranges(15.0, 0.3)})
    assert half_occluded.ranges.distance_m[0] < 17


@pytest.mark.parametrize("foot", ["ground", "lane"])
def test_contact_point_supports_stereo_against_size(foot):
    """A car at 38 m that is detected as a truck, at 98 m by its size."""
    truck = {"mono": ranges(98.0, 13.0), "stereo": ranges(38.0, 0.6)}
    assert single_frame(truck).ranges.distance_m[0] == pytest.approx(98.0)
    result = single_frame(truck | {foot: ranges(45.0, 4.0)}).ranges
    assert (result.distance_m[0], result.sigma_m[0]) == pytest.approx((38.0, 0.6))
    assert single_frame(truck | {foot: ranges(90.0, 9.0)}).ranges.distance_m[0] == pytest.approx(
        98.0
    )
    assert single_frame(truck | {foot: ranges(60.0, 2.0)}).ranges.distance_m[0] == pytest.approx(
        98.0
    )


def test_lines_of_another_lane_are_rejected():
    by_method = {"mono": ranges(17.0, 1.2), "lane": ranges(9.0, 0.3)}
    assert single_frame(by_method).ranges.distance_m[0] == pytest.approx(17.0)
    assert single_frame(by_method | {"ground": ranges(16.0, 2.0)}).ranges.distance_m[
        0
    ] == pytest.approx(17.0)
    assert single_frame(by_method | {"ground": ranges(10.0, 1.0)}).ranges.distance_m[
        0
    ] == pytest.approx(9.0)
    agreeing = single_frame(by_method | {"lane": ranges(15.5, 0.5)}).ranges.distance_m[0]
    assert 15.5 < agreeing < 16.0


@pytest.mark.parametrize("n_frames", [0, 1, 60])
def test_decay_over_gaps_depends_on_time_only(n_frames):
    fusion = Fusion()
    for step in range(30):
        fusion.fuse({"mono": ranges(24.0, 2.4), "stereo": ranges(20.0, 0.2)}, ONE, step * 0.1)
    for time_s in np.linspace(2.9, 4.9, n_frames + 2)[1:-1]:
        fusion.fuse({"mono": UNMEASURED}, ONE, time_s)
    assert fused_m(fusion, 49, mono=ranges(24.0, 2.4)) == pytest.approx(20.1, abs=0.2)


def test_dense_is_a_fallback_for_patches():
    dense = ranges(30.0, 1.0)
    for by_method, expected_m in (
        ({"stereo": UNMEASURED, "sgbm": dense}, 30.0),
        ({"stereo": ranges(20.0, 1.0), "sgbm": dense}, 20.0),
        ({"sgbm": dense}, 30.0),
    ):
        assert single_frame(by_method).ranges.distance_m == pytest.approx([expected_m])
        assert single_frame(by_method).scale_source == [ScaleSource.REFERENCE]


def test_no_method_measured():
    for by_method in ({}, {"mono": UNMEASURED}):
        result = single_frame(by_method)
        assert np.isnan(result.ranges.distance_m).all()
        assert np.isnan(result.ranges.sigma_m).all()
        assert result.scale_source == [ScaleSource.ASSUMED]
    assert len(Fusion().fuse({}, np.zeros(0, np.int64), 0.0).ranges) == 0


def test_size_learnt_from_stereo_improves_mono():
    """A car 10 % smaller than its class, at 22 m instead of 20 m by mono."""
    rng, fusion = np.random.default_rng(8), Fusion()
    errors = {True: [], False: []}
    for step in range(40):
        true_m = 30 - 0.3 * step
        mono_m = 1.1 * true_m * np.exp(rng.normal(0, 0.01))
        matches = step < 20
        stereo = (
            ranges(true_m * np.exp(rng.normal(0, 0.003)), 0.01 * true_m) if matches else UNMEASURED
        )
        result = fusion.fuse(
            {"mono": ranges(mono_m, 0.08 * mono_m), "stereo": stereo}, ONE, step * 0.1
        )
        errors[matches].append(result.ranges.distance_m[0] / true_m - 1)
        assert result.scale_source == [ScaleSource.REFERENCE]
    assert np.max(np.abs(errors[True][5:])) < 0.01
    assert np.mean(np.abs(errors[False])) < 0.025  # 10 % without learning
    # larger than the error: the bias of stereo is unknown
    assert 0.01 * 18.3 < result.ranges.sigma_m[0] < 0.07 * 18.3


def test_learnt_size_is_no_more_certain_than_stereo():
    fusion = Fusion()
    for step in range(200):
        fusion.fuse({"mono": ranges(20.0, 2.0), "stereo": ranges(20.0, 1.0)}, ONE, step * 0.1)
    result = fusion.fuse({"mono": ranges(20.0, 2.0)}, ONE, 20.0).ranges
    assert result.sigma_m[0] > 1.0


def test_learnt_size_is_forgotten():
    fusion = Fusion()
    for step in range(30):
        fusion.fuse({"mono": ranges(22.0, 1.7), "stereo": ranges(20.0, 0.2)}, ONE, step * 0.1)
    assert fused_m(fusion, 31, mono=ranges(22.0, 1.7)) == pytest.approx(20.0, rel=0.03)
    no_tracks = np.zeros(0, np.int64)
    fusion.fuse({}, no_tracks, 4.0)
    fusion.fuse({}, no_tracks, 9.0)
    assert fused_m(fusion, 91, mono=ranges(22.0, 1.7)) == pytest.approx(22.0)


def test_wrong_match_of_a_trusted_track_is_rejected():
    fusion = Fusion()
    for step in range(10):
        fused_m(fusion, step, mono=ranges(41.0, 4.0), stereo=ranges(40.0, 1.0))
    assert fused_m(fusion, 10, mono=ranges(41.0, 4.0), stereo=ranges(20.0, 0.3)) == pytest.approx(
        40.0, rel=0.03
    )
    assert fused_m(fusion, 11, mono=ranges(41.0, 4.0), stereo=ranges(40.0, 1.0)) == pytest.approx(
        40.0, rel=0.02
    )


def test_occluded_box_of_a_trusted_track_is_rejected():
    fusion = Fusion()
    for step in range(10):
        fused_m(fusion, step, mono=ranges(21.0, 1.7), stereo=ranges(20.0, 0.3))
    assert fused_m(fusion, 10, mono=ranges(42.0, 3.4), stereo=ranges(20.0, 0.3)) == pytest.approx(
        20.0, rel=0.02
    )


def test_wrong_history_is_given_up():
    """Stereo matched an occluder of the car for a second, and then the car."""
    fusion = Fusion()
    for step in range(10):
        fused_m(fusion, step, mono=ranges(40.0, 4.0), stereo=ranges(33.0, 0.7))
    later = [
        fused_m(fusion, step, mono=ranges(40.0, 4.0), stereo=ranges(60.0, 1.2))
        for step in range(10, 22)
    ]
    assert later[-1] == pytest.approx(60.0, rel=0.05)


def test_tracks_are_independent_and_in_order():
    two, fusion = np.array([5, 2]), Fusion()
    for step in range(20):
        mono = Ranges(two, np.array([22.0, 36.0]), np.array([1.8, 3.0]))
        fusion.fuse(
            {"mono": mono, "stereo": Ranges(two, np.array([20.0, 40.0]), np.array([0.2, 0.4]))},
            two,
            step * 0.1,
        )
    three = np.array([2, 7, 5])
    result = fusion.fuse(
        {"mono": Ranges(three, np.array([36.0, 50.0, 22.0]), np.ones(3) * 2)}, three, 2.0
    ).ranges
    assert result.track_id.tolist() == [2, 7, 5]
    assert result.distance_m == pytest.approx([40.0, 50.0, 20.0], rel=0.05)


@pytest.mark.parametrize(
    ("names", "fractions", "shared", "drive"),
    [
        (("mono", "lane"), (0.6, 0.6**0.5), (2 / 7 * 5 / 12) ** 0.5, 0.375),
        (("mono", "stereo"), (0.6, 0.3), 0.0, 0.0),
    ],
)
def test_fused_is_the_least_squares_solution(names, fractions, shared, drive):
    """Against the joint normal equations of a frame for log d and the biases of the methods."""
    sigma, log_m = np.array([0.1, 0.07]), np.log([30.0, 28.0])
    by_method = {
        n: ranges(np.exp(z), s * np.exp(z)) for n, z, s in zip(names, log_m, sigma, strict=True)
    }
    fraction = np.array(fractions)
    noise = np.outer(fraction * sigma, fraction * sigma) * np.array([[1.0, shared], [shared, 1.0]])
    design = np.hstack([np.ones((2, 1)), np.diag(np.sqrt(1 - fraction**2) * sigma)])
    information = design.T @ np.linalg.inv(noise) @ design
    information[1:, 1:] += np.linalg.inv(np.array([[1.0, drive], [drive, 1.0]]))
    solution = np.linalg.solve(information, design.T @ np.linalg.inv(noise) @ log_m)
    result = single_frame(by_method).ranges
    assert np.log(result.distance_m[0]) == pytest.approx(solution[0])
    assert (result.sigma_m / result.distance_m)[0] == pytest.approx(
        np.sqrt(np.linalg.inv(information)[0, 0])
    )


@pytest.mark.parametrize(("fallback", "preferred"), [("ground", "mono"), ("lane", "stereo")])
def test_fallback_is_used_only_without_the_other_method(fallback, preferred):
    both = single_frame({fallback: ranges(20.0, 1.0), preferred: ranges(24.0, 1.0)}).ranges
    assert both.distance_m[0] == pytest.approx(24.0)
    assert single_frame(
        {fallback: ranges(20.0, 1.0), preferred: ranges(np.nan, np.nan)}
    ).ranges.distance_m[0] == pytest.approx(20.0)


@settings(deadline=None)
@given(st.floats(20, 45), st.floats(20, 45), st.floats(0.1, 10), st.floats(0.1, 10))
def test_fused_distance_lies_between(a, b, sigma_a, sigma_b):
    result = single_frame({"mono": ranges(a, sigma_a), "stereo": ranges(b, sigma_b)}).ranges
    assert min(a, b) - 1e-6 <= result.distance_m[0] <= max(a, b) + 1e-6
    relative = ((a / sigma_a) ** 2 + (b / sigma_b) ** 2) ** -0.5
    assert result.sigma_m[0] / result.distance_m[0] >= relative - 1e-9


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(*[st.one_of(st.none(), st.tuples(st.floats(1, 150), st.floats(0.005, 0.5)))] * 5),
        min_size=1,
        max_size=8,
    )
)
def test_any_measurement_gives_a_finite_distance(frames):
    fusion = Fusion()
    for step, frame in enumerate(frames):
        by_method = {
            name: UNMEASURED if values is None else ranges(values[0], values[0] * values[1])
            for name, values in zip(METHODS, frame, strict=True)
        }
        result = fusion.fuse(by_method, ONE, step * 0.1).ranges
        assert np.isfinite(result.distance_m[0]) == any(values is not None for values in frame)
        assert np.isnan(result.distance_m[0]) or (
            result.distance_m[0] > 0 and result.sigma_m[0] > 0
        )
