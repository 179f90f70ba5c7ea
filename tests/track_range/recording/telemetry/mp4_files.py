"""MP4 files and transport streams with telemetry, made from the published formats."""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class MadeTrack:
    """A track of an MP4 file: samples, one after another, of equal durations."""

    handler: bytes
    format: bytes
    samples: Sequence[bytes]
    ticks: int = 1000
    timescale: int = 1000


def box(kind: bytes, *content: bytes) -> bytes:
    data = b"".join(content)
    return struct.pack(">I4s", 8 + len(data), kind) + data


def mp4(
    tracks: Sequence[MadeTrack] = (),
    *,
    inner: bytes = b"",
    between: bytes = b"",
    top: bytes = b"",
    end: bytes = b"",
) -> bytes:
    """A file: `between` is put before each sample of the first track, `inner` into moov, `top`
    before the media."""
    start = box(b"ftyp", b"isom\0\0\2\0isomavc1") + top
    media, traks = b"", []
    for number, track in enumerate(tracks):
        offsets = []
        for sample in track.samples:
            media += between if number == 0 else b""
            offsets.append(len(start) + 8 + len(media))
            media += sample
        traks.append(_trak(track, offsets))
    return start + box(b"mdat", media) + box(b"moov", _header(b"mvhd", 1000), *traks, inner) + end


def _header(kind: bytes, timescale: int) -> bytes:
    return box(
        kind, struct.pack(">IIIII", 0, 0, 0, timescale, 0), bytes(80 if kind == b"mvhd" else 4)
    )


def _trak(track: MadeTrack, offsets: list[int], number: int = 0) -> bytes:
    n = len(track.samples)
    table = box(
        b"stbl",
        box(
            b"stsd",
            struct.pack(">II", 0, 1),
            box(track.format, bytes(78 if track.handler == b"vide" else 8)),
        ),
        box(b"stts", struct.pack(">IIII", 0, 1, n, track.ticks)),
        box(b"stsc", struct.pack(">IIIII", 0, 1, 1, 1, 1)),
        box(
            b"stsz",
            struct.pack(">III", 0, 0, n),
            *(struct.pack(">I", len(sample)) for sample in track.samples),
        ),
        box(b"stco", struct.pack(">II", 0, n), *(struct.pack(">I", offset) for offset in offsets)),
    )
    media = (
        _header(b"mdhd", track.timescale),
        box(b"hdlr", bytes(8), track.handler, bytes(13)),
        box(b"minf", table),
    )
    return box(
        b"trak", box(b"tkhd", struct.pack(">IIIII", 0, 0, 0, number, 0)), box(b"mdia", *media)
    )


def fragmented_mp4(tracks: Sequence[MadeTrack], *, per_fragment: int = 2) -> bytes:
    """A fragmented file: a `moof` and an `mdat` for each group of `per_fragment` samples of all
    tracks."""
    empty = [dataclasses.replace(track, samples=()) for track in tracks]
    traks = [_trak(track, [], number) for number, track in enumerate(empty, 1)]
    defaults = [
        box(b"trex", struct.pack(">6I", 0, i, 1, track.ticks, 0, 0))
        for i, track in enumerate(tracks, 1)
    ]
    content = box(b"ftyp", b"iso5\0\0\2\0iso5mp41")
    content += box(b"moov", _header(b"mvhd", 1000), *traks, box(b"mvex", *defaults))
    for first in range(0, max(len(track.samples) for track in tracks), per_fragment):
        parts = [track.samples[first : first + per_fragment] for track in tracks]
        n_bytes = len(_fragment(tracks, parts, first, [0] * len(tracks)))
        places = [
            n_bytes + 8 + sum(len(b"".join(part)) for part in parts[:i]) for i in range(len(parts))
        ]
        content += _fragment(tracks, parts, first, places) + box(
            b"mdat", *(b"".join(part) for part in parts)
        )
    return content


