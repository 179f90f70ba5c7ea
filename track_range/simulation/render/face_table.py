"""Many faces as parallel arrays: what a frame shows is turned, culled and cut by a few operations over all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.simulation.render.texture_store import TextureStore
from track_range.simulation.world.faces import Face


@dataclass(frozen=True, slots=True)
class FaceTable:
    """Faces, as `faces.Face` has them.

    Attributes:
        corner, along, down: (F, 3) metres.
        texture: (F,) numbers in a `TextureStore`.
        texels: (F, 2) rows and columns of the textures.
        two_sided, is_shadow: (F,).
    """

    corner: FloatArray
    along: FloatArray
    down: FloatArray
    texture: IntArray
    texels: IntArray
    two_sided: BoolArray
    is_shadow: BoolArray

    def __len__(self) -> int:
        return len(self.corner)

    @classmethod
    def of(cls, faces: Sequence[Face], store: TextureStore) -> FaceTable:
        """The faces, their textures taken into the store; of a shadow's texture only alpha."""
        pictures = [face.texture[:, :, 3] if face.is_shadow else face.texture for face in faces]
        return cls(
            np.array([face.corner for face in faces], np.float64).reshape(-1, 3),
            np.array([face.along for face in faces], np.float64).reshape(-1, 3),
            np.array([face.down for face in faces], np.float64).reshape(-1, 3),
            np.array([store.add(picture) for picture in pictures], np.int64),
            np.array([picture.shape[:2] for picture in pictures], np.int64).reshape(-1, 2),
            np.array([face.two_sided for face in faces], np.bool_),
            np.array([face.is_shadow for face in faces], np.bool_),
        )

    def select(self, rows: IntArray | BoolArray) -> FaceTable:
        """Some of the faces."""
        return FaceTable(*(getattr(self, name)[rows] for name in FaceTable.__slots__))

    def turned(self, turns: FloatArray) -> FaceTable:
        """The same after a (3, 3) turn, or one (F, 3, 3) each."""
        corner, along, down = (
            np.matmul(turns, part[:, :, None])[:, :, 0] for part in (self.corner, self.along, self.down)
        )
        return replace(self, corner=corner, along=along, down=down)

    def moved(self, by_m: FloatArray) -> FaceTable:
        """The same elsewhere: moved by (3,) or (F, 3)."""
        return replace(self, corner=self.corner + by_m)


def joined_tables(tables: Sequence[FaceTable]) -> FaceTable:
    """All faces of several tables, in that order."""
    return FaceTable(*(np.concatenate([getattr(table, name) for table in tables]) for name in FaceTable.__slots__))
