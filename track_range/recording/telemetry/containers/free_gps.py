"""Records of dashcams with Novatek and related chips, `freeGPS `: many layouts, which differ in
fixed characters.

Layouts and units as ExifTool's documentation of QuickTime streams lists them (exiftool.org), and as
sergei.nz/extracting-gps-data-from-viofo-a119-and-other-novatek-powered-cameras describes the first
layout. Offsets count from the start of the box: 4 bytes of size, `freeGPS `, 4 bytes of length,
then the record. Integers and floating-point numbers are little-endian; coordinates are degrees and
minutes (DDMM.MMMM); speeds are in knots unless stated. Coordinates that a maker encrypts or shifts
are still passed on; only speed and course matter.
"""

import math
import re
import struct
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from track_range.recording.telemetry.containers.ligogps import parse_ligo_record, parse_ligo_text
from track_range.recording.telemetry.tracks.positions import MPS_PER_UNIT
from track_range.recording.telemetry.tracks.samples import Sample, Unit, date_s, degrees, signed

MAX_BLOCK_BYTES = 4096  # bytes of a box that are read; boxes have up to 32 kB, most of them empty
_PADDED_BYTES = 0x140  # smallest size of the blocks that layouts read: fields beyond the end are 0


class FreeGps(NamedTuple):
    """Content of one box."""

    # in the order of the record, without time in the video; a void record has one without speed
    samples: tuple[Sample, ...]
    # what is known of the unit of the speed, which is read as km/h unless it is known
    unit: Unit = "known"


def parse_free_gps(block: bytes) -> FreeGps | None:
    """Content of a box; None = the layout is unknown. Records with RMC sentences are read
    elsewhere.
    """
    padded = block.ljust(_PADDED_BYTES, b"\0")
    return next((content for layout in _LAYOUTS if (content := layout(padded)) is not None), None)


_MARKS = re.compile(rb"[A\0][NS][EW]|V[^A-MO-RT-Z].", re.DOTALL)
_SPREAD_MARKS = re.compile(rb"[AV]\0{3}.{8}[NS]\0{3}.{12}[EW]\0{3}", re.DOTALL)
_AKASO_MARKS = re.compile(rb"[AV]\0{3}.{4}[NS]\0{3}.{4}[EW]\0{3}", re.DOTALL)
"""Flags of validity and hemispheres."""


class _Layout(NamedTuple):
    """Offsets of the fields of a record."""

    clock: int  # hour, minute and second, integers of 4 bytes
    date: int  # year, month and day
    # A = valid, V = void, or 0 with hemispheres, a byte that some firmwares do not fill in
    status: int
    north: int  # N or S
    east: int  # E or W
    latitude: int  # 0 = encrypted, as for longitude and speed
    longitude: int
    speed: int
    course: int  # 0 = none
    number: str = "f"  # type of the four numbers, "f" or "d"
    marks: re.Pattern[bytes] = _MARKS  # of the characters from `status` on
    # whether the date must be valid; numbers are then little- or big-endian, of which one has a
    # valid date
    is_dated: bool = True
    unit: Unit = "known"  # of the speed
    mps: float = MPS_PER_UNIT["kn"]
    reversal: bytes = b""  # characters at 0x10 of cameras that state the opposite course
    is_like: Callable[[bytes], object] = bool  # further condition


def _compact(start: int) -> _Layout:
    """The first layout: clock, date, flags, then latitude, longitude, speed and course."""
    return _Layout(
        start,
        start + 12,
        start + 24,
        start + 25,
        start + 26,
        start + 28,
        start + 32,
        start + 36,
        start + 40,
    )


def _text_compact(start: int) -> _Layout:
    """E-ACE B44: encrypted coordinates as text, base64, before the speed."""

    def is_like(block: bytes) -> bool:
        texts = block[start + 28 : start + 48], block[start + 48 : start + 68]
        return all(re.fullmatch(rb"[A-Za-z0-9+/.]{6,20}={0,2}\0*", text) for text in texts)

    compact = _compact(start)
    return compact._replace(
        latitude=0, longitude=0, speed=start + 68, course=start + 72, is_like=is_like
    )


def _spread_doubles(start: int) -> _Layout:
    """Flags as separate words, and numbers of 8 bytes."""
    return _Layout(
        clock=start, date=start + 0x40, status=start + 0x0C, north=start + 0x18, east=start + 0x28,
        latitude=start + 0x10, longitude=start + 0x20, speed=start + 0x30, course=start + 0x38,
        number="d", marks=_SPREAD_MARKS, is_dated=False,
    )  # fmt: skip


