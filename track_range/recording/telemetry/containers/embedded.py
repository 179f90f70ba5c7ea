"""embedded: the telemetry inside a video file, whichever format it has."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import numpy as np

from track_range.foundation.files.input_files import open_regular, readable
from track_range.recording.telemetry.containers.blackvue import read_blackvue
from track_range.recording.telemetry.containers.camm import read_camm
from track_range.recording.telemetry.containers.gpmf import MAX_BARE_BYTES, read_bare_gpmf, read_gpmf
from track_range.recording.telemetry.containers.ligogps import read_ligogps
from track_range.recording.telemetry.containers.mp4_boxes import Movie, read_at, read_movie
from track_range.recording.telemetry.containers.mpeg_ts import packet_bytes, read_mpeg_ts
from track_range.recording.telemetry.containers.novatek import read_novatek
from track_range.recording.telemetry.containers.tesla import read_tesla
from track_range.recording.telemetry.containers.text_tracks import read_text_tracks
from track_range.recording.telemetry.track import TelemetryError, TelemetryTrack

READERS: tuple[Callable[[BinaryIO, Movie, Path], TelemetryTrack | None], ...] = (
    read_gpmf,
    read_camm,
    read_novatek,
    read_blackvue,
    read_text_tracks,
    read_ligogps,
    read_tesla,
)
"""Readers of MP4 and QuickTime files, in the order in which they are tried."""


def embedded(path: Path) -> TelemetryTrack | None:
    """Telemetry inside a video file; None = it has none.

    The first reader with a fix is used; without any fix, the first with samples. Damaged parts are left out.

    Raises:
        TelemetryError: the file cannot be read, its telemetry has an unknown layout, or a package that reads it is not
            installed.
    """
    with open_regular(path, TelemetryError, "a video") as file, readable(path, TelemetryError):
        start = read_at(file, 0, 1024)
        if packet_bytes(start):
            return read_mpeg_ts(file, path)
        if start[:4] == b"DEVC":
            return read_bare_gpmf(read_at(file, 0, MAX_BARE_BYTES))
        movie = read_movie(file)
        return _first_with_fix(file, movie, path) if movie else None


def _first_with_fix(file: BinaryIO, movie: Movie, path: Path) -> TelemetryTrack | None:
    without_fix, problem = None, None
    for read in READERS:
        try:
            telemetry = read(file, movie, path)
        except (ValueError, IndexError, OverflowError, struct.error):  # damaged in a way that no check foresees
            continue
        except TelemetryError as error:
            problem = problem or error
            continue
        if telemetry and np.isfinite(telemetry.speed_mps).any():
            return telemetry
        without_fix = without_fix or telemetry
    if without_fix is None and problem is not None:
        raise problem
    return without_fix
