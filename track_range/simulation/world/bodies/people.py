"""Bodies of pedestrians, cyclists and motorcyclists: rounded trunks and heads, tapered limbs,
wheels.
"""

from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.simulation.world.bodies.faces import (
    Colour,
    Face,
    IdentifyingPart,
    Size,
    Vector,
    block,
    chosen,
    coloured_face,
    lid,
    loft,
    plate_face,
    prism,
    ring,
    rings_across,
    shadow,
)
from track_range.simulation.world.textures.surfaces import (
    RUBBER_BGR,
    cut_outside,
    paint_box,
    paint_wheel,
)

TOPS: tuple[Colour, ...] = (
    *((44, 36, 120), (104, 58, 34), (50, 52, 58), (188, 186, 182)),
    *((52, 70, 44), (34, 32, 34), (66, 54, 150), (60, 150, 196)),
)
TROUSERS: tuple[Colour, ...] = (
    (70, 46, 34),
    (38, 36, 36),
    (44, 44, 50),
    (82, 56, 40),
    (40, 50, 60),
)
SKIN: tuple[Colour, ...] = ((120, 148, 196), (92, 120, 168), (60, 84, 122))
HAIR: tuple[Colour, ...] = ((30, 34, 42), (46, 66, 92), (84, 126, 160), (110, 110, 115))
HELMETS: tuple[Colour, ...] = ((215, 215, 215), (40, 40, 44), (40, 40, 170), (140, 80, 40))
BIKES: tuple[Colour, ...] = (
    (38, 38, 160),
    (44, 42, 42),
    (150, 90, 40),
    (150, 150, 150),
    (60, 110, 50),
)
SHOE: Colour = (36, 34, 36)
CLOTH_CONTRAST = 7.0  # contrast of the texture of clothes, grey levels
WHEEL_RADIUS_M = 0.34  # radius of a bicycle wheel
N_TYRE_PIECES = 10  # number of flat faces of a tyre
# fractions of the height of a standing body
PELVIS, WAIST, CHEST, SHOULDER, NECK = 0.46, 0.60, 0.72, 0.80, 0.845
TRUNK = (  # height, half depth and half width, of the body's height
    (PELVIS, 0.064, 0.102),
    (0.52, 0.074, 0.108),
    (WAIST, 0.068, 0.096),
    (CHEST, 0.076, 0.112),
    (SHOULDER, 0.062, 0.124),
    (NECK, 0.036, 0.048),
)
CYCLIST_TRUNK = (  # x in m, height of the body's, half depth and half width in m
    (-0.24, 0.52, 0.11, 0.17),
    (-0.20, 0.60, 0.125, 0.165),
    (-0.10, 0.70, 0.125, 0.19),
    (0.02, 0.785, 0.11, 0.21),
)
HEAD = (
    (0.16, 0.055, 0.042),
    (0.34, 0.086, 0.066),
    (0.62, 0.098, 0.077),
    (0.86, 0.085, 0.066),
    (1.0, 0.045, 0.035),
)
"""Cross-sections of neck and head: height as a fraction from the neck up, half depth and half width
in metres."""

BARE_SIDES: tuple[tuple[int, ...], ...] = ((0, 1, 2, 3, 4, 5, 6, 7), (4, 5, 6), (4, 5, 6), ())
"""Sides of the head without hair, ring by ring; 5 is the front."""


