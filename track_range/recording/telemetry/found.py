"""found_telemetry: telemetry of the files of a recording on the clock of the recording, in a fixed order of preference.

    inside the video file  >  beside it, with its name: GPX, NMEA, SRT, CSV, VBO, TCX, KML, FIT, 70mai's and
                              BlackVue's logs

Telemetry that cannot be used is a note, and the next file is tried.
"""

import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from track_range.foundation.files.input_files import counted, open_regular, readable
from track_range.recording.telemetry.checks import usable
from track_range.recording.telemetry.companions import companions
from track_range.recording.telemetry.containers.blackvue import read_blackvue
from track_range.recording.telemetry.containers.camm import read_camm
from track_range.recording.telemetry.containers.gpmf import read_bare_gpmf, read_gpmf
from track_range.recording.telemetry.containers.ligogps import read_ligogps
from track_range.recording.telemetry.containers.mp4_boxes import (
    MAX_TELEMETRY_BYTES,
    Movie,
    read_at,
    read_movie,
)
from track_range.recording.telemetry.containers.mpeg_ts import packet_bytes, read_mpeg_ts
from track_range.recording.telemetry.containers.novatek import read_novatek
from track_range.recording.telemetry.containers.ros_topics import read_ros_topics
from track_range.recording.telemetry.containers.tesla import read_tesla
from track_range.recording.telemetry.containers.text_tracks import read_text_tracks
from track_range.recording.telemetry.exiftool import read_with_exiftool
from track_range.recording.telemetry.sidecars.reading import (
    kind_of,
    read_sidecar,
    sidecar_suffixes,
)
from track_range.recording.telemetry.tracks.signal_choice import ANY_SIGNAL, SignalChoice
from track_range.recording.telemetry.tracks.track import COLUMNS, TelemetryError, TelemetryTrack
from track_range.recording.telemetry.video_clock import check_covered, on_video_clock
from track_range.recording.video.video import VideoPart

_MAX_NOTES = 3  # messages about telemetry that is not used

