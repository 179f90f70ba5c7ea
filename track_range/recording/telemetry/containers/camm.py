"""Camera Motion Metadata (CAMM): GPS samples of the types 5 and 6 in the track `camm`,
little-endian.

Format: developers.google.com/streetview/publish/camm-spec. Type 6 has velocities; type 5 has only
positions, as have files in which all velocities of type 6 are 0: speed is then derived from the
positions.
"""

import math
import struct
from pathlib import Path
from typing import BinaryIO

import numpy as np

from track_range.recording.telemetry.containers.mp4_boxes import Movie, read_samples
from track_range.recording.telemetry.tracks.samples import MAX_SAMPLES, Sample, date_s, track
from track_range.recording.telemetry.tracks.track import GPS_SPEED_SIGMA_MPS, TelemetryTrack

_POSITION = struct.Struct("<2xHddd")  # type 5: latitude and longitude in degrees, altitude in m

_GPS = struct.Struct("<2xHdiddfffffff")
"""Type 6: time in seconds since 1980-01-06, fix, latitude, longitude, altitude, horizontal and
vertical accuracy in m, velocity east, north and up, and its accuracy, in m/s."""

_GPS_EPOCH_S = date_s(1980, 1, 6, 0, 0, 0)
_LEAP_SECONDS = 18  # UTC is behind the time of GPS by this much since 2017
# times above this (2017 in UTC, 2027 in GPS time) count from 1970, as some cameras write them
_FIRST_UNIX_S = 1.5e9
_MIN_FIX = 2  # 0 = none, 2 = two-dimensional, 3 = three-dimensional


def read_camm(file: BinaryIO, movie: Movie, _path: Path) -> TelemetryTrack | None:
    """Telemetry of the track `camm` of a movie; None = it has no GPS samples."""
    source = next((part for part in movie.tracks if part.format == b"camm"), None)
    if source is None:
        return None
    gps_rows = np.flatnonzero(source.sizes >= _POSITION.size)[:MAX_SAMPLES]
    positions: list[Sample] = []
    samples: list[Sample] = []
    sigmas_mps = []
    for index, content in read_samples(file, source, gps_rows, _GPS.size):
        type_number = int.from_bytes(content[2:4], "little")
        time_s = float(source.time_s[index]) - movie.start_s
        if type_number == 6 and len(content) >= _GPS.size:
            sample, sigma_mps = _gps(content)
            samples.append(sample.at(time_s))
            sigmas_mps.append(sigma_mps)
        elif type_number == 5 and len(content) >= _POSITION.size:
            _, latitude_deg, longitude_deg, _ = _POSITION.unpack_from(content)
            positions.append(Sample(time_s, latitude_deg=latitude_deg, longitude_deg=longitude_deg))
    if any(sample.speed_mps > 0 for sample in samples):
        stated = [sigma for sigma in sigmas_mps if 0 < sigma < 10]
        sigma_mps = float(np.median(stated)) if stated else GPS_SPEED_SIGMA_MPS
        return track(samples, "CAMM", speed_sigma_mps=sigma_mps)
    return track(samples or positions, "CAMM", has_own_speed=False)


def _gps(content: bytes) -> tuple[Sample, float]:
    """A sample of type 6 without its time in the video, and the standard deviation of its speed."""
    _, stated_s, fix, latitude_deg, longitude_deg, _, _, _, east_mps, north_mps, _, sigma_mps = (
        _GPS.unpack_from(content)
    )
    utc_s = stated_s if stated_s > _FIRST_UNIX_S else stated_s + _GPS_EPOCH_S - _LEAP_SECONDS
    if stated_s <= 0:
        utc_s = math.nan
    if fix < _MIN_FIX:
        return Sample(utc_s=utc_s), math.nan
    speed_mps = math.hypot(east_mps, north_mps)
    course_deg = math.degrees(math.atan2(east_mps, north_mps)) if speed_mps > 0 else math.nan
    return Sample(math.nan, utc_s, speed_mps, course_deg, latitude_deg, longitude_deg), sigma_mps
