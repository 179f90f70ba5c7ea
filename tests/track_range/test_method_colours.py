"""The methods' colours can be told from a page, light or dark (WCAG 2.2, 1.4.11: 3 : 1 for graphics)."""

from __future__ import annotations

import pytest

from track_range.overlay.colours import OTHER_COLOURS, colour_of_each, method_colours

CARDS = ("#ffffff", "#1b2128")


def luminance(colour: str) -> float:
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(a: str, b: str) -> float:
    dark, light = sorted((luminance(a), luminance(b)))
    return (light + 0.05) / (dark + 0.05)


def test_black_on_white_is_21() -> None:
    assert contrast("#000000", "#ffffff") == pytest.approx(21)


@pytest.mark.parametrize("card", CARDS)
@pytest.mark.parametrize("colour", [*method_colours().values(), *OTHER_COLOURS])
def test_each_is_seen_on_light_and_dark(colour: str, card: str) -> None:
    assert contrast(colour, card) >= 3


def test_unknown_methods_have_own_colours_and_filtered_ones_their_methods() -> None:
    found = colour_of_each(["fused", "fused_kf", "radar", "sonar", "radar_kf"])
    assert found["fused"] == found["fused_kf"]
    assert found["radar"] == found["radar_kf"] != found["sonar"]
