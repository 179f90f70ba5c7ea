"""The patch matcher on pairs with known disparities, and on input that it must refuse."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra import numpy as hnp

from tests.stereo.shifted_pairs import (
    Image,
    pair,
    pair_of_two,
    shifted,
    texture,
    tilted_pair,
    to_u8,
)
from track_range.foundation.arrays import FloatArray
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.matching.patch_matcher import PatchMatcher, PatchMatcherSettings
from track_range.stereo.matching.patch_matches import (
    REASONS,
    ExpectedDisparity,
    Outcome,
    PatchMatches,
)

BOX = (200.0, 40.0, 280.0, 100.0)
SMALL = (210.0, 50.0, 240.0, 74.0)
NONE = float("nan")
ROWS, COLUMNS = np.mgrid[:140, :400]


def of_box(
    images: tuple[Image, Image],
    box: tuple[float, ...] = BOX,
    prior_px: float = NONE,
    matcher: PatchMatcher | None = None,
) -> tuple[float, float, Outcome]:
    """Disparity, sigma and outcome of one box."""
    measured = (matcher or PatchMatcher()).match(*images, np.array([box]), np.array([prior_px]))
    return (
        float(measured.disparity_px[0]),
        float(measured.sigma_px[0]),
        Outcome(int(measured.outcome[0])),
    )


def errors_px(
    disparities_px: FloatArray,
    *,
    box: tuple[float, ...] = BOX,
    noise: float = 0.0,
    with_prior: bool = True,
    matcher: PatchMatcher | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Errors and sigmas over textures, one per disparity."""
    measured = [
        of_box(
            pair(float(d), seed=seed, noise=noise),
            box,
            float(d) + 3.0 if with_prior else NONE,
            matcher,
        )
        for seed, d in enumerate(disparities_px)
    ]
    return np.array([f[0] for f in measured]) - disparities_px, np.array([f[1] for f in measured])


# Known shifts


@pytest.mark.parametrize("with_prior", [True, False])
def test_error_on_known_shifts(with_prior: bool) -> None:
    error, _ = errors_px(np.linspace(2.05, 60.0, 50), noise=1.5, with_prior=with_prior)
    assert np.median(np.abs(error)) < 0.02
    assert np.percentile(np.abs(error), 95) < 0.05
    assert np.abs(error).max() < 0.12
    assert abs(error.mean()) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 6.0])
@pytest.mark.parametrize("box", [BOX, SMALL])
def test_no_pixel_locking(box: tuple[float, ...], noise: float) -> None:
    locking = [
        np.median(errors_px(np.full(8, 20 + tenth / 10), box=box, noise=noise)[0])
        for tenth in range(10)
    ]
    assert np.abs(locking).max() < 0.06


def test_large_boxes_in_the_pyramid() -> None:
    for edges, level in (((20.0, 20.0, 390.0, 130.0), 1), ((60.0, 40.0, 620.0, 330.0), 2)):
        images = pair(25.3, seed=level, noise=2.0, height=360, width=640, blur_px=1.2 * 2**level)
        for prior_px in (27.0, NONE):
            assert of_box(images, edges, prior_px)[0] == pytest.approx(25.3, abs=0.04 * 2**level)


def test_distance_by_hand() -> None:
    # f = 1000 px, B = 0.5 m, d = 10 px -> 50 m
    measured = PatchMatcher().match(*pair(10.0), np.array([BOX]), np.array([NONE])).disparity_px
    rig = StereoRig.rectified(PinholeCamera(1000.0, 1000.0, 200.0, 70.0, 400, 140), 0.5)
    assert rig.distance_m(measured)[0] == pytest.approx(50.0, abs=0.2)


def test_exposure_gain_and_colour_do_not_matter() -> None:
    left, right = pair(12.4)
    grey = of_box((left, right))[0]
    for darker in (to_u8(right * 0.7 + 20), to_u8(right * 0.5), to_u8(255 * (right / 255) ** 0.8)):
        assert of_box((left, darker))[0] == pytest.approx(grey, abs=0.05)
    assert of_box((np.dstack([left] * 3), np.dstack([right] * 3)))[0] == pytest.approx(
        grey, abs=1e-9
    )
    assert of_box((np.dstack([left] * 3), right))[0] == pytest.approx(grey, abs=1e-9)


