import numpy as np
import pytest

from track_range.detection.yolo.input_format import InputFormat, placement_and_grey
from track_range.detection.yolo.letterbox import Letterbox


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("centred-114", ("centred", 114)),
        ("Top-Left-0", ("top-left", 0)),
        ("stretch", ("stretch", 114)),
        (" centred ", ("centred", 114)),
    ],
)
def test_letterbox_words(text, wanted):
    assert placement_and_grey(text) == wanted


@pytest.mark.parametrize("text", ["", "middle", "centred-256", "centred-1.5", "centred114", None, 114])
def test_words_that_are_no_letterbox(text):
    with pytest.raises(ValueError, match="is no letterbox; known are centred-114"):
        placement_and_grey(text)


def test_an_image_is_written_by_hand():
    image = np.zeros((2, 4, 3), np.uint8)
    image[0, 0] = 255, 51, 102  # blue, green, red
    for colours, wanted in (("rgb", [0.4, 0.2, 1.0]), ("bgr", [1.0, 0.2, 0.4])):
        form = InputFormat(pad_grey=51, colours=colours)
        letterbox = Letterbox.placed("centred", (2, 4), (4, 4))
        blob = np.empty((1, 3, 4, 4), np.float32)
        form.fill_padding(blob)
        form.write(image, letterbox, blob, scaled=np.empty((2, 4, 3), np.uint8))
        np.testing.assert_allclose(blob[0, :, 1, 0], wanted)
        np.testing.assert_allclose(blob[0, :, 0], 0.2)
        np.testing.assert_allclose(blob[0, :, 2, 1:], 0.0)
        assert form.letterbox == "centred-51"
