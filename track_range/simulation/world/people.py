"""What people, cyclists and motorcyclists are made of: eight-sided limbs, trunks and heads, and wheels."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from track_range.simulation.world.faces import Colour, Extent, Face, block, coloured_face, prism
from track_range.simulation.world.painting import fill
from track_range.simulation.world.shadows import shadow
from track_range.simulation.world.textures import RUBBER_BGR, cut_outside, paint_box, paint_wheel

TOPS: tuple[Colour, ...] = (
    (52, 44, 128),
    (118, 74, 48),
    (62, 66, 70),
    (172, 170, 166),
    (72, 92, 66),
    (40, 38, 40),
    (96, 120, 150),
    (70, 140, 176),
)
TROUSERS: tuple[Colour, ...] = ((78, 58, 46), (44, 42, 42), (96, 100, 108), (92, 74, 62), (58, 70, 80))
SKIN: tuple[Colour, ...] = ((120, 148, 196), (92, 120, 168), (60, 84, 122))
HAIR: tuple[Colour, ...] = ((30, 34, 42), (46, 66, 92), (84, 126, 160), (110, 110, 115))
HELMETS: tuple[Colour, ...] = ((215, 215, 215), (40, 40, 44), (40, 40, 170), (140, 80, 40))
BIKES: tuple[Colour, ...] = ((38, 38, 160), (44, 42, 42), (150, 90, 40), (150, 150, 150), (60, 110, 50))
SHOE: Colour = (36, 34, 36)
CLOTH_CONTRAST = 7.0

WHEEL_RADIUS_M = 0.34
N_TYRE_PIECES = 10


def pedestrian(rng: np.random.Generator, size_hwl_m: tuple[float, float, float]) -> list[Face]:
    """Somebody in mid-step: the arms fill the width of the 3-D box, trunk and legs its length."""
    height, width, length = size_hwl_m
    top, trousers, skin = _one(rng, TOPS), _one(rng, TROUSERS), _one(rng, SKIN)
    x, z = length / 2, width / 2
    hip, waist, neck = 0.47 * height, 0.60 * height, 0.835 * height
    has_bag = rng.uniform() < 0.3
    faces = [shadow(size_hwl_m, under=150)]
    for side, step in ((1, -1), (-1, 1)):  # the left leg behind, the right one before; arms the other way round
        near, far = sorted((side * 0.06 * z, side * 0.62 * z))
        ahead = step * 0.38 * x
        faces += _limb(rng, (ahead - 0.42 * x, ahead + 0.40 * x, 0.24 * height, hip, near, far), trousers, contrast=6.0)
        shin = (1.35 * ahead - 0.30 * x, 1.35 * ahead + 0.28 * x, 0.045 * height, 0.26 * height, near, 0.92 * far)
        faces += _limb(rng, _sorted_z(shin), trousers, contrast=6.0)
        shoe = (1.35 * ahead - 0.32 * x, min(1.35 * ahead + 0.6 * x, x), 0.0, 0.055 * height, near, 0.95 * far)
        faces += block(rng, _sorted_z(shoe), SHOE, contrast=4.0).values()
        faces += _arm(rng, (-step * 0.22 * x, side * z), (height, z), (top, skin))
    faces += prism(rng, (-0.72 * x, 0.72 * x, hip, waist, -0.60 * z, 0.60 * z), top, contrast=CLOTH_CONTRAST)
    faces += prism(rng, (-0.80 * x, 0.80 * x, waist, neck, -0.74 * z, 0.74 * z), top, contrast=CLOTH_CONTRAST)
    if has_bag:
        bag = (-x, -0.7 * x, waist, 0.8 * height, -0.5 * z, 0.5 * z)
        faces += block(rng, bag, _one(rng, TOPS), contrast=6.0).values()
    return [*faces, *_head(rng, low=neck, high=height, skin=skin)]


def _arm(
    rng: np.random.Generator, at: tuple[float, float], body: tuple[float, float], look: tuple[Colour, Colour]
) -> list[Face]:
    """A sleeve and a hand, its outer side at `at` = (x, z)."""
    (x, outer), (height, z), (cloth, skin) = at, body, look
    inner = outer * 0.72
    low, high = sorted((inner, outer))
    sleeve = _limb(rng, (x - 0.30 * z, x + 0.30 * z, 0.49 * height, 0.82 * height, low, high), cloth, contrast=6.0)
    hand = _limb(rng, (x - 0.18 * z, x + 0.22 * z, 0.43 * height, 0.49 * height, low, high), skin, contrast=4.0)
    return [*sleeve, *hand]


def _head(rng: np.random.Generator, *, low: float, high: float, skin: Colour) -> list[Face]:
    """Neck, face and hair."""
    chin = low + 0.22 * (high - low)
    neck = _limb(rng, (-0.055, 0.055, low - 0.03, chin + 0.02, -0.055, 0.055), skin, contrast=4.0)
    head = prism(rng, (-0.10, 0.10, chin, high, -0.08, 0.08), skin, contrast=4.0)
    hair = _one(rng, HAIR)
    for k, side in enumerate(head):  # 0 = back, 4 = front, 8 = top
        reach = {3: 0.35, 4: 0.24, 5: 0.35, 8: 1.0}.get(k, 0.78)
        fill(side.texture, (0, 0, 1, reach), hair)
    fill(head[4].texture, (0.15, 0.42, 0.85, 0.50), tuple(0.55 * channel for channel in skin))
    return [*neck, *head]


def cyclist(rng: np.random.Generator, size_hwl_m: tuple[float, float, float]) -> list[Face]:
    """A rider on two wheels; the wheels reach to both ends of the 3-D box, a bag closes it behind."""
    height, width, length = size_hwl_m
    x, radius = length / 2, WHEEL_RADIUS_M
    top, trousers, skin = _one(rng, TOPS), _one(rng, TROUSERS), _one(rng, SKIN)
    hip, neck, z = 0.53 * height, 0.84 * height, width / 2
    faces = [
        shadow(size_hwl_m, under=120),
        *prism(rng, (-0.34, 0.06, hip, 0.68 * height, -0.55 * z, 0.55 * z), top, contrast=CLOTH_CONTRAST),
        *prism(rng, (-0.24, 0.22, 0.66 * height, neck, -0.72 * z, 0.72 * z), top, contrast=CLOTH_CONTRAST),
    ]
    for side, knee in ((1, 0.20), (-1, 0.05)):
        near, far = sorted((side * 0.14 * z, side * 0.55 * z))
        faces += _limb(rng, (knee - 0.26, knee + 0.06, 0.34 * height, 0.56 * height, near, far), trousers, contrast=6.0)
        shin = (knee - 0.10, knee + 0.06, 0.22 - 0.08 * side, 0.36 * height, near, far)
        faces += _limb(rng, shin, trousers, contrast=6.0)
        faces += block(
            rng, (knee - 0.08, knee + 0.16, 0.15 - 0.08 * side, 0.23 - 0.08 * side, near, far), SHOE
        ).values()
        near, far = sorted((side * 0.72 * z, side * z))
        faces += _limb(rng, (0.08, 0.24, 0.62 * height, 0.80 * height, near, far), top, contrast=6.0)
        faces += _limb(rng, (0.2, 0.5, 0.58 * height, 0.645 * height, near, far), top, contrast=6.0)
    faces += [face.moved(np.array([0.12, 0.0, 0.0])) for face in _head(rng, low=neck, high=height, skin=skin)]
    for centre in (-x + radius, x - radius):
        faces += _wheel(rng, centre, radius)
    frame: Colour = tuple(float(channel) for channel in rng.uniform(20, 150, 3))
    parts: tuple[tuple[Extent, Colour], ...] = (
        ((-x + radius, x - radius - 0.1, 0.52, 0.57, -0.02, 0.02), frame),
        ((-0.22, -0.17, 0.32, 0.92, -0.02, 0.02), frame),
        ((x - 0.52, x - 0.46, 0.45, 1.0, -0.025, 0.025), frame),
        ((-0.36, -0.08, 0.88, 0.94, -0.08, 0.08), SHOE),
        ((-x, -x + 0.36, 0.62, 0.86, -0.17, 0.17), (58, 74, 70)),
        ((x - 0.52, x - 0.46, 0.98, 1.03, -0.27, 0.27), (60, 60, 60)),
    )
    for extent, bgr in parts:
        faces += block(rng, extent, bgr, contrast=6.0).values()
    return faces


def _limb(rng: np.random.Generator, extent: Extent, bgr: Colour, *, contrast: float) -> list[Face]:
    """A box without its top, which another part covers: cheaper than a prism, and as good at this size."""
    return list(block(rng, extent, bgr, contrast=contrast, sides=("back", "front", "left", "right")).values())


def _one(rng: np.random.Generator, colours: tuple[Colour, ...]) -> Colour:
    return colours[int(rng.integers(len(colours)))]


def _sorted_z(extent: Extent) -> Extent:
    """The extent with its z from low to high."""
    x0, x1, low, high, z0, z1 = extent
    return x0, x1, low, high, min(z0, z1), max(z0, z1)


def _wheel(rng: np.random.Generator, centre_x: float, radius: float, *, half_width: float = 0.022) -> list[Face]:
    """A disc along the way it rolls, and a tyre of flat pieces round it."""
    disc = coloured_face(rng, ((centre_x - radius, -2 * radius, 0), (2 * radius, 0, 0), (0, 2 * radius, 0)), RUBBER_BGR)
    paint_wheel(disc.texture, (0.5, 0.5), 0.5)
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    cut_outside(disc.texture, [(0.5 + 0.5 * float(np.cos(a)), 0.5 + 0.5 * float(np.sin(a))) for a in angles])
    turns = np.linspace(0, 2 * np.pi, N_TYRE_PIECES + 1)
    rim = np.stack([centre_x + radius * np.cos(turns), -radius + radius * np.sin(turns)], axis=1).tolist()
    tyre = [
        coloured_face(
            rng, ((x0, y0, -half_width), (0, 0, 2 * half_width), (x1 - x0, y1 - y0, 0)), RUBBER_BGR, contrast=5.0
        )
        for (x0, y0), (x1, y1) in pairwise(rim)
    ]
    return [replace(disc, two_sided=True), *tyre]


def motorcyclist(rng: np.random.Generator, size_hwl_m: tuple[float, float, float]) -> list[Face]:
    """A rider with a helmet, bent forward over tank and fairing, on two thick wheels."""
    height, width, length = size_hwl_m
    x, z, radius = length / 2, width / 2, 0.32
    jacket, helmet = _one(rng, TOPS), _one(rng, HELMETS)
    paint = _one(rng, BIKES)
    seat, neck = 0.50 * height, 0.83 * height
    faces = [
        *prism(rng, (-0.28, 0.22, seat, neck, -0.62 * z, 0.62 * z), jacket, contrast=8.0),
        *prism(rng, (0.0, 0.5, 0.62 * height, 0.72 * height, 0.6 * z, 0.85 * z), jacket, contrast=8.0),
        *prism(rng, (0.0, 0.5, 0.62 * height, 0.72 * height, -0.85 * z, -0.6 * z), jacket, contrast=8.0),
        *prism(rng, (-0.15, 0.35, 0.25, seat, 0.3 * z, 0.6 * z), (52, 48, 46), contrast=8.0),
        *prism(rng, (-0.15, 0.35, 0.25, seat, -0.6 * z, -0.3 * z), (52, 48, 46), contrast=8.0),
        *prism(rng, (-0.05, 0.24, neck, height, -0.14, 0.14), helmet, contrast=6.0),
    ]
    for centre in (-x + radius, x - radius):
        faces += _wheel(rng, centre, radius, half_width=0.07)
    body = block(rng, (-0.8 * x, 0.7 * x, 0.32, seat, -0.15, 0.15), paint, contrast=6.0)
    paint_box(body["back"].texture, (0.2, 0.05, 0.8, 0.35), (36, 30, 200))
    fairing = block(rng, (0.45 * x, 0.75 * x, 0.55, 0.68 * height, -0.24, 0.24), paint, contrast=6.0)
    paint_box(fairing["front"].texture, (0.2, 0.3, 0.8, 0.8), (235, 240, 240))
    mirrors = block(rng, (0.35, 0.4, 0.66 * height, 0.68 * height, -z, z), (30, 30, 30))
    return [shadow(size_hwl_m), *faces, *body.values(), *fairing.values(), *mirrors.values()]
