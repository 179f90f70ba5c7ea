"""Textures brought down to the samples they will cover; each is kept, since the other eye and later frames ask too.

Sizes go up in steps of 2^(1/4), so that few are made: a texture has 1 to 1.19 texels per sample, never less than one
unless it has no more. A fractional area average reads every texel and takes three times as long as a warp; so textures
are halved first, which is quick, and averaged from the last halving that is still large enough.
"""

from __future__ import annotations

import cv2
import numpy as np

from track_range.foundation.arrays import Image, IntArray

STEPS_PER_DOUBLING = 4
STEPS = np.unique(np.ceil(2 ** (np.arange(14 * STEPS_PER_DOUBLING) / STEPS_PER_DOUBLING)).astype(np.int64))
"""Sizes that averages have, texels."""

MOST_BYTES = 128 * 2**20
"""When what is kept exceeds this, all of it is forgotten and made anew as it is wanted."""

Window = tuple[int, int, int, int]
"""Rows from, to, columns from, to, of a texture."""


def stepped_up(size: IntArray, texels: IntArray) -> IntArray:
    """Numbers of texels on the next step, but no more than there are."""
    return np.minimum(STEPS[np.minimum(np.searchsorted(STEPS, size), len(STEPS) - 1)], texels)


class TextureStore:
    """Textures by number, and what has been made of them.

    A texture is (h, w, 4) BGRA, or (h, w) the darkness of a shadow. Threads may share a store: what two of them make
    at once is the same.

    Args:
        most_bytes: that are kept of what was made.
    """

    def __init__(self, most_bytes: int = MOST_BYTES) -> None:
        self._most_bytes = most_bytes
        self._pictures: list[Image] = []
        self._averages: dict[tuple[int, Window, tuple[int, int]], Image] = {}
        self._halved: dict[tuple[int, Window, tuple[int, int]], Image] = {}
        self._n_bytes = 0

    def add(self, picture: Image) -> int:
        """Take in a texture; its number."""
        self._pictures.append(np.ascontiguousarray(picture))
        return len(self._pictures) - 1

    def averaged(self, number: int, window: Window, size: tuple[int, int]) -> Image:
        """A window of a texture brought down to `size` (rows, columns), with a transparent margin of one texel.

        The margin repeats the colours of the edge, so that only alpha fades out.
        """
        key = (number, window, size)
        found = self._averages.get(key)
        if found is None:
            found = _framed(self._resized(number, window, size))
            self._averages[key] = found
            self._n_bytes += found.nbytes
            if self._n_bytes > self._most_bytes:
                self._averages, self._halved, self._n_bytes = {}, {}, 0
        return found

    def _resized(self, number: int, window: Window, size: tuple[int, int]) -> Image:
        shape = (window[1] - window[0], window[3] - window[2])
        halvings = (_n_halvings(shape[0], size[0]), _n_halvings(shape[1], size[1]))
        return _down_to(self._halving(number, window, halvings), size)

    def _halving(self, number: int, window: Window, halvings: tuple[int, int]) -> Image:
        """The window with its rows and columns halved so often."""
        if halvings == (0, 0):
            return self._pictures[number][window[0] : window[1], window[2] : window[3]]
        key = (number, window, halvings)
        found = self._halved.get(key)
        if found is None:
            before = self._halving(number, window, (max(halvings[0] - 1, 0), max(halvings[1] - 1, 0)))
            shape = ((window[1] - window[0]) >> halvings[0], (window[3] - window[2]) >> halvings[1])
            found = _down_to(before, shape)
            self._halved[key] = found
            self._n_bytes += found.nbytes
        return found


def _n_halvings(n_from: int, n_to: int) -> int:
    """How often so many texels may be halved and still be as many as wanted."""
    return (n_from // n_to).bit_length() - 1


def _down_to(picture: Image, shape: tuple[int, int]) -> Image:
    if picture.shape[:2] == shape:
        return picture
    return np.asarray(cv2.resize(picture, shape[::-1], interpolation=cv2.INTER_AREA), np.uint8)


def _framed(picture: Image) -> Image:
    if picture.ndim == 2:
        return np.asarray(cv2.copyMakeBorder(picture, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0), np.uint8)
    framed = cv2.copyMakeBorder(picture, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    framed[[0, -1], :, 3] = 0
    framed[:, [0, -1], 3] = 0
    return np.asarray(framed, np.uint8)
