"""MP4 and QuickTime files: boxes, tracks, and the place and time of samples (ISO/IEC 14496-12).

Only headers and tables are read, never the media data, so that a video of many gigabytes takes milliseconds. Damaged
tables give fewer samples, never an exception.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray

IntArray = npt.NDArray[np.int64]

MAX_MOVIE_BYTES = 256_000_000
"""Size limit of the box `moov`, bytes; ten hours of video at 60 frames per second have about 50 MB."""

MAX_BOXES = 200_000
"""Largest number of boxes read on one level; dashcams write up to one small box per second."""

MAX_TABLE_ROWS = 10_000_000
"""Largest number of samples of a track: 46 hours at 60 frames per second."""

MAX_EQUAL_SAMPLES = 1_000_000
"""Largest number of samples of one size, which a table of a few bytes can announce."""

MAX_TRACKS = 32
"""Largest number of tracks read; cameras with several lenses have up to ten."""

_CONTAINERS = {b"moov", b"trak", b"mdia", b"minf", b"stbl", b"edts", b"udta"}
_FULL_BOX = 4
"""Bytes of version and flags at the start of a full box."""


@dataclass(frozen=True, slots=True)
class Box:
    """A box: its type, and where its content is in the file."""

    kind: bytes
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class Track:
    """Samples of one track.

    Attributes:
        handler: type of the track, such as b"vide" or b"meta".
        format: type of the first sample description, such as b"gpmd".
        description: the first sample description.
        offsets, sizes: (N,) where the samples are in the file, bytes.
        time_s: (N,) when a sample is shown, on the time axis of the movie.
        durations_s: (N,) how long.
        number: the ID of the track in its file.
        ticks_per_s: unit of its times.
        shift_s: seconds from its time axis to that of the movie.
    """

    handler: bytes
    format: bytes
    description: bytes
    offsets: IntArray
    sizes: IntArray
    time_s: FloatArray
    durations_s: FloatArray
    number: int = 0
    ticks_per_s: int = 1000
    shift_s: float = 0.0

    def __len__(self) -> int:
        return len(self.offsets)


@dataclass(frozen=True, slots=True)
class Movie:
    """Contents of an MP4 file that readers of telemetry need.

    Attributes:
        top: boxes of the file.
        inner: content of the boxes in `moov` and `moov/udta`, by type.
        tracks: all tracks.
        n_bytes: size of the file.
    """

    top: tuple[Box, ...]
    inner: dict[bytes, bytes] = field(default_factory=dict)
    tracks: tuple[Track, ...] = ()
    n_bytes: int = 0

    @property
    def video(self) -> Track | None:
        """The video track with most samples: thumbnails are tracks, too."""
        videos = [track for track in self.tracks if track.handler == b"vide" and len(track)]
        return max(videos, key=len, default=None)

    @property
    def start_s(self) -> float:
        """Time of the first frame on the time axis of the movie."""
        return float(self.video.time_s.min()) if self.video else 0.0


def read_movie(file: BinaryIO) -> Movie | None:
    """The movie in an open file, with the samples of its tables; None = it is no MP4 or QuickTime file.

    The samples of fragments are not among them (`mp4_fragments`); tracks without samples are there only if the file has
    fragments.
    """
    n_bytes = os.fstat(file.fileno()).st_size
    top = tuple(_boxes_in_file(file, 0, n_bytes))
    if not any(box.kind in (b"ftyp", b"moov", b"mdat") for box in top[:8]):
        return None
    place = next((box for box in top if box.kind == b"moov"), None)
    if place is None or place.end - place.start > MAX_MOVIE_BYTES:
        return Movie(top, n_bytes=n_bytes)
    content = read_at(file, place.start, place.end - place.start)
    inner: dict[bytes, bytes] = {}
    tracks: list[Track | None] = []
    scale = _timescale(_first(content, b"mvhd"))
    for box in boxes(content):
        if box.kind == b"trak" and len(tracks) < MAX_TRACKS:
            tracks.append(_track(content[box.start : box.end], scale))
        elif box.kind == b"udta":
            for part in boxes(content, box.start, box.end):
                inner.setdefault(part.kind, content[part.start : part.end])
        else:
            inner.setdefault(box.kind, content[box.start : box.end])
    has_fragments = b"mvex" in inner
    known = tuple(track for track in tracks if track is not None and (len(track) or has_fragments))
    return Movie(top, inner, known, n_bytes)


def read_at(file: BinaryIO, offset: int, n_bytes: int) -> bytes:
    """At most `n_bytes` from `offset`; fewer at the end of the file."""
    if offset < 0 or n_bytes <= 0:
        return b""
    file.seek(offset)
    return file.read(n_bytes)


def read_samples(
    file: BinaryIO, track: Track, indices: Sequence[int] | IntArray, max_bytes: int
) -> Iterator[tuple[int, bytes]]:
    """Index and first `max_bytes` of samples of a track; the end once more bytes were read than the file has.

    That happens only in damaged files, where samples overlap.
    """
    budget = os.fstat(file.fileno()).st_size
    for index in indices:
        content = read_at(file, int(track.offsets[index]), min(int(track.sizes[index]), max_bytes))
        budget -= len(content)
        if budget < 0:
            return
        yield int(index), content


def boxes(content: bytes, start: int = 0, end: int | None = None) -> Iterator[Box]:
    """Boxes in a part of the content of another box; the last one may be cut off."""
    end = len(content) if end is None else end
    for _ in range(MAX_BOXES):
        if start + 8 > end:
            return
        box, start = _box(content[start : start + 16], start, end)
        if box is None:
            return
        yield box


def _boxes_in_file(file: BinaryIO, start: int, end: int) -> Iterator[Box]:
    for _ in range(MAX_BOXES):
        if start + 8 > end:
            return
        box, start = _box(read_at(file, start, 16), start, end)
        if box is None:
            return
        yield box


def _box(header: bytes, start: int, end: int) -> tuple[Box | None, int]:
    """The box with this header at `start`, and where the next one starts; None = no valid size."""
    n_bytes, kind = struct.unpack_from(">I4s", header)
    n_header = 8
    if n_bytes == 1 and len(header) >= 16:
        n_bytes, n_header = struct.unpack_from(">Q", header, 8)[0], 16
    elif n_bytes == 0:
        n_bytes = end - start
    if n_bytes < n_header:
        return None, end
    return Box(kind, start + n_header, min(start + n_bytes, end)), start + n_bytes


def _first(content: bytes, *path: bytes) -> bytes:
    """Content of the first box at a path of types; b"" = there is none."""
    for kind in path:
        box = next((box for box in boxes(content) if box.kind == kind), None)
        if box is None:
            return b""
        content = content[box.start : box.end]
    return content


def _timescale(header: bytes) -> int:
    """Ticks per second in the box `mvhd` or `mdhd`; 1000 if it states none."""
    place = 20 if header[:1] == b"\x01" else 12
    value = int.from_bytes(header[place : place + 4], "big") if len(header) >= place + 4 else 0
    return value or 1000


def _track(content: bytes, movie_scale: int) -> Track | None:
    """Track of the content of a box `trak`; None = it has no handler."""
    media = _first(content, b"mdia")
    table = _first(media, b"minf", b"stbl")
    handler = _first(media, b"hdlr")[8:12]
    description = _first(table, b"stsd")[8:]
    sizes = _sizes(table)
    if not handler:
        return None
    offsets = _offsets(table, sizes)
    n = min(len(offsets), len(sizes))
    scale = _timescale(_first(media, b"mdhd"))
    durations = _runs(_first(table, b"stts"), n)
    ticks = np.concatenate([[0], np.cumsum(durations[:-1])]) if n else np.empty(0)
    shown = ticks + _runs(_first(table, b"ctts"), n, signed=True)
    shift_s = _edit_shift_s(_first(content, b"edts", b"elst"), scale, movie_scale)
    return Track(
        handler,
        description[4:8],
        description,
        offsets[:n],
        sizes[:n],
        shown / scale + shift_s,
        durations / scale,
        number=_number(_first(content, b"tkhd")),
        ticks_per_s=scale,
        shift_s=shift_s,
    )


def _number(header: bytes) -> int:
    """ID of a track in its box `tkhd`; 0 = it states none."""
    start = 20 if header[:1] == b"\x01" else 12
    return int.from_bytes(header[start : start + 4], "big")


def _sizes(table: bytes) -> IntArray:
    """(N,) sizes of the samples from the box `stsz` or `stz2`."""
    box = _first(table, b"stsz")
    if len(box) >= 12:
        size, n = struct.unpack_from(">II", box, _FULL_BOX)
        if size:
            return np.full(min(n, MAX_EQUAL_SAMPLES), size, dtype=np.int64)
        return _integers(box, 12, n, ">u4")
    box = _first(table, b"stz2")
    if len(box) >= 12 and box[7] in (8, 16):
        return _integers(box, 12, struct.unpack_from(">I", box, 8)[0], ">u1" if box[7] == 8 else ">u2")
    return np.empty(0, dtype=np.int64)


def _offsets(table: bytes, sizes: IntArray) -> IntArray:
    """(N,) where the samples start, from the boxes `stsc` and `stco` or `co64`."""
    chunks = _chunk_offsets(table)
    rows = _rows(_first(table, b"stsc"), 3)
    if not len(chunks) or not len(rows):
        return np.empty(0, dtype=np.int64)
    first = np.clip(rows[:, 0] - 1, 0, len(chunks))
    n_chunks = np.diff(np.append(first, len(chunks)))
    per_chunk = np.minimum(rows[:, 1], len(sizes))
    if (n_chunks < 0).any():
        return np.empty(0, dtype=np.int64)
    n_in_chunk = np.repeat(per_chunk, n_chunks)
    # tables of damaged files may announce more samples than the file has
    ends = np.minimum(np.cumsum(n_in_chunk), len(sizes))
    n_in_chunk = np.diff(np.concatenate([[0], ends]))
    chunk_of = np.repeat(np.arange(len(n_in_chunk)), n_in_chunk)
    before = np.concatenate([[0], np.cumsum(sizes)])
    start_of_chunk = np.concatenate([[0], ends[:-1]])
    within: IntArray = before[: len(chunk_of)] - before[start_of_chunk[chunk_of]]
    base = chunks[int(first[0]) :][: len(n_in_chunk)]
    offsets: IntArray = base[chunk_of] + within
    return offsets


def _chunk_offsets(table: bytes) -> IntArray:
    for kind, dtype in ((b"stco", ">u4"), (b"co64", ">u8")):
        box = _first(table, kind)
        if len(box) >= 8:
            return np.clip(_integers(box, 8, struct.unpack_from(">I", box, _FULL_BOX)[0], dtype), 0, 2**53)
    return np.empty(0, dtype=np.int64)


def _integers(box: bytes, start: int, n: int, dtype: str) -> IntArray:
    """At most `n` integers of a box from `start`; fewer if it is cut off."""
    item = np.dtype(dtype)
    n = min(n, (len(box) - start) // item.itemsize, MAX_TABLE_ROWS)
    return np.frombuffer(box, dtype=item, count=max(n, 0), offset=start).astype(np.int64)


def _rows(box: bytes, n_columns: int) -> IntArray:
    """(N, n_columns) rows of a table of unsigned integers."""
    if len(box) < 8:
        return np.empty((0, n_columns), dtype=np.int64)
    n = struct.unpack_from(">I", box, _FULL_BOX)[0]
    values = _integers(box, 8, n * n_columns, ">u4")
    return values[: len(values) // n_columns * n_columns].reshape(-1, n_columns)


def _runs(box: bytes, n: int, *, signed: bool = False) -> npt.NDArray[Any]:
    """(n,) values of a table of runs (count, value), as in `stts` and `ctts`; the last value is repeated."""
    rows = _rows(box, 2)
    if not len(rows):
        return np.zeros(n)
    counts = np.diff(np.concatenate([[0], np.minimum(np.cumsum(np.minimum(rows[:, 0], n)), n)]))
    values = np.repeat(rows[:, 1].astype(np.uint32).astype(np.int32) if signed else rows[:, 1], counts)
    return np.concatenate([values, np.full(n - len(values), values[-1] if len(values) else 0)]).astype(float)


def _edit_shift_s(edits: bytes, media_scale: int, movie_scale: int) -> float:
    """Seconds from the time axis of a track to that of the movie, from its edit list; 0 = there is none."""
    is_long = edits[:1] == b"\x01"
    row = struct.Struct(">Qqi" if is_long else ">Iii")
    delay = 0
    for start in range(8, min(len(edits), 8 + 16 * row.size) - row.size + 1, row.size):
        duration, media_time, _ = row.unpack_from(edits, start)
        if media_time >= 0:
            return float(delay / movie_scale - media_time / media_scale)
        delay += duration
    return 0.0