def pedestrian(rng: np.random.Generator, size_hwl_m: Size) -> list[Face]:
    """The faces of a walking pedestrian; the hands span the width of the 3-D box, the feet its
    length.
    """
    height, width, length = size_hwl_m
    top, trousers, skin = chosen(rng, TOPS), chosen(rng, TROUSERS), chosen(rng, SKIN)
    x, z = length / 2, width / 2
    hip_z, has_bag = 0.055 * height, rng.uniform() < 0.3
    faces = [shadow(size_hwl_m, under=150)]
    leg_m, arm_m = (
        [part * height for part in radii]
        for radii in ((0.062, 0.046, 0.034), (0.038, 0.033, 0.026))
    )
    # the left leg behind, the right one in front; the arms opposite
    for side, step in ((1, -1), (-1, 1)):
        ankle = (step * (x - 0.13) - 0.03, 0.08 if step < 0 else 0.06, side * hip_z)
        knee = (0.5 * ankle[0] + 0.05, 0.275 * height, side * 1.05 * hip_z)
        hip = (0.0, (PELVIS + 0.03) * height, side * hip_z)
        faces += _limb(rng, (hip, knee, ankle), (leg_m[0], leg_m[1], leg_m[1], leg_m[2]), trousers)
        heel = -x if step < 0 else x - 0.27
        shoe = (heel, heel + 0.27, 0.0, 0.075, side * hip_z - 0.045, side * hip_z + 0.045)
        faces += block(rng, shoe, SHOE, contrast=4.0).values()
        shoulder = (0.0, (SHOULDER - 0.015) * height, side * 0.112 * height)
        elbow = (-step * 0.30 * x - 0.03, 0.625 * height, side * (z - 0.034 * height))
        wrist = (-step * 0.62 * x + 0.03, 0.49 * height, side * (z - 0.026 * height))
        palm = (wrist[0] + 0.01, wrist[1] - 0.09, side * (z - 0.034))
        faces += _limb(rng, (shoulder, elbow, wrist), (arm_m[0], arm_m[1], arm_m[1], arm_m[2]), top)
        faces += _tube(rng, wrist, palm, (0.033, 0.030), skin)
    rings = [
        ring((0.0, fraction * height, 0.0), (rx * height, rz * height))
        for fraction, rx, rz in TRUNK
    ]
    faces += _trunk(rng, rings, trousers, top)
    if has_bag:
        bag = (-0.19, -0.06, WAIST * height, 0.79 * height, -0.15, 0.15)
        faces += block(rng, bag, chosen(rng, TOPS), contrast=6.0).values()
    return [*faces, *_head(rng, x=0.015, low=NECK * height, high=height, skin=skin)]


def cyclist(rng: np.random.Generator, size_hwl_m: Size) -> list[Face]:
    """The faces of a cyclist; the wheels span the length of the 3-D box, and a bag is at the
    rear.
    """
    height, width, length = size_hwl_m
    x, z, radius = length / 2, width / 2, WHEEL_RADIUS_M
    top, trousers, skin = chosen(rng, TOPS), chosen(rng, TROUSERS), chosen(rng, SKIN)
    neck, hip_z = 0.835 * height, 0.10
    rings = [
        ring((at_x, fraction * height, 0.0), (rx, rz)) for at_x, fraction, rx, rz in CYCLIST_TRUNK
    ]
    rings.append(ring((0.07, neck, 0.0), (0.065, 0.085)))
    faces = [shadow(size_hwl_m, under=120), *_trunk(rng, rings, trousers, top)]
    for side, pedal in ((1, (0.10, 0.42)), (-1, (-0.06, 0.12))):
        hip, ankle = (
            (-0.18, 0.53 * height, side * hip_z),
            (pedal[0] - 0.07, pedal[1] + 0.10, side * 0.12),
        )
        knee = (
            0.27 if side > 0 else 0.14,
            0.47 * height if side > 0 else 0.35 * height,
            side * 0.13,
        )
        faces += _limb(rng, (hip, knee, ankle), (0.092, 0.065, 0.062, 0.042), trousers)
        shoe = (
            pedal[0] - 0.12,
            pedal[0] + 0.15,
            pedal[1],
            pedal[1] + 0.09,
            side * 0.12 - 0.045,
            side * 0.12 + 0.045,
        )
        faces += block(rng, shoe, SHOE, contrast=4.0).values()
        shoulder, elbow = (
            (0.02, 0.775 * height, side * 0.20),
            (0.22, 0.66 * height, side * (z - 0.045)),
        )
        grip = (x - 0.44, 0.595 * height, side * (z - 0.06))
        faces += _limb(rng, (shoulder, elbow, grip), (0.062, 0.047, 0.047, 0.036), top)
    faces += _head(rng, x=0.13, low=neck, high=height, skin=skin, helmet=chosen(rng, HELMETS))
    for centre in (-x + radius, x - radius):
        faces += _bicycle_wheel(rng, centre, radius)
    frame = chosen(rng, BIKES)
    crank, seat, head_tube = (-0.02, 0.28, 0.0), (-0.22, 0.88, 0.0), (x - 0.50, 0.90, 0.0)
    rear, front, bar = (-x + radius, radius, 0.0), (x - radius, radius, 0.0), (x - 0.46, 1.02, 0.0)
    for start, end in (
        (crank, seat),
        (crank, head_tube),
        (seat, head_tube),
        (crank, rear),
        (seat, rear),
        (front, bar),
    ):
        faces += _tube(rng, start, end, (0.02, 0.02), frame, n_sides=4)
    faces += block(rng, (-0.36, -0.08, 0.87, 0.93, -0.08, 0.08), SHOE, contrast=6.0).values()
    faces += block(
        rng, (-x, -x + 0.34, 0.62, 0.86, -0.14, 0.14), (58, 74, 70), contrast=6.0
    ).values()
    faces += block(rng, (x - 0.46, x - 0.42, 1.0, 1.04, -z, z), (60, 60, 60), contrast=6.0).values()
    return faces


