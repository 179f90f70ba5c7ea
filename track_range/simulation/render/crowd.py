"""All road users' faces, laid out for a frame: who is in reach, nearest first, in the camera's frame."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.simulation.render.canvas import Canvas
from track_range.simulation.render.face_table import FaceTable
from track_range.simulation.render.texture_store import TextureStore
from track_range.simulation.world.faces import Face


class Crowd:
    """Faces of many bodies, each in its body's own axes.

    Args:
        bodies: the faces of each.
        store: takes their textures.
    """

    def __init__(self, bodies: Sequence[Sequence[Face]], store: TextureStore) -> None:
        self._faces = FaceTable.of([face for body in bodies for face in body], store)
        self._n_faces = np.array([len(body) for body in bodies], np.int64)
        self._first = np.cumsum(self._n_faces) - self._n_faces

    def draw(
        self, canvas: Canvas, order: IntArray, places: tuple[FloatArray, FloatArray], shown: Iterable[bool]
    ) -> None:
        """Draw bodies in an order.

        Args:
            canvas: drawn on.
            order: (M,) which bodies.
            places: (N, 3) of all bodies in the camera's frame, and (N, 3, 3) turns from their own axes to the camera's.
            shown: for each of `order`, asked just before it is drawn: whether it is.
        """
        n_faces = self._n_faces[order]
        owner, first = np.repeat(order, n_faces), np.cumsum(n_faces) - n_faces
        rows = np.arange(len(owner)) + np.repeat(self._first[order] - first, n_faces)
        table = self._faces.select(rows).turned(places[1][owner]).moved(places[0][owner])
        placed = canvas.place(table)
        starts = np.searchsorted(placed.face, first).tolist()
        ends = np.searchsorted(placed.face, first + n_faces).tolist()
        for start, end, is_shown in zip(starts, ends, shown, strict=False):
            if start < end and is_shown:
                canvas.paint(placed, table, slice(start, end))