def _fragment(
    tracks: Sequence[MadeTrack], parts: Sequence[Sequence[bytes]], first: int, places: Sequence[int]
) -> bytes:
    """A box `moof` with a run of each track, with the sizes of its samples and the offset of its
    data."""
    runs = [
        box(
            b"traf",
            box(b"tfhd", struct.pack(">II", 0x20000, number)),
            box(b"tfdt", struct.pack(">II", 0, first * track.ticks)),
            box(
                b"trun",
                struct.pack(">IIi", 0x201, len(part), place),
                *(struct.pack(">I", len(one)) for one in part),
            ),
        )
        for number, (track, part, place) in enumerate(zip(tracks, parts, places, strict=True), 1)
    ]
    return box(b"moof", box(b"mfhd", struct.pack(">II", 0, first)), *runs)


VIDEO = MadeTrack(b"vide", b"avc1", [b"\0\0\0\2\x41\0" * 4] * 10)
"""Video of ten frames at 1 Hz."""


def free_gps(record: bytes, n_bytes: int = 0x200) -> bytes:
    """A box `freeGPS ` with a record after its 16 bytes of header."""
    return (
        struct.pack(">I", n_bytes)
        + b"freeGPS "
        + struct.pack("<I", 0x4C)
        + record.ljust(n_bytes - 16, b"\0")
    )


def short_record(knots: float = 48.59, flags: bytes = b"ANE", order: str = "<") -> bytes:
    """Record of Viofo's A119V3, from 0x10 on."""
    return struct.pack(f"{order}6I3sx4f", 15, 37, 57, 21, 10, 13, flags, 5000.0, 3000.0, knots, 7.0)


def long_record(knots: float = 48.59, flags: bytes = b"ANE", order: str = "<") -> bytes:
    """Record of Viofo's A119S, from 0x10 on."""
    return bytes(32) + short_record(knots, flags, order)


def rmc(speed_kn: float = 10.0, second: int = 17, status: str = "A") -> bytes:
    """RMC sentence with a right checksum."""
    content = (
        f"GNRMC,1806{second:02d}.000,{status},5000.00000,N,03000.00000,E,{speed_kn},45.0,070625,,,A"
    )
    total = 0
    for character in content.encode():
        total ^= character
    return f"${content}*{total:02X}\r\n".encode()


def transport_stream(
    records: Sequence[bytes], *, stream_id: int = 0xBF, packet_bytes: int = 188
) -> bytes:
    """A stream with one frame and one private packet per second."""
    stream = b""
    for second, record in enumerate(records):
        pts = 90_000 * (second + 5)
        stamp = bytes(
            [
                0x21 | pts >> 29 & 0xE,
                pts >> 22 & 0xFF,
                pts >> 14 & 0xFE | 1,
                pts >> 7 & 0xFF,
                pts << 1 & 0xFE | 1,
            ]
        )
        frame = b"\0\0\1\xe0\0\0\x80\x80\5" + stamp + b"picture"
        header = struct.pack(">3sBH", b"\0\0\1", stream_id, len(record))
        private = header + (b"\x80\0\0" if stream_id == 0xBD else b"") + record
        stream += _packets(256, frame, packet_bytes) + _packets(768, private, packet_bytes)
    return stream


def _packets(pid: int, payload: bytes, packet_bytes: int) -> bytes:
    packets = b""
    for start in range(0, len(payload), 184):
        part = payload[start : start + 184]
        stuffing = 184 - len(part)
        control = 0x10 if not stuffing else 0x30
        head = struct.pack(">BHB", 0x47, pid | (0x4000 if start == 0 else 0), control)
        if stuffing:
            head += bytes([stuffing - 1]) + (
                b"\0" + b"\xff" * (stuffing - 2) if stuffing > 1 else b""
            )
        packets += bytes(packet_bytes - 188) + head + part
    return packets