@pytest.mark.parametrize("slope", [-0.05, 0.02, 0.1])
def test_slanted_surface_at_its_centre(slope: float) -> None:
    for seed in range(4):
        images = tilted_pair(20.3, slope, at_px=240.0, seed=seed)
        assert of_box(images, prior_px=20.0)[0] == pytest.approx(20.3, abs=0.04)
        assert of_box(images)[0] == pytest.approx(20.3, abs=0.04)


def test_small_disparities_without_a_prior() -> None:
    for true_px in (1.0, 1.6, 2.0, 3.3):  # less than one pixel of the level that finds them
        assert of_box(pair(true_px))[0] == pytest.approx(true_px, abs=0.05)


# Priors and ranges


def test_a_prior_off_by_5_px_changes_nothing() -> None:
    for seed in range(5):
        images = pair(30.3, seed=seed, noise=3.0)
        measured = [of_box(images, prior_px=30.3 + off)[0] for off in (0.0, -5.0, 5.0)]
        assert np.ptp(measured) < 0.01
        assert measured[0] == pytest.approx(30.3, abs=0.05)


def test_a_prior_far_off_falls_back_to_the_full_range() -> None:
    for seed in range(5):
        images = pair(30.0, seed=seed, noise=3.0)
        for prior_px in (10.0, 12.0, 50.0, 100.0, 190.0, 0.0, -5.0, 1e9, np.inf, -np.inf):
            assert of_box(images, prior_px=prior_px)[0] == pytest.approx(30.0, abs=0.05)


def test_the_range_ends_at_the_largest_disparity() -> None:
    matcher = PatchMatcher(PatchMatcherSettings(max_disparity_px=50))
    for prior_px in (NONE, 47.0):
        assert of_box(pair(49.6), prior_px=prior_px, matcher=matcher)[0] == pytest.approx(
            49.6, abs=0.05
        )
        for beyond_px in (53.0, 60.0, 90.0):
            measured = of_box(pair(beyond_px), prior_px=prior_px, matcher=matcher)
            assert np.isnan(measured[0])
            assert measured[2] in (Outcome.OUT_OF_RANGE, Outcome.NO_TEXTURE, Outcome.NO_FIT)


def test_largest_disparity_depends_on_box_size() -> None:
    matcher = PatchMatcher(PatchMatcherSettings(max_disparity_per_side=0.5))
    boxes = np.array([BOX, SMALL])  # 40 and 15 px at most
    measured = matcher.match(*pair(30.0), boxes, np.full(2, NONE))
    assert measured.disparity_px[0] == pytest.approx(30.0, abs=0.05)
    assert np.isnan(measured.disparity_px[1])


def test_settings_for_a_rig_reach_the_nearest_distance() -> None:
    rig = StereoRig.rectified(PinholeCamera(1000.0, 1000.0, 640.0, 360.0, 1280, 720), 0.5)
    assert PatchMatcherSettings.for_rig(rig).max_disparity_px == 250
    made = PatchMatcherSettings.for_rig(rig, nearest_m=2.0, smallest_m=0.25)
    assert (made.max_disparity_px, made.max_disparity_per_side) == (250, 2.0)
    # half the image width
    assert PatchMatcherSettings.for_rig(rig, nearest_m=0.1).max_disparity_px == 640


@pytest.mark.parametrize("search_px", [1, 3, 6, 7, 11])
def test_any_search_width(search_px: int) -> None:
    matcher = PatchMatcher(PatchMatcherSettings(search_px=search_px))
    assert of_box(pair(20.3), prior_px=20.5, matcher=matcher)[0] == pytest.approx(20.3, abs=0.05)


# Several surfaces