def _trunk(
    rng: np.random.Generator, rings: list[FloatArray], trousers: Colour, top: Colour
) -> list[Face]:
    """Body of a person through rings of corners, in trousers below the second ring."""
    faces = []
    for low, high in pairwise(rings):
        faces += loft(rng, low, high, trousers if low is rings[0] else top, contrast=CLOTH_CONTRAST)
    return faces


def _limb(
    rng: np.random.Generator,
    points: tuple[Vector, Vector, Vector],
    radii_m: tuple[float, float, float, float],
    bgr: Colour,
) -> list[Face]:
    """Two tapered tubes; the second tube starts slightly before the joint, so that there is no gap
    where it bends.
    """
    start, joint, end = points
    x, height, z = (0.9 * at + 0.1 * back for at, back in zip(joint, start, strict=True))
    first = _tube(rng, start, joint, (radii_m[0], radii_m[1]), bgr)
    return [*first, *_tube(rng, (x, height, z), end, (radii_m[2], radii_m[3]), bgr)]


def _tube(
    rng: np.random.Generator,
    start: Vector,
    end: Vector,
    radii_m: tuple[float, float],
    bgr: Colour,
    *,
    n_sides: int = 6,
) -> list[Face]:
    """A tapered tube between two points (x, height above the road, z)."""
    low, high = rings_across(start, end, radii_m, n_sides=n_sides)
    return loft(rng, low, high, bgr, contrast=6.0)


def _head(
    rng: np.random.Generator,
    *,
    x: float,
    low: float,
    high: float,
    skin: Colour,
    helmet: Colour | None = None,
) -> list[Face]:
    """Neck, face and hair, or a helmet; `x` is the middle of the head."""
    tall, wide = high - low, 1.0 if helmet is None else 1.1
    hair = chosen(rng, HAIR) if helmet is None else helmet
    shoulders = ring((x - 0.02, low - 0.03, 0.0), (0.058, 0.058), n_sides=6)
    neck = loft(
        rng, shoulders, ring((x - 0.01, low + 0.3 * tall, 0.0), (0.052, 0.052), n_sides=6), skin
    )
    rings = [
        ring((x, low + fraction * tall, 0.0), (wide * rx, wide * rz)) for fraction, rx, rz in HEAD
    ]
    head = []
    for (under, over), bare in zip(pairwise(rings), BARE_SIDES, strict=True):
        head += loft(rng, under, over, hair, contrast=4.0, others=dict.fromkeys(bare, skin))
    head.append(lid(rng, rings[-1], hair, contrast=4.0))
    return [*neck, *(replace(face, part=IdentifyingPart.HEAD) for face in head)]


