"""The built-in appearance model: embeddings by hand, invariances, and boxes without an
embedding."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.detection.formats.video_labels.kitti import read_kitti
from track_range.tracking.appearance.embeddings import (
    ColourLayout,
    ColourLayoutSettings,
    has_appearance,
)

RED, BLUE, GREY = (40, 40, 200), (200, 60, 40), (110, 110, 110)
LAYOUT = ColourLayout()


def painted(upper, lower, *, size=1, ground=(60, 120, 60)):
    """An image with one box, 40 x 80 px times `size`, in two colours, one above the other; and that
    box."""
    image = np.full((120 * size, 100 * size, 3), ground, np.uint8)
    image[20 * size : 60 * size, 30 * size : 70 * size] = upper
    image[60 * size : 100 * size, 30 * size : 70 * size] = lower
    return image, np.array([[30.0, 20, 70, 100]]) * size - 0.5


def distance(a, b):
    return float(1 - LAYOUT.embed(*a)[0] @ LAYOUT.embed(*b)[0])


def scene(seed=0):
    """An image of coloured blobs without grey pixels."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(20, 235, (12, 16, 3)).astype(np.uint8)
    return cv2.resize(coarse, (320, 240), interpolation=cv2.INTER_CUBIC)


def test_one_colour_by_hand():
    # L*, a*, b* in OpenCV's bytes; levels are four bytes wide, so 113 counts as 113.5: 113.5 / 255
    # * 7 = 3.116, split between bins 3 and 4 as 0.884 and 0.116. a* and b* are 61 and 41 from grey,
    # beyond the span of 40: the last bin.
    assert cv2.cvtColor(np.uint8([[RED]]), cv2.COLOR_BGR2LAB)[0, 0].tolist() == [113, 189, 169]
    weight = (LAYOUT.embed(*painted(RED, RED))[0].astype(float) ** 2).reshape(3, 6, 8)
    band = weight.sum(axis=2)
    # channels have equal weights
    np.testing.assert_allclose(band, np.broadcast_to(band[0], band.shape), rtol=1e-5)
    np.testing.assert_allclose(band.sum(), 1, rtol=1e-5)
    np.testing.assert_allclose(band[0], band[0, ::-1], rtol=1e-5)
    fraction = weight / band[:, :, None]
    lightness = 113.5 / 255 * 7 - 3
    for row in range(6):
        np.testing.assert_allclose(
            fraction[0, row], [0, 0, 0, 1 - lightness, lightness, 0, 0, 0], atol=1e-4
        )
        np.testing.assert_allclose(fraction[1:, row], [[0] * 7 + [1]] * 2, atol=1e-4)


def test_two_colours_by_hand():
    # Blue's L* of 86 is split between bins 2 and 3 as 0.653 and 0.347; its a* is in the last bin
    # like red's, its b* in the first.
    assert cv2.cvtColor(np.uint8([[BLUE]]), cv2.COLOR_BGR2LAB)[0, 0].tolist() == [86, 171, 54]
    common = (np.sqrt((1 - (113.5 / 255 * 7 - 3)) * (85.5 / 255 * 7 - 2)) + 1 + 0) / 3
    assert distance(painted(RED, BLUE), painted(BLUE, RED)) == pytest.approx(1 - common, abs=1e-4)
    assert distance(painted(RED, RED), painted(RED, BLUE)) == pytest.approx(
        (1 - common) / 2, abs=1e-4
    )
    assert distance(painted(RED, BLUE), painted(RED, BLUE)) == pytest.approx(0.0, abs=1e-6)


def test_embedding_is_nearly_scale_invariant():
    assert distance(painted(RED, BLUE), painted(RED, BLUE, size=5)) < 1e-6
    image = scene()
    small = cv2.resize(image, (160, 120), interpolation=cv2.INTER_AREA)
    box = np.array([[80.0, 60, 180, 200]])
    assert distance((image, box), (small, (box + 0.5) / 2 - 0.5)) < LAYOUT.max_cosine_distance / 4


def test_gate_between_dimming_and_other_colours():
    for seed in range(5):
        image, box = scene(seed), np.array([[80.0, 60, 180, 200]])
        darker = (image * 0.8).astype(np.uint8)
        assert 0.002 < distance((image, box), (darker, box)) < LAYOUT.max_cosine_distance
    assert distance(painted(RED, GREY), painted(BLUE, GREY)) > 2 * LAYOUT.max_cosine_distance


def test_centre_counts_more_than_corners():
    image, box = painted(RED, RED)
    corner, middle = image.copy(), image.copy()
    corner[20:40, 30:40] = BLUE
    middle[50:70, 45:55] = BLUE
    assert 2 * distance((image, box), (corner, box)) < distance((image, box), (middle, box))


def test_background_does_not_count():
    image, box = painted(RED, BLUE)
    other, _ = painted(RED, BLUE, ground=(250, 20, 200))
    np.testing.assert_array_equal(LAYOUT.embed(image, box), LAYOUT.embed(other, box))


def test_grey_images_are_compared_by_lightness():
    # If the a* and b* of grey counted, no two grey boxes could have a distance above 1/3.
    dark, light = (
        painted((40,) * 3, (40,) * 3, ground=(90,) * 3),
        painted((200,) * 3, (200,) * 3, ground=(90,) * 3),
    )
    assert distance(dark, light) == pytest.approx(1.0)
    assert LAYOUT.embed(*dark)[0].reshape(3, -1)[1:].max() == 0
    np.testing.assert_allclose(np.linalg.norm(LAYOUT.embed(*dark)), 1, rtol=1e-6)
    coloured = painted((40,) * 3, (40,) * 3)
    assert LAYOUT.embed(*coloured)[0].reshape(3, -1)[1:].max() > 0


