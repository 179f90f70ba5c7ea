"""Regions of the world, whose road users and lanes differ in size, and the region of a position."""

from typing import Literal

Region = Literal["unknown", "europe", "north-america", "east-asia"]

_AREAS: tuple[tuple[Region, float, float, float, float], ...] = (
    ("europe", 35.0, 72.0, -25.0, 45.0),
    ("north-america", 15.0, 75.0, -170.0, -50.0),
    ("east-asia", -11.0, 55.0, 92.0, 150.0),
)
"""Regions with their smallest and largest latitude and longitude in degrees."""


def region_at(latitude_deg: float, longitude_deg: float) -> Region:
    """The region of a position in degrees (WGS 84); "unknown" outside the known regions."""
    for region, south, north, west, east in _AREAS:
        if south <= latitude_deg <= north and west <= longitude_deg <= east:
            return region
    return "unknown"
