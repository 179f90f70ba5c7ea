"""Reading of image files: the size is read from the header, and limited, before the image is
decoded.

A compressed file of a few kilobytes can announce an image that takes gigabytes.
"""

import io
import os
import re
import struct
from pathlib import Path
from typing import Any, BinaryIO

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.files.input_files import open_regular

# in lower case
IMAGE_SUFFIXES = frozenset(
    {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm"}
)
# largest width and height of an image; the widest panoramic cameras have about 12,000 px
MAX_SIDE_PX = 16_384
# largest number of pixels of an image: 8192x8192, of which 8-bit BGR takes 200 MB
MAX_PIXELS = 2**26
# stored bytes per pixel; of metadata, thumbnails and films
_MAX_PIXEL_BYTES, _MAX_EXTRA_BYTES = 16, 2**26
# segments or tags until the size, bytes between segments
_MAX_HEADER_FIELDS, _MAX_SKIPPED_BYTES = 4096, 65_536
_PNG_START = b"\x89PNG\r\n\x1a\n"

_JPEG_SIZES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # start-of-frame markers
# of a progressive JPEG file, about 12 in practice; a scan of 100 bytes may take 0.6 s
_MAX_SCANS = 64

_JPEG_START = b"\xff\xd8"
_JPEG_END, _JPEG_SCAN = 0xD9, 0xDA
# a segment; not between the bytes of pixels
_JPEG_MARKER = re.compile(rb"\xff([^\x00\x01\xd0-\xd7\xff])")
_JPEG_BARE = frozenset({0x01, *range(0xD0, 0xD8)})  # markers without a length
# tags of image and tiles; 2-byte integers
_TIFF_WIDTHS, _TIFF_HEIGHTS, _TIFF_SHORT = (256, 322), (257, 323), 3
_PNM_SIZE = re.compile(rb"P[1-6](?:\s|#[^\n]*\n)+(\d{1,10})(?:\s|#[^\n]*\n)+(\d{1,10})\s")


def read_image(
    path: Path, error: type[Exception], expected: str = "an image", *, flags: int = cv2.IMREAD_COLOR
) -> npt.NDArray[Any]:
    """The image of a PNG, JPEG, BMP, TIFF, WebP or PNM file, decoded by OpenCV with its `flags`.

    The flags determine the number of channels and the type; `expected` is the noun phrase for the
    file in messages. Raises `error` if it cannot be read, is not a regular file, is damaged or of
    an unknown format, or is too large.
    """
    with open_regular(path, error, expected) as file:
        try:
            size_px = header_size_px(file)
            n_bytes = file.seek(0, os.SEEK_END)
            if size_px is None or 0 in size_px:
                content = (
                    "a file of another format, or a damaged file"
                    if n_bytes
                    else "an empty or damaged file"
                )
                raise error(
                    f"{path}: expected {expected} (PNG, JPEG, BMP, TIFF, WebP, PGM or "
                    f"PPM), found {content}."
                )
            check_size(path, size_px, error)
            max_bytes = _MAX_PIXEL_BYTES * size_px[0] * size_px[1] + _MAX_EXTRA_BYTES
            if n_bytes > max_bytes:
                raise error(
                    f"{path}: expected at most {max_bytes / 1e6:.0f} MB for "
                    f"{size_px[0]}x{size_px[1]} px, found {n_bytes / 1e6:.0f} MB; the file is "
                    "damaged."
                )
            file.seek(0)
            stored = file.read(n_bytes)
        except OSError as reason:
            raise error(
                f"{path}: cannot be read ({reason.strerror or reason}); expected {expected}."
            ) from reason
    return _decoded(stored, path, error, expected, flags)


def decode_image(
    stored: bytes, source: object, error: type[Exception], *, flags: int
) -> npt.NDArray[Any]:
    """The image of a file in memory, see `read_image`; raises `error`, which names `source`, if it
    is unusable.
    """
    size_px = header_size_px(io.BytesIO(stored))
    if size_px is None or 0 in size_px:
        raise error(
            f"{source}: expected an image (PNG or JPEG), found another format or damaged data."
        )
    check_size(source, size_px, error)
    return _decoded(stored, source, error, "an image", flags)


def _decoded(
    stored: bytes, path: object, error: type[Exception], expected: str, flags: int
) -> npt.NDArray[Any]:
    if stored.startswith(_JPEG_START) and _n_scans(stored) > _MAX_SCANS:
        raise error(
            f"{path}: expected a JPEG file of at most {_MAX_SCANS} scans, found more; save "
            "it again."
        )
    try:
        is_cut = not stored or (stored.startswith(_PNG_START) and not _is_complete_png(stored))
        image = None if is_cut else cv2.imdecode(np.frombuffer(stored, np.uint8), flags)
    except cv2.error:  # inconsistent sizes, and formats that this build cannot decode
        image = None
    if image is None:
        raise error(
            f"{path}: expected {expected}, found a damaged or truncated image; replace or "
            "delete it."
        )
    return np.asarray(image)


def check_size(path: object, size_px: tuple[int, int], error: type[Exception]) -> None:
    """Raise `error` if the width and height that a file announces exceed the limits."""
    width_px, height_px = size_px
    if max(size_px) > MAX_SIDE_PX or width_px * height_px > MAX_PIXELS:
        raise error(
            f"{path}: expected images of at most {MAX_SIDE_PX} px a side and {MAX_PIXELS // 10**6} "
            f"megapixels, found {width_px}x{height_px} px; scale them down."
        )


def header_size_px(file: BinaryIO) -> tuple[int, int] | None:
    """Width and height from the header of an image file, without decoding; None = no image of a
    known format.

    For tiled TIFF files, at least the size of a tile, since a decoder allocates whole tiles. May
    raise OSError.
    """
    file.seek(0)
    start = file.read(1024)
    try:
        if start.startswith(_PNG_START):
            return _pair(">II", start, 16) if start[12:16] == b"IHDR" else None
        if start.startswith(_JPEG_START):
            return _jpeg_size_px(file)
        if start.startswith(b"BM"):
            (n_header,) = struct.unpack_from("<I", start, 14)
            width_px, height_px = (
                _pair("<HH", start, 18) if n_header == 12 else _pair("<ii", start, 18)
            )
            return abs(width_px), abs(height_px)  # rows from the top have a negative height
        if start[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
            return _tiff_size_px(
                file, "<" if start[:2] == b"II" else ">", is_big=b"+" in start[2:4]
            )
        if start[:4] == b"RIFF" and start[8:12] == b"WEBP":
            return _webp_size_px(start)
    except struct.error:  # truncated
        return None
    match = _PNM_SIZE.match(start)
    return None if match is None else (int(match[1]), int(match[2]))


def _pair(layout: str, content: bytes, offset: int) -> tuple[int, int]:
    first, second = struct.unpack_from(layout, content, offset)
    return first, second


def _jpeg_size_px(file: BinaryIO) -> tuple[int, int] | None:
    file.seek(2)
    for _ in range(_MAX_HEADER_FIELDS):
        byte, is_marker, n_read = file.read(1), False, 1
        while byte and (byte == b"\xff" or not is_marker):  # decoders skip bytes between segments
            is_marker = byte == b"\xff"
            byte, n_read = file.read(1), n_read + 1
            if n_read > _MAX_SKIPPED_BYTES:
                return None
        if not byte:
            return None
        if byte[0] in _JPEG_BARE:
            continue
        (n_bytes,) = struct.unpack(">H", file.read(2))
        if byte[0] in _JPEG_SIZES:
            height_px, width_px = _pair(">HH", file.read(5), 1)
            return width_px, height_px
        file.seek(max(0, n_bytes - 2), os.SEEK_CUR)
    return None


def _is_complete_png(png: bytes) -> bool:
    """Whether a PNG file contains all its chunks; OpenCV takes seconds and gigabytes to refuse a
    chunk of 2 GB.
    """
    at = len(_PNG_START)
    while at + 12 <= len(png):
        chunk_type = png[at + 4 : at + 8]
        at += 12 + int.from_bytes(png[at : at + 4], "big")  # length, type, data, checksum
        if chunk_type == b"IEND":
            return at <= len(png)
    return False


def _n_scans(jpeg: bytes) -> int:
    """Number of scans of a JPEG file, counted up to the first scan above the limit."""
    at = n_scans = 0
    for _ in range(_MAX_HEADER_FIELDS):
        segment = _JPEG_MARKER.search(jpeg, max(at, len(_JPEG_START)))
        if segment is None or segment[1][0] == _JPEG_END or n_scans > _MAX_SCANS:
            return n_scans
        n_scans += segment[1][0] == _JPEG_SCAN
        at = segment.end() + max(2, int.from_bytes(jpeg[segment.end() : segment.end() + 2], "big"))
    return _MAX_SCANS + 1


def _tiff_size_px(file: BinaryIO, order: str, *, is_big: bool) -> tuple[int, int] | None:
    n_offset, offset_type, count_type, n_tag = (8, "Q", "Q", 20) if is_big else (4, "I", "H", 12)
    file.seek(8 if is_big else 4)
    (offset,) = struct.unpack(order + offset_type, file.read(n_offset))
    if offset >= 2**62:
        return None
    file.seek(offset)
    (n_tags,) = struct.unpack(order + count_type, file.read(struct.calcsize(order + count_type)))
    sizes = dict.fromkeys((*_TIFF_WIDTHS, *_TIFF_HEIGHTS), 0)
    for _ in range(min(n_tags, _MAX_HEADER_FIELDS)):
        field = file.read(n_tag)
        tag, type_number = struct.unpack_from(order + "HH", field)
        if tag in sizes:
            (value,) = struct.unpack_from(
                order + ("H" if type_number == _TIFF_SHORT else "I"), field, n_tag - n_offset
            )
            sizes[tag] = max(sizes[tag], value)
    if not (sizes[_TIFF_WIDTHS[0]] and sizes[_TIFF_HEIGHTS[0]]):
        return None
    return max(sizes[tag] for tag in _TIFF_WIDTHS), max(sizes[tag] for tag in _TIFF_HEIGHTS)


def _webp_size_px(start: bytes) -> tuple[int, int] | None:
    chunk_type = start[12:16]
    if chunk_type == b"VP8X":
        width, height = (int.from_bytes(start[at : at + 3], "little") for at in (24, 27))
        return width + 1, height + 1
    if chunk_type == b"VP8L":
        (bits,) = struct.unpack_from("<I", start, 21)
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if chunk_type == b"VP8 ":
        width, height = _pair("<HH", start, 26)
        return width & 0x3FFF, height & 0x3FFF
    return None
