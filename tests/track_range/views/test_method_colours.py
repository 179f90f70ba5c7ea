"""Contrast of the methods' colours on light and dark pages (WCAG 2.2, 1.4.11: 3 : 1 for
graphics)."""

from __future__ import annotations

import colorsys

import numpy as np
import pytest

from track_range.pipeline.colours import FUSED_COLOUR, OTHER_COLOURS, colour_of_each, method_colours
from track_range.ranging.registry import methods

CARDS = ("#ffffff", "#1b2128")


def luminance(colour: str) -> float:
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [
        part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts
    ]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(a: str, b: str) -> float:
    dark, light = sorted((luminance(a), luminance(b)))
    return (light + 0.05) / (dark + 0.05)


def test_contrast_of_black_on_white_is_21() -> None:
    assert contrast("#000000", "#ffffff") == pytest.approx(21)


@pytest.mark.parametrize("card", CARDS)
@pytest.mark.parametrize("colour", [*method_colours().values(), *OTHER_COLOURS])
def test_contrast_on_light_and_dark(colour: str, card: str) -> None:
    assert contrast(colour, card) >= 3


def test_hues_of_methods_differ() -> None:
    """By 20 degrees at least, among the methods with lines in the charts and apart from greys."""
    tones = [method.colour for method in methods() if method.measures_distance]
    colours = [
        [int(tone[i : i + 2], 16) / 255 for i in (1, 3, 5)] for tone in [*tones, FUSED_COLOUR]
    ]
    hues_deg = sorted(
        360 * hue for hue, tone, _ in (colorsys.rgb_to_hsv(*rgb) for rgb in colours) if tone > 0.2
    )
    assert len(hues_deg) >= 5
    assert min(np.diff([*hues_deg, hues_deg[0] + 360])) > 20


def test_colours_of_unknown_and_filtered_methods() -> None:
    colours = colour_of_each(["fused", "fused_kf", "radar", "sonar", "radar_kf"])
    assert colours["fused"] == colours["fused_kf"]
    assert colours["radar"] == colours["radar_kf"] != colours["sonar"]
