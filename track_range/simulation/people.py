"""What people and cyclists are made of: eight-sided trunk, legs and head, and two wheels."""

from __future__ import annotations

import numpy as np

from track_range.simulation.faces import Colour, Face, block, coloured_face, prism
from track_range.simulation.textures import RUBBER_BGR, cut_outside, paint_box, paint_wheel

CLOTHES: tuple[Colour, ...] = (
    (60, 50, 160),
    (150, 90, 60),
    (70, 130, 80),
    (60, 160, 190),
    (170, 160, 165),
    (60, 60, 65),
)
SKIN: Colour = (120, 150, 195)
HAIR: tuple[Colour, ...] = ((40, 50, 65), (60, 90, 120), (90, 140, 180), (110, 110, 115))

WHEEL_RADIUS_M = 0.34


def pedestrian(rng: np.random.Generator, size_hwl_m: tuple[float, float, float]) -> list[Face]:
    """Legs, trunk and head; the trunk, with the arms, fills width and length of the 3-D box."""
    height, width, length = size_hwl_m
    cloth, trousers = (CLOTHES[index] for index in rng.permutation(len(CLOTHES))[:2])
    x, z, hip, neck = length / 2, width / 2, 0.46 * height, 0.83 * height
    trunk = prism(rng, (-x, x, hip, neck, -z, z), cloth, contrast=16.0)
    for side in (trunk[0], trunk[4]):  # back and front: the gaps between trunk and arms
        paint_box(side.texture, (0.02, 0.15, 0.06, 1), tuple(0.5 * channel for channel in cloth))
        paint_box(side.texture, (0.94, 0.15, 0.98, 1), tuple(0.5 * channel for channel in cloth))
    legs = [
        *prism(rng, (-0.75 * x, 0.1 * x, 0.0, hip, 0.08 * z, 0.75 * z), trousers),
        *prism(rng, (-0.1 * x, 0.75 * x, 0.0, hip, -0.75 * z, -0.08 * z), trousers),
    ]
    return [*legs, *trunk, *_head(rng, low=neck, high=height)]


def _head(rng: np.random.Generator, *, low: float, high: float) -> list[Face]:
    head = prism(rng, (-0.11, 0.11, low, high, -0.095, 0.095), SKIN)
    hair = HAIR[int(rng.integers(len(HAIR)))]
    for k, side in enumerate(head):  # 0 = back, 4 = front, 8 = top
        reach = {3: 0.3, 4: 0.22, 5: 0.3, 8: 1.0}.get(k, 0.72)
        paint_box(side.texture, (0, 0, 1, reach), hair)
    return head


def cyclist(rng: np.random.Generator, size_hwl_m: tuple[float, float, float]) -> list[Face]:
    """A rider on two wheels; the wheels reach to both ends of the 3-D box, a bag closes it behind."""
    height, width, length = size_hwl_m
    x, radius = length / 2, WHEEL_RADIUS_M
    cloth, trousers = (CLOTHES[index] for index in rng.permutation(len(CLOTHES))[:2])
    hip, neck, z = 0.5 * height, 0.83 * height, width / 2
    faces = [
        *prism(rng, (-0.32, 0.25, hip, neck, -z, z), cloth, contrast=16.0),
        *prism(rng, (-0.15, 0.15, 0.2, hip, 0.1, 0.9 * z), trousers),
        *prism(rng, (0.0, 0.3, 0.35, hip, -0.9 * z, -0.1), trousers),
        *_head(rng, low=neck, high=height),
    ]
    for centre in (-x + radius, x - radius):
        faces += _wheel(rng, centre, radius)
    bag = (-x, -x + 0.4, 0.4, 0.42 * height + 0.25, -0.21, 0.21)
    parts = (((-x + radius, x - radius, 0.5, 0.58, -0.03, 0.03), (40, 40, 170)), (bag, (60, 90, 60)))
    bar = ((x - 0.45, x - 0.38, 0.98, 1.05, -0.27, 0.27), (60, 60, 60))
    for extent, bgr in (*parts, bar):
        faces += block(rng, extent, bgr).values()
    return faces


def _wheel(rng: np.random.Generator, centre_x: float, radius: float) -> list[Face]:
    """A disc along the way it rolls, and a narrow tyre from behind and before."""
    disc = coloured_face(rng, ((centre_x - radius, -2 * radius, 0), (2 * radius, 0, 0), (0, 2 * radius, 0)), RUBBER_BGR)
    paint_wheel(disc.texture, (0.5, 0.5), 0.5)
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    cut_outside(disc.texture, [(0.5 + 0.5 * float(np.cos(a)), 0.5 + 0.5 * float(np.sin(a))) for a in angles])
    extent = (centre_x - radius, centre_x + radius, 0.0, 2 * radius, -0.025, 0.025)
    tyre = block(rng, extent, RUBBER_BGR, contrast=8.0, sides=("back", "front"))
    return [Face(disc.corner, disc.along, disc.down, disc.texture, two_sided=True), *tyre.values()]
