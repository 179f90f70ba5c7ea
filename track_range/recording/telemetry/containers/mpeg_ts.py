"""MPEG transport streams (.ts, .m2ts): `freeGPS` and LIGO records in private PES packets, on the
clock of the video.

Packets of 188 bytes, or 192 with a time stamp before each (ISO/IEC 13818-1). The file is read in
blocks from start to end, as it has no index; without a private stream at its start it is not read
further.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from track_range.recording.telemetry.containers.free_gps import MAX_BLOCK_BYTES, parse_free_gps
from track_range.recording.telemetry.containers.mp4_boxes import read_at
from track_range.recording.telemetry.containers.novatek import MAX_BLOCKS, track_of_blocks
from track_range.recording.telemetry.sidecars.nmea import has_rmc
from track_range.recording.telemetry.tracks.track import TelemetryTrack

_SYNC = 0x47
_PACKETS_PER_READ = 40_000  # 7.5 MB
_MAX_LOST = 1000  # times that synchronisation is found again in a file
_SEARCHED_BYTES = 4096  # in which synchronisation is looked for before the next packets are tried
_PROBED_BYTES = 48_000_000  # in which a record must be found; about ten seconds of 4K video
# stream ids of private data with and without the header fields of other streams
_PRIVATE_1, _PRIVATE_2 = 0xBD, 0xBF

_PTS_HZ = 90_000
_PTS_WRAP = 1 << 33
# start of a box before the record, which transport streams leave out
_EMPTY_HEADER = b"\0\0\0\0freeGPS \0\0\0\0"


@dataclass(slots=True)
class _Scan:
    """State while packets are read; time stamps are in ticks."""

    first_pts: int | None = None  # smallest time stamp among the first frames
    last_pts: int = 0  # time stamp of the last frame
    n_frames: int = 0
    # content of the private packet that is not complete, by PID, and the time stamp at its start
    open: dict[int, tuple[int, bytearray]] = field(default_factory=dict)
    # time stamp and content of the complete ones
    records: list[tuple[int, bytes]] = field(default_factory=list)
    pids: set[int] = field(default_factory=set)  # PIDs of private streams


def packet_bytes(start: bytes) -> int | None:
    """Distance between packets in the first bytes of a file; None = it is no transport stream."""
    for n_bytes, offset in ((188, 0), (192, 4)):
        marks = start[offset : offset + 5 * n_bytes : n_bytes]
        if len(marks) >= 3 and set(marks) == {_SYNC}:
            return n_bytes
    return None


def read_mpeg_ts(file: BinaryIO, path: Path) -> TelemetryTrack | None:
    """Telemetry of a transport stream; None = it has none, or is another file."""
    n_bytes = packet_bytes(read_at(file, 0, 1024))
    if n_bytes is None:
        return None
    scan = _Scan()
    for offset, packets in _packets(file, n_bytes):
        _read(packets, scan)
        has_record = any(_is_record(content) for _, content in scan.records[:50])
        if (offset > _PROBED_BYTES and not has_record) or len(scan.records) > MAX_BLOCKS:
            break
    scan.records += [(pts, bytes(content)) for pts, content in scan.open.values()]
    blocks = sorted(
        ((pts, _block(content)) for pts, content in scan.records if _is_record(content)),
        key=itemgetter(0),
    )
    if not blocks:
        return None
    first = scan.first_pts or 0
    times_s = np.array([_difference(pts, first) / _PTS_HZ for pts, _ in blocks])
    if scan.first_pts is None or not (np.diff(times_s) >= 0).all():
        times_s = np.arange(len(blocks), dtype=float)
    return track_of_blocks([block for _, block in blocks], times_s, path)


def _difference(pts: int, first: int) -> int:
    """Ticks from `first` to `pts`, which may have wrapped."""
    return (pts - first + _PTS_WRAP // 2) % _PTS_WRAP - _PTS_WRAP // 2


def _packets(file: BinaryIO, n_bytes: int) -> Iterator[tuple[int, npt.NDArray[np.uint8]]]:
    """Offset and (N, 188) packets of successive parts of the file; lost synchronisation is found
    again.
    """
    offset, n_stamp, n_lost = 0, n_bytes - 188, 0
    while content := read_at(file, offset, n_bytes * _PACKETS_PER_READ):
        start = 0
        while len(content) - start >= n_bytes:
            part = content[start : start + (len(content) - start) // n_bytes * n_bytes]
            rows = np.frombuffer(part, np.uint8).reshape(-1, n_bytes)[:, n_stamp:]
            lost = np.flatnonzero(rows[:, 0] != _SYNC)
            n = int(lost[0]) if len(lost) else len(rows)
            yield offset + start, rows[:n]
            start += n * n_bytes
            if len(lost):
                n_lost += 1
                start += 1
                end = min(len(content) - n_bytes - n_stamp, start + _SEARCHED_BYTES)
                heads = range(start + n_stamp, end + n_stamp)
                marks = (i - n_stamp for i in heads if content[i] == _SYNC == content[i + n_bytes])
                start = next(marks, max(end, start))
            if n_lost > _MAX_LOST:
                return
        offset += max(start, 1)


def _read(packets: npt.NDArray[np.uint8], scan: _Scan) -> None:
    pids = (packets[:, 1] & 0x1F).astype(np.uint16) << 8 | packets[:, 2]
    has_payload, has_adaptation = (packets[:, 3] & 0x10) > 0, (packets[:, 3] & 0x20) > 0
    starts = np.where(has_adaptation, 5 + packets[:, 4].astype(np.int64), 4)  # of the payloads
    is_head = has_payload & ((packets[:, 1] & 0x40) > 0) & (starts <= 188 - 6)
    stream_ids = packets[np.arange(len(packets)), np.minimum(starts + 3, 187)]
    scan.pids.update(
        np.unique(pids[is_head & np.isin(stream_ids, (_PRIVATE_1, _PRIVATE_2))]).tolist()
    )
    is_private = has_payload & np.isin(pids, list(scan.pids))
    is_video = is_head & (stream_ids & 0xF0 == 0xE0)
    for index in np.flatnonzero(is_video | is_private).tolist():
        payload = packets[index, starts[index] :].tobytes()
        is_header = bool(is_head[index]) and payload[:3] == b"\0\0\1"
        if is_header and is_video[index]:
            _frame(payload, scan)
        elif is_private[index]:
            _private(int(pids[index]), payload, is_header, scan)


def _frame(payload: bytes, scan: _Scan) -> None:
    """Add the presentation time stamp of a PES header, if it has one."""
    if len(payload) < 14 or not payload[7] & 0x80:
        return
    b = payload[9:14]
    pts = (b[0] >> 1 & 7) << 30 | b[1] << 22 | b[2] >> 1 << 15 | b[3] << 7 | b[4] >> 1
    scan.n_frames += 1
    scan.last_pts = pts
    if scan.first_pts is None or (scan.n_frames < 30 and _difference(pts, scan.first_pts) < 0):
        scan.first_pts = pts


def _private(pid: int, payload: bytes, is_header: bool, scan: _Scan) -> None:
    if is_header:
        if pid in scan.open and len(scan.records) <= MAX_BLOCKS:
            pts, content = scan.open.pop(pid)
            scan.records.append((pts, bytes(content)))
        start = 9 + payload[8] if payload[3] == _PRIVATE_1 and len(payload) > 8 else 6
        scan.open[pid] = (scan.last_pts, bytearray(payload[start:]))
    elif pid in scan.open and len(scan.open[pid][1]) < MAX_BLOCK_BYTES:
        scan.open[pid][1].extend(payload)


def _block(content: bytes) -> bytes:
    start = content[:16].find(b"freeGPS ")
    return bytes(4) + content[start:] if start >= 0 else _EMPTY_HEADER + content


def _is_record(content: bytes) -> bool:
    block = _block(content)
    return has_rmc(block) or parse_free_gps(block) is not None
