"""Windows refined by their grey values: exact subpixel shifts, other exposures, and windows without a match."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.stereo.shifted_pairs import Image, pair, shifted, texture, tilted_pair, to_u8
from track_range.foundation.arrays import BoolArray
from track_range.stereo.evaluation.kitti_2015 import pair_names, read_pair
from track_range.stereo.matching.patch_matcher import PatchMatcher
from track_range.stereo.matching.sample_windows import BoxWindows, GreyLevels
from track_range.stereo.matching.subpixel import refine_windows
from track_range.stereo.matching.window_sgm import WindowMatches

BOX = np.array([[200.0, 20.0, 320.0, 120.0]])
WHOLE = 20
FRACTIONS = np.arange(-0.5, 0.5, 0.1)

FLOOR_PX2 = 0.06**2 + (0.006 * WHOLE) ** 2
UNCONFIRMED_WEIGHT = 1.0 / (0.6**2 + FLOOR_PX2)


def refined(images: tuple[Image, Image], start: float, *, slope: float = 4.0) -> tuple[WindowMatches, BoolArray]:
    """Refined windows of a box, all with the census disparity `WHOLE` + `start`."""
    windows = BoxWindows.of_boxes(BOX, (images[0].shape[0], images[0].shape[1]))
    shape = windows.column.shape
    matches = WindowMatches(np.full(shape, 3), np.full(shape, start), np.full(shape, slope))
    left, right = (GreyLevels.of(image, 1) for image in images)
    return refine_windows(left, right, windows, matches, first=np.array([WHOLE - 3]))


def pooled(images: tuple[Image, Image], start: float) -> float:
    """Weighted mean offset of the windows."""
    matches, _ = refined(images, start)
    return float(np.average(matches.offset, weights=matches.weight))


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 2.0])
@pytest.mark.parametrize("blur_px", [0.8, 1.2, 2.5])
def test_no_fraction_of_a_pixel_is_preferred(noise: float, blur_px: float) -> None:
    bias = []
    for fraction in FRACTIONS:
        pairs = [pair(WHOLE + fraction, seed=seed, noise=noise, blur_px=blur_px) for seed in range(6)]
        bias.append(np.mean([pooled(both, 0.7 * fraction) - fraction for both in pairs]))
    assert np.abs(bias).max() < 0.01


def test_scatter_matches_the_weights() -> None:
    ratio = []
    for seed in range(10):
        matches, is_confirmed = refined(pair(WHOLE + 0.3, seed=seed, noise=8.0), 0.2)
        assert is_confirmed.mean() > 0.8
        ratio.append(((matches.offset - 0.3) / np.sqrt(1.0 / matches.weight - FLOOR_PX2))[is_confirmed])
    assert 0.8 < np.sqrt((np.concatenate(ratio) ** 2).mean()) < 1.2


def test_noise_lowers_the_weight() -> None:
    weight = [np.median(refined(pair(WHOLE + 0.3, noise=noise), 0.2)[0].weight) for noise in (0.0, 4.0, 12.0)]
    assert 1.0 / FLOOR_PX2 > weight[0] > weight[1] > 1.2 * weight[2]


@pytest.mark.parametrize("start", [-0.3, -0.1, 0.5])
def test_initial_offset_hardly_matters(start: float) -> None:
    images = pair(WHOLE + 0.1, noise=1.0)
    assert pooled(images, start) == pytest.approx(pooled(images, 0.1), abs=0.01)


def test_exposure_does_not_matter() -> None:
    left, right = pair(WHOLE + 0.35)
    for other in (to_u8(right * 0.5 + 60), to_u8(right * 0.8), to_u8(right * 1.2 - 30)):
        assert pooled((left, other), 0.2) == pytest.approx(0.35, abs=0.01)


def test_slanted_wall() -> None:
    slope = 0.01
    matches, _ = refined(tilted_pair(WHOLE, slope, at_px=260.0), 0.0)
    windows = BoxWindows.of_boxes(BOX, (140, 400))
    expected = slope * (windows.column + 4 - 260.0)
    assert np.median(np.abs(matches.offset - expected)) < 0.02
    assert np.ptp(expected) > 0.4


def test_unconfirmed_windows_keep_census_disparities() -> None:
    matches, is_confirmed = refined((to_u8(texture(0)), to_u8(texture(500))), 0.25)
    assert is_confirmed.mean() < 0.5
    np.testing.assert_array_equal(matches.offset[~is_confirmed], 0.25)
    np.testing.assert_allclose(matches.weight[~is_confirmed], UNCONFIRMED_WEIGHT)
    assert (matches.weight[is_confirmed] > UNCONFIRMED_WEIGHT).all()
    inverted = pair(WHOLE)[0], to_u8(255.0 - shifted(texture(0), WHOLE))
    assert not refined(inverted, 0.25)[1].any()


def test_windows_without_a_minimum_or_texture() -> None:
    matches, is_confirmed = refined(pair(WHOLE), 0.0, slope=0.0)
    assert (matches.weight == 0).all()
    assert not is_confirmed.any()
    flat = np.full((140, 400), 90, np.uint8)
    matches, is_confirmed = refined((flat, flat), 0.1)
    assert not is_confirmed.any()
    np.testing.assert_array_equal(matches.offset, 0.1)
    np.testing.assert_allclose(matches.weight, UNCONFIRMED_WEIGHT)


def test_subpixel_shift_of_real_cars(shared_data: Path) -> None:
    """Pixel locking without ground truth: shifting the right image by half a pixel must change d by as much."""
    matcher, error_px = PatchMatcher(), []
    for name in pair_names(shared_data / "kitti2015")[:6]:
        real = read_pair(shared_data / "kitti2015", name)
        right = cv2.cvtColor(np.asarray(real.right), cv2.COLOR_BGR2GRAY)
        reference = matcher.match(real.left, right, real.xyxy_px, np.full(len(real.true_px), np.nan)).disparity_px
        for shift_px in (0.25, 0.5):
            shift = np.array([[1.0, 0.0, shift_px], [0.0, 1.0, 0.0]])
            flags = cv2.INTER_LANCZOS4 | cv2.WARP_INVERSE_MAP
            moved = np.asarray(cv2.warpAffine(right, shift, right.shape[::-1], flags=flags), np.uint8)
            matches = matcher.match(real.left, moved, real.xyxy_px, reference + shift_px).disparity_px
            error_px.append(matches - reference - shift_px)
    abs_error_px = np.abs(np.concatenate(error_px))
    assert len(abs_error_px) >= 20
    assert np.nanmedian(abs_error_px) < 0.03


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10_000), st.floats(-0.5, 0.5), st.sampled_from(["noise", "texture", "black", "white", "edge"]))
def test_any_pixels_give_finite_numbers(seed: int, start: float, kind: str) -> None:
    rng = np.random.default_rng(seed)
    left = rng.integers(0, 256, (140, 400), dtype=np.uint8)
    right = {
        "noise": rng.integers(0, 256, (140, 400), dtype=np.uint8),
        "texture": to_u8(texture(seed)),
        "black": np.zeros((140, 400), np.uint8),
        "white": np.full((140, 400), 255, np.uint8),
        "edge": np.repeat(np.where(np.arange(400) < 240, 0, 255).astype(np.uint8)[None], 140, axis=0),
    }[kind]
    for images in ((left, right), (right, left)):
        matches, is_confirmed = refined(images, start)
        assert np.isfinite(matches.offset).all()
        assert (np.abs(matches.offset) <= 1.0).all()
        assert ((matches.weight >= UNCONFIRMED_WEIGHT) & (matches.weight < 1.0 / FLOOR_PX2)).all()
        assert (matches.offset[~is_confirmed] == start).all()
