import numpy as np
import pytest

from track_range.detection.yolo.input_format import InputFormat, placement_and_grey
from track_range.detection.yolo.letterbox import Letterbox


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("centred-114", ("centred", 114)),
        ("Top-Left-0", ("top-left", 0)),
        ("stretch", ("stretch", 114)),
        (" centred ", ("centred", 114)),
    ],
)
def test_letterbox_words(text, expected):
    assert placement_and_grey(text) == expected


@pytest.mark.parametrize(
    "text", ["", "middle", "centred-256", "centred-1.5", "centred114", None, 114]
)
def test_invalid_letterboxes(text):
    with pytest.raises(ValueError, match="letterbox"):
        placement_and_grey(text)


def test_image_is_written_by_hand():
    image = np.zeros((2, 4, 3), np.uint8)
    image[0, 0] = 255, 51, 102  # blue, green, red
    for colours, expected in (("rgb", [0.4, 0.2, 1.0]), ("bgr", [1.0, 0.2, 0.4])):
        input_format = InputFormat(pad_grey=51, colours=colours)
        letterbox = Letterbox.of_placement("centred", (2, 4), (4, 4))
        blob = np.empty((1, 3, 4, 4), np.float32)
        input_format.fill_padding(blob)
        input_format.write(image, letterbox, blob, scaled=np.empty((2, 4, 3), np.uint8))
        np.testing.assert_allclose(blob[0, :, 1, 0], expected)
        np.testing.assert_allclose(blob[0, :, 0], 0.2)
        np.testing.assert_allclose(blob[0, :, 2, 1:], 0.0)
        assert input_format.letterbox == "centred-51"


@pytest.mark.parametrize("dtype", [np.float32, np.float16])
def test_mean_and_std_by_hand(dtype):
    image = np.zeros((2, 4, 3), np.uint8)
    image[0, 0] = 255, 51, 102  # blue, green, red
    input_format = InputFormat(pad_grey=0, mean=(0.4, 0.1, 0.5), std=(0.5, 0.1, 0.25))
    letterbox = Letterbox.of_placement("centred", (2, 4), (4, 4))
    blob = np.empty((1, 3, 4, 4), dtype)
    input_format.fill_padding(blob)
    input_format.write(image, letterbox, blob, scaled=np.empty((2, 4, 3), np.uint8))
    np.testing.assert_allclose(blob[0, :, 1, 0], [0.0, 1.0, 2.0], atol=2e-3)
    np.testing.assert_allclose(blob[0, :, 0], np.full((3, 4), [[-0.8], [-1.0], [-2.0]]), atol=2e-3)
    np.testing.assert_allclose(
        blob[0, :, 2, 1:], np.full((3, 3), [[-0.8], [-1.0], [-2.0]]), atol=2e-3
    )
