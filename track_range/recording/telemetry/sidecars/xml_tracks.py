"""TCX files of Garmin and others, and KML files with times: Google's gx:Track, and places with a
time stamp.
"""

import math
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

from track_range.foundation.files.input_files import open_regular
from track_range.foundation.files.numeric_text import number
from track_range.foundation.files.xml_events import parse_xml
from track_range.recording.telemetry.sidecars.sidecar import Sidecar, of_file
from track_range.recording.telemetry.tracks.samples import Sample, track
from track_range.recording.telemetry.tracks.track import TelemetryError, TelemetryTrack

_EXPECTED = "a TCX or KML file"
_POINTS = ("Trackpoint", "Placemark")  # elements of a point


class _Points:
    """Handler that collects the points of a file."""

    def __init__(self) -> None:
        self.samples: list[Sample] = []
        self._point: dict[str, str] = {}
        self._whens: list[str] = []
        self._coordinates: list[str] = []

    def start(self, path: list[str], attributes: Mapping[str, str], line: int) -> None:
        """See `XmlHandler`."""
        if _local(path[-1]) in _POINTS:
            self._point = {}

    def end(self, path: list[str], text: str, line: int) -> None:
        """See `XmlHandler`."""
        name = _local(path[-1])
        if name == "coord":
            self._coordinates.append(text)
        elif name == "when" and "Track" in map(_local, path):
            self._whens.append(text)
        elif name == "Track" and self._whens:
            for when, coordinates in zip(self._whens, self._coordinates, strict=False):
                self._add(when, coordinates.split())
            self._whens, self._coordinates = [], []
        elif name in _POINTS:
            cells = self._point.get("coordinates", "").split(",")
            if "LatitudeDegrees" in self._point:
                cells = [self._point.get("LongitudeDegrees", ""), self._point["LatitudeDegrees"]]
            self._add(
                self._point.get("Time", self._point.get("when", "")),
                cells,
                self._point.get("Speed", ""),
            )
        else:
            self._point[name] = text

    def _add(self, when: str, lon_lat: list[str], speed: str = "") -> None:
        try:
            moment = datetime.fromisoformat(when.strip()[:40])
            utc_s = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
        except (ValueError, OverflowError):
            return
        lon, lat = (number(cell.strip()) for cell in (*lon_lat, "", "")[:2])
        self.samples.append(Sample(utc_s, utc_s, number(speed.strip()), math.nan, lat, lon))


def _local(name: str) -> str:
    return name.rpartition(":")[2]


def read_xml_track(path: Path) -> TelemetryTrack | None:
    """Telemetry of the points with times of a TCX or KML file; None = it has none. Raises
    TelemetryError if unreadable.

    Speeds are read from TCX's extension TPX in m/s, or computed from positions.
    """
    points = _Points()
    with open_regular(path, TelemetryError, _EXPECTED) as file:
        parse_xml(file, path, points, TelemetryError, _EXPECTED)
    has_speed = any(math.isfinite(sample.speed_mps) for sample in points.samples)
    return track(points.samples, path.name, "utc", has_own_speed=has_speed)


XML_TRACK = Sidecar(suffixes=(".tcx", ".kml"), read=of_file(read_xml_track), priority=-10)
