"""Kinds of roads: lanes, markings, surfaces and roadside objects.

All x are in metres to the right of the ego lane's centre. All lengths along the road divide
`PERIOD_M`, after which road and sides repeat.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

PERIOD_M = 48.0  # length along the road after which its textures and objects repeat
Colour = tuple[float, float, float]  # blue, green, red, 0 to 255

PAVEMENT: Colour = (138, 140, 142)
GRASS: Colour = (52, 104, 84)
KERB: Colour = (160, 162, 163)
GRAVEL: Colour = (108, 120, 128)


@dataclass(frozen=True, slots=True)
class Row:
    """A row of identical objects along the road."""

    kind: Literal["tree", "lamp", "post"]
    x_m: float  # lateral position
    every_m: float  # distance between objects
    first_m: float  # position of the first object along the road


@dataclass(frozen=True, slots=True, kw_only=True)
class Surroundings:
    """One kind of road."""

    half_width_m: float  # half of the width of the ground
    # (number, from, to): 0 = ego lane, 1 = right of it, -1 = left of it
    lanes: tuple[tuple[int, float, float], ...]
    # (from, to, colour) of the ground that is not asphalt
    bands: tuple[tuple[float, float, Colour], ...]
    solid_m: tuple[float, ...]  # centres of the lines
    dashed_m: tuple[float, ...]
    dash_m: tuple[float, float]  # length and period of dashes
    side: Literal["houses", "woods"]  # scenery at the edges of the ground
    rails_m: tuple[float, ...] = ()  # positions of guard rails
    rows: tuple[Row, ...] = ()  # rows of trees, lamps and posts
    texels_per_m: int = 48  # resolution of the ground's texture

    def lane_of(self, x_m: float) -> int | None:
        """Number of the lane at a lateral position; None = outside all lanes."""
        return next((number for number, from_m, to_m in self.lanes if from_m <= x_m < to_m), None)


_TOWN_BANDS = (
    (-11.0, -7.6, PAVEMENT),
    (-7.65, -7.5, KERB),
    (7.6, 11.0, PAVEMENT),
    (7.5, 7.65, KERB),
)

_TOWN = Surroundings(
    half_width_m=11.0,
    lanes=((-1, -5.25, -1.75), (0, -1.75, 1.75), (1, 1.75, 5.25)),
    bands=_TOWN_BANDS,
    solid_m=(-1.87, -1.63, -5.3, 5.3),
    dashed_m=(1.75,),
    dash_m=(4.0, 12.0),
    side="houses",
)
SURROUNDINGS = {  # the kinds of roads by name
    "town": _TOWN,
    "city": replace(
        _TOWN,
        half_width_m=13.0,
        bands=((-13.0, -7.6, PAVEMENT), _TOWN_BANDS[1], (7.6, 13.0, PAVEMENT), _TOWN_BANDS[3]),
        rows=(
            Row("tree", -10.6, 16.0, 9.0),
            Row("tree", 10.8, 24.0, 15.0),
            Row("lamp", 8.2, 24.0, 3.0),
            Row("lamp", -8.2, 24.0, 15.0),
        ),
    ),
    "country": Surroundings(
        half_width_m=26.0,
        lanes=((-1, -5.25, -1.75), (0, -1.75, 1.75)),
        bands=((-26.0, -6.2, GRASS), (-6.2, -5.6, GRAVEL), (2.3, 2.9, GRAVEL), (2.9, 26.0, GRASS)),
        solid_m=(-5.25, 1.75),
        dashed_m=(-1.75,),
        dash_m=(4.0, 12.0),
        side="woods",
        rows=(
            Row("tree", 8.5, 24.0, 11.0),
            Row("tree", -11.5, 16.0, 3.0),
            Row("post", 3.4, 24.0, 6.0),
            Row("post", -6.8, 24.0, 6.0),
        ),
        texels_per_m=32,
    ),
    "highway": Surroundings(
        half_width_m=30.0,
        lanes=(
            (-1, -5.45, -1.8),
            (0, -1.8, 1.8),
            (1, 1.8, 5.45),
            (-3, -13.8, -10.2),
            (-2, -10.2, -6.9),
        ),
        bands=((-30.0, -17.0, GRASS), (-6.7, -6.1, GRAVEL), (9.2, 30.0, GRASS)),
        solid_m=(-5.45, 5.45, -6.95, -13.85),
        dashed_m=(-1.8, 1.8, -10.3),
        dash_m=(6.0, 16.0),
        side="woods",
        rails_m=(-6.4, 9.0, -16.8),
        rows=(
            Row("tree", 17.0, 16.0, 5.0),
            Row("tree", -23.0, 24.0, 13.0),
            Row("lamp", 10.0, 48.0, 20.0),
        ),
        texels_per_m=32,
    ),
}
