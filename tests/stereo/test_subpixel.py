"""Windows refined by their grey values: exact shifts of any fraction, other exposures, and what does not fit."""

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
UNFIT_WEIGHT = 1.0 / (0.6**2 + FLOOR_PX2)


def refined(eyes: tuple[Image, Image], start: float, *, slope: float = 4.0) -> tuple[WindowMatches, BoolArray]:
    """A box's windows, all of which census puts at `WHOLE` + `start`."""
    windows = BoxWindows.of_boxes(BOX, (eyes[0].shape[0], eyes[0].shape[1]))
    shape = windows.column.shape
    found = WindowMatches(np.full(shape, 3), np.full(shape, start), np.full(shape, slope))
    left, right = (GreyLevels.of(eye, 1) for eye in eyes)
    return refine_windows(left, right, windows, found, first=np.array([WHOLE - 3]))


def pooled(eyes: tuple[Image, Image], start: float) -> float:
    """The windows' mean by weight."""
    found, _ = refined(eyes, start)
    return float(np.average(found.offset, weights=found.weight))


@pytest.mark.parametrize("noise", [0.0, 2.0])
@pytest.mark.parametrize("blur_px", [0.8, 1.2, 2.5])
def test_no_fraction_of_a_pixel_is_preferred(noise: float, blur_px: float) -> None:
    bias = []
    for fraction in FRACTIONS:
        eyes = [pair(WHOLE + fraction, seed=seed, noise=noise, blur_px=blur_px) for seed in range(6)]
        bias.append(np.mean([pooled(both, 0.7 * fraction) - fraction for both in eyes]))
    assert np.abs(bias).max() < 0.01


def test_scatter_matches_the_weights() -> None:
    ratio = []
    for seed in range(10):
        found, is_sure = refined(pair(WHOLE + 0.3, seed=seed, noise=8.0), 0.2)
        assert is_sure.mean() > 0.8
        ratio.append(((found.offset - 0.3) / np.sqrt(1.0 / found.weight - FLOOR_PX2))[is_sure])
    assert 0.8 < np.sqrt((np.concatenate(ratio) ** 2).mean()) < 1.2


def test_noise_lowers_the_weight() -> None:
    weight = [np.median(refined(pair(WHOLE + 0.3, noise=noise), 0.2)[0].weight) for noise in (0.0, 4.0, 12.0)]
    assert 1.0 / FLOOR_PX2 > weight[0] > weight[1] > 1.2 * weight[2]


@pytest.mark.parametrize("start", [-0.3, -0.1, 0.5])
def test_initial_offset_hardly_matters(start: float) -> None:
    eyes = pair(WHOLE + 0.1, noise=1.0)
    assert pooled(eyes, start) == pytest.approx(pooled(eyes, 0.1), abs=0.01)


def test_exposure_does_not_matter() -> None:
    left, right = pair(WHOLE + 0.35)
    for other in (to_u8(right * 0.5 + 60), to_u8(right * 0.8), to_u8(right * 1.2 - 30)):
        assert pooled((left, other), 0.2) == pytest.approx(0.35, abs=0.01)


def test_slanted_wall() -> None:
    slope = 0.01
    found, _ = refined(tilted_pair(WHOLE, slope, at_px=260.0), 0.0)
    windows = BoxWindows.of_boxes(BOX, (140, 400))
    expected = slope * (windows.column + 4 - 260.0)
    assert np.median(np.abs(found.offset - expected)) < 0.02
    assert np.ptp(expected) > 0.4


def test_unconfirmed_windows_keep_census_disparities() -> None:
    found, is_sure = refined((to_u8(texture(0)), to_u8(texture(500))), 0.25)
    assert is_sure.mean() < 0.5
    np.testing.assert_array_equal(found.offset[~is_sure], 0.25)
    np.testing.assert_allclose(found.weight[~is_sure], UNFIT_WEIGHT)
    assert (found.weight[is_sure] > UNFIT_WEIGHT).all()
    inverted = pair(WHOLE)[0], to_u8(255.0 - shifted(texture(0), WHOLE))
    assert not refined(inverted, 0.25)[1].any()


def test_windows_without_a_minimum_or_texture() -> None:
    found, is_sure = refined(pair(WHOLE), 0.0, slope=0.0)
    assert (found.weight == 0).all()
    assert not is_sure.any()
    flat = np.full((140, 400), 90, np.uint8)
    found, is_sure = refined((flat, flat), 0.1)
    assert not is_sure.any()
    np.testing.assert_array_equal(found.offset, 0.1)
    np.testing.assert_allclose(found.weight, UNFIT_WEIGHT)


def test_subpixel_shift_of_real_cars(shared_data: Path) -> None:
    """What pulls to whole pixels shows without a truth: a right image moved by half a pixel must change d by that."""
    matcher, error_px = PatchMatcher(), []
    for name in pair_names(shared_data / "kitti2015")[:6]:
        real = read_pair(shared_data / "kitti2015", name)
        right = cv2.cvtColor(np.asarray(real.right), cv2.COLOR_BGR2GRAY)
        still = matcher.match(real.left, right, real.xyxy_px, np.full(len(real.true_px), np.nan)).disparity_px
        for shift_px in (0.25, 0.5):
            to_the_left = np.array([[1.0, 0.0, shift_px], [0.0, 1.0, 0.0]])
            flags = cv2.INTER_LANCZOS4 | cv2.WARP_INVERSE_MAP
            moved = np.asarray(cv2.warpAffine(right, to_the_left, right.shape[::-1], flags=flags), np.uint8)
            found = matcher.match(real.left, moved, real.xyxy_px, still + shift_px).disparity_px
            error_px.append(found - still - shift_px)
    off_px = np.abs(np.concatenate(error_px))
    assert len(off_px) >= 20
    assert 0.0 < np.nanmedian(off_px) < 0.03


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
    for eyes in ((left, right), (right, left)):
        found, is_sure = refined(eyes, start)
        assert np.isfinite(found.offset).all()
        assert (np.abs(found.offset) <= 1.0).all()
        assert ((found.weight >= UNFIT_WEIGHT) & (found.weight < 1.0 / FLOOR_PX2)).all()
        assert (found.offset[~is_sure] == start).all()
