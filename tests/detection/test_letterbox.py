import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.detection.yolo.letterbox import Letterbox, input_hw_of_area, rectangular_input_hw

SIDE = st.integers(1, 3000)


def to_input(letterbox, xyxy_px):
    """(N, 4) boxes in the network's corner coordinates from image pixels: x_net = (x + 0.5) * scale
    + pad."""
    (image_h, image_w), (height, width), (pad_y, pad_x) = (
        letterbox.image_hw,
        letterbox.resized_hw,
        letterbox.pad_yx,
    )
    scale = np.array([width / image_w, height / image_h] * 2)
    return (xyxy_px + 0.5) * scale + np.array([pad_x, pad_y] * 2)


@settings(deadline=None)
@given(SIDE, SIDE, st.sampled_from([(640, 640), (416, 416), (384, 640)]), st.integers(0, 99))
def test_round_trip_is_exact(height, width, input_hw, seed):
    letterbox = Letterbox.of_placement("centred", (height, width), input_hw)
    boxes = np.random.default_rng(seed).uniform(-10, 3000, (5, 4))
    np.testing.assert_allclose(letterbox.to_image(to_input(letterbox, boxes)), boxes, atol=1e-6)


@settings(deadline=None)
@given(SIDE, SIDE)
def test_whole_image_fills_resized_part(height, width):
    letterbox = Letterbox.of_placement("centred", (height, width), (640, 640))
    whole = np.array([[-0.5, -0.5, width - 0.5, height - 0.5]])
    (x1, y1, x2, y2) = to_input(letterbox, whole)[0]
    assert (y1, x1) == letterbox.pad_yx
    assert (y2 - y1, x2 - x1) == pytest.approx(letterbox.resized_hw)


@pytest.mark.parametrize(
    ("size_hw", "box"), [((375, 1242), (311, 83, 702, 241)), ((720, 1280), (400, 300, 900, 500))]
)
def test_rectangle_edges_within_tenth_of_pixel(size_hw, box):
    x1, y1, x2, y2 = box  # pixels x1 .. x2 - 1 are white, so the edges are at x1 - 0.5 and x2 - 0.5
    image = np.zeros((*size_hw, 3), np.uint8)
    image[y1:y2, x1:x2] = 255
    # so that sampling every other pixel does not alias the edge
    image = cv2.GaussianBlur(image, (0, 0), 3)
    letterbox = Letterbox.of_placement("centred", size_hw, (640, 640))
    canvas = np.zeros((640, 640, 3), np.uint8)
    canvas[letterbox.inside] = letterbox.scaled(image)
    white = canvas[..., 0].astype(float) / 255
    row, column = white[:, white.sum(0).argmax()], white[white.sum(1).argmax()]
    # in corner coordinates
    x1, x2, y1, y2 = (edge for line in (column, row) for edge in edges(line))
    back = letterbox.to_image(np.array([[x1, y1, x2, y2]]))[0]
    np.testing.assert_allclose(back, np.array(box) - 0.5, atol=0.1)


def edges(line):
    """First and last edge of the bright run, from the brightness on either side of the middle."""
    middle = int(np.average(np.arange(len(line)), weights=line))
    return middle - line[:middle].sum(), middle + line[middle:].sum()


def test_same_size_is_not_copied_and_padding_is_split():
    image = np.random.default_rng(0).integers(0, 255, (32, 32, 3), np.uint8)
    letterbox = Letterbox.of_placement("centred", (32, 32), (32, 65))
    assert letterbox.scaled(image) is image
    assert letterbox.inside == (slice(0, 32), slice(16, 48))


def test_boxes_are_clipped_to_the_outer_border():
    letterbox = Letterbox.of_placement("centred", (100, 200), (640, 640))
    clipped = letterbox.to_image_clipped(
        to_input(letterbox, np.array([[-30.0, 10.0, 500.0, 120.0]]))
    )
    np.testing.assert_allclose(clipped, [[-0.5, 10.0, 199.5, 99.5]])


def test_rectangular_input_of_kitti_and_hd():
    assert rectangular_input_hw((375, 1242), size_px=640) == (224, 640)
    assert rectangular_input_hw((720, 1280), size_px=640) == (384, 640)
    assert rectangular_input_hw((1, 1), size_px=640) == (640, 640)
    assert rectangular_input_hw((10, 4000), size_px=640) == (32, 640)


def test_input_of_an_area_has_the_aspect_ratio_and_about_the_area():
    area_px2 = 512 * 384
    assert input_hw_of_area((480, 640), area_px2=area_px2) == (384, 512)
    assert input_hw_of_area((375, 1242), area_px2=area_px2) == (256, 800)
    assert input_hw_of_area((1080, 1920), area_px2=area_px2) == (320, 576)
    assert input_hw_of_area((1920, 1080), area_px2=area_px2) == (576, 320)
    assert input_hw_of_area((10, 4000), area_px2=area_px2) == (32, 1120)


def test_resize_maps_areas_onto_areas():
    # The equations require that OpenCV's linear resize has no half-pixel shift: a ramp must stay
    # the same ramp.
    ramp = np.tile(np.arange(200, dtype=np.float32), (4, 1))
    small = cv2.resize(ramp, (100, 4), interpolation=cv2.INTER_LINEAR)
    np.testing.assert_allclose(small[0], (np.arange(100) + 0.5) * 2 - 0.5)


@pytest.mark.parametrize("placement", ["centred", "top-left"])
def test_extreme_aspect_ratios_leave_one_pixel(placement):
    assert Letterbox.of_placement(placement, (1, 4000), (320, 320)).resized_hw == (1, 320)
    assert Letterbox.of_placement(placement, (4000, 1), (320, 320)).resized_hw == (320, 1)