# in the order of their use
READERS: tuple[Callable[[BinaryIO, Movie, Path], TelemetryTrack | None], ...] = (
    read_gpmf,
    read_camm,
    read_novatek,
    read_blackvue,
    read_text_tracks,
    read_ligogps,
    read_tesla,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundTelemetry:
    """Telemetry of a recording."""

    # samples in seconds from the first frame; None = none can be used
    track: TelemetryTrack | None = None
    sigma_s: float = 0.0  # standard deviation of their time offset
    notes: tuple[str, ...] = ()  # messages for the user
    files: tuple[Path, ...] = ()  # the files that were read, besides the videos


Read = Callable[[VideoPart], tuple[TelemetryTrack, Path] | None]  # None = the file has no telemetry


def candidates(
    parts: Sequence[VideoPart], choice: SignalChoice = ANY_SIGNAL
) -> Iterator[FoundTelemetry]:
    """Telemetry of a recording from each source that has any, best first; without a track where
    none can be used.
    """
    for read in (_inside, partial(_beside, choice=choice)):
        telemetry = _of_parts(parts, read)
        if telemetry.track is not None or telemetry.notes:
            yield telemetry


def named_telemetry(
    path: Path, parts: Sequence[VideoPart], choice: SignalChoice = ANY_SIGNAL
) -> FoundTelemetry:
    """Telemetry of a file that the user names, for the whole recording; raises TelemetryError if it
    is unusable.
    """
    first = parts[0]
    whole_s = max(part.start_s + part.duration_s for part in parts) if first.duration_s else 0.0
    recording = replace(first, duration_s=whole_s)
    is_sidecar = path.suffix.lower() in sidecar_suffixes()
    kind = kind_of(path)
    track = None
    if not is_sidecar or not kind:
        track = (
            read_sidecar(path, first.path.name, whole_s, choice) if is_sidecar else _in_video(path)
        )
    if track is None:
        raise TelemetryError(
            f"{path}: expected speeds or positions with times, found {kind or 'none'}."
        )
    track, sigma_s = _checked(track, path, recording)
    check_covered(track.time_s, whole_s, str(path))
    notes = tuple(f"{path.name}: {note}" for note in track.notes)
    return FoundTelemetry(track=track, sigma_s=sigma_s, notes=notes, files=(path,))


def _inside(part: VideoPart) -> tuple[TelemetryTrack, Path] | None:
    track = _in_video(part.path)
    return None if track is None else (track, part.path)


def _in_video(path: Path) -> TelemetryTrack | None:
    """Telemetry inside a video file, from our readers, else from ExifTool; otherwise the error of
    our readers.
    """
    if (track := read_ros_topics(path)) is not None or not path.is_file():
        return track
    try:
        track = embedded(path)
    except TelemetryError:
        track = read_with_exiftool(path)
        if track is None:
            raise
    return read_with_exiftool(path) if track is None else track


def embedded(path: Path) -> TelemetryTrack | None:
    """Telemetry inside a video file; None = it has none.

    The first reader with a fix is used; without any fix, the first with samples. Damaged parts are
    left out. A TelemetryError means that the file cannot be read, its telemetry has an unknown
    layout, or a package is missing.
    """
    with open_regular(path, TelemetryError, "a video") as file, readable(path, TelemetryError):
        start = read_at(file, 0, 1024)
        if packet_bytes(start):
            return read_mpeg_ts(file, path)
        if start[:4] == b"DEVC":
            return read_bare_gpmf(read_at(file, 0, MAX_TELEMETRY_BYTES))
        movie = read_movie(file)
        return _first_with_fix(file, movie, path) if movie else None


def _first_with_fix(file: BinaryIO, movie: Movie, path: Path) -> TelemetryTrack | None:
    without_fix, problem = None, None
    for read in READERS:
        try:
            telemetry = read(file, movie, path)
        # damaged in a way that no check foresees
        except (ValueError, IndexError, OverflowError, struct.error):
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


def _beside(part: VideoPart, choice: SignalChoice) -> tuple[TelemetryTrack, Path] | None:
    """The first usable file beside a video; if there is none, the error of the first unusable
    file.
    """
    problem: TelemetryError | None = None
    for name in companions(part.path.name)["telemetry"]:
        path = part.path.parent / name
        if not path.is_file() or path == part.path:
            continue
        try:
            track = read_sidecar(path, part.path.name, part.duration_s, choice)
            if track is not None:
                _checked(track, path, part)  # another file may be better
                return track, path
        except TelemetryError as error:
            problem = problem or error
    if problem is not None:
        raise problem
    return None


def _checked(track: TelemetryTrack, path: Path, part: VideoPart) -> tuple[TelemetryTrack, float]:
    """A checked track on the clock of its video, and the sigma of its offset, s; errors name the
    file.
    """
    try:
        return on_video_clock(usable(track), part)
    except TelemetryError as error:
        raise TelemetryError(
            f"{path}: {'' if track.source == path.name else f'{track.source}: '}{error}"
        ) from error


def _of_parts(parts: Sequence[VideoPart], read: Read) -> FoundTelemetry:
    tracks: list[TelemetryTrack] = []
    notes: list[str] = []
    files: list[Path] = []
    sigmas_s: list[float] = []
    for part in parts:
        try:
            track_and_path = read(part)
            if track_and_path is None:
                continue
            track, path = track_and_path
            source = track.source if path != part.path else f"{track.source} in {path.name}"
            track, sigma_s = _checked(track, path, part)
        except TelemetryError as error:
            notes.append(f"Telemetry is not used: {error}")
            continue
        tracks.append(replace(track, time_s=track.time_s + part.start_s, source=source))
        notes += [f"{path.name}: {note}" for note in track.notes]
        sigmas_s.append(sigma_s)
        files += [path] if path != part.path else []
    shown = tuple(dict.fromkeys(notes))[:_MAX_NOTES]
    if not tracks:
        return FoundTelemetry(notes=shown)
    return FoundTelemetry(
        track=_joined(tracks), sigma_s=max(sigmas_s), notes=shown, files=tuple(files)
    )


def _joined(tracks: Sequence[TelemetryTrack]) -> TelemetryTrack:
    """Tracks of successive files as one; where two overlap, the later track begins after the
    earlier one.
    """
    first = tracks[0]
    if len(tracks) == 1:
        return first
    last_s, later = -np.inf, list[TelemetryTrack]()
    for track in tracks:
        later.append(track.selected(track.time_s > last_s))
        last_s = max(last_s, float(track.time_s[-1]))
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(track, name) for track in later]) for name in COLUMNS
    }
    return replace(
        first,
        **columns,
        source=f"{first.source} and {counted(len(tracks) - 1, 'other file')}",
        speed_sigma_mps=max(track.speed_sigma_mps for track in tracks),
    )