_AKASO = _Layout(  # flags as separate words, and the hemispheres after each coordinate
    clock=0x30, date=0x58, status=0x3C, north=0x44, east=0x4C, latitude=0x40, longitude=0x48, speed=0x50, course=0x54,
    marks=_AKASO_MARKS, is_dated=False, unit="assumed", mps=MPS_PER_UNIT["km/h"],
    reversal=b"x.xx", is_like=lambda block: _is_clock(*struct.unpack_from("<3I", block, 0x30)),
)  # fmt: skip

_VANTRUE_S1 = _Layout(
    clock=0x50,
    date=0x44,
    status=0x40,
    north=0x41,
    east=0x42,
    latitude=0x60,
    longitude=0x5C,
    speed=0x64,
    course=0x68,
)
_ENCRYPTED = _compact(0x30)._replace(  # Akaso V1 and Redtiger
    latitude=0, longitude=0, speed=0x60, course=0, unit="unknown", mps=MPS_PER_UNIT["km/h"],
    is_like=lambda block: block[0x48:0x49] != b"V" and block[0x4B:0x50] == bytes(5) and any(block[0x50:0x60]),
)  # fmt: skip


def _fixed(layout: _Layout, block: bytes) -> FreeGps | None:
    order = _byte_order(layout, block)
    marks = layout.marks.match(block, layout.status)
    if order is None or not marks or not layout.is_like(block):
        return None

    def numbers(form: str, offset: int) -> tuple[float, ...]:
        return struct.unpack_from(f"{order}{form}", block, offset)

    utc_s = date_s(*numbers("3I", layout.date), *numbers("3I", layout.clock))
    if block[layout.status : layout.status + 1] == b"V":
        return FreeGps((Sample(utc_s=utc_s),), layout.unit)
    latitude_deg = longitude_deg = course_deg = math.nan
    if layout.latitude:
        (latitude,), (longitude,) = (
            numbers(layout.number, layout.latitude),
            numbers(layout.number, layout.longitude),
        )
        if layout.number == "d":
            latitude, longitude = abs(latitude), abs(longitude)
        latitude_deg = degrees(latitude, chr(block[layout.north]))
        longitude_deg = degrees(longitude, chr(block[layout.east]))
    if layout.course:
        (course_deg,) = numbers(layout.number, layout.course)
        if layout.reversal:
            course_deg = (course_deg + 180 * (block[0x10:0x14] == layout.reversal)) % 360
    speed_mps = numbers(layout.number, layout.speed)[0] * layout.mps
    return FreeGps(
        (Sample(math.nan, utc_s, speed_mps, course_deg, latitude_deg, longitude_deg),), layout.unit
    )


def _byte_order(layout: _Layout, block: bytes) -> str | None:
    """The order in which clock and date are valid; None = in neither."""
    for order in "<>" if layout.is_dated else ():
        year, month, day = struct.unpack_from(f"{order}3I", block, layout.date)
        is_date = 1 <= month <= 12 and 1 <= day <= 31 and year < 2200
        if is_date and _is_clock(*struct.unpack_from(f"{order}3I", block, layout.clock)):
            return order
    return None if layout.is_dated else "<"


def _is_clock(hour: int, minute: int, second: int) -> bool:
    return hour < 24 and minute < 60 and second < 61


def _integers(block: bytes) -> FreeGps | None:
    """Viofo A119S with the mark "IQS": coordinates of 1e-7 degrees and a speed in cm/s, without
    course.
    """
    plain = _fixed(_compact(0x30), block) if block[0x10:0x13] == b"IQS" else None
    if plain is None or block[0x48:0x49] == b"V":
        return plain
    latitude, longitude, speed = struct.unpack_from("<3i", block, 0x4C)
    north, east = (
        signed(abs(latitude / 1e7), chr(block[0x49])),
        signed(abs(longitude / 1e7), chr(block[0x4A])),
    )
    return FreeGps((Sample(math.nan, plain.samples[0].utc_s, speed / 100, math.nan, north, east),))


def _innovv(block: bytes) -> FreeGps | None:
    """INNOVV: records of 32 bytes from 0x10 with flags and floating-point numbers, without date."""
    if not re.match(rb".{16}A[NS][EW]\0", block, re.DOTALL):
        return None
    samples = []
    for match in re.finditer(rb"A([NS])([EW])\0(.{28})", block, re.DOTALL):
        latitude, longitude, knots, course_deg = struct.unpack_from("<4f", match[3])
        north, east = (
            degrees(abs(latitude), match[1].decode()),
            degrees(abs(longitude), match[2].decode()),
        )
        samples.append(
            Sample(math.nan, math.nan, knots * MPS_PER_UNIT["kn"], course_deg, north, east)
        )
    return FreeGps(tuple(samples))


