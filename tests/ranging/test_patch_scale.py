"""Tests of the growth of objects by registration of patches, on textures that are scaled by known
factors."""

import cv2
import numpy as np
import pytest

from track_range.detection.classes import ROAD_CLASSES
from track_range.ranging.methods.patch_scale import PatchScales
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.tracking.tracks import Tracks

CAMERA = PinholeCamera(700.0, 700.0, 320.0, 180.0, width_px=640, height_px=360)
CAR = ROAD_CLASSES.index("car")
SIZE_PX = np.array([40.0, 32.0])  # of the boxes in the first frame


def texture(seed, sides=(240, 300)):
    rng = np.random.default_rng(seed)
    coarse = cv2.resize(
        rng.uniform(40, 220, (sides[0] // 12, sides[1] // 12)).astype(np.float32), sides[::-1]
    )
    return coarse + cv2.GaussianBlur(rng.normal(0, 40, sides).astype(np.float32), (0, 0), 5)


def scene(objects, *, seed=0, noise=2.0, gain=1.0):
    """(360, 640, 3) image of objects (texture, middle, width and height in px), each over those
    before."""
    rng = np.random.default_rng(seed)
    image = cv2.resize(texture(99), (640, 360))
    for pattern, middle_px, size_px in objects:
        scale = size_px / np.array(pattern.shape[::-1])
        shift = np.asarray(middle_px) - scale * (np.array(pattern.shape[::-1]) - 1) / 2
        placed = np.array([[scale[0], 0, shift[0]], [0, scale[1], shift[1]]])
        # averaged over the area of a pixel: drawn at four times the size
        large = cv2.warpAffine(
            pattern, 4 * placed + [[0, 0, 1.5]] * 2, (2560, 1440), borderValue=-1e4
        )
        small = cv2.resize(large, (640, 360), interpolation=cv2.INTER_AREA)
        image = np.where(small >= 0, small, image)
    grey = np.clip(gain * image + rng.normal(0, noise, image.shape), 0, 255).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def tracks(middles_px, sizes_px, *, class_id=CAR, noise_px=0.0, seed=0):
    boxes = np.concatenate([middles_px - sizes_px / 2, middles_px + sizes_px / 2], axis=1)
    boxes = boxes + np.random.default_rng(seed).normal(0, noise_px, boxes.shape)
    n = len(boxes)
    return Tracks(
        np.arange(1, n + 1), boxes, np.full(n, class_id), np.ones(n), np.ones(n, np.bool_)
    )


def grown(middles_px, scale, shift_px, *, n_seeds=12, noise_px=1.0, gain=1.0):
    """Log ratios and sigmas of objects that grow by `scale` and move by `shift_px` between two
    frames."""
    values = []
    for seed in range(n_seeds):
        scales, pattern = (
            PatchScales(CAMERA),
            [texture(10 * seed + i) for i in range(len(middles_px))],
        )
        middles = np.array(middles_px, float)
        now = middles + np.array(shift_px)
        before = scene([(p, m, SIZE_PX) for p, m in zip(pattern, middles, strict=True)], seed=seed)
        after = scene(
            [(p, m, SIZE_PX * scale) for p, m in zip(pattern, now, strict=True)],
            seed=seed + 50,
            gain=gain,
        )
        start = tracks(middles, SIZE_PX, noise_px=noise_px, seed=seed)
        assert scales.measure(start, before, 0.0).is_key.all()
        end = tracks(now, SIZE_PX * scale, noise_px=noise_px, seed=seed + 50)
        values.append(scales.measure(end, after, 0.1)[:2])
    log_ratio, sigma = np.array(values).transpose(1, 0, 2)
    return log_ratio.ravel(), sigma.ravel()


@pytest.mark.parametrize(("scale", "gain"), [(1.0, 1.0), (1.08, 1.0), (0.93, 0.85)])
def test_scale_and_its_sigma(scale, gain):
    log_ratio, sigma = grown([(320, 180), (500, 190), (150, 185)], scale, (3.0, -2.0), gain=gain)
    known = np.isfinite(log_ratio)
    assert known.mean() > 0.9
    error = log_ratio[known] - np.log(scale)
    assert np.median(np.abs(error)) < 0.01
    assert 0.6 < np.mean(np.abs(error) < sigma[known]) <= 1.0
    assert np.mean(np.abs(error) < 2 * sigma[known]) > 0.9
    assert 0.002 < np.median(sigma[known]) < 0.02


def test_nearer_boxes_have_no_weight():
    """A nearer object in front of half of the patch, which moves away to the side and grows."""
    errors = {}
    for knows_nearer in (True, False):
        measured = []
        for seed in range(12):
            scales, far, near = PatchScales(CAMERA), texture(seed), texture(seed + 100)
            for step, (near_x, near_size) in enumerate(((345, 50.0), (351, 56.0))):
                middles = np.array([[320.0, 180.0], [near_x, 190.0]])
                sizes = np.array([SIZE_PX * (1.03 if step else 1.0), [near_size, near_size]])
                image = scene(
                    [(far, middles[0], sizes[0]), (near, middles[1], sizes[1])], seed=seed + step
                )
                present = tracks(middles, sizes)
                result = scales.measure(
                    present if knows_nearer else present.select(np.array([0])), image, 0.1 * step
                )
            measured.append(result.log_ratio[0] - np.log(1.03))
        errors[knows_nearer] = np.array(measured)
    assert np.isfinite(errors[True]).mean() > 0.7
    assert np.nanmedian(np.abs(errors[True])) < 0.012
    lost_or_wrong = [np.mean(~(np.abs(values) < 0.03)) for values in (errors[True], errors[False])]
    assert lost_or_wrong[0] + 0.2 < lost_or_wrong[1]


def test_width_of_sides_counts_little():
    """Beside the axis the width of a car may grow faster than the car: 8 % against 4 % in
    height."""
    log_ratio, sigma = grown([(560, 180)], np.array([1.08, 1.04]), (2.0, 0.0))
    on_axis, axis_sigma = grown([(320, 180)], np.array([1.08, 1.04]), (2.0, 0.0))
    assert np.nanmedian(log_ratio) == pytest.approx(np.log(1.04), abs=0.012)
    assert np.nanmedian(on_axis) > np.nanmedian(log_ratio) + 0.005
    assert np.nanmedian(sigma) > np.nanmedian(axis_sigma)


def test_key_frames():
    """A key frame lasts a second, or until the object is lost; measured after 0.1 s, and then every
    0.2 s."""
    scales, pattern, middle = PatchScales(CAMERA), texture(1), np.array([[320.0, 180.0]])
    image, present = scene([(pattern, middle[0], SIZE_PX)]), tracks(middle, SIZE_PX)
    keys, measured = [], []
    for step in range(28):
        result = scales.measure(present, image, 0.05 * step)
        keys += [step] if result.is_key[0] else []
        measured += [step] if np.isfinite(result.log_ratio[0]) else []
    assert keys == [0, 22]
    assert measured == [2, 6, 10, 14, 18, 22, 24]
    other = scene([(texture(7), middle[0], SIZE_PX)])
    lost = scales.measure(present, other, 1.45)
    assert (np.isnan(lost.log_ratio).all(), lost.is_key.all()) == (True, True)


def test_images_and_boxes_without_a_patch():
    """Tiny images, boxes outside, and no tracks."""
    tiny = np.zeros((10, 12, 3), np.uint8)
    outside = tracks(np.array([[900.0, 500.0], [-200.0, 10.0]]), SIZE_PX)
    for image in (tiny, np.zeros((360, 640, 3), np.uint8)):
        scales = PatchScales(CAMERA)
        for time_s in (0.0, 0.1):
            assert len(scales.measure(Tracks.empty(), image, time_s).sigma) == 0
        for time_s in (0.2, 0.3):
            assert np.isnan(scales.measure(outside, image, time_s).log_ratio).all()
