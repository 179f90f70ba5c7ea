"""Tests of the growth of objects by registration of patches, on textures that are scaled by known
factors."""

import numpy as np
import pytest

from tests.ranging.patch_scenes import SIZE_PX, scene, texture, tracks
from track_range.ranging.methods.patch_scale import (
    PatchScales,
    covered_points,
    template_slopes,
)
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.tracking.tracks import Tracks

CAMERA = PinholeCamera(700.0, 700.0, 320.0, 180.0, width_px=640, height_px=360)


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


def test_slopes_of_a_template_are_those_of_numpy():
    template = np.random.default_rng(0).random((3, 20, 20), np.float32)
    down, across = np.gradient(template, axis=(1, 2))
    slopes = template_slopes(template.reshape(3, -1))
    np.testing.assert_array_equal(slopes[0].reshape(template.shape), across)
    np.testing.assert_array_equal(slopes[1].reshape(template.shape), down)


def test_an_image_is_not_read_without_a_patch_that_is_due():
    """Its patches were measured 0.05 s before, or the boxes are predicted or small."""
    scales, middle = PatchScales(CAMERA), np.array([[320.0, 180.0]])
    image = scene([(texture(0), middle[0], SIZE_PX)], seed=0)
    seen = tracks(middle, SIZE_PX, noise_px=0.0, seed=0)
    scales.measure(seen, image, 0.0)
    predicted = Tracks(seen.track_id, seen.xyxy_px, seen.class_id, seen.score, ~seen.observed)
    for boxes, time_s in ((seen, 0.05), (predicted, 0.1), (Tracks.empty(), 0.1)):
        growth = scales.measure(boxes, None, time_s)
        assert np.isnan(growth.log_ratio).all()
        assert not growth.is_key.any()
    assert np.isfinite(scales.measure(seen, image, 0.1).log_ratio).all()


def test_points_in_any_nearer_box_are_covered():
    """Against each point of each patch in each box that ends lower, one after the other."""
    rng = np.random.default_rng(1)
    corner, size = rng.uniform(0.0, 300.0, (12, 2)), rng.uniform(20.0, 120.0, (12, 2))
    boxes = np.concatenate([corner, corner + size], axis=1)
    rows = np.array([0, 3, 4, 9, 11])
    centre, extent = (corner + size / 2)[rows], 0.4 * size[rows]
    line = np.linspace(-1.0, 1.0, 20, dtype=np.float32)
    expected = np.zeros((len(rows), 20, 20), bool)
    for i, row in enumerate(rows):
        for box in boxes[boxes[:, 3] > boxes[row, 3]]:
            first, last = (box[:2] - centre[i]) / extent[i], (box[2:] - centre[i]) / extent[i]
            x, y = line[None, :], line[:, None]
            expected[i] |= (first[0] <= x) & (x <= last[0]) & (first[1] <= y) & (y <= last[1])
    covered = covered_points(centre, extent, boxes, rows)
    np.testing.assert_array_equal(covered, expected.reshape(len(rows), -1))
    assert 0.1 < covered.mean() < 0.9
    lowest = boxes[:, 3].argmax()[None]
    alone = covered_points(corner[lowest], size[lowest], boxes, lowest)
    assert not alone.any()