@pytest.mark.parametrize(
    ("front", "front_px", "behind_px", "object_px"),
    [
        ((np.abs(COLUMNS - 240) <= 24) & (ROWS >= 40), 25, 10, 25),  # a person before a wall
        ((ROWS >= 58) & (COLUMNS >= 200) & (COLUMNS <= 280), 25, 10, 25),  # a car under the sky
        (COLUMNS <= 228, 40, 20, 20),  # a car behind an object on its left
        (np.abs(COLUMNS - 225) <= 5, 40, 20, 20),  # behind a pole
    ],
)
def test_of_two_surfaces_the_object_is_measured(
    front: npt.NDArray[np.bool_], front_px: int, behind_px: int, object_px: int
) -> None:
    for seed in range(4):
        images = pair_of_two(front, front_px=front_px, behind_px=behind_px, seed=seed)
        for prior_px in (NONE, object_px + 2.0):
            assert of_box(images, prior_px=prior_px)[0] == pytest.approx(object_px, abs=0.15)


@pytest.mark.xfail(
    strict=True,
    reason="without a size, the wall's two thirds of the box outvote the person before it",
)
def test_a_person_in_a_third_of_its_box() -> None:
    images = pair_of_two((np.abs(COLUMNS - 240) <= 12) & (ROWS >= 40), front_px=25, behind_px=10)
    assert of_box(images)[0] == pytest.approx(25, abs=0.15)


def test_a_half_is_exact() -> None:
    errors = [
        of_box(pair_of_two(COLUMNS < 240, front_px=40, behind_px=20, seed=seed), prior_px=40.0)[0]
        - 40.0
        for seed in range(4)
    ]
    assert np.abs(errors).max() < 0.6


def test_the_prior_decides_between_halves() -> None:
    for seed in range(4):
        images = pair_of_two(COLUMNS < 240, front_px=40, behind_px=20, seed=seed)
        for prior_px in (20.0, 40.0):
            assert of_box(images, prior_px=prior_px)[0] == pytest.approx(prior_px, abs=0.8)


def of_size(
    images: tuple[Image, Image],
    by_size_px: float,
    *,
    log_sigma: float = 0.15,
    prior_px: float = NONE,
) -> PatchMatches:
    """Matches of the box `BOX` with the disparity expected from its size."""
    by_size = ExpectedDisparity(np.array([by_size_px]), np.array([log_sigma]))
    return PatchMatcher().match(*images, np.array([BOX]), np.array([prior_px]), by_size)


def test_size_decides_between_halves() -> None:
    images = pair_of_two(COLUMNS < 240, front_px=40, behind_px=20)
    for by_size_px in (20.0, 40.0):
        matches = of_size(images, by_size_px)
        assert matches.disparity_px[0] == pytest.approx(by_size_px, abs=0.8)
        assert matches.probability[0] > 0.5


def test_object_behind_a_pole_with_its_size() -> None:
    for seed in range(4):
        images = pair_of_two(np.abs(COLUMNS - 240) <= 6, front_px=40, behind_px=20, seed=seed)
        for by_size_px in (NONE, 18.0, 22.0):
            assert of_size(images, by_size_px).disparity_px[0] == pytest.approx(20.0, abs=0.2)


def test_surfaces_are_counted() -> None:
    one = PatchMatcher().match(*pair(20.3), np.array([BOX]), np.array([NONE]))
    assert (one.n_surfaces.tolist(), one.probability[0] > 0.95) == ([1], True)
    two = PatchMatcher().match(
        *pair_of_two(COLUMNS < 230, front_px=40, behind_px=20), np.array([BOX]), np.array([NONE])
    )
    assert two.n_surfaces[0] >= 2
    assert 0.4 <= two.probability[0] < 1.0
    boxes = np.array([BOX, (-90.0, 0.0, -50.0, 40.0)])
    outside = PatchMatcher().match(*pair(20.3), boxes, np.full(2, NONE))
    assert (outside.n_surfaces[1], np.isnan(outside.probability[1])) == (0, True)


def test_sigma_contains_the_other_surfaces() -> None:
    """sigma^2 is at least P (30 - 20)^2 where the other surface has the probability P; that of no
    surface is below 0.07."""
    images = pair_of_two(COLUMNS < 240, front_px=30, behind_px=20)
    sigma = []
    for by_size_px in (19.0, 21.0, 22.0):
        matches = of_size(images, by_size_px)
        assert matches.disparity_px[0] == pytest.approx(20.0, abs=0.8)
        assert matches.n_surfaces[0] == 2
        other = max(1.0 - matches.probability[0] - 0.07, 0.0)
        assert matches.sigma_px[0] >= 0.9 * 10.0 * np.sqrt(other)
        sigma.append(matches.sigma_px[0])
    assert (np.diff(sigma) > 0).all()
    assert of_size(pair(20.0), 22.0).sigma_px[0] < 0.25


