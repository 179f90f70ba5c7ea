"""Dense disparities of known shifts, and medians of boxes by hand."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from track_range.foundation.arrays import Image
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.matching.sgbm import (
    Mode,
    Sgbm,
    SgbmSettings,
    centre_disparity,
    disparity_picture,
)


def pair(disparity_px: int, *, width: int = 400) -> tuple[Image, Image]:
    """A fronto-parallel wall: left(x) = right(x - disparity)."""
    noise = np.random.default_rng(1).normal(size=(120, width + disparity_px))
    wall = cv2.normalize(
        cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX
    ).astype(np.uint8)
    return wall[:, :width].copy(), wall[:, disparity_px : disparity_px + width].copy()


@pytest.mark.parametrize("mode", ["3way", "sgbm", "hh", "hh4"])
def test_a_wall_has_one_disparity(mode: Mode) -> None:
    left, right = pair(24)
    disparity = Sgbm(SgbmSettings(mode=mode)).dense_disparity(left, right)
    assert disparity.shape == left.shape
    assert disparity.dtype == np.float32
    inside = disparity[10:-10, 40:-10]
    assert np.isfinite(inside).mean() > 0.95
    assert np.nanpercentile(np.abs(inside - 24), 95) < 0.2


def test_left_border_is_matched_if_visible() -> None:
    left, right = pair(24)
    disparity = Sgbm().dense_disparity(left, right)
    # OpenCV alone gives nothing left of column 128
    assert np.isfinite(disparity[10:-10, 30:128]).mean() > 0.9
    assert np.nanmedian(disparity[10:-10, 30:128]) == pytest.approx(24, abs=0.1)
    columns = np.broadcast_to(np.arange(400), disparity.shape)
    known = np.isfinite(disparity)
    assert (disparity[known] <= columns[known]).all()


def test_images_without_texture_are_unknown() -> None:
    flat = np.full((120, 400), 80, np.uint8)
    assert np.isnan(Sgbm().dense_disparity(flat, flat)).mean() > 0.95


def test_colour_is_matched_in_grey() -> None:
    left, right = pair(24)
    grey = Sgbm().dense_disparity(left, right)
    colour = Sgbm().dense_disparity(np.dstack([left] * 3), np.dstack([right] * 3))
    assert np.array_equal(grey, colour, equal_nan=True)


def test_images_of_different_size_are_an_error() -> None:
    left, right = pair(24)
    with pytest.raises(ValueError, match="equal sizes"):
        Sgbm().dense_disparity(left, right[:, :-2])


def test_grey_right_and_colour_left_image() -> None:
    left, right = pair(24)
    both_grey = Sgbm().dense_disparity(left, right)
    assert np.array_equal(
        both_grey, Sgbm().dense_disparity(np.dstack([left] * 3), right), equal_nan=True
    )


def test_settings_for_a_rig_are_whole_sixteens() -> None:
    rig = StereoRig.rectified(PinholeCamera(721.5, 721.5, 609.6, 172.9, 1242, 375), 0.5327)
    assert SgbmSettings.for_rig(rig).n_disparities == 144  # 721.5 * 0.5327 / 3 = 128.1
    assert SgbmSettings.for_rig(rig, nearest_m=1000.0).n_disparities == 16


def test_the_centre_is_one_pixel() -> None:
    disparity = np.full((40, 40), np.nan, np.float32)
    disparity[10:30, 10:30] = 50.0
    disparity[20, 20] = 47.0  # middle of the first box, 19.5, rounds to the even 20
    disparity[5, 33] = 9.0  # the only known pixel in its box
    nan = np.nan
    boxes = np.array(
        [
            [-0.5, -0.5, 39.5, 39.5],
            [30.0, 2.0, 36.0, 8.0],
            [30.0, 20.0, 38.0, 28.0],
            [30.0, 30.0, 60.0, 60.0],
            [-80.0, 0.0, -40.0, 40.0],
            [nan, 0.0, 40.0, 40.0],
            [0.0, 0.0, np.inf, 40.0],
            [-1e308, 0.0, -1e308, 40.0],
            [1e12, 0.0, 1e13, 40.0],
        ]
    )
    centre, sigma = centre_disparity(disparity, boxes, settings=SgbmSettings(shape_share=0.5))
    assert centre[:2].tolist() == [47.0, 9.0]
    assert sigma[:2] == pytest.approx([0.15, 0.15])
    assert np.isnan(centre[2:]).all()
    assert np.isnan(sigma[2:]).all()
    assert centre_disparity(disparity, np.zeros((0, 4)))[0].shape == (0,)


def test_disparity_picture() -> None:
    disparity = np.full((4, 6), np.nan, np.float32)
    disparity[:, 2:4], disparity[:, 4:] = 5.0, 60.0
    picture = disparity_picture(disparity, largest_px=64.0)
    assert (picture.shape, picture.dtype) == ((4, 6, 3), np.uint8)
    assert (picture[:, :2] == 0).all()
    far, near = picture[0, 2].astype(int), picture[0, 4].astype(int)
    assert far[0] > far[2]  # bluer than red
    assert near[2] > near[0]
    assert np.array_equal(
        disparity_picture(disparity, largest_px=30.0)[0, 4], disparity_picture(disparity)[0, 4]
    )
    assert (disparity_picture(np.full((4, 6), np.nan)) == 0).all()


def test_user_settings() -> None:
    rig = StereoRig.rectified(PinholeCamera(721.5, 721.5, 609.6, 172.9, 1242, 375), 0.5327)
    settings = SgbmSettings.for_rig(rig, chosen={"mode": "hh", "block_size": 7})
    assert (settings.mode, settings.block_size, settings.n_disparities) == ("hh", 7, 144)
    assert SgbmSettings.for_rig(rig, chosen={"n_disparities": 64}).n_disparities == 64


def test_other_names_of_settings() -> None:
    names = {"uniqueness_pct": 5, "max_left_right_px": 2, "speckle_px2": 50, "speckle_range_px": 3}
    fields = {
        "uniqueness_ratio": 5,
        "disp12_max_diff": 2,
        "speckle_window_size": 50,
        "speckle_range": 3,
    }
    assert SgbmSettings.of(names) == SgbmSettings(**fields)


@pytest.mark.parametrize(
    ("name", "value", "key_word"),
    [
        ("modes", "hh", "'modes'"),
        ("mode", "best", "'best'"),
        ("n_disparities", 100, "multiple of 16"),
        ("n_disparities", 128.0, "multiple of 16"),
        ("n_disparities", 0, "multiple of 16"),
        ("min_disparity", -1000, "min_disparity"),
        ("block_size", 4, "odd number"),
        ("small_step_penalty", 0, "small_step_penalty"),
        ("large_step_penalty", 8, "small_step_penalty"),
        ("large_step_penalty", 1400, "32767"),
        ("small_step_penalty", "8", "'8'"),
        ("block_size", "5", "'5'"),
        ("mode", ["hh"], "one of 3way"),
        ("speckle_window_size", 10**12, "speckle_window_size"),
        ("uniqueness_ratio", 100, "uniqueness_ratio"),
        ("disp12_max_diff", -2, "disp12_max_diff"),
        ("speckle_px2", "many", "speckle_window_size"),
        ("speckle_range", -1, "speckle_range"),
        ("pre_filter_cap", 0, "pre_filter_cap"),
        ("min_valid_share", 1.5, "min_valid_share"),
        ("min_valid_share", float("nan"), "min_valid_share"),
        ("shape_share", -0.1, "shape_share"),
    ],
)
def test_wrong_settings(name: str, value: object, key_word: str) -> None:
    with pytest.raises(ValueError, match="sgbm") as error:
        SgbmSettings.of({name: value})
    assert key_word in str(error.value)