def test_parts_outside_the_image_do_not_count():
    image, box = painted(RED, RED)
    edged = image.copy()
    edged[:, 48:50] = BLUE
    # cut: its right half is outside
    whole, cut = LAYOUT.embed(edged, box), LAYOUT.embed(edged[:, :50], box)
    plain = LAYOUT.embed(image, box)
    # 1 of 16 columns of points differs, 1 of 8 in the cut image
    assert 0.01 < float(1 - whole[0] @ plain[0]) < float(1 - cut[0] @ plain[0]) < 0.1


@pytest.mark.parametrize(
    "box",
    [
        [200, 20, 240, 100],
        [-60, 20, -10, 100],
        [30, 20, 30, 100],
        [70, 20, 30, 100],
        [30, 20, 33, 100],
        [-100, 20, 10, 100],
        [np.nan, 20, 70, 100],
        [30, 20, np.inf, 100],
        [-1e300, -1e300, 1e300, 1e300],
        [1e300, 0, 1.5e300, 10],
    ],
)
def test_boxes_without_embedding(box):
    image, good = painted(RED, BLUE)
    embedding = LAYOUT.embed(image, np.concatenate([good, [box]]))
    np.testing.assert_allclose(np.linalg.norm(embedding, axis=1), [1, 0], atol=1e-6)
    assert has_appearance(image, np.array([box])).tolist() == [False]


def test_no_boxes_and_tiny_pictures():
    image, box = painted(RED, BLUE)
    assert LAYOUT.embed(image, np.zeros((0, 4))).shape == (0, LAYOUT.n_values)
    for shape in ((1, 1, 3), (0, 0, 3), (0, 5, 3)):
        assert not LAYOUT.embed(np.zeros(shape, np.uint8), box).any()
    two_px = LAYOUT.embed(np.full((5, 2, 3), RED, np.uint8), np.array([[-1.5, -0.5, 2.5, 4.5]]))
    np.testing.assert_allclose(np.linalg.norm(two_px), 1, rtol=1e-6)


def test_many_boxes_equal_single_boxes():
    rng = np.random.default_rng(1)
    corner = rng.uniform(-40, 300, (10_000, 2))
    boxes = np.concatenate([corner, corner + rng.uniform(0, 120, corner.shape)], axis=1)
    image = scene()
    embedding = LAYOUT.embed(image, boxes)
    length = np.linalg.norm(embedding, axis=1)
    np.testing.assert_allclose(length[length > 0], 1, rtol=1e-5)
    np.testing.assert_array_equal(length > 0, has_appearance(image, boxes))
    assert 1000 < (length > 0).sum() < 9000
    for row in range(0, 10_000, 997):
        np.testing.assert_allclose(
            embedding[row], LAYOUT.embed(image, boxes[row : row + 1])[0], atol=1e-6
        )


@settings(deadline=None, max_examples=60)
@given(
    st.lists(st.tuples(*[st.floats(width=32)] * 4), max_size=5),
    st.integers(1, 40),
    st.integers(1, 40),
)
def test_embeddings_have_length_1_or_0(boxes, height, width):
    image = np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)
    length = np.linalg.norm(LAYOUT.embed(image, np.array(boxes, np.float64).reshape(-1, 4)), axis=1)
    assert (np.isclose(length, 1, atol=1e-5) | (length == 0)).all()


def test_inputs_are_not_modified():
    image, box = painted(RED, BLUE)
    image.setflags(write=False)
    box.setflags(write=False)
    first = LAYOUT.embed(image, box)
    np.testing.assert_array_equal(first, LAYOUT.embed(image, box))


def test_wrong_arguments_are_refused():
    with pytest.raises(ValueError, match=r"image.*shape"):
        LAYOUT.embed(np.zeros((10, 10), np.uint8), np.zeros((0, 4)))
    with pytest.raises(ValueError, match="n_rows"):
        ColourLayout(ColourLayoutSettings(n_bands=7))


def test_real_cars(shared_data):
    # Sequence 0005, which the layout was not tuned on.
    folder = shared_data / "kitti_stereo" / "0005"
    labels, video = read_kitti(folder / "label.txt"), cv2.VideoCapture(str(folder / "left.mp4"))
    same, other = [], []
    before = None
    for frame in range(16):
        rows = labels.select(
            (labels.frame == frame) & (labels.track_id >= 0) & (labels.kitti_type == "Car")
        )
        now = rows.track_id, LAYOUT.embed(video.read()[1], rows.xyxy_px)
        if before is not None:
            cosine_distance, is_same = 1 - before[1] @ now[1].T, before[0][:, None] == now[0]
            same.append(cosine_distance[is_same])
            other.append(cosine_distance[~is_same])
        before = now
    assert np.quantile(np.concatenate(same), 0.95) < LAYOUT.max_cosine_distance / 2
    assert (
        0.5 * LAYOUT.max_cosine_distance
        < np.quantile(np.concatenate(other), 0.05)
        < np.concatenate(other).mean()
        < 0.5
    )
