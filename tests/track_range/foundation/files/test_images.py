"""Images: sizes from headers of all formats, limits before decoding, and files that are no
images."""

from __future__ import annotations

import io
import os
import resource
import struct
import sys
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.foundation.errors import UserError
from track_range.foundation.files.images import MAX_SIDE_PX, header_size_px, read_image

IMAGE = np.arange(5 * 7 * 3, dtype=np.uint8).reshape(5, 7, 3)

FORMATS: dict[str, tuple[str, list[int]]] = {
    "png": (".png", []),
    "jpeg": (".jpg", []),
    "progressive jpeg": (".jpg", [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]),
    "bmp": (".bmp", []),
    "tiff": (".tif", []),
    "lossy webp": (".webp", [cv2.IMWRITE_WEBP_QUALITY, 80]),
    "lossless webp": (".webp", [cv2.IMWRITE_WEBP_QUALITY, 101]),
    "pgm": (".pgm", []),
    "ppm": (".ppm", []),
    "text ppm": (".ppm", [cv2.IMWRITE_PXM_BINARY, 0]),
}


def encoded(kind: str, image: np.ndarray = IMAGE) -> bytes:
    suffix, options = FORMATS[kind]
    return cv2.imencode(suffix, image if suffix != ".pgm" else image[..., 0], options)[1].tobytes()


def png(width_px: int, height_px: int) -> bytes:
    """A PNG file of 130 kB that announces a size, and contains a part of its rows."""
    header = struct.pack(">IIBBBBB", width_px, height_px, 8, 2, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(bytes(2**27), 1)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )


def tiff(**changed: int) -> bytes:
    """A TIFF file with 32-bit width and height, and no pixels; `order`, `width`, `height`,
    `tile_width`."""
    values = {"width": 7, "height": 5} | changed
    numbers = {"width": 256, "height": 257, "tile_width": 322, "tile_height": 323}
    tags = b"".join(
        struct.pack(">HHII", numbers[name], 4, 1, value) for name, value in values.items()
    )
    return b"MM\0*" + struct.pack(">IH", 8, len(values)) + tags + bytes(4)


@pytest.mark.parametrize("kind", FORMATS)
def test_size_from_the_header(kind: str) -> None:
    assert header_size_px(io.BytesIO(encoded(kind))) == (7, 5)


def test_size_after_metadata() -> None:
    jpeg, segment = encoded("jpeg"), b"\xff\xe1\xff\xff" + bytes(65533)
    assert header_size_px(io.BytesIO(jpeg[:2] + 20 * segment + jpeg[2:])) == (7, 5)
    assert header_size_px(io.BytesIO(b"P5 # comment\n#another\n 7 5 255\n")) == (7, 5)
    assert header_size_px(io.BytesIO(b"RIFF    WEBPVP8X" + bytes(8) + b"\6\0\0\4\0\0")) == (7, 5)
    assert header_size_px(io.BytesIO(tiff())) == (7, 5)
    assert header_size_px(io.BytesIO(tiff(tile_width=2**31))) == (2**31, 5)


@pytest.mark.parametrize(
    "content", [b"", b"text", b"P5", b"\xff\xd8" + bytes(200_000), b"BM", b"GIF89a\7\0\5\0"]
)
def test_no_size(content: bytes) -> None:
    assert header_size_px(io.BytesIO(content)) is None


@settings(max_examples=50, deadline=None)
@given(
    kind=st.sampled_from(list(FORMATS)),
    at=st.integers(0, 400),
    junk=st.binary(max_size=8),
    is_cut=st.booleans(),
)
def test_damaged_images(
    tmp_path_factory: pytest.TempPathFactory, kind: str, at: int, junk: bytes, is_cut: bool
) -> None:
    path, content = tmp_path_factory.getbasetemp() / "damaged.png", encoded(kind)
    at %= len(content)
    path.write_bytes(content[:at] + junk + (b"" if is_cut else content[at + len(junk) :]))
    try:
        image = read_image(path, UserError)
    except UserError as error:
        message = str(error)
        is_sentence = message.startswith(f"{path}: ") and len(message) < 300 + len(str(path))
        assert is_sentence, message
    else:
        assert image.ndim == 3


@pytest.mark.parametrize(
    "content",
    [
        png(30_000, 30_000),
        png(2**31 - 1, 1),
        png(MAX_SIDE_PX, MAX_SIDE_PX),
        tiff(width=60_000, height=60_000),
        b"P6 65535 65535 255\n",
        b"BM" + struct.pack("<12xIii", 40, 65_000, -65_000) + bytes(40),
    ],
    ids=["png", "wide", "largest", "tiff", "ppm", "bmp"],
)
def test_too_large_images_are_not_decoded(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bomb.png"
    path.write_bytes(content)
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(UserError, match=r"bomb\.png: .*megapixels"):
        read_image(path, UserError)
    if sys.platform == "linux":
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 50_000


def test_pipes_folders_and_loops(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "loop.png").symlink_to("loop.png")
    (tmp_path / "zero.png").symlink_to("/dev/zero")
    for name, word in (
        ("pipe", "pipe"),
        ("folder", "folder"),
        ("loop", "loop"),
        ("zero", "device"),
        ("no", "no such"),
    ):
        with pytest.raises(UserError, match=rf"{name}\.png: .*{word}"):
            read_image(tmp_path / f"{name}.png", UserError)


def test_png_with_an_endless_chunk(tmp_path: Path) -> None:
    path, content = tmp_path / "chunk.png", bytearray(encoded("png"))
    at = content.index(b"IDAT")
    content[at - 4 : at] = struct.pack(">I", 2**31 - 1)
    path.write_bytes(content)
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(UserError, match=r"chunk\.png: .*damaged"):
        read_image(path, UserError)
    if sys.platform == "linux":
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 50_000


def test_jpeg_with_many_scans(tmp_path: Path) -> None:
    path, jpeg = tmp_path / "slow.jpg", encoded("progressive jpeg")
    path.write_bytes(jpeg)
    assert read_image(path, UserError).shape == IMAGE.shape
    last_scan = jpeg[jpeg.rindex(b"\xff\xda") : -2]
    path.write_bytes(jpeg[:-2] + 100 * last_scan + jpeg[-2:])
    with pytest.raises(UserError, match=r"slow\.jpg: .*scans"):
        read_image(path, UserError)


def test_file_too_long_for_its_image(tmp_path: Path) -> None:
    path = tmp_path / "long.png"
    path.write_bytes(encoded("png"))
    os.truncate(path, 10**9)  # sparse
    with pytest.raises(UserError, match=r"long\.png: .*MB"):
        read_image(path, UserError)
