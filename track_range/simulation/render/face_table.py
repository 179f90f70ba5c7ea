"""FaceTable: many faces as parallel arrays, so that a few array operations transform, cull and split all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.simulation.render.texture_store import TextureStore
from track_range.simulation.world.bodies.faces import Face


@dataclass(frozen=True, slots=True)
class FaceTable:
    """Faces as arrays, see `faces.Face`, with vectors in metres.

    `label` is what the masks show at the face: its `IdentifyingPart`, or a number of part and road user (`Crowd`).
    """

    corner: FloatArray  # (F, 3)
    along: FloatArray  # (F, 3)
    down: FloatArray  # (F, 3)
    texture: IntArray  # (F,) indices of the textures in a `TextureStore`
    texels: IntArray  # (F, 2) rows and columns of the textures
    two_sided: BoolArray  # (F,) whether the back is visible too
    is_shadow: BoolArray  # (F,) whether the face is a shadow
    label: IntArray  # (F,)

    def __len__(self) -> int:
        return len(self.corner)

    @classmethod
    def of(cls, faces: Sequence[Face], store: TextureStore) -> FaceTable:
        """A table of faces; their textures are added to the store, for shadows only the alpha channel."""
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
    """Faces with label 0; `vectors_m` are corner, along and down, `texels` are (F, 2), or the same for all."""
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
    return FaceTable(*(np.concatenate([getattr(table, name) for table in tables]) for name in FaceTable.__slots__))