def test_wrong_sizes_do_not_hide_a_single_surface() -> None:
    for by_size_px in (8.0, 30.0, 150.0, 1e-3, 1e9, np.inf, -4.0):
        assert of_size(pair(20.3), by_size_px).disparity_px[0] == pytest.approx(20.3, abs=0.05)


@pytest.mark.parametrize("with_priors", [True, False])
def test_a_car_that_a_nearer_one_covers_is_refused(with_priors: bool) -> None:
    """The far box, at 20 px by its size, shows nothing but a surface at 42 px: it is uncertain
    whether it is of a wrong class, unless there is the box of a nearer car at 42 px."""
    images, boxes = pair(42.0), np.array([BOX, (180.0, 30.0, 330.0, 130.0)])
    by_size = ExpectedDisparity(np.array([20.0, 40.0]), np.full(2, 0.12))
    priors_px = np.array([NONE, 42.0 if with_priors else NONE])
    alone = PatchMatcher().match(*images, boxes[:1], priors_px[:1], by_size.select(np.array([0])))
    assert alone.disparity_px[0] == pytest.approx(42.0, abs=0.1)
    assert alone.sigma_px[0] > 10.0  # 20 px is in about two sigma
    matches = PatchMatcher().match(*images, boxes, priors_px, by_size)
    assert Outcome(int(matches.outcome[0])) is Outcome.AMBIGUOUS
    assert matches.disparity_px[1] == pytest.approx(42.0, abs=0.1)
    assert matches.sigma_px[1] < 1.0


def test_repeated_texture_is_accepted_at_the_expected_disparity() -> None:
    fence = np.tile(texture(3, width=32), (1, 13))[:, :400]
    images = to_u8(fence), to_u8(np.roll(fence, -20, axis=1))
    assert of_box(images)[2] is Outcome.AMBIGUOUS
    assert of_size(images, 21.0).disparity_px[0] == pytest.approx(20.0, abs=0.05)


# Many boxes; only required pixels are read

MANY = np.array(
    [
        BOX,
        SMALL,
        (30.0, 10.0, 380.0, 130.0),
        (100.0, 20.0, 116.0, 34.0),
        (150.0, 90.0, 230.0, 139.5),
        (0, 0, 40, 40.0),
    ]
)
MANY_PRIORS = np.array([NONE, 20.0, 22.0, NONE, 90.0, 19.0])


def as_rows(measured: PatchMatches) -> FloatArray:
    return np.stack(
        [measured.disparity_px, measured.sigma_px, measured.outcome.astype(np.float64)], axis=1
    )


def test_boxes_are_independent() -> None:
    left, right = pair(20.7, noise=3.0)
    matcher = PatchMatcher(PatchMatcherSettings(max_disparity_px=64))
    together = as_rows(matcher.match(left, right, MANY, MANY_PRIORS))
    alone = [
        as_rows(matcher.match(left, right, MANY[i : i + 1], MANY_PRIORS[i : i + 1]))[0]
        for i in range(len(MANY))
    ]
    assert np.allclose(together, alone, atol=1e-6, equal_nan=True)
    assert np.isfinite(together[:5, 0]).all()


class RecordingImage:
    """An image that records which of its pixels are read."""

    def __init__(self, image: Image) -> None:
        self._image = image
        self.was_read = np.zeros(image.shape[:2], np.bool_)

    @property
    def shape(self) -> tuple[int, ...]:
        return self._image.shape

    def __getitem__(self, window: tuple[slice, slice], /) -> Image:
        self.was_read[window] = True
        return self._image[window]


@pytest.mark.parametrize("priors_px", [MANY_PRIORS, np.full(6, NONE), np.full(6, 21.0)])
def test_lazily_computed_images_give_equal_results(priors_px: FloatArray) -> None:
    left, right = pair(20.7, noise=3.0)
    for images in ((left, right), (np.dstack([left] * 3), np.dstack([right] * 3))):
        view = RecordingImage(images[1])
        assert np.array_equal(
            as_rows(PatchMatcher().match(images[0], view, MANY, priors_px)),
            as_rows(PatchMatcher().match(*images, MANY, priors_px)),
            equal_nan=True,
        )


