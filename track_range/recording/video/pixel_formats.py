"""Pixel formats of cameras and of ROS by name, and images in them as (H, W, 3) uint8 BGR.

bgr8, rgb8, 8UC3                     (H, W, 3) uint8
bgra8, rgba8, 8UC4                   (H, W, 4) uint8; the fourth channel is not used
mono8, 8UC1, bayer_rggb8, ...        (H, W) uint8
mono16, mono12, mono10               (H, W) uint16; the upper 8 of 16, 12 or 10 bits are used
yuyv, yuv422_yuy2, uyvy, yuv422      (H, W, 2) uint8, as OpenCV has them
nv12, nv21, i420                     (3 H / 2, W) uint8, as OpenCV has them: W and H are even
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import Image
from track_range.foundation.files.images import MAX_PIXELS
from track_range.foundation.files.input_files import quoted
from track_range.recording.video.frame import FrameError

_WHITE = 255  # largest value of 8 bits


class PixelFormat(NamedTuple):
    """How an image is stored."""

    channels: int  # 1 = (H, W)
    to_bgr: int | None  # OpenCV's conversion; None = none
    n_bits: int = 8  # of a channel, in 8 or 16 bits
    is_planar: bool = False  # half as many rows of colours below the image
    is_grey: bool = False

    @property
    def dtype(self) -> Any:
        """Type of the array."""
        return np.uint8 if self.n_bits == 8 else np.uint16

    @property
    def shape(self) -> str:
        """Shape of the array in words."""
        if self.is_planar:
            return "(3 H / 2, W)"
        return "(H, W)" if self.channels == 1 else f"(H, W, {self.channels})"

    def n_rows(self, height_px: int) -> int:
        """Rows of the array of an image."""
        return height_px * 3 // 2 if self.is_planar else height_px


_GREY = PixelFormat(1, cv2.COLOR_GRAY2BGR, is_grey=True)
_BGRA = PixelFormat(4, cv2.COLOR_BGRA2BGR)
_YUYV = PixelFormat(2, cv2.COLOR_YUV2BGR_YUY2)
_UYVY = PixelFormat(2, cv2.COLOR_YUV2BGR_UYVY)

PIXEL_FORMATS: Mapping[str, PixelFormat] = {
    "bgr8": PixelFormat(3, None),
    "8UC3": PixelFormat(3, None),
    "rgb8": PixelFormat(3, cv2.COLOR_RGB2BGR),
    "bgra8": _BGRA,
    "8UC4": _BGRA,
    "rgba8": PixelFormat(4, cv2.COLOR_RGBA2BGR),
    "mono8": _GREY,
    "8UC1": _GREY,
    "mono16": _GREY._replace(n_bits=16),
    "mono12": _GREY._replace(n_bits=12),
    "mono10": _GREY._replace(n_bits=10),
    "bayer_rggb8": PixelFormat(1, cv2.COLOR_BayerRGGB2BGR),
    "bayer_bggr8": PixelFormat(1, cv2.COLOR_BayerBGGR2BGR),
    "bayer_gbrg8": PixelFormat(1, cv2.COLOR_BayerGBRG2BGR),
    "bayer_grbg8": PixelFormat(1, cv2.COLOR_BayerGRBG2BGR),
    "yuv422": _UYVY,
    "uyvy": _UYVY,
    "yuv422_yuy2": _YUYV,
    "yuyv": _YUYV,
    "nv12": PixelFormat(1, cv2.COLOR_YUV2BGR_NV12, is_planar=True),
    "nv21": PixelFormat(1, cv2.COLOR_YUV2BGR_NV21, is_planar=True),
    "i420": PixelFormat(1, cv2.COLOR_YUV2BGR_I420, is_planar=True),
}


def pixel_format_of(name: object) -> PixelFormat:
    """The pixel format of this name; FrameError for another name."""
    if isinstance(name, str) and name in PIXEL_FORMATS:
        return PIXEL_FORMATS[name]
    raise FrameError(
        f"pixel format: expected one of {', '.join(PIXEL_FORMATS)}, found {quoted(str(name), 30)}."
    )


def bgr_of(
    pixels: Any, pixel_format: str, name: str = "image", *, keeps_grey: bool = False
) -> Image:
    """(H, W, 3) uint8 BGR of an array in a pixel format, with `keeps_grey` (H, W) of a grey one;
    FrameError with the `name` of the image for an array of another type or shape.
    """
    form = pixel_format_of(pixel_format)
    _check(pixels, form, f"{name}: expected an image in {pixel_format}")
    if form.n_bits > 8:
        pixels = pixels >> (form.n_bits - 8)
        if pixels.max() > _WHITE:
            raise FrameError(
                f"{name}: expected values of {form.n_bits} bits in {pixel_format}, found larger ones; "
                "name images of 16 bits mono16."
            )
        pixels = pixels.astype(np.uint8)
    if form.to_bgr is None or (keeps_grey and form.is_grey):
        return np.asarray(pixels)
    return np.asarray(cv2.cvtColor(pixels, form.to_bgr)).astype(np.uint8, copy=False)


def decoded_image(
    data: Any,
    pixel_format: str,
    width_px: int,
    height_px: int,
    *,
    step: int | None = None,
    is_bigendian: bool = False,
) -> Image:
    """(H, W, 3) uint8 BGR image of the bytes of a camera's buffer or of a message of ROS.

    Args:
        data: bytes, or an object with a buffer of bytes.
        pixel_format: name of the format: bgr8, rgb8, bgra8, rgba8, mono8, mono16, mono12, mono10,
            yuyv, uyvy, nv12, nv21, i420, bayer_rggb8 and the other encodings of ROS.
        width_px: width of the image.
        height_px: height of the image.
        step: bytes per row, with padding; None = without padding.
        is_bigendian: order of the bytes of 16-bit formats.

    Raises:
        FrameError: the format is unknown, or the bytes are not those of such an image.

    Example:
        >>> import track_range as tr
        >>> tr.decoded_image(bytes(6 * 4 * 2), "yuyv", 6, 4).shape
        (4, 6, 3)
    """
    form = pixel_format_of(pixel_format)
    values = np.frombuffer(memoryview(data), np.uint8)
    n_rows, n_bytes = form.n_rows(height_px), width_px * form.channels * (1 + (form.n_bits > 8))
    step = n_bytes if step is None else step
    is_whole = 0 < width_px * height_px <= MAX_PIXELS and step >= n_bytes
    if not (is_whole and values.size >= step * n_rows):
        raise FrameError(
            f"image: expected {width_px}x{height_px} pixels in {pixel_format}, found {values.size} "
            f"bytes with {step} per row."
        )
    rows = np.ascontiguousarray(values[: step * n_rows].reshape(n_rows, step)[:, :n_bytes])
    pixels: npt.NDArray[Any] = rows
    if form.n_bits > 8:
        pixels = rows.view(">u2" if is_bigendian else "<u2").astype(np.uint16)
    elif form.channels > 1:
        pixels = rows.reshape(n_rows, width_px, form.channels)
    return bgr_of(pixels, pixel_format)


def _check(pixels: Any, form: PixelFormat, expected: str) -> None:
    """Raises FrameError for an array of another type or shape."""
    wanted = f"{expected}, {np.dtype(form.dtype)} {form.shape}"
    if not isinstance(pixels, np.ndarray):
        raise FrameError(f"{wanted}, found {type(pixels).__name__}.")
    n_axes = 2 if form.channels == 1 else 3
    is_usable = pixels.dtype == form.dtype and pixels.ndim == n_axes and 0 not in pixels.shape
    if is_usable and n_axes == 3:
        is_usable = pixels.shape[2] == form.channels
    if is_usable and form.is_planar:
        is_usable = pixels.shape[0] % 3 == 0 and pixels.shape[1] % 2 == 0
    if is_usable and form.channels == 2:
        is_usable = pixels.shape[1] % 2 == 0
    if not is_usable:
        raise FrameError(f"{wanted}, found {pixels.dtype} {pixels.shape}.")
