"""with_fragments: the samples of fragmented MP4 files, which cameras write so that a power cut loses only a second.

    moov  tracks without samples; mvex/trex = defaults of each track
    moof  traf of each track: tfhd = defaults, tfdt = first time, trun = size and duration of each sample
    mdat  the samples

Format: ISO/IEC 14496-12, 8.8. Damaged fragments are left out, never an exception.
"""

from __future__ import annotations

import struct
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import BinaryIO

import numpy as np

from track_range.recording.telemetry.containers.mp4_boxes import (
    MAX_EQUAL_SAMPLES,
    MAX_TABLE_ROWS,
    IntArray,
    Movie,
    Track,
    boxes,
    read_at,
)

MAX_FRAGMENT_BYTES = 16_000_000
"""Size limit of a box `moof`, bytes; a second of video with all tables has about 5 kB."""

_MAX_INTEGER = 2**53
"""Limit of offsets and times, with which sums do not overflow."""

_BASE_OFFSET, _DESCRIPTION, _DURATION, _SIZE, _BASE_IS_MOOF = 0x1, 0x2, 0x8, 0x10, 0x20000
"""Flags of `tfhd`: which fields it has, and that offsets count from the `moof`."""

_DATA_OFFSET, _FIRST_FLAGS = 0x1, 0x4
_SAMPLE_DURATION, _SAMPLE_SIZE, _SAMPLE_FLAGS, _SAMPLE_SHIFT = 0x100, 0x200, 0x400, 0x800
"""Flags of `trun`: which fields it has, and which each of its samples has."""


@dataclass(slots=True)
class _Samples:
    """Samples of a track in its fragments so far: parts of arrays, and where the next fragment continues."""

    offsets: list[IntArray] = field(default_factory=list)
    sizes: list[IntArray] = field(default_factory=list)
    shown: list[IntArray] = field(default_factory=list)
    durations: list[IntArray] = field(default_factory=list)
    end: int = 0
    n: int = 0


@dataclass(slots=True)
class _Run:
    """What a box `traf` states before its samples."""

    number: int
    base: int
    duration: int
    size: int


def with_fragments(file: BinaryIO, movie: Movie) -> Movie:
    """A movie with the samples of its fragments; the movie itself if it has none."""
    if b"mvex" not in movie.inner:
        return movie
    defaults = _defaults(movie.inner[b"mvex"])
    samples = {track.number: _Samples(end=_end(track)) for track in movie.tracks}
    start = 0
    for box in movie.top:
        if box.kind == b"moof" and box.end - box.start <= MAX_FRAGMENT_BYTES:
            with suppress(struct.error, ValueError, OverflowError):  # cut off or damaged
                _add_fragment(read_at(file, box.start, box.end - box.start), start, defaults, samples)
        start = box.end
    tracks = (_joined(track, samples[track.number]) for track in movie.tracks)
    return replace(movie, tracks=tuple(track for track in tracks if len(track)))


def _end(track: Track) -> int:
    """End of the samples of a track outside its fragments, in its ticks."""
    return round(float(track.durations_s.sum()) * track.ticks_per_s)


def _defaults(content: bytes) -> dict[int, tuple[int, int]]:
    """Duration and size of the samples by track, from the boxes `trex`."""
    return {
        number: (duration, size)
        for box in boxes(content)
        if box.kind == b"trex" and box.end - box.start >= 20
        for number, _, duration, size in [struct.unpack_from(">4I", content, box.start + 4)]
    }


def _add_fragment(
    content: bytes, start: int, defaults: dict[int, tuple[int, int]], samples: dict[int, _Samples]
) -> None:
    """Add the samples of a box `moof` that starts at `start` in the file."""
    end_of_data = start
    for box in boxes(content):
        if box.kind != b"traf":
            continue
        parts = list(boxes(content, box.start, box.end))
        header = next((content[part.start : part.end] for part in parts if part.kind == b"tfhd"), b"")
        run = _run(header, start, end_of_data, defaults)
        track = samples.get(run.number)
        if track is None:
            continue
        end_of_data = run.base
        for part in parts:
            body = content[part.start : part.end]
            if part.kind == b"tfdt":
                (end,) = struct.unpack_from(">Q" if body[:1] == b"\x01" else ">I", body, 4)
                track.end = min(end, _MAX_INTEGER)
            elif part.kind == b"trun":
                end_of_data = _add_run(track, body, run, end_of_data)


def _run(header: bytes, start: int, end_of_data: int, defaults: dict[int, tuple[int, int]]) -> _Run:
    """Content of a box `tfhd`."""
    flags, number = struct.unpack_from(">II", header)
    flags &= 0xFFFFFF
    duration, size = defaults.get(number, (0, 0))
    run = _Run(number, start if flags & _BASE_IS_MOOF else end_of_data, duration, size)
    place = 8
    if flags & _BASE_OFFSET:
        run.base = min(struct.unpack_from(">Q", header, place)[0], _MAX_INTEGER)
        place += 8
    place += 4 * bool(flags & _DESCRIPTION)
    if flags & _DURATION:
        (run.duration,) = struct.unpack_from(">I", header, place)
        place += 4
    if flags & _SIZE:
        (run.size,) = struct.unpack_from(">I", header, place)
    return run


def _add_run(track: _Samples, body: bytes, run: _Run, end_of_data: int) -> int:
    """Add the samples of a box `trun`; returns where their data end in the file."""
    flags, n = struct.unpack_from(">II", body)
    flags &= 0xFFFFFF
    place, data_start = 8, end_of_data
    if flags & _DATA_OFFSET:
        data_start = run.base + struct.unpack_from(">i", body, place)[0]
        place += 4
    place += 4 * bool(flags & _FIRST_FLAGS)
    fields = [flag for flag in (_SAMPLE_DURATION, _SAMPLE_SIZE, _SAMPLE_FLAGS, _SAMPLE_SHIFT) if flags & flag]
    n = min(n, MAX_EQUAL_SAMPLES, MAX_TABLE_ROWS - track.n)
    if fields:
        n = min(n, (len(body) - place) // (4 * len(fields)))
    rows = np.frombuffer(body, ">u4", n * len(fields), place).reshape(n, len(fields)).astype(np.int64)
    column = {flag: rows[:, i] for i, flag in enumerate(fields)}
    durations = column.get(_SAMPLE_DURATION, np.full(n, run.duration, np.int64))
    sizes = column.get(_SAMPLE_SIZE, np.full(n, run.size, np.int64))
    shifts = column.get(_SAMPLE_SHIFT, np.zeros(n, np.int64)).astype(np.uint32).view(np.int32)
    ends = np.cumsum(sizes)
    track.offsets.append(np.clip(data_start + ends - sizes, 0, _MAX_INTEGER))
    track.sizes.append(sizes)
    track.shown.append(track.end + np.cumsum(durations) - durations + shifts)
    track.durations.append(durations)
    track.end += int(durations.sum())
    track.n += n
    return data_start + int(sizes.sum())


def _joined(track: Track, samples: _Samples) -> Track:
    """A track with the samples of its fragments after those of its tables."""
    if not samples.n:
        return track
    return replace(
        track,
        offsets=np.concatenate([track.offsets, *samples.offsets]),
        sizes=np.concatenate([track.sizes, *samples.sizes]),
        time_s=np.concatenate([track.time_s, np.concatenate(samples.shown) / track.ticks_per_s + track.shift_s]),
        durations_s=np.concatenate([track.durations_s, np.concatenate(samples.durations) / track.ticks_per_s]),
    )
