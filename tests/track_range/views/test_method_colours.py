"""Contrast of the methods' colours on light and dark pages (WCAG 2.2, 1.4.11: 3 : 1 for graphics)."""

from __future__ import annotations

import pytest

from track_range.pipeline.colours import OTHER_COLOURS, colour_of_each, method_colours

CARDS = ("#ffffff", "#1b2128")


def luminance(colour: str) -> float:
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
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


def test_colours_of_unknown_and_filtered_methods() -> None:
    colours = colour_of_each(["fused", "fused_kf", "radar", "sonar", "radar_kf"])
    assert colours["fused"] == colours["fused_kf"]
    assert colours["radar"] == colours["radar_kf"] != colours["sonar"]
