import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.detection.training.data.augmentation import (
    AugmentationSettings,
    LabelledPixels,
    mosaic,
    single,
)

PLAIN = AugmentationSettings(
    mosaic=0.0, min_gain=1.0, max_gain=1.0, shift=0.0, mirror=0.0, hue=0, saturation=0, value=0
)


RED = (0, 0, 255)
COLOURLESS = {"hue": 0.0, "saturation": 0.0, "value": 0.0}


def scene(width_px, height_px, *boxes, class_index=0):
    """A dark image with red rectangles, and their labels."""
    image = np.full((height_px, width_px, 3), 40, np.uint8)
    for x1, y1, x2, y2 in boxes:
        cv2.rectangle(image, (x1, y1), (x2 - 1, y2 - 1), RED, -1)
    n = len(boxes)
    return LabelledPixels(
        image,
        np.array(boxes, np.float64).reshape(-1, 4),
        np.full(n, class_index, np.int64),
        np.zeros(n, np.bool_),
        np.ones(n),
        np.broadcast_to(np.array([True, class_index % 2 == 0]), (2, 2, 2)),
    )


def red_boxes(image):
    """Boxes of the red areas of an RGB image, in corner coordinates."""
    red = ((image[..., 0] > 120) & (image[..., 1] < 60)).astype(np.uint8)
    _, _, stats, _ = cv2.connectedComponentsWithStats(red)
    return np.array(
        [[x, y, x + w, y + h] for x, y, w, h, area in stats[1:] if area > 12], np.float64
    ).reshape(-1, 4)


def test_letterbox_without_augmentation():
    result = single(scene(100, 50, (10, 20, 30, 40)), 200, PLAIN, np.random.default_rng(0))
    assert result.image.shape == (200, 200, 3)
    assert result.image[10, 100].tolist() == [114, 114, 114]
    assert result.xyxy.tolist() == [[20, 90, 60, 130]]
    assert red_boxes(result.image) == pytest.approx(result.xyxy, abs=1.0)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_boxes_follow_the_pixels(seed):
    strong = AugmentationSettings(min_gain=0.6, max_gain=2.5, **COLOURLESS)
    rng = np.random.default_rng(seed)
    for source in (scene(120, 90, (50, 30, 90, 60)), scene(60, 140, (10, 50, 50, 90))):
        result = single(source, 128, strong, rng)
        red = red_boxes(result.image)
        assert len(result.xyxy) == 1
        assert len(red) == 1 or result.is_ignored.all()
        if len(red) == len(result.xyxy):
            assert red == pytest.approx(result.xyxy, abs=2.0)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_mosaic_has_boxes_of_all_four(seed):
    strong = AugmentationSettings(min_gain=0.4, max_gain=1.5, **COLOURLESS)
    sources = [scene(120, 90, (50, 30, 90, 60), class_index=i) for i in range(4)]
    result = mosaic(sources, 160, strong, np.random.default_rng(seed))
    assert result.image.shape == (160, 160, 3)
    assert (result.xyxy >= 0).all()
    assert (result.xyxy <= 160).all()
    assert set(result.class_index.tolist()) <= {0, 1, 2, 3}
    clear = result.xyxy[~result.is_ignored]
    for box in clear:  # objects that are not ignored are visible
        inside = result.image[
            int(box[1]) : int(np.ceil(box[3])), int(box[0]) : int(np.ceil(box[2]))
        ]
        assert np.median(inside[..., 0]) > 100
    assert result.is_complete.tolist() == [[[True, True], [True, False]]] * 2


def test_crop_of_large_image_has_an_object():
    enlarged = AugmentationSettings(min_gain=4.0, max_gain=4.0, **COLOURLESS)
    n_objects = [
        len(
            single(
                scene(400, 300, (30, 40, 50, 60)), 100, enlarged, np.random.default_rng(seed)
            ).xyxy
        )
        for seed in range(20)
    ]
    assert min(n_objects) == 1


def test_rotation_keeps_the_object_inside_its_box():
    turned = AugmentationSettings(
        rotation_deg=30, shear_deg=8, min_gain=1, max_gain=1, mirror=0.5, **COLOURLESS
    )
    for seed in range(10):
        result = single(
            scene(200, 200, (80, 60, 120, 150)), 200, turned, np.random.default_rng(seed)
        )
        red = red_boxes(result.image)
        assert (red[:, :2] >= result.xyxy[:, :2] - 1.5).all()
        assert (red[:, 2:] <= result.xyxy[:, 2:] + 1.5).all()


def test_cut_objects_are_dropped():
    from track_range.detection.training.data.augmentation import _Part, _transformed_labels

    source = scene(100, 100, (0, 0, 100, 20), (40, 40, 60, 60), (99, 0, 100, 2))
    matrix = np.array([[1.0, 0, -93], [0, 1.0, 0]])
    boxes, _, ignored, _ = _transformed_labels(
        source, matrix, _Part(slice(0, 50), slice(0, 50), (0, 0))
    )
    assert boxes.tolist() == [[0, 0, 7, 20], [6, 0, 7, 2]]
    assert ignored.tolist() == [True, True]


def test_colours_change_and_the_seed_decides():
    source = scene(64, 64, (10, 10, 50, 50))
    result = [
        single(source, 64, AugmentationSettings(mirror=0), np.random.default_rng(seed)).image
        for seed in (1, 1, 2)
    ]
    assert np.array_equal(result[0], result[1])
    assert not np.array_equal(result[0], result[2])
