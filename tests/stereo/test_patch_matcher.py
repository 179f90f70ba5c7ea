"""The patch matcher against brute force, known shifts and hostile boxes."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from stereo.camera import PinholeCamera
from stereo.census import census, cost_curves
from stereo.patch_matcher import PatchMatcher, PatchMatcherSettings
from stereo.patches import Patch
from stereo.rig import StereoRig

Image = npt.NDArray[np.uint8]
FloatArray = npt.NDArray[np.float64]

BOX = np.array([[200.0, 40.0, 280.0, 100.0]])
NO_PRIOR = np.array([np.nan])
EXACT = PatchMatcherSettings(alignment_sigma_px=0.02)


def texture(seed: int, *, height: int = 140, width: int = 400, blur_px: float = 1.2) -> FloatArray:
    """Smooth random grey values, 0..255."""
    noise = np.random.default_rng(seed).normal(size=(height, width))
    smooth = cv2.GaussianBlur(noise, (0, 0), blur_px)
    return np.clip(128 + 50 * smooth / smooth.std(), 0, 255)


def shifted(image: FloatArray, shift_px: float) -> FloatArray:
    """The image moved to the left by a fraction of a pixel, exactly: a phase ramp in Fourier space."""
    frequency = np.fft.rfftfreq(image.shape[1])
    return np.fft.irfft(np.fft.rfft(image, axis=1) * np.exp(2j * np.pi * frequency * shift_px), image.shape[1], axis=1)


def pair(disparity_px: float, *, seed: int = 0, noise: float = 0.0) -> tuple[Image, Image]:
    left = texture(seed)
    right = shifted(left, disparity_px)
    sensor = np.random.default_rng(seed + 1000).normal(scale=noise, size=(2, *left.shape)) if noise else np.zeros(2)
    return to_u8(left + sensor[0]), to_u8(right + sensor[1])


def to_u8(image: FloatArray) -> Image:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def slow_cost_bits(left: Image, right: Image, patch: Patch, disparity_px: int) -> float:
    """Mean differing bits of a patch, neighbour by neighbour, as the definition says."""
    bits = []
    for y in range(patch.top, patch.bottom + 1):
        for x in range(patch.left, patch.right + 1):
            if 2 <= x - disparity_px <= right.shape[1] - 3:
                bits.append(slow_differing_bits(left, right, (x, y), disparity_px))
    return float(np.mean(bits))


def slow_differing_bits(left: Image, right: Image, xy: tuple[int, int], disparity_px: int) -> int:
    x, y = xy
    count = 0
    for dy in range(-2, 3):
        for dx in range(-2, 3):
            ours = left[y + dy, x + dx] > left[y, x]
            theirs = right[y + dy, x + dx - disparity_px] > right[y, x - disparity_px]
            count += int(ours != theirs)
    return count


def test_census_bits_of_one_window_are_its_comparisons() -> None:
    window = np.arange(25, dtype=np.uint8).reshape(5, 5)  # the 12 pixels after the centre are brighter
    assert census(window).shape == (1, 1)
    assert int(census(window)[0, 0]).bit_count() == 12
    assert int(census(np.full((5, 5), 7, np.uint8))[0, 0]) == 0


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("first_px", "last_px"), [(0, 24), (18, 40)])
def test_costs_equal_brute_force(seed: int, first_px: int, last_px: int) -> None:
    left, right = pair(11.3 if first_px == 0 else 27.6, seed=seed, noise=4.0)
    patch = Patch(40, 20, 54, 31)
    fast = cost_curves(left, right, patch, first_px=first_px, last_px=last_px, row_step=1)
    slow = [slow_cost_bits(left, right, patch, d) for d in range(first_px, last_px + 1)]
    assert np.allclose(fast.whole, slow)
    assert fast.first_px + int(fast.whole.argmin()) == first_px + int(np.argmin(slow))


def test_matcher_gives_the_brute_force_minimum_to_within_half_a_pixel() -> None:
    matcher = PatchMatcher(PatchMatcherSettings(max_disparity_px=40))
    for seed, true_px in enumerate((3.2, 8.9, 17.5, 26.1)):
        left, right = pair(true_px, seed=seed, noise=6.0)
        patch = Patch(95, 50, 110, 61)
        slow = int(np.argmin([slow_cost_bits(left, right, patch, d) for d in range(41)]))
        box = np.array([[87.5, 44.5, 118.0, 67.5]])
        found, _ = matcher.match(left, right, box, NO_PRIOR)
        assert abs(found[0] - slow) <= 0.5
        assert abs(found[0] - true_px) < 0.6


def test_row_step_takes_every_nth_row() -> None:
    left, right = pair(9.0)
    patch = Patch(100, 30, 140, 71)
    rows = [
        cost_curves(left, right, Patch(100, y, 140, y), first_px=0, last_px=20, row_step=1).whole
        for y in range(30, 72, 7)
    ]
    assert np.allclose(cost_curves(left, right, patch, first_px=0, last_px=20, row_step=7).whole, np.mean(rows, axis=0))


def test_subpixel_error_on_known_shifts() -> None:
    shifts_px = np.round(np.linspace(2.05, 60.0, 60), 3)
    errors = []
    for seed, shift_px in enumerate(shifts_px):
        left, right = pair(float(shift_px), seed=seed, noise=1.5)
        for prior in (NO_PRIOR, np.array([shift_px + 3.0])):
            found, _ = PatchMatcher().match(left, right, BOX, prior)
            errors.append(found[0] - shift_px)
    absolute = np.abs(errors)
    assert np.isfinite(absolute).all()
    assert 0.001 < np.median(absolute) < 0.05
    assert np.percentile(absolute, 95) < 0.12
    assert abs(np.mean(errors)) < 0.02


def test_sigma_is_honest_where_the_eyes_are_exact() -> None:
    ratio = []
    for seed in range(60):
        shift_px = 5.0 + 0.37 * seed
        left, right = pair(shift_px, seed=seed, noise=8.0)
        found, sigma = PatchMatcher(EXACT).match(left, right, np.array([[200.0, 40.0, 240.0, 76.0]]), NO_PRIOR)
        ratio.append(abs(found[0] - shift_px) / sigma[0])
    within = float(np.mean(np.array(ratio) < 1))
    assert 0.5 <= within <= 0.85
    assert np.mean(np.array(ratio) < 2) >= 0.9


def test_a_stereo_distance_by_hand() -> None:
    # f = 1000 px, B = 0.5 m, d = 10 px -> 50 m
    left, right = pair(10.0)
    found, _ = PatchMatcher().match(left, right, BOX, NO_PRIOR)
    rig = StereoRig.rectified(PinholeCamera(1000.0, 1000.0, 200.0, 70.0, 400, 140), 0.5)
    assert rig.distance_m(found)[0] == pytest.approx(50.0, abs=0.3)


def test_colour_and_grey_agree_and_exposure_does_not_matter() -> None:
    left, right = pair(12.4)
    grey, _ = PatchMatcher().match(left, right, BOX, NO_PRIOR)
    colour, _ = PatchMatcher().match(np.dstack([left] * 3), np.dstack([right] * 3), BOX, NO_PRIOR)
    darker, _ = PatchMatcher().match(left, to_u8(right * 0.7 + 20), BOX, NO_PRIOR)
    assert grey[0] == pytest.approx(colour[0])
    assert grey[0] == pytest.approx(darker[0], abs=0.05)


def test_a_wrong_prior_falls_back_to_the_full_range() -> None:
    left, right = pair(30.0)
    for prior_px in (30.0, 24.0, 33.9, 10.0, 100.0, -5.0, 1e9, np.inf):
        found, _ = PatchMatcher().match(left, right, BOX, np.array([prior_px]))
        assert found[0] == pytest.approx(30.0, abs=0.05)


def test_a_ramp_without_texture_is_refused() -> None:
    flat = np.full((140, 400), 90, np.uint8)
    ramp = np.tile(np.linspace(0, 255, 140).astype(np.uint8)[:, None], (1, 400))
    for image in (flat, ramp):
        found, sigma = PatchMatcher().match(image, image, BOX, NO_PRIOR)
        assert np.isnan(found).all()
        assert np.isnan(sigma).all()


def test_noise_that_does_not_correspond_is_refused() -> None:
    rng = np.random.default_rng(5)
    boxes = np.array([[210.0 + 10 * i, 30.0, 230.0 + 12 * i, 60.0 + 3 * i] for i in range(10)])
    priors = np.where(np.arange(10) % 2 == 0, np.nan, 20.0)
    n_found = 0
    for _ in range(10):
        left, right = rng.integers(0, 256, (2, 140, 400), dtype=np.uint8)
        found, _ = PatchMatcher().match(left, right, boxes, priors)
        n_found += int(np.isfinite(found).sum())
    assert n_found <= 1  # of 100


def test_repeated_texture_is_refused_without_a_prior_and_matched_with_one() -> None:
    fence = np.tile(texture(3, width=32), (1, 13))[:, :400]
    left, right = to_u8(fence), to_u8(np.roll(fence, -20, axis=1))
    found, _ = PatchMatcher().match(left, right, BOX, NO_PRIOR)
    assert np.isnan(found[0])
    found, _ = PatchMatcher().match(left, right, BOX, np.array([21.0]))
    assert found[0] == pytest.approx(20.0, abs=0.05)


def test_zero_disparity_and_disparities_beyond_the_range_are_refused() -> None:
    left, _ = pair(5.0)
    assert np.isnan(PatchMatcher().match(left, left, BOX, NO_PRIOR)[0][0])
    left, right = pair(60.0)
    narrow = PatchMatcher(PatchMatcherSettings(max_disparity_px=50))
    assert np.isnan(narrow.match(left, right, BOX, NO_PRIOR)[0][0])


def test_what_the_right_eye_does_not_see_is_no_match() -> None:
    left, right = to_u8(texture(0)), to_u8(texture(0))
    right[:, :-60] = left[:, 60:]  # disparity 60; the left image's first 60 columns are outside the right one
    right[:, -60:] = to_u8(texture(9))[:, -60:]
    unseen, partly = np.array([[0.0, 40.0, 60.0, 100.0]]), np.array([[30.0, 40.0, 110.0, 100.0]])
    assert np.isnan(PatchMatcher().match(left, right, unseen, NO_PRIOR)[0][0])
    assert PatchMatcher().match(left, right, partly, NO_PRIOR)[0][0] == pytest.approx(60.0, abs=0.1)


def test_boxes_that_cannot_be_measured_are_nan_and_leave_the_others_alone() -> None:
    left, right = pair(12.0)
    nan, inf = np.nan, np.inf
    boxes = np.array(
        [
            BOX[0],
            [100.0, 50.0, 104.0, 54.0],  # 4 px
            [-500.0, 10.0, -400.0, 60.0],  # outside
            [500.0, 10.0, 600.0, 60.0],
            [nan, 10.0, 60.0, 60.0],
            [10.0, 10.0, inf, 60.0],
            [-inf, -inf, inf, inf],
            [90.0, 90.0, 40.0, 40.0],  # inside out
            [1e300, 1e300, 1e301, 1e301],
        ]
    )
    found, sigma = PatchMatcher().match(left, right, boxes, np.full(len(boxes), np.nan))
    assert found[0] == pytest.approx(12.0, abs=0.05)
    assert np.isnan(found[1:]).all()
    assert np.array_equal(np.isnan(found), np.isnan(sigma))


def test_a_box_as_large_as_the_image_is_measured_where_all_of_it_is_one_plane() -> None:
    left, right = pair(12.0)
    found, _ = PatchMatcher().match(left, right, np.array([[-0.5, -0.5, 399.5, 139.5]]), NO_PRIOR)
    assert found[0] == pytest.approx(12.0, abs=0.05)


def test_no_boxes_give_no_disparities() -> None:
    left, right = pair(12.0)
    found, sigma = PatchMatcher().match(left, right, np.zeros((0, 4)), np.zeros(0))
    assert found.shape == sigma.shape == (0,)


def test_images_of_different_size_are_an_error() -> None:
    left, right = pair(12.0)
    with pytest.raises(ValueError, match="equal shapes"):
        PatchMatcher().match(left, right[:-1], BOX, NO_PRIOR)


@settings(deadline=None, max_examples=60)
@given(
    hnp.arrays(np.float64, (3, 4), elements=st.floats(-600, 600) | st.just(np.nan)),
    hnp.arrays(np.float64, 3, elements=st.floats(allow_nan=True, allow_infinity=True)),
)
def test_any_box_and_prior_is_taken_without_a_word(boxes: FloatArray, priors: FloatArray) -> None:
    left, right = pair(12.0)
    found, sigma = PatchMatcher().match(left, right, boxes, priors)
    known = np.isfinite(found)
    assert np.array_equal(known, np.isfinite(sigma))
    assert (sigma[known] > 0).all()
    assert np.allclose(found[known], 12.0, atol=1.5)


def test_settings_for_a_rig_reach_the_nearest_distance() -> None:
    rig = StereoRig.rectified(PinholeCamera(1000.0, 1000.0, 640.0, 360.0, 1280, 720), 0.5)
    assert PatchMatcherSettings.for_rig(rig, nearest_m=2.0).max_disparity_px == 250
