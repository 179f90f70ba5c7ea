"""Boxes `freeGPS ` of a movie: found through the index `gps `, as boxes of the file, or between the
samples.

The times are the video's at the same offset in the file, or one second per box.
"""

import itertools
import math
import struct
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.recording.telemetry.containers.free_gps import MAX_BLOCK_BYTES, parse_free_gps
from track_range.recording.telemetry.containers.mp4_boxes import Movie, read_at
from track_range.recording.telemetry.sidecars.nmea import has_rmc, rmc_samples
from track_range.recording.telemetry.tracks.positions import MPS_PER_UNIT
from track_range.recording.telemetry.tracks.samples import (
    Sample,
    Unit,
    degrees,
    has_plausible_positions,
    track,
)
from track_range.recording.telemetry.tracks.track import TelemetryError, TelemetryTrack

MAX_BLOCKS = 50_000  # largest number of boxes read: 14 hours at 1 Hz
_MAX_PROBED = 400  # number of gaps between samples in which the first box must be found

_MARK = b"freeGPS "
_GAP_BYTES = 512  # bytes read at the start of a gap; boxes are aligned to blocks of the card
_CIPHER_MARK = b"4W`b]S<"  # `$GPRMC,` with 16 added to each character, at 0x3C


def read_novatek(file: BinaryIO, movie: Movie, path: Path) -> TelemetryTrack | None:
    """Telemetry of the boxes `freeGPS ` of a movie; None = there are none that can be read."""
    for offsets in (_indexed(movie), _top_level(movie), _between_samples(file, movie)):
        blocks = list(itertools.islice(_blocks(file, offsets), MAX_BLOCKS))
        if blocks:
            times_s = _block_times_s(np.array([offset for offset, _ in blocks]), movie)
            return track_of_blocks([block for _, block in blocks], times_s, path)
    return _seventymai_table(file, movie)


def _blocks(file: BinaryIO, offsets: Iterable[int]) -> Iterator[tuple[int, bytes]]:
    """Offset and content of the boxes `freeGPS ` at these places."""
    for offset in offsets:
        block = read_at(file, offset, MAX_BLOCK_BYTES)
        if block[4:12] != _MARK:
            continue
        n_bytes = int.from_bytes(block[:4], "big")
        is_stated = 12 <= n_bytes < len(block)
        yield offset, block[:n_bytes] if is_stated else block


def _indexed(movie: Movie) -> Iterator[int]:
    """Offsets in the index `gps `: after version and count, offset and size of each box."""
    index = movie.inner.get(b"gps ", b"")
    for start in range(8, min(len(index), 8 + 8 * MAX_BLOCKS) - 7, 8):
        yield struct.unpack_from(">I", index, start)[0]


def _top_level(movie: Movie) -> Iterator[int]:
    """Possible offsets of the mark in boxes `free`: it begins with the type of the box, or directly
    after it.
    """
    for box in movie.top:
        if box.type in (b"free", b"skip"):
            yield box.start - 8
            yield box.start - 4


def _between_samples(file: BinaryIO, movie: Movie) -> Iterator[int]:
    """Offsets of boxes in the parts of the media data that belong to no track."""
    media = [box for box in movie.top if box.type == b"mdat"]
    tracks = [part for part in movie.tracks if len(part)]
    if not media or not tracks:
        return
    starts = np.concatenate([part.offsets for part in tracks])
    order = np.argsort(starts, kind="stable")
    ends = np.maximum.accumulate((starts + np.concatenate([part.sizes for part in tracks]))[order])
    starts = starts[order]
    first = np.concatenate([[media[0].start], ends])
    last = np.concatenate([starts, [media[-1].end]])
    is_gap = (last - first >= 64) & (first < movie.n_bytes)
    is_found = False
    for n_probed, (start, end) in enumerate(
        zip(first[is_gap].tolist(), last[is_gap].tolist(), strict=True)
    ):
        if n_probed >= _MAX_PROBED and not is_found:
            return
        n_before = read_at(file, start, min(end - start, _GAP_BYTES)).find(_MARK)
        offset = start + n_before - 4
        while n_before >= 4 and offset + 12 <= end:  # successive boxes
            header = read_at(file, offset, 12)
            if header[4:] != _MARK:
                break
            is_found = True
            yield offset
            offset += max(int.from_bytes(header[:4], "big"), 12)


