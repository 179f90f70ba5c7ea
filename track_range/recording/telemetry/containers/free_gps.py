"""Records of dashcams with Novatek and related chips, `freeGPS `: many layouts, which differ in fixed characters.

Layouts and units as ExifTool's documentation of QuickTime streams lists them (exiftool.org), and as
sergei.nz/extracting-gps-data-from-viofo-a119-and-other-novatek-powered-cameras describes the first. Offsets count from
the start of the box: 4 bytes of size, `freeGPS `, 4 bytes of length, then the record. Integers and floating-point
numbers are little-endian; coordinates are degrees and minutes (DDMM.MMMM); speeds are in knots unless stated.
Coordinates that a maker encrypts or shifts are still passed on; only speed and course matter.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable
from dataclasses import dataclass

from track_range.recording.telemetry.containers.ligogps import parse_ligo_record, parse_ligo_text
from track_range.recording.telemetry.containers.samples import Sample, Unit, date_s, degrees
from track_range.recording.telemetry.sidecars.units import MPS_PER_UNIT

MPS_PER_KNOT, MPS_PER_KMH = MPS_PER_UNIT["kn"], MPS_PER_UNIT["km/h"]

MAX_BLOCK_BYTES = 4096
"""Bytes of a box that are read; boxes have up to 32 kB, most of them empty."""


@dataclass(frozen=True, slots=True)
class FreeGps:
    """Content of one box.

    Attributes:
        samples: in the order of the record, without time in the video; a void record has one without speed.
        unit: what is known of the unit of the speed, which is read as km/h unless it is known.
    """

    samples: tuple[Sample, ...]
    unit: Unit = "known"


def parse_free_gps(block: bytes) -> FreeGps | None:
    """Content of a box; None = the layout is unknown. Records with RMC sentences are read elsewhere."""
    for layout in _LAYOUTS:
        content = layout(block.ljust(_PADDED_BYTES, b"\0"))
        if content is not None:
            return content
    return None


_PADDED_BYTES = 0x140
"""Smallest size of the blocks that layouts read: fields beyond the end are 0."""


def _ints(block: bytes, offset: int, n: int) -> tuple[int, ...]:
    return struct.unpack_from(f"<{n}I", block, offset)


def _float(block: bytes, offset: int) -> float:
    return float(struct.unpack_from("<f", block, offset)[0])


def _double(block: bytes, offset: int) -> float:
    return float(struct.unpack_from("<d", block, offset)[0])


def _int(block: bytes, offset: int) -> int:
    return int(struct.unpack_from("<i", block, offset)[0])


def _is_clock(hour: int, minute: int, second: int) -> bool:
    return hour < 24 and minute < 60 and second < 61


def _flags(block: bytes, offset: int) -> tuple[str, str, str] | None:
    """Status and hemispheres at `offset`, such as "ANE"; a void record has only the V. None = they are others.

    A status of 0 with hemispheres counts as valid: it is a byte that some firmwares do not fill in.
    """
    flags = block[offset : offset + 3].decode("latin-1")
    if re.fullmatch("[A\0][NS][EW]", flags):
        return "A", flags[1], flags[2]
    return ("V", "", "") if re.fullmatch("V[^A-MO-RT-Z]..?|V[NS].?", flags, re.DOTALL) else None


def _one(
    utc_s: float,
    is_valid: bool,
    speed_mps: float,
    course_deg: float,
    latitude_deg: float = math.nan,
    longitude_deg: float = math.nan,
) -> FreeGps:
    """One sample; a void one has no speed."""
    if not is_valid:
        return FreeGps((Sample(utc_s=utc_s),))
    return FreeGps((Sample(math.nan, utc_s, speed_mps, course_deg, latitude_deg, longitude_deg),))


def _short(block: bytes) -> FreeGps | None:
    """Viofo A119V3 and relatives: date and time at 0x10, flags at 0x28; Kenwood has 48 bytes more before them.

    In the variant with text coordinates (E-ACE B44, base64, encrypted), speed and course are at 0x54.
    """
    for extra in (0, 48):
        dated = _dated(block, 0x10 + extra)
        flags = _flags(block, 0x28 + extra)
        if flags is None or dated is None:
            continue
        texts = block[0x2C + extra : 0x40 + extra], block[0x40 + extra : 0x54 + extra]
        if all(re.fullmatch(rb"[A-Za-z0-9+/.]{6,20}={0,2}\0*", text) for text in texts):
            speed_mps, course_deg = _float(block, 0x54 + extra) * MPS_PER_KNOT, _float(block, 0x58 + extra)
            return _one(dated[0], flags[0] == "A", speed_mps, course_deg)
        return _floats(block, dated, flags, 0x2C + extra)
    return None


def _dated(block: bytes, offset: int) -> tuple[float, str] | None:
    """Date and time of the integers hour to second and year to day, and their byte order; None = they are none.

    Numbers are little-endian in all known firmwares; a date is valid in one order only.
    """
    for order in "<>":
        hour, minute, second, year, month, day = struct.unpack_from(f"{order}6I", block, offset)
        if _is_clock(hour, minute, second) and 1 <= month <= 12 and 1 <= day <= 31 and year < 2200:
            return date_s(year, month, day, hour, minute, second), order
    return None


def _floats(block: bytes, dated: tuple[float, str], flags: tuple[str, str, str], offset: int) -> FreeGps:
    """Latitude, longitude, speed and course as floating-point numbers from `offset`."""
    latitude, longitude, knots, course_deg = struct.unpack_from(f"{dated[1]}4f", block, offset)
    return _one(
        dated[0],
        flags[0] == "A",
        knots * MPS_PER_KNOT,
        course_deg,
        degrees(latitude, flags[1]),
        degrees(longitude, flags[2]),
    )


def _long(block: bytes) -> FreeGps | None:
    """Viofo A119S and most Novatek: date and time at 0x30, flags at 0x48.

    Cameras with the mark "IQS" have integers: 1e-7 degrees and cm/s. Akaso V1 and Redtiger have encrypted coordinates
    from 0x50, and a speed of unknown unit at 0x60.
    """
    flags, dated = _flags(block, 0x48), _dated(block, 0x30)
    if flags is None or dated is None:
        return None
    if block[0x10:0x13] == b"IQS":
        position_deg = [abs(_int(block, place) / 1e7) for place in (0x4C, 0x50)]
        signs = [-1 if hemisphere in ("S", "W") else 1 for hemisphere in flags[1:]]
        latitude_deg, longitude_deg = (sign * value for sign, value in zip(signs, position_deg, strict=True))
        return _one(dated[0], flags[0] == "A", _int(block, 0x54) / 100, math.nan, latitude_deg, longitude_deg)
    if flags[0] == "A" and block[0x4B:0x50] == bytes(5) and any(block[0x50:0x60]):
        return FreeGps((Sample(math.nan, dated[0], _float(block, 0x60) * MPS_PER_KMH),), "unknown")
    return _floats(block, dated, flags, 0x4C)


def _spread(block: bytes) -> FreeGps | None:
    """Flags as separate words: time at 0x30, status at 0x3C, hemispheres after each coordinate; km/h.

    Akaso and relatives have floating-point numbers of 4 bytes.
    """
    is_short = re.match(rb".{60}[AV]\0{3}.{4}[NS]\0{3}.{4}[EW]\0{3}", block, re.DOTALL)
    hour, minute, second = _ints(block, 0x30, 3)
    year, month, day = _ints(block, 0x58, 3)
    if not is_short or not _is_clock(hour, minute, second):
        return None
    sample = Sample(
        math.nan,
        date_s(year, month, day, hour, minute, second),
        _float(block, 0x50) * MPS_PER_KMH,
        (_float(block, 0x54) + (180 if block[0x10:0x14] == b"x.xx" else 0)) % 360,
        degrees(_float(block, 0x40), chr(block[0x44])),
        degrees(_float(block, 0x48), chr(block[0x4C])),
    )
    is_valid = block[0x3C:0x3D] == b"A"
    return FreeGps((sample if is_valid else Sample(utc_s=sample.utc_s),), "assumed")


def _spread_doubles(block: bytes) -> FreeGps | None:
    """As `_spread` with floating-point numbers of 8 bytes and knots: from 0x30, or from 0x10 in Vantrue's N4."""
    for start in (0x30, 0x10):
        fields = block[start + 12 : start + 0x4C]
        if not re.match(rb"[AV]\0{3}.{8}[NS]\0{3}.{12}[EW]\0{3}", fields, re.DOTALL):
            continue
        hour, minute, second = _ints(block, start, 3)
        year, month, day = _ints(block, start + 0x40, 3)
        return _one(
            date_s(year, month, day, hour, minute, second),
            fields[:1] == b"A",
            _double(block, start + 0x30) * MPS_PER_KNOT,
            _double(block, start + 0x38),
            degrees(abs(_double(block, start + 0x10)), chr(block[start + 0x18])),
            degrees(abs(_double(block, start + 0x20)), chr(block[start + 0x28])),
        )
    return None


