r"""Bodies of vans, trucks and buses: boxes of full width with windows and wheels.

Back, front and sides coincide with the 3-D box, so that the ray through the centre of a box in the
image meets the paint where it meets the 3-D box (except above the bonnet of vans and trucks, which
a road camera does not see from above). Below the sill there are wheels, with the road visible
between them.
"""

import numpy as np

from track_range.simulation.world.bodies.cars import LAMP_RED, LAMP_WHITE
from track_range.simulation.world.bodies.faces import (
    ALL_SIDES,
    Colour,
    Extent,
    Face,
    Size,
    block,
    chosen,
    shaded,
    shadow,
    with_plate,
)
from track_range.simulation.world.textures.surfaces import SEAM, clip, fill, pane, shade_rows, wheel

VAN_PAINTS: tuple[Colour, ...] = (
    (208, 208, 206),
    (200, 202, 204),
    (128, 126, 122),
    (110, 66, 40),
    (44, 40, 140),
)
CARGO_PAINTS: tuple[Colour, ...] = ((204, 204, 200), (190, 192, 190), (150, 96, 52), (60, 110, 60))
BUS_PAINTS: tuple[Colour, ...] = ((60, 190, 225), (44, 40, 170), (206, 206, 204), (150, 100, 50))
STEEL: Colour = (52, 52, 55)

SILL_M = 0.34  # height of the lower edge of the body

SHADE = ((0.0, 1.08), (0.3, 1.0), (0.75, 0.9), (1.0, 0.62))


def van(rng: np.random.Generator, size_hwl_m: Size) -> list[Face]:
    """The faces of a van: a high box, and a bonnet of about half its height."""
    height, width, length = size_hwl_m
    paint = chosen(rng, VAN_PAINTS)
    x, z, bonnet_x = length / 2, width / 2, 0.27 * length
    box = _painted(rng, (-x, bonnet_x, 0, height, -z, z), paint)
    bonnet = _painted(
        rng, (bonnet_x, x, 0, 0.56 * height, -z, z), paint, sides=("front", "left", "right", "top")
    )
    _panes(box["back"], (0.09, 0.10, 0.47, 0.40), (0.53, 0.10, 0.91, 0.40))
    fill(box["back"].texture, (0.495, 0.05, 0.505, 0.86), SEAM)
    _panes(box["left"], (0.03, 0.1, 0.28, 0.4))
    _panes(box["right"], (0.72, 0.1, 0.97, 0.4))
    for face, seam in ((box["left"], 0.3), (box["right"], 0.7)):
        fill(face.texture, (seam, 0.06, seam + 0.006, 0.84), SEAM)
    _panes(box["front"], (0.06, 0.06, 0.94, 0.42))
    _lamps(box["back"], (0.44, 0.66), LAMP_RED, 0.09)
    _lamps(bonnet["front"], (0.16, 0.34), LAMP_WHITE, 0.2)
    fill(bonnet["front"].texture, (0.25, 0.18, 0.75, 0.36), (30, 30, 32))
    for face, wheel_at in (
        (box["left"], 0.8),
        (box["right"], 0.2),
        (bonnet["left"], 0.6),
        (bonnet["right"], 0.4),
    ):
        _on_wheels(face, 0.34, (wheel_at,))
    for face in (box["back"], bonnet["front"]):
        _on_tyres(face)
    _, back_plate = with_plate(box["back"], (0.36, 0.62, 0.64, 0.68))
    _, front_plate = with_plate(bonnet["front"], (0.36, 0.56, 0.64, 0.66))
    return [shadow(size_hwl_m), *box.values(), *bonnet.values(), back_plate, front_plate]


def truck(rng: np.random.Generator, size_hwl_m: Size) -> list[Face]:
    """The faces of a truck: a cargo box on a frame, and a cab; three wheels per side."""
    height, width, length = size_hwl_m
    paint, cargo_paint = chosen(rng, VAN_PAINTS), chosen(rng, CARGO_PAINTS)
    x, z, bed, cab_x = length / 2, width / 2, 0.30 * height, 0.5 * length - 2.1
    cargo = _painted(rng, (-x, cab_x - 0.3, bed, height, -z, z), cargo_paint)
    frame = _painted(rng, (-x, cab_x, 0, bed, -z, z), STEEL, sides=("back", "left", "right"))
    cab = _painted(rng, (cab_x, x, 0, 0.85 * height, -z, z), paint)
    for side, window, wheels in (
        ("left", (0.08, 0.55), (0.72, 0.87)),
        ("right", (0.45, 0.92), (0.13, 0.28)),
    ):
        for fraction in np.linspace(0.08, 0.92, 8):
            fill(cargo[side].texture, (fraction, 0.02, fraction + 0.004, 0.98), SEAM)
        fill(cargo[side].texture, (0.2, 0.3, 0.8, 0.55), paint)
        _panes(cab[side], (window[0], 0.12, window[1], 0.45))
        _on_wheels(frame[side], 0.48, wheels, sill_m=0.55)
        _on_wheels(cab[side], 0.48, (0.5,), sill_m=0.4)
    back = cargo["back"].texture
    for left in (0.0, 0.488, 0.97):
        fill(back, (left, 0, left + 0.03, 1), (88, 88, 88))
    for left in (0.25, 0.38, 0.60, 0.73):
        fill(back, (left, 0.03, left + 0.012, 0.97), (70, 70, 72))
    fill(back, (0.0, 0.96, 1.0, 1.0), (60, 60, 62))
    _lamps(frame["back"], (0.15, 0.34), LAMP_RED, 0.16)
    _on_tyres(frame["back"], sill_m=0.55)
    fill(cab["front"].texture, (0.06, 0.08, 0.94, 0.44), SEAM)
    _panes(cab["front"], (0.08, 0.1, 0.92, 0.42))
    fill(cab["front"].texture, (0.16, 0.52, 0.84, 0.70), (34, 34, 36))
    _lamps(cab["front"], (0.72, 0.80), LAMP_WHITE, 0.16)
    _on_tyres(cab["front"])
    _, back_plate = with_plate(frame["back"], (0.4, 0.15, 0.6, 0.3))
    _, front_plate = with_plate(cab["front"], (0.4, 0.825, 0.6, 0.87))
    return [
        shadow(size_hwl_m),
        *cargo.values(),
        *frame.values(),
        *cab.values(),
        back_plate,
        front_plate,
    ]


