"""Colours: of tracks and warnings in the overlay, of ranging methods in the charts of the report."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence

import numpy as np

from track_range.ranging.registry import methods

Bgr = tuple[int, int, int]

BLACK, GREY, WHITE = (0, 0, 0), (210, 210, 210), (255, 255, 255)
AMBER, RED = (0, 170, 255), (50, 50, 240)
CALM: Bgr = (125, 110, 95)

LANE_COLOUR: Bgr = (70, 255, 215)
"""Of the own lane's lines: between amber and the first of the tracks' greens."""

FUSED_COLOUR = "#2f7ed8"

OTHER_COLOURS = ("#c44e9c", "#9c8c0a", "#1496ab", "#d1495b")
"""Of methods in a result that are not registered here, in the order of their names."""

TTC_AMBER_S, TTC_RED_S = 4.0, 2.0

LUMA_MIN = 0.5
"""Of full white: darker text is hard to read on a label's backing."""


def track_palette() -> tuple[Bgr, ...]:
    """Twelve colours, bright enough to be read on a dark label, following ones far apart.

    Hues run from 75 to 325 degrees: red and amber are kept for warnings.
    """
    hues = np.linspace(75, 325, 6)[[0, 3, 1, 4, 2, 5]] / 360
    rgb = np.array([colorsys.hsv_to_rgb(hue, tone, 1.0) for tone in (0.85, 0.4) for hue in hues.tolist()])
    luma = rgb @ (0.299, 0.587, 0.114)
    white = np.clip((LUMA_MIN - luma) / (1 - luma), 0, 1)[:, None]
    bgr = np.rint(255 * (rgb + white * (1 - rgb)))[:, ::-1].astype(int)
    return tuple((int(blue), int(green), int(red)) for blue, green, red in bgr)


PALETTE = track_palette()


def track_colour(track_id: int) -> Bgr:
    """The colour of a track, the same in every frame."""
    return PALETTE[track_id % len(PALETTE)]


def alarm_colour(ttc_s: float, *, may_hit: bool = True) -> Bgr | None:
    """Red below 2 s to collision, amber below 4 s, else none (NaN: none); none for what passes beside."""
    if not may_hit:
        return None
    if ttc_s < TTC_RED_S:
        return RED
    return AMBER if ttc_s < TTC_AMBER_S else None


def method_colours() -> dict[str, str]:
    """The colour, "#rrggbb", of each registered method and of the fused distance."""
    return {**{method.name: method.colour for method in methods()}, "fused": FUSED_COLOUR}


def colour_of_each(names: Sequence[str]) -> dict[str, str]:
    """The colour of each of a result's distances; a filtered one has its method's."""
    known = method_colours()
    unknown = sorted({name.removesuffix("_kf") for name in names} - known.keys())
    known |= {name: OTHER_COLOURS[i % len(OTHER_COLOURS)] for i, name in enumerate(unknown)}
    return {name: known[name.removesuffix("_kf")] for name in names}