def _vantrue_s1(block: bytes) -> FreeGps | None:
    """Vantrue S1: flags at 0x40, year to second at 0x44, longitude, latitude, speed and course from 0x5C."""
    flags = _flags(block, 0x40)
    year, month, day, hour, minute, second = _ints(block, 0x44, 6)
    if flags is None or not (1 <= month <= 12 and 1 <= day <= 31 and _is_clock(hour, minute, second)):
        return None
    return _one(
        date_s(year, month, day, hour, minute, second),
        flags[0] == "A",
        _float(block, 0x64) * MPS_PER_KNOT,
        _float(block, 0x68),
        degrees(_float(block, 0x60), flags[1]),
        degrees(_float(block, 0x5C), flags[2]),
    )


def _innovv(block: bytes) -> FreeGps | None:
    """INNOVV: records of 32 bytes from 0x10 with flags and floating-point numbers, without date."""
    if not re.match(rb".{16}A[NS][EW]\0", block, re.DOTALL):
        return None
    samples = []
    for match in re.finditer(rb"A([NS])([EW])\0(.{28})", block, re.DOTALL):
        latitude, longitude, knots, course_deg = struct.unpack_from("<4f", match[3])
        north, east = degrees(abs(latitude), match[1].decode()), degrees(abs(longitude), match[2].decode())
        samples.append(Sample(math.nan, math.nan, knots * MPS_PER_KNOT, course_deg, north, east))
    return FreeGps(tuple(samples))


