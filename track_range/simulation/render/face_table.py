"""Faces as parallel arrays, and textures averaged to the resolution at which they are drawn, with a
cache.

Sizes are quantized in steps of 2^(1/4), so that there are few: an averaged texture has 1 to 1.19
texels per sample, or all of its texels if it has fewer. Area averaging by a fractional factor reads
every texel and takes three times as long as a warp; therefore textures are halved first, which is
fast, and then averaged from the smallest sufficient size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, Image, IntArray
from track_range.simulation.world.bodies.faces import Face

STEPS_PER_DOUBLING = 4  # number of sizes per factor of 2
# texels
STEPS = np.unique(
    np.ceil(2 ** (np.arange(14 * STEPS_PER_DOUBLING) / STEPS_PER_DOUBLING)).astype(np.int64)
)
MAX_BYTES = 128 * 2**20  # default size of the cache; a full cache is emptied
# part of a texture: first row, end row, first column, end column
Window = tuple[int, int, int, int]


def quantized_up(size: IntArray, texels: IntArray) -> IntArray:
    """Sizes rounded up to the next of `STEPS`, but at most `texels`."""
    return np.minimum(STEPS[np.minimum(np.searchsorted(STEPS, size), len(STEPS) - 1)], texels)


class TextureStore:
    """Textures by number, with a cache of averaged versions.

    A texture is (h, w, 4) BGRA, or (h, w) the darkness of a shadow. Threads may share a store: if
    two of them compute the same version at once, the results are equal.
    """

    def __init__(self, max_bytes: int = MAX_BYTES) -> None:
        self._max_bytes = max_bytes
        self._pictures: list[Image] = []
        self._averages: dict[tuple[int, Window, tuple[int, int]], Image] = {}
        self._halved: dict[tuple[int, Window, tuple[int, int]], Image] = {}
        self._n_bytes = 0

    def add(self, picture: Image) -> int:
        """Add a texture; returns its number."""
        self._pictures.append(np.ascontiguousarray(picture))
        return len(self._pictures) - 1

    def averaged(self, number: int, window: Window, size: tuple[int, int]) -> Image:
        """A window of a texture averaged to `size` (rows, columns), with a transparent margin of
        one texel.

        The margin repeats the colours of the edge, so that only alpha fades out.
        """
        key = (number, window, size)
        average = self._averages.get(key)
        if average is None:
            shape = (window[1] - window[0], window[3] - window[2])
            # as often as the sizes can be halved without falling below `size`
            n_rows, n_columns = (
                (before // after).bit_length() - 1
                for before, after in zip(shape, size, strict=True)
            )
            average = _with_margin(
                _down_to(self._halving(number, window, (n_rows, n_columns)), size)
            )
            self._averages[key] = average
            self._n_bytes += average.nbytes
            if self._n_bytes > self._max_bytes:
                self._averages, self._halved, self._n_bytes = {}, {}, 0
        return average

    def _halving(self, number: int, window: Window, halvings: tuple[int, int]) -> Image:
        """The window with rows and columns halved `halvings` times."""
        if halvings == (0, 0):
            return self._pictures[number][window[0] : window[1], window[2] : window[3]]
        key = (number, window, halvings)
        halved = self._halved.get(key)
        if halved is None:
            larger = self._halving(
                number, window, (max(halvings[0] - 1, 0), max(halvings[1] - 1, 0))
            )
            shape = ((window[1] - window[0]) >> halvings[0], (window[3] - window[2]) >> halvings[1])
            halved = _down_to(larger, shape)
            self._halved[key] = halved
            self._n_bytes += halved.nbytes
        return halved


def _down_to(picture: Image, shape: tuple[int, int]) -> Image:
    if picture.shape[:2] == shape:
        return picture
    return np.asarray(cv2.resize(picture, shape[::-1], interpolation=cv2.INTER_AREA), np.uint8)


def _with_margin(picture: Image) -> Image:
    if picture.ndim == 2:
        return np.asarray(
            cv2.copyMakeBorder(picture, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0), np.uint8
        )
    padded = cv2.copyMakeBorder(picture, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    padded[[0, -1], :, 3] = 0
    padded[:, [0, -1], 3] = 0
    return np.asarray(padded, np.uint8)


@dataclass(frozen=True, slots=True)
class FaceTable:
    """Faces as arrays, see `faces.Face`, with vectors in metres; a few operations transform, cull
    and split them.
    """

    corner: FloatArray  # (F, 3)
    along: FloatArray  # (F, 3)
    down: FloatArray  # (F, 3)
    texture: IntArray  # (F,) indices of the textures in a `TextureStore`
    texels: IntArray  # (F, 2) rows and columns of the textures
    two_sided: BoolArray  # (F,) whether the back is visible too
    is_shadow: BoolArray  # (F,) whether the face is a shadow
    # (F,) what masks show: an `IdentifyingPart`, or a number of part and road user (`Crowd`)
    label: IntArray

    def __len__(self) -> int:
        return len(self.corner)

    @classmethod
    def of(cls, faces: Sequence[Face], store: TextureStore) -> FaceTable:
        """A table of faces; their textures are added to the store, for shadows only the alpha
        channel.
        """
        pictures = [face.texture[:, :, 3] if face.is_shadow else face.texture for face in faces]
        return cls(
            np.array([face.corner for face in faces], np.float64).reshape(-1, 3),
            np.array([face.along for face in faces], np.float64).reshape(-1, 3),
            np.array([face.down for face in faces], np.float64).reshape(-1, 3),
            np.array([store.add(picture) for picture in pictures], np.int64),
            np.array([picture.shape[:2] for picture in pictures], np.int64).reshape(-1, 2),
            np.array([face.two_sided for face in faces], np.bool_),
            np.array([face.is_shadow for face in faces], np.bool_),
            np.array([face.part for face in faces], np.int64),
        )

    def select(self, rows: IntArray | BoolArray) -> FaceTable:
        """The faces of the given rows."""
        return FaceTable(*(getattr(self, name)[rows] for name in FaceTable.__slots__))

    def rotated(self, rotations: FloatArray) -> FaceTable:
        """The faces rotated by one (3, 3) or one rotation per face (F, 3, 3)."""
        vectors = (self.corner, self.along, self.down)
        corner, along, down = (np.matmul(rotations, part[:, :, None])[:, :, 0] for part in vectors)
        return replace(self, corner=corner, along=along, down=down)

    def moved(self, by_m: FloatArray) -> FaceTable:
        """The faces translated by (3,) or (F, 3)."""
        return replace(self, corner=self.corner + by_m)


def unlabelled_faces(
    vectors_m: tuple[FloatArray, FloatArray, FloatArray],
    texture: IntArray,
    texels: IntArray | tuple[int, ...],
    *,
    two_sided: BoolArray | bool = False,
    is_shadow: bool = False,
) -> FaceTable:
    """Faces with label 0; `vectors_m` are corner, along and down, `texels` are (F, 2), or the same
    for all.
    """
    n = len(texture)
    return FaceTable(
        *vectors_m,
        texture,
        np.broadcast_to(texels, (n, 2)),
        np.broadcast_to(two_sided, n),
        np.full(n, is_shadow),
        np.zeros(n, np.int64),
    )


def joined_tables(tables: Sequence[FaceTable]) -> FaceTable:
    """The faces of several tables, concatenated."""
    return FaceTable(
        *(
            np.concatenate([getattr(table, name) for table in tables])
            for name in FaceTable.__slots__
        )
    )
