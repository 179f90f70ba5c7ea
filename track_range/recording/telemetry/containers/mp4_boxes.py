"""MP4 and QuickTime files: boxes, tracks, and the offsets and times of samples (ISO/IEC 14496-12).

    moov  tracks with tables of their samples: stsz = sizes, stsc and stco = offsets, stts and ctts = times
    mdat  the samples

Cameras write fragments, too, so that a power cut loses only a second (8.8):

    moov  tracks without samples; mvex/trex = defaults of each track
    moof  traf of each track: tfhd = defaults, tfdt = first time, trun = size and duration of each sample

Only headers and tables are read, never the media data, so that a video of many gigabytes takes milliseconds. Damaged
tables give fewer samples, and damaged fragments none, never an exception.
"""

import os
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import BinaryIO, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray, IntArray

# size limit of the box `moov`, bytes; ten hours at 60 frames per second have about 50 MB
MAX_MOVIE_BYTES = 256_000_000
# size limit of a box `moof`, bytes; a second of video with all tables has about 5 kB
MAX_FRAGMENT_BYTES = 16_000_000
# size limit of a box, trailer or file of telemetry; an hour at 1 Hz has 1.5 MB
MAX_TELEMETRY_BYTES = 64_000_000
# largest number of boxes read on one level; dashcams write up to one small box per second
MAX_BOXES = 200_000
# largest number of samples of a track: 46 hours at 60 frames per second
MAX_TABLE_ROWS = 10_000_000
# largest number of samples of one size, which a table of a few bytes can announce
MAX_EQUAL_SAMPLES = 1_000_000
MAX_TRACKS = 32  # largest number of tracks read; cameras with several lenses have up to ten
_MAX_INTEGER = 2**53  # limit of offsets and times, with which sums do not overflow


class Box(NamedTuple):
    """A box: its type, and the position of its content in the file."""

    type: bytes
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class Track:
    """Samples of one track."""

    handler: bytes  # type of the track, such as b"vide" or b"meta"
    format: bytes  # type of the first sample description, such as b"gpmd"
    description: bytes  # the first sample description
    offsets: IntArray  # (N,) where the samples are in the file, bytes
    sizes: IntArray  # (N,) bytes
    time_s: FloatArray  # (N,) when a sample is shown, on the time axis of the movie
    durations_s: FloatArray  # (N,) how long
    number: int = 0  # the ID of the track in its file; 0 = not stated
    ticks_per_s: int = 1000  # unit of its times
    shift_s: float = 0.0  # seconds from its time axis to that of the movie

    def __len__(self) -> int:
        return len(self.offsets)


@dataclass(frozen=True, slots=True)
class Movie:
    """Contents of an MP4 file that readers of telemetry need."""

    top: tuple[Box, ...]  # boxes of the file, of `n_bytes`
    # content of the boxes in `moov` and `moov/udta`, by type
    inner: dict[bytes, bytes] = field(default_factory=dict)
    tracks: tuple[Track, ...] = ()  # all tracks with samples
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
    """The movie in an open file; None = it is no MP4 or QuickTime file."""
    n_bytes = os.fstat(file.fileno()).st_size
    top = tuple(_walk(lambda offset: read_at(file, offset, 16), 0, n_bytes))
    if not any(box.type in (b"ftyp", b"moov", b"mdat") for box in top[:8]):
        return None
    moov = next((box for box in top if box.type == b"moov"), None)
    if moov is None or moov.end - moov.start > MAX_MOVIE_BYTES:
        return Movie(top, n_bytes=n_bytes)
    inner: dict[bytes, bytes] = {}
    traks = []
    for box_type, content in boxes(read_at(file, moov.start, moov.end - moov.start)):
        if box_type == b"trak":
            traks.append(content)
        else:
            for part_type, part in boxes(content) if box_type == b"udta" else [(box_type, content)]:
                inner.setdefault(part_type, part)
    scale = _timescale(inner.get(b"mvhd", b""))
    tracks = [track for trak in traks[:MAX_TRACKS] if (track := _track(trak, scale)) is not None]
    if b"mvex" in inner:
        tracks = _with_fragments(file, top, tracks, inner[b"mvex"])
    return Movie(top, inner, tuple(track for track in tracks if len(track)), n_bytes)


