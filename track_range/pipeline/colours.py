"""Colours of tracks and warnings in the overlay, and of ranging methods in the charts of the
report.
"""

import colorsys
from collections.abc import Sequence

import numpy as np

from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.registry import methods

Bgr = tuple[int, int, int]

BLACK, GREY, WHITE = (0, 0, 0), (210, 210, 210), (255, 255, 255)
AMBER, RED = (0, 170, 255), (50, 50, 240)
CALM: Bgr = (125, 110, 95)  # bar of a time to collision that is not urgent
# lines of the ego lane; a hue between amber and the greens of tracks
LANE_COLOUR: Bgr = (70, 255, 215)

FUSED_COLOUR = "#2f7ed8"
"""Fused distance in the charts."""

OTHER_COLOURS = ("#c44e9c", "#9c8c0a", "#1496ab", "#d1495b")
"""Methods of a result that are not registered, in the order of their names."""

# times to collision in seconds below which tracks are marked in amber and red
TTC_AMBER_S, TTC_RED_S = 4.0, 2.0
AMBER_PROBABILITY = 0.25  # probability of contact from which tracks are marked in amber
# smallest luma (0..1) of the colour of a track; darker text is hard to read on the background of
# labels
LUMA_MIN = 0.5


def track_palette() -> tuple[Bgr, ...]:
    """Twelve colours that are readable on dark labels, neighbours with different hues.

    Hues range from 75 to 325 degrees; red and amber are reserved for warnings.
    """
    hues = np.linspace(75, 325, 6)[[0, 3, 1, 4, 2, 5]] / 360
    rgb = np.array(
        [colorsys.hsv_to_rgb(hue, tone, 1.0) for tone in (0.85, 0.4) for hue in hues.tolist()]
    )
    luma = rgb @ (0.299, 0.587, 0.114)
    white = np.clip((LUMA_MIN - luma) / (1 - luma), 0, 1)[:, None]
    bgr = np.rint(255 * (rgb + white * (1 - rgb)))[:, ::-1].astype(int)
    return tuple((int(blue), int(green), int(red)) for blue, green, red in bgr)


PALETTE = track_palette()  # colours of tracks


def track_colour(track_id: int) -> Bgr:
    """Colour of a track, the same in every frame."""
    return PALETTE[track_id % len(PALETTE)]


def alarm_colour(ttc_s: float) -> Bgr | None:
    """Red below 2 s to collision, amber below 4 s, else None (also for NaN)."""
    if ttc_s < TTC_RED_S:
        return RED
    return AMBER if ttc_s < TTC_AMBER_S else None


def warning_colour(result: FrameResult, row: int) -> Bgr | None:
    """Red during the collision warning of a track, amber while a contact is possible, else None.

    Results without warnings have the colours of their times to collision.
    """
    if not result.alarms.has_warnings:
        return alarm_colour(float(result.ttc_s[row]))
    if result.warnings.active[row]:
        return RED
    return AMBER if result.warnings.probability[row] >= AMBER_PROBABILITY else None


def method_colours() -> dict[str, str]:
    """Colours "#rrggbb" of the registered methods and of the fused distance, by name."""
    return {**{method.name: method.colour for method in methods()}, "fused": FUSED_COLOUR}


def colour_of_each(names: Sequence[str]) -> dict[str, str]:
    """Colours of the distances of a result by name; a filtered distance has the colour of its
    method.
    """
    known = method_colours()
    unknown = sorted({name.removesuffix("_kf") for name in names} - known.keys())
    known |= {name: OTHER_COLOURS[i % len(OTHER_COLOURS)] for i, name in enumerate(unknown)}
    return {name: known[name.removesuffix("_kf")] for name in names}