def _seventymai(block: bytes) -> FreeGps | None:
    """70mai A810: status at 0x1E, then coordinates (DDMM.MMMMM as integers) and the speed in km/h; no date."""
    if not re.match(rb".{16}\x03\0.{12}[AV].{20}[AV][AV]", block, re.DOTALL):
        return None
    latitude, longitude = _int(block, 31) / 1e5, _int(block, 35) / 1e5
    if block[30:31] == b"V":
        return FreeGps((Sample(),), "assumed")
    speed_mps = _int(block, 43) * MPS_PER_KMH
    return FreeGps(
        (Sample(speed_mps=speed_mps, latitude_deg=degrees(latitude), longitude_deg=degrees(longitude)),), "assumed"
    )


def _xor_text(block: bytes) -> FreeGps | None:
    """Azdome and EEEkit: text under the mask 0xAA from 0x12; km/h."""
    if block[18:26] != b"\xaa\xaa\xf2\xe1\xf0\xee\x54\x54":
        return None
    text = bytes(byte ^ 0xAA for byte in block[18:0x113])
    match = re.match(
        rb".{8}(\d{4})(\d\d)(\d\d)(\d\d)(\d\d)(\d\d).{16}([NS])(\d{8})([EW])(\d{9})(\d{8})?", text, re.DOTALL
    )
    if not match:
        return FreeGps((Sample(),))
    utc_s = date_s(*(int(match[i]) for i in range(1, 7)))
    speed = match[11]
    if speed is None:
        later = re.match(rb".{57}[-+]\d{4}(\d{3})", text, re.DOTALL)
        speed = later[1] if later else None
    kmh = float(speed) if speed else math.nan
    north, east = degrees(int(match[8]) / 1e4, match[7].decode()), degrees(int(match[10]) / 1e4, match[9].decode())
    return _one(utc_s, True, kmh * MPS_PER_KMH, math.nan, north, east)