def _bicycle_wheel(rng: np.random.Generator, centre_x: float, radius: float) -> list[Face]:
    """A tyre of flat faces, and a disc that is transparent except for rim and spokes."""
    disc, *tyre = _wheel(rng, centre_x, radius)
    side = disc.texture.shape[0]
    middle, rim = (side // 2, side // 2), round(0.45 * side)
    kept = np.zeros(disc.texture.shape[:2], np.uint8)
    cv2.circle(kept, middle, rim, 255, max(2, round(0.09 * side)))
    for angle in np.arange(8) * np.pi / 4:
        end = (
            round(middle[0] + rim * float(np.cos(angle))),
            round(middle[1] + rim * float(np.sin(angle))),
        )
        cv2.line(kept, middle, end, 255, 1)
    disc.texture[:, :, 3] = np.minimum(disc.texture[:, :, 3], kept)
    return [disc, *tyre]


def _wheel(
    rng: np.random.Generator, centre_x: float, radius: float, *, half_width: float = 0.022
) -> list[Face]:
    """A disc in the plane of the wheel, and a tyre of flat faces around it."""
    disc = coloured_face(
        rng,
        ((centre_x - radius, -2 * radius, 0), (2 * radius, 0, 0), (0, 2 * radius, 0)),
        RUBBER_BGR,
    )
    paint_wheel(disc.texture, (0.5, 0.5), 0.5)
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    cut_outside(
        disc.texture, [(0.5 + 0.5 * float(np.cos(a)), 0.5 + 0.5 * float(np.sin(a))) for a in angles]
    )
    turns = np.linspace(0, 2 * np.pi, N_TYRE_PIECES + 1)
    rim = np.stack(
        [centre_x + radius * np.cos(turns), -radius + radius * np.sin(turns)], axis=1
    ).tolist()
    tyre = [
        coloured_face(
            rng,
            ((x0, y0, -half_width), (0, 0, 2 * half_width), (x1 - x0, y1 - y0, 0)),
            RUBBER_BGR,
            contrast=5.0,
        )
        for (x0, y0), (x1, y1) in pairwise(rim)
    ]
    return [replace(disc, two_sided=True), *tyre]


def motorcyclist(rng: np.random.Generator, size_hwl_m: Size) -> list[Face]:
    """The faces of a motorcycle with a rider in a helmet, leaning forward."""
    height, width, length = size_hwl_m
    x, z, radius = length / 2, width / 2, 0.32
    jacket, helmet, paint = chosen(rng, TOPS), chosen(rng, HELMETS), chosen(rng, BIKES)
    seat, neck = 0.50 * height, 0.83 * height
    arm, leg = (0.0, 0.5, 0.62 * height, 0.72 * height), (-0.15, 0.35, 0.25, seat)
    faces = prism(rng, (-0.28, 0.22, seat, neck, -0.62 * z, 0.62 * z), jacket, contrast=8.0)
    for limb, z0, z1, bgr in (
        (arm, 0.6 * z, 0.85 * z, jacket),
        (arm, -0.85 * z, -0.6 * z, jacket),
        (leg, 0.3 * z, 0.6 * z, (52, 48, 46)),
        (leg, -0.6 * z, -0.3 * z, (52, 48, 46)),
    ):
        faces += prism(rng, (*limb, z0, z1), bgr, contrast=8.0)
    head = prism(rng, (-0.05, 0.24, neck, height, -0.14, 0.14), helmet, contrast=6.0)
    faces += [replace(face, part=IdentifyingPart.HEAD) for face in head]
    for centre in (-x + radius, x - radius):
        faces += _wheel(rng, centre, radius, half_width=0.07)
    body = block(rng, (-0.8 * x, 0.7 * x, 0.32, seat, -0.15, 0.15), paint, contrast=6.0)
    paint_box(body["back"].texture, (0.2, 0.05, 0.8, 0.35), (36, 30, 200))
    fairing = block(
        rng, (0.45 * x, 0.75 * x, 0.55, 0.68 * height, -0.24, 0.24), paint, contrast=6.0
    )
    paint_box(fairing["front"].texture, (0.2, 0.3, 0.8, 0.8), (235, 240, 240))
    mirrors = block(rng, (0.35, 0.4, 0.66 * height, 0.68 * height, -z, z), (30, 30, 30))
    plate = plate_face(rng, ((-0.95 * x, -0.80, 0.10), (0.0, 0.0, -0.20), (0.0, 0.15, 0.0)))
    return [shadow(size_hwl_m), *faces, *body.values(), *fairing.values(), *mirrors.values(), plate]
