"""Crowd: the faces of all road users and obstacles, transformed to the camera's frame and drawn nearest first."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.simulation.render.canvas import Canvas
from track_range.simulation.render.face_table import FaceTable
from track_range.simulation.render.texture_store import TextureStore
from track_range.simulation.world.bodies.faces import Face


class Crowd:
    """Faces of many bodies, stored in the frame of each body.

    The labels of faces are 2 n + part for body n (`faces.IdentifyingPart`), and 0 for other faces.
    """

    def __init__(self, bodies: Sequence[Sequence[Face]], store: TextureStore) -> None:
        faces = FaceTable.of([face for body in bodies for face in body], store)
        self._n_faces = np.array([len(body) for body in bodies], np.int64)
        owner = np.repeat(np.arange(len(bodies)), self._n_faces)
        self._faces = replace(faces, label=np.where(faces.label > 0, 2 * owner + faces.label, 0))
        self._first = np.cumsum(self._n_faces) - self._n_faces

    def with_owners(self) -> Crowd:
        """The same faces with the labels n + 1 for body n."""
        owned = copy(self)
        owned._faces = replace(self._faces, label=1 + np.repeat(np.arange(len(self._n_faces)), self._n_faces))
        return owned

    def draw(
        self, canvas: Canvas, order: IntArray, poses: tuple[FloatArray, FloatArray], is_visible: Iterable[bool]
    ) -> None:
        """Draw the bodies with the indices `order` (M,), if visible; each value is read just before its body is drawn.

        `poses` are (N, 3) locations of all bodies in the camera's frame, and (N, 3, 3) rotations to that frame.
        """
        n_faces = self._n_faces[order]
        owner, first = np.repeat(order, n_faces), np.cumsum(n_faces) - n_faces
        rows = np.arange(len(owner)) + np.repeat(self._first[order] - first, n_faces)
        table = self._faces.select(rows).rotated(poses[1][owner]).moved(poses[0][owner])
        pieces = canvas.project(table)
        starts = np.searchsorted(pieces.face, first).tolist()
        ends = np.searchsorted(pieces.face, first + n_faces).tolist()
        for start, end, is_drawn in zip(starts, ends, is_visible, strict=False):
            if start < end and is_drawn:
                canvas.paint(pieces, table, slice(start, end))
