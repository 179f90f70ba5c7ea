"""Images by name of their pixel format, from arrays and from the bytes of a camera."""

from typing import Any

import cv2
import numpy as np
import pytest

import track_range as tr
from track_range.recording.video.pixel_formats import PIXEL_FORMATS, bgr_of

WIDTH_PX, HEIGHT_PX = 12, 8
BGR = np.zeros((HEIGHT_PX, WIDTH_PX, 3), np.uint8)
BGR[:] = (40, 90, 200)
GREY = np.full((HEIGHT_PX, WIDTH_PX), 91, np.uint8)


def planar(bgr: Any, order: str) -> Any:
    """A YUV 4:2:0 image of one colour, by the conversion of OpenCV to I420."""
    i420 = cv2.cvtColor(bgr, cv2.COLOR_BGR2YUV_I420)
    y, rest = i420[:HEIGHT_PX], i420[HEIGHT_PX:].ravel()
    u, v = rest[: len(rest) // 2], rest[len(rest) // 2 :]
    if order == "i420":
        return i420
    pairs = (u, v) if order == "nv12" else (v, u)
    return np.vstack([y, np.stack(pairs, axis=1).reshape(-1, WIDTH_PX)])


def packed(bgr: Any, order: str) -> Any:
    """A YUV 4:2:2 image of one colour."""
    i420 = planar(bgr, "i420").ravel()
    n = HEIGHT_PX * WIDTH_PX
    y, u, v = int(i420[0]), int(i420[n]), int(i420[n + n // 4])
    four = [y, u, y, v] if order == "yuyv" else [u, y, v, y]
    return np.tile(np.array(four, np.uint8), n // 2).reshape(HEIGHT_PX, WIDTH_PX, 2)


STORED = {
    "bgr8": (BGR, BGR),
    "rgb8": (BGR[..., ::-1].copy(), BGR),
    "bgra8": (np.dstack([BGR, GREY]), BGR),
    "rgba8": (np.dstack([BGR[..., ::-1], GREY]), BGR),
    "mono8": (GREY, GREY),
    "mono16": (GREY.astype(np.uint16) << 8 | 0x7F, GREY),
    "mono12": (GREY.astype(np.uint16) << 4 | 0x7, GREY),
    "mono10": (GREY.astype(np.uint16) << 2 | 0x1, GREY),
    "nv12": (planar(BGR, "nv12"), BGR),
    "nv21": (planar(BGR, "nv21"), BGR),
    "i420": (planar(BGR, "i420"), BGR),
    "yuyv": (packed(BGR, "yuyv"), BGR),
    "uyvy": (packed(BGR, "uyvy"), BGR),
    "yuv422": (packed(BGR, "uyvy"), BGR),
}


@pytest.mark.parametrize("name", STORED)
def test_arrays_and_bytes_of_each_format(name: str) -> None:
    stored, shown = STORED[name]
    expected = shown if shown.ndim == 3 else np.repeat(shown[..., None], 3, axis=2)
    image = bgr_of(stored, name)
    assert (image.dtype, image.shape) == (np.uint8, (HEIGHT_PX, WIDTH_PX, 3))
    tolerance = 3 if PIXEL_FORMATS[name].is_planar or stored.shape[-1] == 2 else 0
    np.testing.assert_allclose(image.astype(int), expected, atol=tolerance)
    rows = stored.reshape(len(stored), -1)
    with_padding = np.pad(rows, ((0, 0), (0, 3)))
    decoded = tr.decoded_image(
        with_padding.tobytes(), name, WIDTH_PX, HEIGHT_PX, step=with_padding.strides[0]
    )
    np.testing.assert_array_equal(decoded, image)
    if stored.dtype == np.uint16:
        swapped = tr.decoded_image(
            rows.byteswap().tobytes(), name, WIDTH_PX, HEIGHT_PX, is_bigendian=True
        )
        np.testing.assert_array_equal(swapped, image)


def test_grey_images_of_a_right_camera_stay_grey() -> None:
    np.testing.assert_array_equal(bgr_of(STORED["mono16"][0], "mono16", keeps_grey=True), GREY)
    assert bgr_of(STORED["nv12"][0], "nv12", keeps_grey=True).ndim == 3


@pytest.mark.parametrize(
    ("image", "name", "words"),
    [
        (
            GREY,
            "rgb8",
            r"left: expected an image in rgb8, uint8 \(H, W, 3\), found uint8 \(8, 12\)",
        ),
        (GREY, "mono16", r"uint16 \(H, W\), found uint8"),
        (np.full((8, 12), 4096, np.uint16), "mono12", "values of 12 bits.*name images of 16 bits"),
        (BGR, "bgra8", r"\(H, W, 4\), found uint8 \(8, 12, 3\)"),
        (np.zeros((10, 12), np.uint8), "nv12", r"\(3 H / 2, W\), found uint8 \(10, 12\)"),
        (np.zeros((4, 3, 2), np.uint8), "yuyv", r"\(H, W, 2\), found uint8 \(4, 3, 2\)"),
        ([1], "bgr8", "found list"),
        (BGR, "bgr24", "expected one of bgr8, 8UC3, rgb8.*found 'bgr24'"),
    ],
)
def test_other_arrays_and_names_are_errors(image: Any, name: str, words: str) -> None:
    with pytest.raises(tr.errors.FrameError, match=words):
        bgr_of(image, name, "left")


@pytest.mark.parametrize(("n_bytes", "step"), [(8 * 36 - 1, 36), (8 * 36, 35), (0, None)])
def test_too_few_bytes_are_an_error(n_bytes: int, step: int | None) -> None:
    with pytest.raises(tr.errors.FrameError, match=rf"12x8 pixels in rgb8, found {n_bytes} bytes"):
        tr.decoded_image(bytes(n_bytes), "rgb8", WIDTH_PX, HEIGHT_PX, step=step)


class Seen:
    """A detector that keeps the images that it gets."""

    def __init__(self) -> None:
        self.images: list[Any] = []

    def detect(self, image: Any) -> tr.Detections:
        self.images.append(image)
        return tr.Detections.empty()


def test_a_pipeline_takes_images_by_name_of_their_format() -> None:
    camera = tr.PinholeCamera(500.0, 500.0, 320.0, 180.0, width_px=640, height_px=360)
    bgr = np.random.default_rng(4).integers(0, 256, (360, 640, 3), np.uint8)
    rgb, grey = bgr[..., ::-1].copy(), bgr[..., 1].astype(np.uint16) << 8
    seen = Seen()
    rig = tr.StereoRig.rectified(camera, baseline_m=0.3)
    with tr.Pipeline.stereo(
        rig, detector=seen, sgbm=False, align="off", pixel_format=("rgb8", "mono16")
    ) as pipeline:
        pipeline.step(rgb, grey, 0.0)
        np.testing.assert_array_equal(seen.images[-1], bgr)
        pipeline.step(bgr, bgr, 0.1, pixel_format="bgr8")
        np.testing.assert_array_equal(seen.images[-1], bgr)
        with pytest.raises(tr.errors.FrameError, match=r"^right: expected an image in mono16"):
            pipeline.step(rgb, rgb, 0.2)
        with pytest.raises(tr.errors.FrameError, match=r"^left: expected 640x360 px as before"):
            pipeline.step(rgb[::2, ::2], grey[::2, ::2], 0.2)
    with pytest.raises(tr.errors.FrameError, match="bgr24"):
        tr.Pipeline.mono(focal_px=500, detector=seen, pixel_format="bgr24")
    with pytest.raises(tr.errors.ConfigError, match="pixel_format: expected a name"):
        tr.Pipeline.mono(focal_px=500, detector=seen, pixel_format=3)  # type: ignore[arg-type]