def _atc(block: bytes) -> FreeGps | None:
    """Ring buffer of the last 30 seconds, records of 52 bytes from 0x30 that hold their own keys; the newest counts."""
    if block[0x45:0x48] != b"ATC":
        return None
    samples = []
    for start in range(0x30, min(len(block), 0x30 + 64 * 52) - 52, 52):
        record = bytearray(block[start : start + 52])
        first, second = record[0x14], record[0x1C]
        for i in (*range(0x15), *range(0x18, 0x1C)):
            record[i] ^= first
        for i in (0x1C, *range(0x20, 0x33)):
            record[i] ^= second
        hour, minute, secs = record[0x0D] + 1, record[0x0E], record[0x0F]
        year, month, day = struct.unpack_from("<HBB", record, 0x2C)
        utc_s = date_s(year, month, day, hour & 0xFF, minute, secs)
        latitude, longitude, speed = (struct.unpack_from("<i", record, place)[0] for place in (0x10, 0x18, 0x20))
        course_deg = struct.unpack_from("<h", record, 0x24)[0] / 100
        if math.isfinite(utc_s):
            samples.append(Sample(math.nan, utc_s, speed / 100, course_deg, latitude / 1e7, longitude / 1e7))
    return FreeGps((max(samples, key=lambda sample: sample.utc_s),)) if samples else None


def _nextbase(block: bytes) -> FreeGps | None:
    """Nextbase 512G: big-endian records of 32 bytes from 0x30, ten per second; cm/s."""
    if block[0x30:0x32] != b"$S":
        return None
    samples = []
    for start in range(0x30, min(len(block), 0x30 + 64 * 32) - 31, 32):
        speed, course, year, month, day, hour, minute, tenths = struct.unpack_from(">HhHBBBBH", block, start + 2)
        latitude, longitude = struct.unpack_from(">ii", block, start + 0x0F)
        utc_s = date_s(year, month, day, hour, minute, tenths / 10)
        if year < 2000 or not math.isfinite(utc_s):
            break
        samples.append(Sample(math.nan, utc_s, speed / 100, course / 100 % 360, latitude / 1e7, longitude / 1e7))
    return FreeGps(tuple(samples)) if samples else None


def _ligo(block: bytes) -> FreeGps | None:
    """LIGOGPSINFO records at 0x10, 0x30 or 0x50, or their text alone."""
    for start in (0x10, 0x30, 0x50):
        if block[start : start + 12] == b"LIGOGPSINFO\0":
            sample = parse_ligo_record(block[start + 0x14 : start + 0x98])
            return FreeGps((sample or Sample(),))
    sample = parse_ligo_text(block[0x10:0xA0])
    return FreeGps((sample,), "assumed") if sample else None


_LAYOUTS: tuple[Callable[[bytes], FreeGps | None], ...] = (
    _xor_text,
    _ligo,
    _short,
    _spread,
    _spread_doubles,
    _atc,
    _long,
    _vantrue_s1,
    _innovv,
    _seventymai,
    _nextbase,
)
"""Readers of the layouts, the most specific first."""