def test_pixels_read_near_a_prior() -> None:
    left, right = pair(20.7)
    view = RecordingImage(right)
    assert np.isfinite(
        PatchMatcher().match(left, view, np.array([SMALL]), np.array([21.0])).disparity_px[0]
    )
    rows, columns = np.nonzero(view.was_read)
    # a tile of 48 x 32 px about (225, 62); 21 +- 8 px to the left; margins of 4 px
    assert columns.min() == 225 - 24 - 4 - 21 - 8 + 1
    assert columns.max() == 225 + 24 + 4 - 21 + 8
    assert (rows.min(), rows.max()) == (62 - 16 - 4, 62 + 16 + 4 - 1)
    untouched = RecordingImage(right)
    PatchMatcher().match(left, untouched, np.array([[-90.0, 0.0, -50.0, 40.0]]), np.array([20.0]))
    assert not untouched.was_read.any()


# Refused, with the reason


def test_textureless_and_saturated_boxes_are_refused() -> None:
    flat = np.full((140, 400), 90, np.uint8)
    downwards = np.tile(np.linspace(0, 255, 140).astype(np.uint8)[:, None], (1, 400))
    across = np.tile(np.linspace(0, 255, 400).astype(np.uint8), (140, 1))
    saturated = to_u8(texture(0) * 0.1 + 250)
    for image in (flat, downwards, across, saturated, np.zeros_like(flat)):
        for prior_px in (NONE, 20.0):
            disparity, sigma, outcome = of_box((image, image), prior_px=prior_px)
            assert np.isnan(disparity)
            assert np.isnan(sigma)
            assert outcome is Outcome.NO_TEXTURE


def test_a_partly_saturated_box_is_measured() -> None:
    left = texture(0)
    brighter = to_u8(2.0 * left), to_u8(2.0 * shifted(left, 12.0))
    assert 0.3 < np.mean(brighter[0] == 255) < 0.7
    assert of_box(brighter)[0] == pytest.approx(12.0, abs=0.05)


@pytest.mark.parametrize("make", ["noise", "texture"])
@pytest.mark.parametrize(("with_prior", "most_pct"), [(False, 0), (True, 8)])
def test_unrelated_images_are_refused(make: str, with_prior: bool, most_pct: int) -> None:
    boxes = np.array([[210.0 + 10 * i, 30.0, 230.0 + 12 * i, 60.0 + 3 * i] for i in range(10)])
    n_found = 0
    for seed in range(10):
        if make == "noise":
            left, right = np.random.default_rng(seed).integers(
                0, 256, (2, 140, 400), dtype=np.uint8
            )
        else:
            left, right = to_u8(texture(seed)), to_u8(texture(seed + 500))
        measured = PatchMatcher().match(
            left, right, boxes, np.full(10, 20.0 if with_prior else NONE)
        )
        assert set(measured.outcome.tolist()) <= {
            Outcome.MATCHED,
            Outcome.NO_TEXTURE,
            Outcome.NO_FIT,
            Outcome.AMBIGUOUS,
        }
        n_found += int(np.isfinite(measured.disparity_px).sum())
    assert n_found <= most_pct  # of 100