def bus(rng: np.random.Generator, size_hwl_m: Size) -> list[Face]:
    """The faces of a city bus: one box with a row of windows, doors on the right, and a destination
    display.
    """
    height, width, length = size_hwl_m
    paint = chosen(rng, BUS_PAINTS)
    x, z = length / 2, width / 2
    hull = _painted(rng, (-x, x, 0, height, -z, z), paint)
    for side in ("left", "right"):
        lefts = np.linspace(0.03, 0.86, 7).tolist()
        _panes(hull[side], *((left, 0.14, left + 0.115, 0.5) for left in lefts))
        fill(hull[side].texture, (0, 0.56, 1, 0.6), (230, 230, 230))
    for left in (0.30, 0.86):
        _panes(hull["right"], (left, 0.14, left + 0.1, 0.84))
        fill(hull["right"].texture, (left + 0.048, 0.14, left + 0.052, 0.84), SEAM)
    for face, low in ((hull["back"], 0.42), (hull["front"], 0.58)):
        fill(face.texture, (0.2, 0.03, 0.8, 0.12), (24, 24, 24))
        fill(face.texture, (0.42, 0.05, 0.58, 0.10), (70, 190, 250))
        _panes(face, (0.06, 0.15, 0.94, low))
        _on_tyres(face)
    fill(hull["back"].texture, (0.2, 0.55, 0.8, 0.78), shaded(paint, 0.8))
    _lamps(hull["back"], (0.60, 0.72), LAMP_RED, 0.1)
    _lamps(hull["front"], (0.74, 0.80), LAMP_WHITE, 0.16)
    _on_wheels(hull["left"], 0.48, (0.24, 0.72))
    _on_wheels(hull["right"], 0.48, (0.28, 0.76))
    _, back_plate = with_plate(hull["back"], (0.4, 0.80, 0.6, 0.85))
    _, front_plate = with_plate(hull["front"], (0.4, 0.835, 0.6, 0.88))
    return [shadow(size_hwl_m), *hull.values(), back_plate, front_plate]


def _painted(
    rng: np.random.Generator, extent: Extent, bgr: Colour, *, sides: tuple[str, ...] = ALL_SIDES
) -> dict[str, Face]:
    """The given sides of a box by name, lighter at the top."""
    faces = block(rng, extent, bgr, contrast=5.0, sides=sides)
    for side in faces.keys() - {"top"}:
        shade_rows(faces[side].texture, SHADE)
    return faces


def _panes(face: Face, *boxes: tuple[float, float, float, float]) -> None:
    for x1, y1, x2, y2 in boxes:
        pane(face.texture, [(x1, y1), (x2, y1), (x2, y2), (x1, y2)])


def _lamps(face: Face, rows: tuple[float, float], bgr: Colour, width: float) -> None:
    """Paint two lamps on a back or front; `rows` and `width` are fractions of the texture's
    size.
    """
    for left in (0.02, 0.98 - width):
        fill(face.texture, (left, rows[0], left + width, rows[1]), bgr)


def _on_wheels(
    face: Face, radius_m: float, at: tuple[float, ...], *, sill_m: float = SILL_M
) -> None:
    """Paint wheels at fractions `at` of a side's length; the texture is transparent between
    them.
    """
    down_m = float(face.down[1])
    radius, sill = radius_m / down_m, 1 - sill_m / down_m
    for fraction in at:
        wheel(face.texture, (fraction, 1 - radius), radius)
    clip(
        face.texture,
        [[(0, 0), (1, 0), (1, sill), (0, sill)]],
        [(fraction, 1 - radius, radius) for fraction in at],
    )


def _on_tyres(face: Face, *, sill_m: float = SILL_M) -> None:
    """Paint a bumper and two tyres below a back or front."""
    sill = 1 - sill_m / float(face.down[1])
    fill(face.texture, (0, sill - 0.06, 1, sill), (38, 38, 40))
    fill(face.texture, (0, sill, 1, 1), (20, 20, 22))
    tyres = [
        [(left, sill), (left + 0.16, sill), (left + 0.16, 1), (left, 1)] for left in (0.04, 0.80)
    ]
    clip(face.texture, [[(0, 0), (1, 0), (1, sill), (0, sill)], *tyres])
