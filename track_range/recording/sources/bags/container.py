"""Bag: messages by topic in files of the formats MCAP, ROS 2 (SQLite) and ROS 1, and the common
parts of their readers.

rosbags' AnyReader refuses MCAP files with Foxglove's messages, files that are cut off and unusual
suffixes, and it does not see the journal that a killed recorder leaves. So each format has one
reader here, for whole and for cut files.
"""

import bz2
import sqlite3
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn, Protocol

from track_range.foundation.files.input_files import shortened
from track_range.recording.video.frame import VideoError

EXPECTED = "an MCAP file or ROS bag"

# size limit of a record, bytes; chunks have 1 to 10 MB, the largest raw image 200 MB
MAX_RECORD_BYTES = 2**29

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


class DamagedError(ValueError):
    """A record cannot be read; the text gives the reason."""


DAMAGE = (  # errors of readers and decompressors in damaged files
    *(
        ArithmeticError,
        AttributeError,
        EOFError,
        LookupError,
        MemoryError,
        OSError,
        RuntimeError,
        TypeError,
    ),
    *(ValueError, struct.error, sqlite3.DatabaseError),
)


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a bag, such as /camera/image."""

    name: str
    type: str  # type of its messages as ROS 2 writes it, such as sensor_msgs/msg/Image, or foxglove.CompressedImage
    encoding: str  # cdr, ros1, protobuf or json
    definition: bytes  # schema of the messages
    n_messages: int | None  # None = unknown


class Bag(Protocol):
    """One file, `path`, with messages, and its topics by name."""

    path: Path
    topics: dict[str, Topic]

    @property
    def end_problem(self) -> str:
        """Reason why reading ended early; empty = it did not."""

    @property
    def n_damaged(self) -> int:
        """Number of damaged parts that were skipped."""

    def messages(self, topic: str, from_s: float) -> Iterator[tuple[int, float, bytes]]:
        """Number, from 0, time of recording in s, and content of the messages of a topic in the
        order of the file.

        Messages before the first one at `from_s` or later may be left out, but are counted.
        """


def ros2_type(name: str) -> str:
    """Name of a message type as ROS 2 writes it, printable: sensor_msgs/Image ->
    sensor_msgs/msg/Image.
    """
    name = shortened(name, 100)
    package, _, short = name.partition("/")
    return f"{package}/msg/{short}" if short and "/" not in short else name


def decompressed(data: bytes, compression: str, n_bytes: int) -> bytes:
    """Content of a chunk compressed with bz2, lz4, zstd or not ("", none), of which `n_bytes` are
    announced.

    Raises DamagedError if the compression is unknown or the size differs, and VideoError if a
    library is missing.
    """
    if n_bytes > MAX_RECORD_BYTES:
        raise DamagedError("chunk too large")
    content = data
    if compression == "bz2":
        content = bz2.BZ2Decompressor().decompress(data, max_length=n_bytes + 1)
    elif compression == "lz4":
        content = (
            library("lz4.frame").LZ4FrameDecompressor().decompress(data, max_length=n_bytes + 1)
        )
    elif compression == "zstd":
        zstandard = library("zstandard")
        try:
            content = zstandard.ZstdDecompressor().stream_reader(data).read(n_bytes + 1)
        except zstandard.ZstdError as error:
            raise DamagedError("compressed chunk") from error
    elif compression not in ("", "none"):
        raise DamagedError(f"unknown compression {compression[:20]}")
    if len(content) != n_bytes:
        raise DamagedError("size of a chunk")
    return content


def library(name: str) -> Any:
    """A module of the extra [mcap]; raises VideoError if it is not installed."""
    try:
        return import_module(name)
    except ImportError as error:
        missing_library(error)


def missing_library(error: ImportError) -> NoReturn:
    """Raise the VideoError for a package of the extra that is not installed."""
    raise VideoError(
        f"MCAP files and ROS bags require the package {error.name}: install it with pip install "
        "'track-range[mcap]'."
    ) from error