def test_repeated_texture_needs_a_prior() -> None:
    for period_px in (20, 32, 50):
        fence = np.tile(texture(3, width=period_px), (1, 400 // period_px + 1))[:, :400]
        images = to_u8(fence), to_u8(np.roll(fence, -20, axis=1))
        assert of_box(images)[2] is Outcome.AMBIGUOUS
        assert of_box(images, prior_px=21.0)[0] == pytest.approx(20.0, abs=0.05)
    fence = np.tile(texture(3, width=8), (1, 50))
    assert (
        of_box((to_u8(fence), to_u8(np.roll(fence, -20, axis=1))), prior_px=21.0)[2]
        is not Outcome.MATCHED
    )


def test_disparity_zero_is_not_matched() -> None:
    left, _ = pair(5.0)
    assert np.isnan(of_box((left, left))[0])
    assert np.isnan(of_box((left, left), prior_px=3.0)[0])


def test_parts_outside_the_right_image() -> None:
    left, right = to_u8(texture(0)), to_u8(texture(9))
    # disparity 60; the left image's first 60 columns are outside the right one
    right[:, :-60] = left[:, 60:]
    for box in ((0.0, 40.0, 60.0, 100.0), (5.0, 40.0, 35.0, 60.0)):
        for prior_px in (NONE, 58.0):
            assert np.isnan(of_box((left, right), box, prior_px)[0])
    assert of_box((left, right), (0.0, 40.0, 60.0, 100.0), 58.0)[2] is not Outcome.MATCHED
    partly = (30.0, 40.0, 110.0, 100.0)  # inner half 50 .. 90, seen from 62 on
    assert of_box((left, right), partly, 58.0)[0] == pytest.approx(60.0, abs=0.1)


def test_box_outside_the_right_image() -> None:
    matcher = PatchMatcher(PatchMatcherSettings(min_disparity_px=40))
    measured = of_box(pair(60.0), (0.0, 40.0, 50.0, 80.0), matcher=matcher)
    assert measured[2] is Outcome.NOT_SEEN


def test_outcomes_of_unusable_boxes() -> None:
    inf = np.inf
    cases = [
        (BOX, Outcome.MATCHED),
        ((100.0, 50.0, 104.0, 54.0), Outcome.TOO_SMALL),
        ((100.0, 50.0, 180.0, 54.0), Outcome.TOO_SMALL),
        ((-500.0, 10.0, -400.0, 60.0), Outcome.OUTSIDE),
        ((500.0, 10.0, 600.0, 60.0), Outcome.OUTSIDE),
        ((NONE, 10.0, 60.0, 60.0), Outcome.OUTSIDE),
        ((NONE, NONE, NONE, NONE), Outcome.OUTSIDE),
        ((10.0, 10.0, inf, 60.0), Outcome.OUTSIDE),
        ((-inf, -inf, inf, inf), Outcome.OUTSIDE),
        ((90.0, 90.0, 40.0, 40.0), Outcome.OUTSIDE),
        ((40.0, 40.0, 40.0, 90.0), Outcome.OUTSIDE),
        ((1e300, 1e300, 1e301, 1e301), Outcome.OUTSIDE),
        ((-0.5, -0.5, 399.5, 139.5), Outcome.MATCHED),  # the whole image
        ((-1e6, -1e6, 1e6, 1e6), Outcome.MATCHED),
        ((380.0, 100.0, 500.0, 500.0), Outcome.MATCHED),  # partly inside
    ]
    boxes = np.array([box for box, _ in cases])
    measured = PatchMatcher().match(*pair(12.0), boxes, np.full(len(boxes), NONE))
    assert [Outcome(code) for code in measured.outcome.tolist()] == [
        outcome for _, outcome in cases
    ]
    matched = measured.outcome == Outcome.MATCHED
    assert np.allclose(measured.disparity_px[matched], 12.0, atol=0.15)
    assert np.array_equal(np.isfinite(measured.disparity_px), matched)
    assert np.array_equal(np.isfinite(measured.sigma_px), matched)


@pytest.mark.parametrize("image_hw", [(10, 400), (140, 12), (1, 1), (7, 9)])
def test_an_image_smaller_than_a_window_is_too_small(image_hw: tuple[int, int]) -> None:
    image = np.random.default_rng(0).integers(0, 256, image_hw, dtype=np.uint8)
    box = (-0.5, -0.5, image_hw[1] - 0.5, image_hw[0] - 0.5)
    assert of_box((image, image), box, 3.0)[2] is Outcome.TOO_SMALL


@pytest.mark.parametrize(("height", "width"), [(11, 400), (13, 200), (24, 300), (43, 600)])
def test_low_images_are_measured(height: int, width: int) -> None:
    images = pair(3.0, height=height, width=width)
    for prior_px in (NONE, 4.0):
        whole = of_box(images, (-0.5, -0.5, width - 0.5, height - 0.5), prior_px)
        assert whole[0] == pytest.approx(3.0, abs=0.15)


def test_empty_image() -> None:
    empty = np.zeros((0, 0), np.uint8)
    assert of_box((empty, empty), BOX)[2] is Outcome.OUTSIDE


def test_no_boxes() -> None:
    matches = PatchMatcher().match(*pair(12.0), np.zeros((0, 4)), np.zeros(0))
    measured, sigma = matches.disparity_px, matches.sigma_px
    assert measured.shape == sigma.shape == (0,)


def test_images_of_different_size_are_an_error() -> None:
    left, right = pair(12.0)
    for other in (right[:-1], right[:, 1:]):
        with pytest.raises(ValueError, match="equal sizes"):
            PatchMatcher().match(left, other, np.array([BOX]), np.array([NONE]))


def test_each_outcome_has_a_reason() -> None:
    assert set(REASONS) == set(Outcome)
    assert len(set(REASONS.values())) == len(Outcome)


HOSTILE = pair(12.0)


@settings(deadline=None, max_examples=60)
@given(
    hnp.arrays(np.float64, (3, 4), elements=st.floats(-600, 600) | st.just(np.nan)),
    hnp.arrays(np.float64, 3, elements=st.floats(allow_nan=True, allow_infinity=True)),
)
def test_any_box_and_prior_is_accepted(boxes: FloatArray, priors: FloatArray) -> None:
    matches = PatchMatcher().match(*HOSTILE, boxes, priors)
    measured, sigma = matches.disparity_px, matches.sigma_px
    known = np.isfinite(measured)
    assert np.array_equal(known, np.isfinite(sigma))
    assert (sigma[known] > 0).all()
    assert np.allclose(measured[known], 12.0, atol=1.5)


# Sigma


@pytest.mark.slow
def test_sigma_matches_errors_on_noisy_textures() -> None:
    """Without the floors for objects that are not smooth, sigma is that of the sensor noise."""
    smooth = PatchMatcher(PatchMatcherSettings(floor_px=0.03, floor_fraction=0.0))
    ratios = []
    for noise, box in (
        (10.0, SMALL),
        (12.0, SMALL),
        (14.0, (200.0, 40.0, 240.0, 76.0)),
        (8.0, (200, 50, 216, 64)),
    ):
        error, sigma = errors_px(5.0 + 0.37 * np.arange(40), box=box, noise=noise, matcher=smooth)
        ratios.append(np.abs(error) / sigma)
    # somewhat too large: the windows' variances have floors for objects too
    assert 0.55 < np.mean(np.array(ratios) < 1) < 0.9
    assert 0.9 < np.mean(np.array(ratios) < 2) <= 1.0


def test_sigma_is_not_below_its_floor_without_noise() -> None:
    disparity_px = 5.0 + 0.37 * np.arange(20)
    error, sigma = errors_px(disparity_px)
    floor_px = floor_at(disparity_px)
    assert (sigma >= 0.999 * floor_px).all()
    assert np.median(sigma / floor_px) < 1.2
    assert (np.abs(error) < 2 * sigma).all()


def floor_at(disparity_px: FloatArray | float) -> FloatArray:
    """Sigma of a flat, noiseless box in a tile of scale 1, px."""
    constants = PatchMatcherSettings()
    return np.hypot(constants.floor_px, constants.floor_fraction * np.asarray(disparity_px))


def test_sigma_grows_with_noise_and_with_tilt() -> None:
    of_noise = [
        np.median(errors_px(np.full(10, 12.3), noise=noise)[1]) for noise in (0.0, 6.0, 12.0, 18.0)
    ]
    assert (np.diff(of_noise) > 0).all()
    assert of_noise[3] ** 2 - floor_at(12.3) ** 2 > 1.25 * (of_noise[0] ** 2 - floor_at(12.3) ** 2)
    of_tilt = [
        of_box(tilted_pair(20.3, slope, at_px=240.0), prior_px=20.0)[1]
        for slope in (0.0, 0.02, 0.05, 0.1)
    ]
    assert (np.diff(of_tilt) > 0).all()
    # a share of the change over the inner half
    assert of_tilt[3] == pytest.approx(0.12 * 0.1 * 40, rel=0.5)


def test_sigma_is_in_full_pixels() -> None:
    images = pair(25.3, noise=8.0, height=360, width=640)
    _, whole, _ = of_box(images, (60.0, 40.0, 620.0, 330.0), 25.0)
    assert whole > 4 * 0.03  # measured in the image shrunk by 4
