"""The colours of the ranging methods, the same in every chart of a report; 3 : 1 on white and on near black."""

from __future__ import annotations

METHOD_COLOURS = {
    "mono": "#cf7410",
    "lane": "#9467bd",
    "ground": "#a0714f",
    "stereo": "#1aa36b",
    "sgbm": "#7f8a95",
    "fused": "#2f7ed8",
}
"""Colour of a method and of its filtered twin (`_kf`, dashed)."""

OTHER_COLOURS = ("#c44e9c", "#9c8c0a", "#1496ab", "#d1495b")
"""For methods that the table does not know, in the order of their names."""


def colour_of_each(methods: list[str]) -> dict[str, str]:
    """A colour for each method; a filtered one has its method's."""
    strangers = sorted({name.removesuffix("_kf") for name in methods} - METHOD_COLOURS.keys())
    colours = METHOD_COLOURS | {name: OTHER_COLOURS[i % len(OTHER_COLOURS)] for i, name in enumerate(strangers)}
    return {name: colours[name.removesuffix("_kf")] for name in methods}