def _seventymai(block: bytes) -> FreeGps | None:
    """70mai A810: status at 0x1E, then coordinates (DDMM.MMMMM as integers) and the speed in km/h;
    no date.
    """
    if not re.match(rb".{16}\x03\0.{12}[AV].{20}[AV][AV]", block, re.DOTALL):
        return None
    if block[30:31] == b"V":
        return FreeGps((Sample(),), "assumed")
    latitude, longitude, _, kmh = struct.unpack_from("<4i", block, 31)
    position_deg = degrees(latitude / 1e5), degrees(longitude / 1e5)
    return FreeGps(
        (Sample(math.nan, math.nan, kmh * MPS_PER_UNIT["km/h"], math.nan, *position_deg),),
        "assumed",
    )


def _xor_text(block: bytes) -> FreeGps | None:
    """Azdome and EEEkit: text under the mask 0xAA from 0x12; km/h."""
    if block[18:26] != b"\xaa\xaa\xf2\xe1\xf0\xee\x54\x54":
        return None
    text = bytes(byte ^ 0xAA for byte in block[18:0x113])
    match = re.match(
        rb".{8}(\d{4})(\d\d)(\d\d)(\d\d)(\d\d)(\d\d).{16}([NS])(\d{8})([EW])(\d{9})(\d{8})?",
        text,
        re.DOTALL,
    )
    if not match:
        return FreeGps((Sample(),))
    speed = match[11]
    if speed is None:
        later = re.match(rb".{57}[-+]\d{4}(\d{3})", text, re.DOTALL)
        speed = later[1] if later else b"nan"
    north, east = (
        degrees(int(match[8]) / 1e4, match[7].decode()),
        degrees(int(match[10]) / 1e4, match[9].decode()),
    )
    utc_s = date_s(*(int(match[i]) for i in range(1, 7)))
    return FreeGps(
        (Sample(math.nan, utc_s, float(speed) * MPS_PER_UNIT["km/h"], math.nan, north, east),)
    )


def _atc(block: bytes) -> FreeGps | None:
    """Ring buffer of the last 30 seconds, records of 52 bytes from 0x30 that hold their own keys;
    the newest counts.
    """
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
        latitude, longitude, speed = (
            struct.unpack_from("<i", record, at)[0] for at in (0x10, 0x18, 0x20)
        )
        course_deg = struct.unpack_from("<h", record, 0x24)[0] / 100
        if math.isfinite(utc_s):
            samples.append(
                Sample(math.nan, utc_s, speed / 100, course_deg, latitude / 1e7, longitude / 1e7)
            )
    return FreeGps((max(samples, key=lambda sample: sample.utc_s),)) if samples else None


def _nextbase(block: bytes) -> FreeGps | None:
    """Nextbase 512G: big-endian records of 32 bytes from 0x30, ten per second; cm/s."""
    if block[0x30:0x32] != b"$S":
        return None
    samples = []
    for start in range(0x30, min(len(block), 0x30 + 64 * 32) - 31, 32):
        speed, course, year, month, day, hour, minute, tenths = struct.unpack_from(
            ">HhHBBBBH", block, start + 2
        )
        latitude, longitude = struct.unpack_from(">ii", block, start + 0x0F)
        utc_s = date_s(year, month, day, hour, minute, tenths / 10)
        if year < 2000 or not math.isfinite(utc_s):
            break
        samples.append(
            Sample(
                math.nan, utc_s, speed / 100, course / 100 % 360, latitude / 1e7, longitude / 1e7
            )
        )
    return FreeGps(tuple(samples)) if samples else None


def _ligo(block: bytes) -> FreeGps | None:
    """LIGOGPSINFO records at 0x10, 0x30 or 0x50, or their text alone."""
    for start in (0x10, 0x30, 0x50):
        if block[start : start + 12] == b"LIGOGPSINFO\0":
            return FreeGps((parse_ligo_record(block[start + 0x14 : start + 0x98]) or Sample(),))
    sample = parse_ligo_text(block[0x10:0xA0])
    return FreeGps((sample,), "assumed") if sample else None


_LAYOUTS: tuple[Callable[[bytes], FreeGps | None], ...] = (  # the most specific first
    _xor_text,
    _ligo,
    partial(_fixed, _text_compact(0x10)),
    partial(_fixed, _compact(0x10)),  # Viofo A119V3 and relatives
    partial(_fixed, _text_compact(0x40)),
    partial(_fixed, _compact(0x40)),  # Kenwood
    partial(_fixed, _AKASO),
    partial(_fixed, _spread_doubles(0x30)),
    partial(_fixed, _spread_doubles(0x10)),  # Vantrue N4
    _atc,
    _integers,
    partial(_fixed, _ENCRYPTED),
    partial(_fixed, _compact(0x30)),  # Viofo A119S and most Novatek
    partial(_fixed, _VANTRUE_S1),
    _innovv,
    _seventymai,
    _nextbase,
)
