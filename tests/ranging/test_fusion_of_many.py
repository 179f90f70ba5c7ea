"""Fusion of arbitrary methods, of which only the declared error sources are known."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.ranging.fusion.error_model import ErrorModel
from track_range.ranging.fusion.estimation import TrackBiases
from track_range.ranging.fusion.fusion import Fusion, ScaleSource
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.method import ErrorSource, RangingMethod
from track_range.ranging.registry import methods

ONE = np.array([1])


def method(name, *sources, **options):
    return RangingMethod(
        name=name,
        title=name,
        letter="x",
        colour="#000000",
        create=lambda context: None,
        error_sources=tuple(ErrorSource(*source) for source in sources),
        **options,
    )


def like(name, other, **options):
    """A method with the error sources of another one."""
    sources = next(known.error_sources for known in methods() if known.name == other)
    return method(
        name,
        *((source.name, source.systematic, source.independent) for source in sources),
        **options,
    )


MONO, LANE, STEREO = (like(name, name) for name in ("mono", "lane", "stereo"))
REFERENCE = like("stereo", "stereo", is_scale_reference=True)
COPY = like("copy", "mono")
RADAR = method("radar", ("own", 0.5, 0.5))
LIDAR = method("lidar", ("own", 0.2, 0.8))
SIX = (MONO, COPY, LANE, REFERENCE, RADAR, LIDAR)


def ranges(distance_m, relative_sigma):
    return Ranges(ONE, np.array([float(distance_m)]), np.array([distance_m * relative_sigma]))


def relative_sigma(fused):
    return (fused.ranges.sigma_m / fused.ranges.distance_m)[0]


def single_frame(listed, **by_method):
    """Fusion of one frame of distances and relative sigmas, without history."""
    return Fusion(listed).fuse(
        {name: ranges(*value) for name, value in by_method.items()}, ONE, 0.0
    )


@pytest.mark.parametrize(
    ("copy_m", "copy_sigma"), [(30.0, 0.1), (30.5, 0.1), (30.0, 0.13), (29.5, 0.11), (30.0, 0.3)]
)
def test_redundant_copy_does_not_narrow_sigma(copy_m, copy_sigma):
    both = single_frame((MONO, COPY), mono=(30.0, 0.1), copy=(copy_m, copy_sigma))
    assert 0.095 <= relative_sigma(both) <= 0.105
    assert both.ranges.distance_m[0] == pytest.approx(30.0, rel=0.02)


def test_redundant_copy_does_not_outvote_a_third_method():
    of_two = single_frame((MONO, STEREO), mono=(32.0, 0.1), stereo=(30.0, 0.05))
    of_three = single_frame(
        (MONO, COPY, STEREO), mono=(32.0, 0.1), copy=(32.0, 0.1), stereo=(30.0, 0.05)
    )
    assert 0.95 <= relative_sigma(of_three) / relative_sigma(of_two) <= 1.0
    assert of_three.ranges.distance_m == pytest.approx(of_two.ranges.distance_m, rel=0.005)
    contradicted = single_frame(
        (MONO, COPY, STEREO), mono=(40.0, 0.05), copy=(40.0, 0.05), stereo=(20.0, 0.05)
    )
    assert 20.5 < contradicted.ranges.distance_m[0] < 39.5


def test_redundant_copy_does_not_narrow_learnt_biases():
    sigmas = {}
    for listed in ((MONO, REFERENCE), (MONO, COPY, REFERENCE)):
        rng, fusion = np.random.default_rng(3), Fusion(listed)
        for step in range(40):
            mono_m = 22.0 * np.exp(rng.normal(0, 0.02))
            by_method = {"mono": ranges(mono_m, 0.08), "copy": ranges(mono_m * 1.01, 0.09)}
            if step < 30:
                by_method["stereo"] = ranges(20.0 * np.exp(rng.normal(0, 0.005)), 0.02)
            fused = fusion.fuse(by_method, ONE, step * 0.1)
        sigmas[len(listed)] = relative_sigma(fused)
        assert fused.ranges.distance_m[0] == pytest.approx(20.0, rel=0.06)
    assert 0.95 < sigmas[3] / sigmas[2] <= 1.001


def test_independent_method_narrows_sigma_as_predicted():
    both = single_frame((MONO, RADAR), mono=(30.0, 0.1), radar=(30.0, 0.08))
    assert relative_sigma(both) == pytest.approx((0.1**-2 + 0.08**-2) ** -0.5)
    five = single_frame(
        (MONO, LANE, REFERENCE, RADAR, LIDAR),
        mono=(30.0, 0.1),
        lane=(30.0, 0.1),
        stereo=(30.0, 0.05),
        radar=(30.0, 0.08),
        lidar=(30.0, 0.06),
    )
    # covariance of mono and lane: contact point, scale of the drive
    shared = (np.sqrt(0.36 * 2 / 7 * 0.25) + np.sqrt(0.24 * 0.15)) * 0.1**2
    of_both = np.array([[0.1**2, shared], [shared, 0.1**2]])
    information = np.linalg.inv(of_both).sum() + 0.05**-2 + 0.08**-2 + 0.06**-2
    assert relative_sigma(five) == pytest.approx(information**-0.5)


def sampled_errors(rng, model, sigma, n_tracks, n_frames):
    """(n_frames, M, n_tracks) errors of log distances, sampled from the declared sources for (M,)
    relative sigmas."""
    m = len(sigma)
    systematic = (
        rng.multivariate_normal(np.zeros(m), model.systematic_correlation, n_tracks).T
        * model.systematic[:, :1]
    )
    new = rng.multivariate_normal(
        np.zeros(m), model.independent_covariance[..., 0], (n_frames, n_tracks)
    )
    return (systematic + np.moveaxis(new, 2, 1)) * sigma[:, None]


@pytest.mark.parametrize("n_frames", [1, 12])
def test_sigma_is_consistent_with_declared_sources(n_frames):
    rng, n, sigma = np.random.default_rng(5), 3000, np.array([0.1, 0.12, 0.07, 0.03, 0.08, 0.05])
    fusion, ids = Fusion(SIX), np.arange(n)
    for step, errors in enumerate(sampled_errors(rng, ErrorModel.of(SIX), sigma, n, n_frames)):
        distance_m = 30.0 * np.exp(errors)
        by_method = {
            one.name: Ranges(ids, distance_m[i], distance_m[i] * sigma[i])
            for i, one in enumerate(SIX)
        }
        result = fusion.fuse(by_method, ids, step * 0.1).ranges
    normalised = np.log(result.distance_m / 30.0) / (result.sigma_m / result.distance_m)
    # Sigma is widened for large chi^2, but never narrowed for small chi^2: with 5 degrees of
    # freedom the mean of 1 / max(1, chi^2 / 5) is 0.84.
    chi2 = rng.chisquare(5, 100_000) / 5
    assert np.mean(normalised**2) == pytest.approx(np.mean(1 / np.maximum(1, chi2)), rel=0.08)
    assert abs(np.mean(normalised)) < 0.06
    assert 0.66 < np.mean(np.abs(normalised) < 1) < 0.76


@pytest.mark.parametrize("wrong", [one.name for one in SIX])
@pytest.mark.parametrize("factor", [0.5, 1.8])
@pytest.mark.parametrize("n_before", [0, 12])
def test_outlier_of_any_method_is_rejected(wrong, factor, n_before):
    fusion, true_m = Fusion(SIX), 30.0
    sigma = dict(zip((one.name for one in SIX), (0.08, 0.08, 0.06, 0.03, 0.06, 0.05), strict=True))
    for step in range(n_before):
        fusion.fuse({name: ranges(true_m, s) for name, s in sigma.items()}, ONE, step * 0.1)
    now = {
        name: ranges(true_m * (factor if name == wrong else 1.0), s) for name, s in sigma.items()
    }
    result = fusion.fuse(now, ONE, n_before * 0.1).ranges
    assert result.distance_m[0] == pytest.approx(true_m, rel=0.02)
    assert result.sigma_m[0] < 0.04 * true_m


def test_history_decides_between_two_methods():
    contradiction = {"radar": ranges(30.0, 0.03), "lidar": ranges(45.0, 0.03)}
    undecided = Fusion((RADAR, LIDAR)).fuse(contradiction, ONE, 0.0)
    assert undecided.ranges.distance_m == pytest.approx([np.sqrt(30 * 45)])
    assert undecided.ranges.sigma_m[0] > 5.0
    assert undecided.n_conflicts == [1]
    fusion = Fusion((RADAR, LIDAR))
    for step in range(8):
        fusion.fuse({"radar": ranges(30.0, 0.03), "lidar": ranges(30.0, 0.03)}, ONE, step * 0.1)
    decided = fusion.fuse(contradiction, ONE, 0.8)
    assert decided.ranges.distance_m == pytest.approx([30.0], rel=0.01)
    assert decided.n_conflicts == [0]


def test_fallback_is_used_only_if_its_target_is_missing():
    dense = like("dense", "stereo", fallback_for="stereo")
    sonar = method("sonar", ("own", 0.5, 0.5), fallback_for="stereo")
    separate = method("separate", ("own", 0.5, 0.5), fallback_for="absent")
    listed = (sonar, dense, REFERENCE, separate)
    assert single_frame(
        listed, stereo=(20.0, 0.05), dense=(22.0, 0.05), sonar=(24.0, 0.05)
    ).ranges.distance_m == pytest.approx([20])
    # Dense has the same sources as stereo and replaces it, also for the other fallback.
    assert single_frame(
        listed, dense=(22.0, 0.05), sonar=(24.0, 0.05)
    ).ranges.distance_m == pytest.approx([22.0])
    assert single_frame(listed, sonar=(24.0, 0.05)).ranges.distance_m == pytest.approx([24.0])
    assert (
        20.0
        < single_frame(listed, stereo=(20.0, 0.05), separate=(22.0, 0.05)).ranges.distance_m[0]
        < 22.0
    )


def test_scale_source_of_reference_and_learnt_biases():
    fusion = Fusion((MONO, REFERENCE, RADAR))
    assert fusion.fuse({"radar": ranges(20.0, 0.05)}, ONE, 0.0).scale_source == [
        ScaleSource.ASSUMED
    ]
    for step in range(1, 30):
        by_method = {"mono": ranges(24.0, 0.1), "stereo": ranges(20.0, 0.02)}
        assert fusion.fuse(by_method, ONE, step * 0.1).scale_source == [ScaleSource.REFERENCE]
    later = fusion.fuse({"mono": ranges(24.0, 0.1)}, ONE, 5.0)
    assert later.scale_source == [ScaleSource.REFERENCE]
    assert later.ranges.distance_m == pytest.approx([20.0], rel=0.03)


def test_pair_with_the_same_sources_is_a_reference():
    copy = like("second", "stereo")
    fusion = Fusion((MONO, REFERENCE, copy))
    for step in range(30):
        fusion.fuse({"mono": ranges(24.0, 0.1), "second": ranges(20.0, 0.02)}, ONE, step * 0.1)
    result = fusion.fuse({"mono": ranges(24.0, 0.1)}, ONE, 3.0)
    assert result.ranges.distance_m == pytest.approx([20.0], rel=0.02)
    assert result.scale_source == [ScaleSource.REFERENCE]


measurement = st.one_of(st.none(), st.tuples(st.floats(10, 60), st.floats(0.01, 0.3)))


@settings(deadline=None, max_examples=60)
@given(st.lists(st.tuples(*[measurement] * 6), min_size=1, max_size=6), st.permutations(range(6)))
def test_order_of_methods_does_not_matter(frames, order):
    first, second = Fusion(SIX), Fusion([SIX[i] for i in order])
    for step, frame in enumerate(frames):
        by_method = {
            one.name: ranges(*value)
            for one, value in zip(SIX, frame, strict=True)
            if value is not None
        }
        a, b = (fusion.fuse(by_method, ONE, step * 0.1) for fusion in (first, second))
        assert a.ranges.distance_m == pytest.approx(b.ranges.distance_m, rel=1e-6, nan_ok=True)
        assert a.ranges.sigma_m == pytest.approx(b.ranges.sigma_m, rel=1e-6, nan_ok=True)
        assert a.condition.tolist() == b.condition.tolist()
        assert np.isfinite(a.ranges.distance_m[0]) == bool(by_method)
        assert not by_method or a.ranges.sigma_m[0] > 0


@pytest.mark.parametrize("n_copies", [2, 6])
def test_copies_of_a_method_count_as_one(n_copies):
    listed = [like(f"copy_{i}", "stereo") for i in range(n_copies)]
    result = single_frame(
        listed, **{one.name: (30.0 + 0.1 * i, 0.05) for i, one in enumerate(listed)}
    )
    assert 0.95 * 0.05 <= relative_sigma(result) <= 0.0501


@pytest.mark.slow
@pytest.mark.parametrize("listed", [None, SIX])
def test_bias_covariance_stays_valid_over_many_conflicts(listed):
    rng, ids, fusion = np.random.default_rng(0), np.arange(8), Fusion(listed)
    names = [
        one.name for one in (methods(()) if listed is None else listed) if one.measures_distance
    ]
    true_m = rng.uniform(10, 60, 8)
    for step in range(1000):
        by_method = {}
        for name, sigma in zip(names, (0.08, 0.1, 0.06, 0.02, 0.02, 0.05), strict=False):
            distance_m = true_m * np.exp(sigma * rng.normal(size=8))
            distance_m[rng.random(8) > 0.7] = np.nan
            by_method[name] = Ranges(ids, distance_m, sigma * distance_m)
        result = fusion.fuse(by_method, ids, step * 0.1).ranges
        has_any = np.isfinite(result.distance_m)
        assert result.distance_m[has_any] == pytest.approx(true_m[has_any], rel=0.6)
    C = TrackBiases.from_columns(fusion._tracks.known, len(names)).C.transpose(2, 0, 1)
    assert np.array_equal(C, C.transpose(0, 2, 1))
    assert np.linalg.eigvalsh(C).min() > -1e-9


def test_correlations_of_the_built_in_methods():
    """By hand: mono, ground and lane share the contact point, mono and ground the horizon; dense and
    patch matching share the rig."""
    model = ErrorModel.of(methods(()))
    mono, ground, lane, stereo, sgbm = (
        model.names.index(name) for name in ("mono", "ground", "lane", "stereo", "sgbm")
    )
    noise = model.independent_covariance[..., 0] / (model.independent * model.independent.T)
    assert [noise[mono, ground], noise[mono, lane], noise[ground, lane]] == pytest.approx(
        [0.456, 0.345, 0.550], abs=1e-3
    )
    assert noise[[mono, ground, lane], stereo] == pytest.approx([0, 0, 0])
    assert model.systematic_correlation[stereo, sgbm] == pytest.approx(1.0)
    assert model.systematic_correlation[mono, [ground, lane, stereo]] == pytest.approx(
        [(np.sqrt(0.09 * 0.25) + np.sqrt(0.07 * 0.2)) / np.sqrt(0.64 * 0.45), 0.375, 0]
    )
    assert model.reference.tolist() == [stereo, sgbm]
    assert np.argwhere(model.superseded_by).tolist() == [
        [ground, mono],
        [lane, stereo],
        [lane, sgbm],
        [sgbm, stereo],
    ]
