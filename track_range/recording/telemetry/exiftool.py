"""read_with_exiftool: telemetry that the program ExifTool finds in a video file, for formats that
no reader here knows.

ExifTool (exiftool.org) is used if it is installed. Its output is one JSON object; each record of a
receiver is a "document", and the keys are DOCUMENT:TAG, such as "Doc12:GPSSpeed", or
"Doc3-2:GPSSpeed" in a sample with several.
"""

import math
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

from track_range.foundation.files.numeric_text import plain_number
from track_range.foundation.files.structured_text import parse_json
from track_range.recording.telemetry.tracks.positions import MPS_PER_UNIT
from track_range.recording.telemetry.tracks.samples import MAX_SAMPLES, Sample, date_s, track
from track_range.recording.telemetry.tracks.track import Clock, TelemetryError, TelemetryTrack

# longest time in s that ExifTool may take; it reads files of unknown formats from start to end
TIMEOUT_S = 20.0
# size limit of ExifTool's output, bytes; an hour at 18 Hz has 25 MB
_MAX_OUTPUT_BYTES = 200_000_000

_TAGS = (  # `SampleTime` is the time in the video, s
    *(
        "GPSDateTime",
        "GPSLatitude",
        "GPSLongitude",
        "GPSSpeed",
        "GPSSpeedRef",
        "GPSTrack",
        "GPSMeasureMode",
    ),
    *("GPSStatus", "SampleTime", "SampleDuration"),
)

_KEY = re.compile(r"Doc(\d+)(?:-(\d+))?(?:-\d+)*:(\w+)")
# by GPSSpeedRef (Exif); without it, km/h is documented
_UNITS = {"K": "km/h", "M": "mph", "N": "kn"}
_DATE = re.compile(r"(\d{4}):(\d\d):(\d\d) (\d\d):(\d\d):(\d\d(?:\.\d+)?)")

_MIN_MODE = 2  # smallest GPSMeasureMode with a fix

_Document = tuple[int, int]  # numbers of a document: Doc3-2 is (3, 2), and Doc3 is (3, 0)


def read_with_exiftool(path: Path, *, timeout_s: float = TIMEOUT_S) -> TelemetryTrack | None:
    """Telemetry that ExifTool finds; None = it is not installed, or finds none. Raises
    TelemetryError at a timeout.
    """
    program = shutil.which("exiftool")
    if program is None:
        return None
    options = (
        "-ee3",
        "-n",
        "-j",
        "-G3",
        "-api",
        "largefilesupport=1",
        *(f"-{tag}" for tag in _TAGS),
    )
    with tempfile.TemporaryFile() as output:
        try:
            subprocess.run(
                [program, *options, str(path.absolute())],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.DEVNULL,
                timeout=timeout_s,
                check=False,  # it fails with partial output, too
            )
        except subprocess.TimeoutExpired as error:
            raise TelemetryError(
                f"{path}: exiftool did not finish within {timeout_s:.0f} s."
            ) from error
        except OSError:
            return None
        if os.fstat(output.fileno()).st_size > _MAX_OUTPUT_BYTES:
            return None
        output.seek(0)
        text = output.read().decode("utf-8", "replace")
    try:
        content = parse_json(text, path, TelemetryError, "the output of exiftool")
    except TelemetryError:
        return None
    return track_of_records(content[0]) if isinstance(content, list) and content else None


def track_of_records(record: object) -> TelemetryTrack | None:
    """Telemetry of the JSON object of a file; None = it has no records of a receiver.

    Times are times in the video if ExifTool states them for all records, otherwise times of the
    receiver.
    """
    if not isinstance(record, Mapping):
        return None
    documents = _documents(record)
    times_s = _times_s(documents)
    gps = {key: tags for key, tags in documents.items() if _has_gps(tags)}
    samples = [
        _sample(tags, times_s.get(key, math.nan)) for key, tags in sorted(gps.items())[:MAX_SAMPLES]
    ]
    if not samples:
        return None
    clock: Clock = "video"
    if not all(math.isfinite(sample.time_s) for sample in samples):
        samples = [sample.at(sample.utc_s) for sample in samples]
        is_utc = all(str(tags.get("GPSDateTime", "Z")).endswith("Z") for tags in gps.values())
        clock = "utc" if is_utc else "local"
    has_own_speed = any("GPSSpeed" in tags for tags in gps.values())
    telemetry = track(samples, "ExifTool", clock, has_own_speed=has_own_speed)
    unit = "m/s" if all("GPSSpeedRef" in tags for tags in gps.values()) else None
    return None if telemetry is None else replace(telemetry, unit=unit)


def _documents(record: Mapping[Any, Any]) -> dict[_Document, dict[str, Any]]:
    """The tags that are read, by document."""
    documents: dict[_Document, dict[str, Any]] = {}
    for name, value in record.items():
        match = _KEY.fullmatch(str(name))
        if match and match[3] in _TAGS:
            documents.setdefault((int(match[1]), int(match[2] or 0)), {})[match[3]] = value
    return documents


def _has_gps(tags: Mapping[str, Any]) -> bool:
    return "GPSLatitude" in tags or "GPSSpeed" in tags


def _times_s(documents: Mapping[_Document, Mapping[str, Any]]) -> dict[_Document, float]:
    """Times in the video by document, s; the records of one sample are spread over its duration."""
    times_s = {}
    for _, group in groupby(sorted(documents), key=itemgetter(0)):
        keys = list(group)
        timed = next((key for key in keys if "SampleTime" in documents[key]), None)
        if timed is None:
            continue
        start_s = plain_number(documents[timed].get("SampleTime"))
        duration_s = plain_number(documents[timed].get("SampleDuration"))
        has_gps = [key for key in keys if _has_gps(documents[key])]
        is_spread = bool(has_gps) and math.isfinite(duration_s)
        step_s = duration_s / len(has_gps) if is_spread else 0.0
        for i, key in enumerate(has_gps):
            own_s = plain_number(documents[key].get("SampleTime"))
            has_own = key != timed and math.isfinite(own_s)
            times_s[key] = own_s if has_own else start_s + i * step_s
    return times_s


def _sample(tags: Mapping[str, Any], time_s: float) -> Sample:
    """A record as a sample; without speed and position if it states that there is no fix."""
    mode, status = plain_number(tags.get("GPSMeasureMode")), str(tags.get("GPSStatus", "A"))
    latitude_deg, longitude_deg = (
        plain_number(tags.get("GPSLatitude")),
        plain_number(tags.get("GPSLongitude")),
    )
    date = _DATE.match(str(tags.get("GPSDateTime", "")))
    utc_s = date_s(*(float(part) for part in date.groups())) if date else math.nan
    is_void = (
        latitude_deg == longitude_deg == 0 or mode < _MIN_MODE or status not in ("A", "Active")
    )
    if is_void:
        return Sample(time_s, utc_s)
    factor = MPS_PER_UNIT[_UNITS.get(str(tags.get("GPSSpeedRef", "K"))[:1], "km/h")]
    speed_mps = factor * plain_number(tags.get("GPSSpeed"))
    return Sample(
        time_s, utc_s, speed_mps, plain_number(tags.get("GPSTrack")), latitude_deg, longitude_deg
    )