def klv(key: bytes, kind: bytes, row_bytes: int, content: bytes) -> bytes:
    """An entry of GPMF."""
    n_rows = len(content) // row_bytes
    return key + kind + struct.pack(">BH", row_bytes, n_rows) + content + bytes(-len(content) % 4)


def gps5_payload(
    speeds_mps: Sequence[float], fix: int = 3, dop: int = 200, second: int = 0
) -> bytes:
    """Payload with a stream GPS5."""
    rows = b"".join(
        struct.pack(">5i", 331264969, -1173273542, -20184, round(speed * 1000), round(speed * 100))
        for speed in speeds_mps
    )
    parts = (
        klv(b"GPSF", b"L", 4, struct.pack(">I", fix)),
        klv(b"GPSU", b"U", 16, f"1704171731{second:02d}.000".encode()),
        klv(b"GPSP", b"S", 2, struct.pack(">H", dop)),
        klv(b"SCAL", b"l", 4, struct.pack(">5i", 10_000_000, 10_000_000, 1000, 1000, 100)),
        klv(b"GPS5", b"l", 20, rows),
    )
    return _device(b"".join(parts))


def gps9_payload(speed_mps: float, fix: int = 3, second: int = 0) -> bytes:
    """Payload with a stream GPS9 of one row."""
    row = struct.pack(
        ">7i2H",
        488083646,
        93550506,
        248083,
        round(speed_mps * 1000),
        0,
        9138,
        (37982 + second) * 1000,
        396,
        fix,
    )
    parts = (
        klv(b"TYPE", b"c", 1, b"lllllllSS"),
        klv(
            b"SCAL",
            b"l",
            4,
            struct.pack(">9i", 10_000_000, 10_000_000, 1000, 1000, 100, 1, 1000, 100, 1),
        ),
        klv(b"GPS9", b"?", 32, row),
    )
    return _device(b"".join(parts))


def _device(stream: bytes) -> bytes:
    inside = klv(b"DVID", b"L", 4, b"\0\0\0\1") + klv(b"STRM", b"\0", 1, stream)
    return klv(b"DEVC", b"\0", 1, inside)


def camm_gps(east_mps: float, north_mps: float, fix: int = 3, latitude_deg: float = 50.0) -> bytes:
    """CAMM sample of type 6."""
    return struct.pack(
        "<HHdiddfffffff", 0, 6, 1.3e9, fix, latitude_deg, 8.0, 0, 1, 1, east_mps, north_mps, 0, 0.3
    )


def camm_position(latitude_deg: float) -> bytes:
    """CAMM sample of type 5."""
    return struct.pack("<HHddd", 0, 5, latitude_deg, 8.0, 100.0)


def tesla_frame(speed_mps: float | None, *, codec: str = "h264") -> bytes:
    """A frame with Tesla's message, or with another one; emulation prevention as an encoder writes
    it."""
    message = b"\x08\1\x10\1"
    if speed_mps is None:
        payload = b"another user data"
    else:
        message += b"\x25" + struct.pack("<f", speed_mps) if speed_mps else b""
        message += (
            b"\x59"
            + struct.pack("<d", 50.0)
            + b"\x61"
            + struct.pack("<d", 8.0)
            + b"\x69"
            + struct.pack("<d", 90.0)
        )
        payload = b"\x42\x42\x42\x69" + message
    unit = (
        (b"\x06" if codec == "h264" else b"\x4e\1")
        + bytes([5, len(payload)])
        + _prevented(payload)
        + b"\x80"
    )
    picture = b"\x65picture" if codec == "h264" else b"\x26\1picture"
    return struct.pack(">I", len(unit)) + unit + struct.pack(">I", len(picture)) + picture


def _prevented(payload: bytes) -> bytes:
    out, zeros = bytearray(), 0
    for byte in payload:
        if zeros >= 2 and byte <= 3:
            out.append(3)
            zeros = 0
        out.append(byte)
        zeros = zeros + 1 if byte == 0 else 0
    return bytes(out)
