"""GPX files, read with gpxpy after a check of the XML: GPX 1.0 and 1.1 with the speeds of their
extensions.
"""

import io
import math
from datetime import UTC
from pathlib import Path
from typing import Any

import numpy as np

from track_range.foundation.files.input_files import read_text
from track_range.foundation.files.numeric_text import number, plain_number
from track_range.foundation.files.xml_events import parse_xml
from track_range.recording.telemetry.sidecars.sidecar import Sidecar, of_file
from track_range.recording.telemetry.tracks.positions import speed_from_positions
from track_range.recording.telemetry.tracks.samples import Sample, plain_track
from track_range.recording.telemetry.tracks.track import (
    TelemetryError,
    TelemetryTrack,
    optional_package,
)

_MAX_BYTES = 50_000_000  # size limit; a day at 1 Hz with extensions has 35 MB
# number of declarations; gpxpy searches for them in the text, which is slow with many
_MAX_NAMESPACES = 100

_EXPECTED = "a GPX file"


def read_gpx(path: Path) -> TelemetryTrack:
    """Telemetry of the track points of a GPX file, or of its route or way points if it has no
    track.

    Speeds are read from the file (GPX 1.0 `speed`, Garmin's TrackPointExtension and others, in m/s)
    or computed from positions. Raises TelemetryError if it cannot be read, is unsafe XML or has no
    points with times, or gpxpy is not installed.
    """
    text = read_text(path, TelemetryError, _EXPECTED, max_bytes=_MAX_BYTES)
    if text.count("xmlns") > _MAX_NAMESPACES:
        raise TelemetryError(
            f"{path}: expected {_EXPECTED} with at most {_MAX_NAMESPACES} namespaces, found more."
        )
    parse_xml(io.BytesIO(text.encode()), path, None, TelemetryError, _EXPECTED)
    gpxpy = optional_package("gpxpy", str(path))
    try:
        gpx = gpxpy.parse(text)
    except (ValueError, KeyError, TypeError, AttributeError, gpxpy.gpx.GPXException) as error:
        raise TelemetryError(
            f"{path}: expected {_EXPECTED}, found a file with invalid points or times."
        ) from error
    tracked = [
        point for track in gpx.tracks for segment in track.segments for point in segment.points
    ]
    points = tracked or [point for route in gpx.routes for point in route.points] or gpx.waypoints
    samples = [_sample(point) for point in points if point.time is not None]
    if not samples:
        raise TelemetryError(f"{path}: expected track points with times, found none.")
    first: dict[float, Sample] = {}  # some programs write each point twice
    for sample in samples:
        first.setdefault(sample.utc_s, sample)
    samples = list(first.values())
    if any(math.isfinite(sample.speed_mps) for sample in samples):
        return plain_track(samples, path.name, "utc", unit=None)
    utc_s, _, _, _, latitude_deg, longitude_deg = np.array(samples).T
    derived = speed_from_positions(
        utc_s, latitude_deg, longitude_deg, utc_s, source=path.name, clock="utc"
    )
    if derived is None:
        raise TelemetryError(
            f"{path}: expected at least two positions with different times, found fewer."
        )
    return derived


def _sample(point: Any) -> Sample:
    """A point with its UTC as time."""
    time = point.time if point.time.tzinfo is not None else point.time.replace(tzinfo=UTC)
    extended = {}
    for element in (element for extension in point.extensions for element in extension.iter()):
        value = number((element.text or "").strip())
        if isinstance(element.tag, str) and math.isfinite(value):
            extended[element.tag.rpartition("}")[2].lower()] = value  # without namespace
    speed_mps, course_deg = (
        extended.get(name, math.nan)
        if getattr(point, name, None) is None
        else plain_number(getattr(point, name))
        for name in ("speed", "course")
    )
    utc_s = time.timestamp()
    return Sample(
        utc_s,
        utc_s,
        speed_mps,
        course_deg,
        plain_number(point.latitude),
        plain_number(point.longitude),
    )


GPX = Sidecar(suffixes=(".gpx",), read=of_file(read_gpx))
