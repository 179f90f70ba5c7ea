"""Surfaces refined by grey values: exact subpixel shifts, other exposures, and windows without a
match."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from tests.stereo.shifted_pairs import Image, pair, shifted, texture, tilted_pair, to_u8
from tests.stereo.tile_cases import EXACT_BOX, box_of_scale, tiles_of
from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.stereo.evaluation.kitti_2015 import pair_names, read_pair
from track_range.stereo.matching.patch_matcher import PatchMatcher
from track_range.stereo.matching.subpixel import RefinedSurface, refine_surface
from track_range.stereo.matching.surfaces import SurfaceFit
from track_range.stereo.matching.tiles import COARSE, FINE, BoxTiles, TileShape

WHOLE = 20
FRACTIONS = np.arange(-0.5, 0.5, 0.1)

FLOOR_PX2 = 0.06**2 + (0.01 * WHOLE) ** 2
UNCONFIRMED_WEIGHT = 1.0 / (0.2**2 + FLOOR_PX2)


def refined(tiles: BoxTiles, start_px: float, is_member: BoolArray | None = None) -> RefinedSurface:
    """The refined surface of a box whose windows all have the census disparity `start_px`, px of
    the image."""
    index = np.full((1, 49), (start_px - tiles.first_px[0]) / tiles.scale[0, 0])
    plane = SurfaceFit(np.array([[index[0, 0], 0.0, 0.0, 0.0, 0.0]]))
    return refine_surface(tiles, index, tiles.is_used if is_member is None else is_member, plane)


def measured_px(
    images: tuple[Image, Image], start_px: float, box: tuple[float, ...] = EXACT_BOX
) -> float:
    """Disparity at the centre of a box."""
    tiles = tiles_of(images, box)
    return float(tiles.disparity_px(refined(tiles, start_px).fit.p[:, 0])[0])


def windows_px(tiles: BoxTiles, surface: RefinedSurface) -> FloatArray:
    """(G,) disparities of the windows."""
    return tiles.disparity_px(surface.fit.at(tiles.u, tiles.v) + surface.residual)[0]


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 2.0])
@pytest.mark.parametrize("blur_px", [0.8, 1.2, 2.5])
def test_no_fraction_of_a_pixel_is_preferred(noise: float, blur_px: float) -> None:
    bias = []
    for fraction in FRACTIONS:
        pairs = [
            pair(WHOLE + fraction, seed=seed, noise=noise, blur_px=blur_px) for seed in range(6)
        ]
        bias.append(
            np.mean(
                [measured_px(both, WHOLE + 0.7 * fraction) - WHOLE - fraction for both in pairs]
            )
        )
    assert np.abs(bias).max() < 0.012


@pytest.mark.parametrize("shape", [FINE, COARSE])
@pytest.mark.parametrize("scale", [1.0, 1.25, 1.5, 2.5])
def test_exact_shifts_at_each_scale(scale: float, shape: TileShape) -> None:
    """Tiles of all scales resample both images in the same way: no scale is biased."""
    scale *= shape.min_scale
    for seed, true_px in enumerate((20.0, 21.3, 23.9)):
        images = pair(true_px, seed=seed, height=400, width=600, blur_px=1.2 * scale)
        tiles = tiles_of(images, box_of_scale(scale, shape), first_px=20.0 - 4 * scale, shape=shape)
        assert tiles.scale[:, 0].tolist() == [scale, scale]
        surface = refined(tiles, true_px + 0.3 * scale)
        assert tiles.disparity_px(surface.fit.p[:, 0])[0] == pytest.approx(
            true_px, abs=0.02 * scale
        )
        assert surface.is_confirmed.mean() > 0.9


def test_scatter_matches_the_weights() -> None:
    ratio = []
    for seed in range(10):
        tiles = tiles_of(pair(WHOLE + 0.3, seed=seed, noise=8.0))
        surface = refined(tiles, WHOLE + 0.2)
        assert surface.is_confirmed.mean() > 0.8
        error = windows_px(tiles, surface) - WHOLE - 0.3
        variance = 1.0 / surface.weight[0] - FLOOR_PX2
        ratio.append((error / np.sqrt(variance))[surface.is_confirmed[0]])
    assert 0.8 < np.sqrt((np.concatenate(ratio) ** 2).mean()) < 1.2


def test_noise_lowers_the_weight() -> None:
    weight = [
        np.median(refined(tiles_of(pair(WHOLE + 0.3, noise=noise)), WHOLE + 0.2).weight)
        for noise in (0.0, 8.0, 16.0)
    ]
    assert 1.0 / FLOOR_PX2 > weight[0] > weight[1] > weight[2]


@pytest.mark.parametrize("start", [-0.3, -0.1, 0.5])
def test_initial_disparity_hardly_matters(start: float) -> None:
    images = pair(WHOLE + 0.1, noise=1.0)
    assert measured_px(images, WHOLE + start) == pytest.approx(
        measured_px(images, WHOLE + 0.1), abs=0.01
    )


def test_exposure_does_not_matter() -> None:
    left, right = pair(WHOLE + 0.35)
    for other in (to_u8(right * 0.5 + 60), to_u8(right * 0.8), to_u8(right * 1.2 - 30)):
        assert measured_px((left, other), WHOLE + 0.2) == pytest.approx(WHOLE + 0.35, abs=0.015)


def test_vertical_offset_hardly_matters() -> None:
    left, right = texture(0), shifted(texture(0), WHOLE + 0.3)
    for offset_px in (-0.2, 0.2):
        moved = shifted(np.ascontiguousarray(right.T), offset_px).T
        assert measured_px((to_u8(left), to_u8(moved)), WHOLE + 0.2) == pytest.approx(
            WHOLE + 0.3, abs=0.02
        )


def test_slanted_wall() -> None:
    slope = 0.02
    tiles = tiles_of(tilted_pair(WHOLE, slope, at_px=223.5))
    surface = refined(tiles, WHOLE)
    expected = WHOLE + slope * 48.0 * tiles.u[0]
    assert np.median(np.abs(windows_px(tiles, surface) - expected)) < 0.02
    assert np.ptp(expected) > 0.7
    assert surface.fit.p[0, 0] == pytest.approx(WHOLE - tiles.first_px[0], abs=0.02)


def test_unconfirmed_windows_keep_census_disparities() -> None:
    unrelated = tiles_of((to_u8(texture(0)), to_u8(texture(500))))
    inverted = tiles_of((pair(WHOLE)[0], to_u8(255.0 - shifted(texture(0), WHOLE))))
    for tiles in (unrelated, inverted):
        surface = refined(tiles, WHOLE + 0.25)
        confirmed = surface.is_confirmed[0]
        assert confirmed.mean() < 0.5
        np.testing.assert_allclose(windows_px(tiles, surface)[~confirmed], WHOLE + 0.25)
        np.testing.assert_allclose(surface.weight[0, ~confirmed], UNCONFIRMED_WEIGHT, rtol=0.02)
        assert (surface.weight[0, confirmed] > UNCONFIRMED_WEIGHT).all()
    assert not surface.is_confirmed.any()


def test_windows_of_other_surfaces_and_without_texture() -> None:
    tiles = tiles_of(pair(WHOLE))
    is_member = tiles.u < 0.1
    surface = refined(tiles, WHOLE, is_member)
    assert np.array_equal(np.isfinite(surface.residual), is_member)
    assert np.array_equal(surface.weight > 0, is_member)
    assert not surface.is_confirmed[~is_member].any()
    flat = tiles_of((np.full((140, 400), 90, np.uint8),) * 2)
    surface = refined(flat, WHOLE + 0.1)
    assert not surface.is_confirmed.any()
    np.testing.assert_allclose(windows_px(flat, surface), WHOLE + 0.1)
    np.testing.assert_allclose(surface.weight, UNCONFIRMED_WEIGHT, rtol=0.02)


def test_surfaces_of_boxes_are_independent() -> None:
    boxes = (EXACT_BOX, (100.0, 20.0, 300.0, 120.0), (180.0, 60.0, 200.0, 80.0))
    images = pair(WHOLE + 0.3, noise=3.0)
    tiles = tiles_of(images, *boxes, first_px=12.0)
    index = (WHOLE - tiles.first_px)[:, None] / tiles.scale[0][:, None] + np.zeros((3, 49))
    planes = SurfaceFit(np.stack([index[:, 0], *np.zeros((4, 3))], axis=1))
    together = refine_surface(tiles, index, tiles.is_used, planes)
    for i, box in enumerate(boxes):
        alone = refined(tiles_of(images, box, first_px=12.0), WHOLE)
        assert together.fit.p[i] == pytest.approx(alone.fit.p[0], abs=1e-5)
        assert np.array_equal(together.is_confirmed[i], alone.is_confirmed[0])


def test_subpixel_shift_of_real_cars(shared_data: Path) -> None:
    """Pixel locking without ground truth: shifting the right image by half a pixel must change d by
    as much."""
    matcher, error_px = PatchMatcher(), []
    for name in pair_names(shared_data / "kitti2015")[:6]:
        real = read_pair(shared_data / "kitti2015", name)
        right = cv2.cvtColor(np.asarray(real.right), cv2.COLOR_BGR2GRAY)
        reference = matcher.match(
            real.left, right, real.xyxy_px, np.full(len(real.true_px), np.nan)
        ).disparity_px
        for shift_px in (0.25, 0.5):
            shift = np.array([[1.0, 0.0, shift_px], [0.0, 1.0, 0.0]])
            flags = cv2.INTER_LANCZOS4 | cv2.WARP_INVERSE_MAP
            moved = np.asarray(
                cv2.warpAffine(right, shift, right.shape[::-1], flags=flags), np.uint8
            )
            matches = matcher.match(
                real.left, moved, real.xyxy_px, reference + shift_px
            ).disparity_px
            error_px.append(matches - reference - shift_px)
    abs_error_px = np.abs(np.concatenate(error_px))
    assert len(abs_error_px) >= 20
    assert np.nanmedian(abs_error_px) < 0.03


@settings(deadline=None, max_examples=25)
@given(
    st.integers(0, 10_000),
    st.floats(-0.5, 0.5),
    st.sampled_from(["noise", "texture", "black", "white", "edge"]),
)
def test_any_pixels_give_finite_numbers(seed: int, start: float, kind: str) -> None:
    rng = np.random.default_rng(seed)
    left = rng.integers(0, 256, (140, 400), dtype=np.uint8)
    right = {
        "noise": rng.integers(0, 256, (140, 400), dtype=np.uint8),
        "texture": to_u8(texture(seed)),
        "black": np.zeros((140, 400), np.uint8),
        "white": np.full((140, 400), 255, np.uint8),
        "edge": np.repeat(
            np.where(np.arange(400) < 240, 0, 255).astype(np.uint8)[None], 140, axis=0
        ),
    }[kind]
    for images in ((left, right), (right, left)):
        tiles = tiles_of(images)
        surface = refined(tiles, WHOLE + start)
        assert np.isfinite(surface.fit.p).all()
        moved_px = windows_px(tiles, surface) - WHOLE - start
        assert (np.abs(moved_px) <= 3.0).all()
        assert (
            (surface.weight >= UNCONFIRMED_WEIGHT * 0.8) & (surface.weight < 1.0 / FLOOR_PX2 * 1.2)
        ).all()
        assert moved_px[~surface.is_confirmed[0]] == pytest.approx(0.0, abs=1e-9)
