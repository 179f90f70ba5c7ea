"""GPX files, read with gpxpy after a check of the XML: GPX 1.0 and 1.1 with the speeds of their extensions."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping
from datetime import UTC
from pathlib import Path
from typing import Any

import numpy as np

from track_range.foundation.files.input_files import read_text
from track_range.foundation.files.numeric_text import number
from track_range.foundation.files.xml_events import parse_xml
from track_range.recording.telemetry.errors import TelemetryError
from track_range.recording.telemetry.libraries import imported
from track_range.recording.telemetry.positions import speed_from_positions
from track_range.recording.telemetry.track import TelemetryTrack

MAX_GPX_BYTES = 50_000_000
"""Size limit of a GPX file, bytes; a day at 1 Hz with extensions has 35 MB."""

_MAX_NAMESPACES = 100
"""Largest number of namespace declarations; gpxpy searches for them in the text, which is slow with many."""

_EXPECTED = "a GPX file"


def read_gpx(path: Path) -> TelemetryTrack:
    """Telemetry of the track points of a GPX file, or of its route or way points if it has no track.

    Speeds are those of the file (GPX 1.0 `speed`, Garmin's TrackPointExtension and others, in m/s), or from positions.

    Raises:
        TelemetryError: it cannot be read, is unsafe XML, has no points with times, or gpxpy is not installed.
    """
    text = read_text(path, TelemetryError, _EXPECTED, max_bytes=MAX_GPX_BYTES)
    _check_xml(text, path)
    gpxpy = imported("gpxpy", str(path))
    try:
        gpx = gpxpy.parse(text)
    except (ValueError, KeyError, TypeError, AttributeError, gpxpy.gpx.GPXException) as error:
        raise TelemetryError(f"{path}: expected {_EXPECTED}, found one with invalid points or times.") from error
    points = [point for point in _points(gpx) if point.time is not None]
    if not points:
        raise TelemetryError(f"{path}: expected track points with times, found none.")
    rows = np.array([_row(point) for point in points])
    _, first = np.unique(rows[:, 0], return_index=True)
    rows = rows[np.sort(first)]  # some programs write each point twice
    utc_s, latitude_deg, longitude_deg, speed_mps, course_deg = rows.T
    if np.isfinite(speed_mps).any():
        return TelemetryTrack(
            time_s=utc_s,
            speed_mps=speed_mps,
            course_rad=np.radians(course_deg),
            latitude_deg=latitude_deg,
            longitude_deg=longitude_deg,
            source=path.name,
            clock="utc",
            states_unit=False,
        )
    track = speed_from_positions(utc_s, latitude_deg, longitude_deg, utc_s, source=path.name, clock="utc")
    if track is None:
        raise TelemetryError(f"{path}: expected at least two positions with different times, found fewer.")
    return track


class _NoHandler:
    """Handler that only lets the parser check the XML."""

    def start(self, path: list[str], attributes: Mapping[str, str], line: int) -> None:
        """Ignore the start of an element."""

    def end(self, path: list[str], text: str, line: int) -> None:
        """Ignore the end of an element."""


def _check_xml(text: str, path: Path) -> None:
    """Check the limits of XML: no document type or entities, no deep nesting, few namespaces."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise TelemetryError(f"{path}: expected {_EXPECTED} without a document type, found one; remove it.")
    if text.count("xmlns") > _MAX_NAMESPACES:
        raise TelemetryError(f"{path}: expected {_EXPECTED} with at most {_MAX_NAMESPACES} namespaces, found more.")
    parse_xml(io.BytesIO(text.encode()), path, _NoHandler(), TelemetryError, _EXPECTED)


def _points(gpx: Any) -> Iterator[Any]:
    """Track points; without any, route points; without any, way points."""
    tracked = [point for track in gpx.tracks for segment in track.segments for point in segment.points]
    yield from tracked or [point for route in gpx.routes for point in route.points] or gpx.waypoints


def _row(point: Any) -> tuple[float, float, float, float, float]:
    """UTC in s, latitude, longitude, speed in m/s and course in degrees; NaN = not stated."""
    time = point.time if point.time.tzinfo is not None else point.time.replace(tzinfo=UTC)
    extended = dict(_extensions(point))
    speed_mps = getattr(point, "speed", None)
    course_deg = getattr(point, "course", None)
    return (
        time.timestamp(),
        _number(point.latitude),
        _number(point.longitude),
        extended.get("speed", math.nan) if speed_mps is None else _number(speed_mps),
        extended.get("course", math.nan) if course_deg is None else _number(course_deg),
    )


def _extensions(point: Any) -> Iterator[tuple[str, float]]:
    """Names, without namespaces, and numbers of the extensions of a point."""
    for extension in point.extensions:
        for element in extension.iter():
            value = number((element.text or "").strip())
            if isinstance(element.tag, str) and math.isfinite(value):
                yield element.tag.rpartition("}")[2].lower(), value


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) else math.nan
