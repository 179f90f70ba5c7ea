"""Units of speed in headings and texts."""

from __future__ import annotations

import re

from track_range.recording.telemetry.sidecars.nmea import MPS_PER_KNOT

MPS_PER_UNIT = {"m/s": 1.0, "km/h": 1 / 3.6, "mph": 0.44704, "kn": MPS_PER_KNOT}
"""Factor from each unit of speed to m/s."""

_UNITS = (
    ("km/h", re.compile(r"km\s?/?\s?h|kmph|kph|km\s?/\s?hr", re.IGNORECASE)),
    ("mph", re.compile(r"mph|mi\s?/\s?h|miles", re.IGNORECASE)),
    ("m/s", re.compile(r"m\s?/\s?s|mps|m\s?s-1|meters?_?\s?per|metres?_?\s?per", re.IGNORECASE)),
    ("kn", re.compile(r"knots?|(?<![a-z])k[nt]s?(?![a-z])", re.IGNORECASE)),
)
"""Notations of the units, in the order in which they are looked for."""


def unit_in(text: str) -> str | None:
    """The unit of speed that a heading or a text names; None = none."""
    return next((unit for unit, notation in _UNITS if notation.search(text)), None)
