"""Number plates: faces separate from the body, so that the masks show which pixels belong to them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from track_range.simulation.world.bodies.faces import Face, IdentifyingPart, Vector, coloured_face
from track_range.simulation.world.textures.painting import Box, number_plate

RECESS_M = 0.001  # depth of a plate below the surface that it is cut out of, so that it is inside the 3-D box

MARGIN_TEXELS = 4
"""Width of the strip of the body around a plate that belongs to the plate's face and closes gaps at the edge of the
hole, whose resolution in the image may differ from that of the plate."""


def with_plate(face: Face, box: Box) -> list[Face]:
    """A face with a hole, and the number plate behind it; `box` is the plate as fractions of the texture's size.

    The texture of `face` is modified: the plate is painted on it, copied to the plate's texture, and cut out.
    """
    picture = face.texture
    number_plate(picture, box)
    height, width = picture.shape[:2]
    x1, y1, x2, y2 = np.rint(np.array(box) * (width, height, width, height)).astype(int).tolist()
    left, top = max(x1 - MARGIN_TEXELS, 0), max(y1 - MARGIN_TEXELS, 0)
    right, bottom = min(x2 + MARGIN_TEXELS, width), min(y2 + MARGIN_TEXELS, height)
    inwards = np.cross(face.along, face.down)
    inwards = inwards / np.linalg.norm(inwards)
    plate = Face(
        face.corner + left / width * face.along + top / height * face.down + RECESS_M * inwards,
        (right - left) / width * face.along,
        (bottom - top) / height * face.down,
        picture[top:bottom, left:right].copy(),
        part=IdentifyingPart.PLATE,
    )
    picture[y1:y2, x1:x2, 3] = 0
    return [face, plate]


def plate_face(rng: np.random.Generator, place: tuple[Vector, Vector, Vector]) -> Face:
    """A number plate at `place`, (corner, along, down) in metres, that is not part of another face."""
    face = coloured_face(rng, place, (222, 228, 228), contrast=4.0)
    number_plate(face.texture, (0.0, 0.0, 1.0, 1.0))
    return replace(face, part=IdentifyingPart.PLATE)
