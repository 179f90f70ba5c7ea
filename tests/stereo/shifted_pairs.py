"""Pairs of random textures with exact disparities: shifted, tilted, or one in front of the
other."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray, Image

HEIGHT, WIDTH = 140, 400
_OVERSAMPLING = 8


def texture(
    seed: int, *, height: int = HEIGHT, width: int = WIDTH, blur_px: float = 1.2
) -> FloatArray:
    """Smooth random grey values, 0..255."""
    noise = np.random.default_rng(seed).normal(size=(height, width))
    smooth = cv2.GaussianBlur(noise, (0, 0), blur_px)
    return np.clip(128 + 50 * smooth / smooth.std(), 0, 255)


def shifted(image: FloatArray, shift_px: float) -> FloatArray:
    """The image moved to the left by a fraction of a pixel, exactly: a phase ramp in Fourier
    space."""
    frequency = np.fft.rfftfreq(image.shape[1])
    return np.fft.irfft(
        np.fft.rfft(image, axis=1) * np.exp(2j * np.pi * frequency * shift_px),
        image.shape[1],
        axis=1,
    )


def to_u8(image: FloatArray) -> Image:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def with_noise(left: FloatArray, right: FloatArray, noise: float, seed: int) -> tuple[Image, Image]:
    """Grey values, each image with independent sensor noise."""
    sensor = np.random.default_rng(seed + 1000).normal(scale=noise, size=(2, *left.shape))
    return to_u8(left + sensor[0]), to_u8(right + sensor[1])


def pair(
    disparity_px: float,
    *,
    seed: int = 0,
    noise: float = 0.0,
    height: int = HEIGHT,
    width: int = WIDTH,
    blur_px: float = 1.2,
) -> tuple[Image, Image]:
    left = texture(seed, height=height, width=width, blur_px=blur_px)
    return with_noise(left, shifted(left, disparity_px), noise, seed)


def tilted_pair(
    disparity_px: float, slope: float, *, at_px: float, seed: int = 0
) -> tuple[Image, Image]:
    """An oblique wall: the disparity grows by `slope` per column and is `disparity_px` at column
    `at_px`."""
    left = texture(seed)
    oversampled = (
        np.fft.irfft(np.fft.rfft(left, axis=1), WIDTH * _OVERSAMPLING, axis=1) * _OVERSAMPLING
    )
    columns = np.arange(WIDTH, dtype=np.float64)
    source = np.interp(columns, columns - disparity_px - slope * (columns - at_px), columns)
    right = np.stack(
        [
            np.interp(source * _OVERSAMPLING, np.arange(WIDTH * _OVERSAMPLING), row)
            for row in oversampled
        ]
    )
    return to_u8(left), to_u8(right)


def pair_of_two(
    front: npt.NDArray[np.bool_],
    *,
    front_px: int,
    behind_px: int,
    seed: int = 0,
    noise: float = 2.0,
) -> tuple[Image, Image]:
    """A pair with a near surface in the mask `front` of the left image, in front of a far one."""
    near, far = texture(seed), texture(seed + 500)
    mask = np.zeros_like(front)
    mask[:, :-front_px] = front[:, front_px:]
    left = np.where(front, near, far)
    right = np.where(mask, shifted(near, front_px), shifted(far, behind_px))
    return with_noise(left, right, noise, seed)