def read_at(file: BinaryIO, offset: int, n_bytes: int) -> bytes:
    """At most `n_bytes` from `offset`; fewer at the end of the file."""
    if offset < 0 or n_bytes <= 0:
        return b""
    file.seek(offset)
    return file.read(n_bytes)


def read_samples(
    file: BinaryIO, track: Track, indices: Sequence[int] | IntArray, max_bytes: int
) -> Iterator[tuple[int, bytes]]:
    """Index and first bytes of samples; ends after as many bytes as the file has: damaged tables
    may overlap.
    """
    budget = os.fstat(file.fileno()).st_size
    for index in indices:
        content = read_at(file, int(track.offsets[index]), min(int(track.sizes[index]), max_bytes))
        budget -= len(content)
        if budget < 0:
            return
        yield int(index), content


def boxes(content: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Types and contents of the boxes in the content of another box; the last one may be cut
    off.
    """
    for box in _walk(lambda offset: content[offset : offset + 16], 0, len(content)):
        yield box.type, content[box.start : box.end]


def _walk(header_at: Callable[[int], bytes], start: int, end: int) -> Iterator[Box]:
    """Successive boxes, up to one without a valid size; `header_at` returns the 16 bytes from an
    offset.
    """
    for _ in range(MAX_BOXES):
        if start + 8 > end:
            return
        header = header_at(start)
        n_bytes, box_type = struct.unpack_from(">I4s", header)
        n_header = 8
        if n_bytes == 1 and len(header) >= 16:
            n_bytes, n_header = struct.unpack_from(">Q", header, 8)[0], 16
        elif n_bytes == 0:
            n_bytes = end - start
        if n_bytes < n_header:
            return
        yield Box(box_type, start + n_header, min(start + n_bytes, end))
        start += n_bytes


def _first(content: bytes, *path: bytes) -> bytes:
    """Content of the first box at a path of types; b"" if there is no such box."""
    for step in path:
        content = next((part for box_type, part in boxes(content) if box_type == step), b"")
    return content


def _track(content: bytes, movie_scale: int) -> Track | None:
    """Track of the content of a box `trak`; None = it has no handler."""
    media = _first(content, b"mdia")
    table = _first(media, b"minf", b"stbl")
    handler = _first(media, b"hdlr")[8:12]
    description = _first(table, b"stsd")[8:]
    if not handler:
        return None
    sizes = _sizes(table)
    offsets = _offsets(table, sizes)
    n = min(len(offsets), len(sizes))
    scale = _timescale(_first(media, b"mdhd"))
    durations = _runs(_table(_first(table, b"stts"), 2), n)
    ticks = np.concatenate([[0], np.cumsum(durations[:-1])]) if n else np.empty(0)
    shifts = _table(_first(table, b"ctts"), 2).astype(np.uint32).astype(np.int32)
    shift_s = _edit_shift_s(_first(content, b"edts", b"elst"), scale, movie_scale)
    return Track(
        handler,
        description[4:8],
        description,
        offsets[:n],
        sizes[:n],
        (ticks + _runs(shifts, n)) / scale + shift_s,
        durations / scale,
        number=_after_times(_first(content, b"tkhd")),
        ticks_per_s=scale,
        shift_s=shift_s,
    )


def _after_times(header: bytes) -> int:
    """The number after the times of creation and change in `mvhd` and `mdhd` (ticks per second) and
    `tkhd` (ID).
    """
    start = 20 if header[:1] == b"\x01" else 12
    return int.from_bytes(header[start : start + 4], "big")


def _timescale(header: bytes) -> int:
    return (
        _after_times(header) if len(header) >= (24 if header[:1] == b"\x01" else 16) else 0
    ) or 1000


def _table(box: bytes, n_columns: int = 1, dtype: str = ">u4", start: int = 4) -> IntArray:
    """(N, n_columns) integers that follow the number N at `start`; fewer if the box is cut off."""
    item = np.dtype(dtype)
    n = min(int.from_bytes(box[start : start + 4], "big") * n_columns, MAX_TABLE_ROWS)
    n = max(min(n, (len(box) - start - 4) // item.itemsize), 0) // n_columns
    if not n:
        return np.empty((0, n_columns), np.int64)
    return np.frombuffer(box, item, n * n_columns, start + 4).astype(np.int64).reshape(n, n_columns)


def _sizes(table: bytes) -> IntArray:
    """(N,) sizes of the samples from the box `stsz` or `stz2`."""
    box = _first(table, b"stsz")
    if len(box) >= 12:
        size, n = struct.unpack_from(">II", box, 4)
        return (
            np.full(min(n, MAX_EQUAL_SAMPLES), size, np.int64)
            if size
            else _table(box, start=8)[:, 0]
        )
    box = _first(table, b"stz2")
    dtype = {8: ">u1", 16: ">u2"}.get(box[7]) if len(box) >= 12 else None
    return np.empty(0, np.int64) if dtype is None else _table(box, dtype=dtype, start=8)[:, 0]


def _offsets(table: bytes, sizes: IntArray) -> IntArray:
    """(N,) positions of the samples in the file, from the boxes `stsc` and `stco` or `co64`."""
    small = _first(table, b"stco")
    chunks = _table(small) if len(small) >= 8 else _table(_first(table, b"co64"), dtype=">u8")
    chunks = np.clip(chunks[:, 0], 0, _MAX_INTEGER)
    rows = _table(_first(table, b"stsc"), 3)
    if not len(chunks) or not len(rows):
        return np.empty(0, np.int64)
    first = np.clip(rows[:, 0] - 1, 0, len(chunks))
    n_chunks = np.diff(np.append(first, len(chunks)))
    if (n_chunks < 0).any():
        return np.empty(0, np.int64)
    # tables of damaged files may announce more samples than the file has
    n_in_chunk = np.repeat(np.minimum(rows[:, 1], len(sizes)), n_chunks)
    ends = np.minimum(np.cumsum(n_in_chunk), len(sizes))
    starts = np.concatenate([[0], ends[:-1]])
    chunk_of = np.repeat(np.arange(len(ends)), ends - starts)
    before = np.concatenate([[0], np.cumsum(sizes)])
    base = chunks[int(first[0]) :][: len(ends)]
    offsets: IntArray = base[chunk_of] + before[: len(chunk_of)] - before[starts[chunk_of]]
    return offsets


def _runs(rows: npt.NDArray[np.integer], n: int) -> FloatArray:
    """(n,) values of rows (count, value), as in `stts` and `ctts`; the last value is repeated."""
    if not len(rows):
        return np.zeros(n)
    ends = np.minimum(np.cumsum(np.minimum(rows[:, 0].astype(np.uint32).astype(np.int64), n)), n)
    values = np.repeat(rows[:, 1], np.diff(np.concatenate([[0], ends])))
    return np.concatenate(
        [values, np.full(n - len(values), values[-1] if len(values) else 0)]
    ).astype(float)


def _edit_shift_s(edits: bytes, media_scale: int, movie_scale: int) -> float:
    """Seconds from the time axis of a track to the movie's, from its edit list; 0 without an edit
    list.
    """
    row = struct.Struct(">Qqi" if edits[:1] == b"\x01" else ">Iii")
    delay = 0
    for start in range(8, min(len(edits), 8 + 16 * row.size) - row.size + 1, row.size):
        duration, media_time, _ = row.unpack_from(edits, start)
        if media_time >= 0:
            return float(delay / movie_scale - media_time / media_scale)
        delay += duration
    return 0.0


@dataclass(slots=True)
class _Samples:
    """Samples of a track in its fragments so far: (N, 4) offsets, sizes, times and durations, and
    the next time.
    """

    end: int
    parts: list[IntArray] = field(default_factory=list)
    n: int = 0


def _with_fragments(
    file: BinaryIO, top: Sequence[Box], tracks: Sequence[Track], extends: bytes
) -> list[Track]:
    """Tracks with the samples of their fragments; `extends` is the box `mvex`."""
    defaults = {}
    for box_type, content in boxes(extends):
        if box_type == b"trex" and len(content) >= 20:
            number, _, duration, size = struct.unpack_from(">4I", content, 4)
            defaults[number] = duration, size
    samples = {
        t.number: _Samples(end=round(float(t.durations_s.sum()) * t.ticks_per_s)) for t in tracks
    }
    start = 0
    for box in top:
        if box.type == b"moof" and box.end - box.start <= MAX_FRAGMENT_BYTES:
            with suppress(struct.error, ValueError, OverflowError):  # cut off or damaged
                _add_fragment(
                    read_at(file, box.start, box.end - box.start), start, defaults, samples
                )
        start = box.end
    joined = []
    for track in tracks:
        rows = np.concatenate([np.empty((0, 4), np.int64), *samples[track.number].parts])
        joined.append(
            replace(
                track,
                offsets=np.concatenate([track.offsets, rows[:, 0]]),
                sizes=np.concatenate([track.sizes, rows[:, 1]]),
                time_s=np.concatenate(
                    [track.time_s, rows[:, 2] / track.ticks_per_s + track.shift_s]
                ),
                durations_s=np.concatenate([track.durations_s, rows[:, 3] / track.ticks_per_s]),
            )
        )
    return joined


def _add_fragment(
    content: bytes, start: int, defaults: dict[int, tuple[int, int]], samples: dict[int, _Samples]
) -> None:
    end_of_data = start
    for box_type, fragment in boxes(content):
        if box_type != b"traf":
            continue
        header = _FragmentHeader.read(_first(fragment, b"tfhd"), defaults)
        track = samples.get(header.number)
        if track is None:
            continue
        if header.base is not None:
            end_of_data = header.base
        elif header.is_base_moof:
            end_of_data = start
        base = end_of_data
        for part_type, body in boxes(fragment):
            if part_type == b"tfdt":
                (end,) = struct.unpack_from(">Q" if body[:1] == b"\x01" else ">I", body, 4)
                track.end = min(end, _MAX_INTEGER)
            elif part_type == b"trun":
                end_of_data = _add_run(track, body, base, end_of_data, header.duration, header.size)


class _FragmentHeader(NamedTuple):
    """A box `tfhd`."""

    number: int  # of the track
    base: int | None  # of the offsets of the data in the file; None = not stated
    is_base_moof: bool  # whether the base is the `moof`, else the end of the data before
    duration: int  # of a sample, if its run states none
    size: int

    @classmethod
    def read(cls, header: bytes, defaults: Mapping[int, tuple[int, int]]) -> Self:
        """The box, with the durations and sizes of the tracks by number where it states none."""
        flags, number = struct.unpack_from(">II", header)
        duration, size = defaults.get(number, (0, 0))
        base, offset = None, 8
        if flags & 0x1:
            base = min(struct.unpack_from(">Q", header, offset)[0], _MAX_INTEGER)
            offset += 8
        if flags & 0x2:  # sample description
            offset += 4
        if flags & 0x8:
            (duration,) = struct.unpack_from(">I", header, offset)
            offset += 4
        if flags & 0x10:
            (size,) = struct.unpack_from(">I", header, offset)
        return cls(number, base, bool(flags & 0x20000), duration, size)


def _add_run(
    track: _Samples, body: bytes, base: int, end_of_data: int, duration: int, size: int
) -> int:
    """Add the samples of a box `trun`, with a default duration and size; returns where their data
    end in the file.
    """
    flags, n = struct.unpack_from(">II", body)
    offset, data_start = 8, end_of_data
    if flags & 0x1:
        data_start, offset = base + struct.unpack_from(">i", body, offset)[0], offset + 4
    offset += 4 * bool(flags & 0x4)  # flags of the first sample
    fields = [
        name
        for name, flag in (("t", 0x100), ("size", 0x200), ("flags", 0x400), ("shift", 0x800))
        if flags & flag
    ]
    n = min(n, MAX_EQUAL_SAMPLES, MAX_TABLE_ROWS - track.n)
    if fields:
        n = min(n, (len(body) - offset) // (4 * len(fields)))
    rows = (
        np.frombuffer(body, ">u4", n * len(fields), offset).reshape(n, len(fields)).astype(np.int64)
    )
    column = dict(zip(fields, rows.T, strict=True))
    durations = column.get("t", np.full(n, duration, np.int64))
    sizes = column.get("size", np.full(n, size, np.int64))
    shifts = column.get("shift", np.zeros(n, np.int64)).astype(np.uint32).view(np.int32)
    offsets = np.clip(data_start + np.cumsum(sizes) - sizes, 0, _MAX_INTEGER)
    times = track.end + np.cumsum(durations) - durations + shifts
    track.parts.append(np.stack([offsets, sizes, times, durations], axis=1))
    track.end += int(durations.sum())
    track.n += n
    return data_start + int(sizes.sum())