def _block_times_s(offsets: np.ndarray, movie: Movie) -> FloatArray:
    """(N,) times of the frames that follow the boxes in the file; one second per box where they are
    not spread.
    """
    seconds = np.arange(len(offsets), dtype=float)
    video = movie.video
    if video is None or len(offsets) < 2:
        return seconds
    order = np.argsort(video.offsets, kind="stable")
    index = np.minimum(np.searchsorted(video.offsets[order], offsets), len(video) - 1)
    time_s = video.time_s[order][index] - movie.start_s
    is_spread = time_s[-1] - time_s[0] > 0.5 * (len(offsets) - 1) and bool(
        (np.diff(time_s) >= 0).all()
    )
    return np.asarray(time_s) if is_spread else seconds


def track_of_blocks(
    blocks: Sequence[bytes], times_s: FloatArray, path: Path
) -> TelemetryTrack | None:
    """Telemetry of boxes from their 4 bytes of size on, at (N,) times in the video; None = the
    boxes are empty.

    Samples of one box are spread over a second. Raises TelemetryError for an unknown layout, or
    without pynmea2.
    """
    plain = list(map(_deciphered, blocks))
    if any(map(has_rmc, plain)):
        sentences = [sample or Sample() for sample in rmc_samples(plain, str(path))]
        return track(_timed(((sample,) for sample in sentences), times_s), "freeGPS records")
    records = [parse_free_gps(block) for block in blocks]
    known = [record for record in records if record]
    if not known:
        if any(any(block[16:0x80]) for block in blocks):  # without a receiver, boxes are empty
            raise TelemetryError(
                f"{path}: its freeGPS records have an unknown layout; export them as GPX."
            )
        return None
    unit: Unit = max((record.unit for record in known), key=("known", "assumed", "unknown").index)
    samples = _timed((record.samples if record else () for record in records), times_s)
    return track(_with_plausible_positions(samples), "freeGPS records", unit=unit)


def _with_plausible_positions(samples: list[Sample]) -> list[Sample]:
    """The samples, without positions if these are encrypted, as by some makers."""
    if has_plausible_positions(samples):
        return samples
    return [sample._replace(latitude_deg=math.nan, longitude_deg=math.nan) for sample in samples]


def _deciphered(block: bytes) -> bytes:
    """A box whose text is not shifted by 16."""
    if not block.startswith(_CIPHER_MARK, 0x3C):
        return block
    return bytes(byte - 16 for byte in block[0x3C:0x8C] if byte >= 16)


def _timed(groups: Iterable[Sequence[Sample]], times_s: FloatArray) -> list[Sample]:
    return [
        sample.at(float(start_s) + number / len(group))
        for group, start_s in zip(groups, times_s, strict=True)
        for number, sample in enumerate(group)
    ]


def _seventymai_table(file: BinaryIO, movie: Movie) -> TelemetryTrack | None:
    """Telemetry of the box `GPS ` of older 70mai cameras: rows of 36 bytes with seconds of the
    video and m/h.
    """
    box = next((box for box in movie.top if box.type == b"GPS "), None)
    content = read_at(file, box.start, min(box.end - box.start, 36 * MAX_BLOCKS)) if box else b""
    samples = []
    for start in range(0, len(content) - 35, 36):
        _, _, second, speed, north, latitude, east, longitude = struct.unpack_from(
            "<IIIIcIcI", content, start
        )
        if north in b"NS" and east in b"EW" and north.strip(b"\0"):
            position_deg = (
                degrees(latitude / 1e3, north.decode()),
                degrees(longitude / 1e3, east.decode()),
            )
            speed_mps = speed / 1e3 * MPS_PER_UNIT["km/h"]
            samples.append(Sample(float(second), math.nan, speed_mps, math.nan, *position_deg))
    return track(samples, "70mai", unit="assumed")
