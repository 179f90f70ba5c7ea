"""Ros1File: messages of a ROS 1 bag (#ROSBAG V2.0), read chunk by chunk; files without an index in
sequence.

record = length of header, header (name=value, ...), length of data, data

Format: http://wiki.ros.org/Bags/Format/2.0
"""

import io
import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

from track_range.foundation.files.input_files import open_regular
from track_range.recording.sources.bags import container
from track_range.recording.video.frame import VideoError

MAGIC = b"#ROSBAG V2.0\n"

_MESSAGE, _CHUNK, _CONNECTION = b"\x02", b"\x05", b"\x07"  # operation codes of records


class Ros1File:
    """Messages of a ROS 1 bag; see `Bag` for the attributes. Raises VideoError if it cannot be
    read.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.end_problem, self.n_damaged = path, "", 0
        self.topics: dict[str, container.Topic] = {}
        self._topic_of: dict[int, str] = {}
        # place, last time in s, messages by connection
        self._chunks: list[tuple[int, float, dict[int, int]]] = []
        with open_regular(path, VideoError, container.EXPECTED) as file:
            try:
                self._read_index(file)
            except container.DAMAGE:
                self._chunks = []
            if not self._chunks:
                self.topics, self._topic_of = {}, {}
                for _ in self._in_sequence(file, ""):
                    pass
                self.end_problem = ""  # reported when the messages are read

    def _read_index(self, file: BinaryIO) -> None:
        file.seek(len(MAGIC))
        header, _ = _record(file)
        file.seek(_number(header[b"index_pos"]))
        for _ in range(_number(header[b"conn_count"])):
            self._add_connection(*_record(file))
        counts = Counter[str]()
        for _ in range(_number(header[b"chunk_count"])):
            fields, data = _record(file)
            by_connection = dict(struct.iter_unpack("<II", data))
            self._chunks.append(
                (_number(fields[b"chunk_pos"]), _time_s(fields[b"end_time"]), by_connection)
            )
            for connection, n_messages in by_connection.items():
                counts[self._topic_of[connection]] += n_messages
        self.topics = {
            name: replace(topic, n_messages=counts[name]) for name, topic in self.topics.items()
        }
        self._chunks.sort(key=lambda chunk: chunk[0])

    def _add_connection(self, header: dict[bytes, bytes], data: bytes) -> None:
        if header[b"op"] != _CONNECTION:
            raise container.DamagedError("no connection")
        fields, name = _fields(data), header[b"topic"].decode()
        self._topic_of[_number(header[b"conn"])] = name
        type_name = container.ros2_type(fields[b"type"].decode())
        self.topics.setdefault(
            name,
            container.Topic(name, type_name, "ros1", fields.get(b"message_definition", b""), None),
        )

    def messages(self, topic: str, from_s: float) -> Iterator[tuple[int, float, bytes]]:
        """Number, time and content of the messages of a topic; see `Bag.messages`."""
        self.end_problem, self.n_damaged, number = "", 0, 0
        connections = {connection for connection, name in self._topic_of.items() if name == topic}
        with open_regular(self.path, VideoError, container.EXPECTED) as file:
            if not self._chunks:
                for number, (time_s, data) in enumerate(self._in_sequence(file, topic)):
                    yield number, time_s, data
                return
            is_late = False
            for offset, end_s, counts in self._chunks:
                n_messages = sum(counts.get(connection, 0) for connection in connections)
                is_late |= end_s >= from_s  # and so are all later chunks, if the clock is set back
                if not n_messages or not is_late:
                    number += n_messages
                    continue
                try:
                    file.seek(offset)
                    messages = list(self._messages_in(*_record(file), topic))
                except container.DAMAGE:
                    self.n_damaged += 1
                    number += n_messages
                    continue
                for time_s, data in messages:
                    yield number, time_s, data
                    number += 1

    def _messages_in(
        self, header: dict[bytes, bytes], data: bytes, topic: str
    ) -> Iterator[tuple[float, bytes]]:
        """Time and content of the messages of a topic in a chunk; connections are collected."""
        content = container.decompressed(
            data, header[b"compression"].decode(), _number(header[b"size"])
        )
        records = io.BytesIO(content)
        while records.seek(0, io.SEEK_CUR) < len(content):
            fields, data = _record(records)
            if fields[b"op"] == _CONNECTION:
                self._add_connection(fields, data)
            elif (
                fields[b"op"] == _MESSAGE
                and topic
                and self._topic_of.get(_number(fields[b"conn"])) == topic
            ):
                yield _time_s(fields[b"time"]), data

    def _in_sequence(self, file: BinaryIO, topic: str) -> Iterator[tuple[float, bytes]]:
        """Time and content of the messages of a topic from the beginning to the first damaged
        record.
        """
        n_bytes = file.seek(0, 2)
        file.seek(len(MAGIC))
        try:
            while file.tell() < n_bytes:
                header, data = _record(file)
                if header[b"op"] == _CHUNK:
                    yield from self._messages_in(header, data, topic)
                elif header[b"op"] == _CONNECTION:
                    self._add_connection(header, data)
        except container.DAMAGE:
            self.end_problem = f"the file is cut off or damaged after {file.tell() / 1e6:.1f} MB"


def _record(file: BinaryIO) -> tuple[dict[bytes, bytes], bytes]:
    return _fields(_block(file)), _block(file)


def _block(file: BinaryIO) -> bytes:
    (length,) = struct.unpack("<I", file.read(4))
    if length > container.MAX_RECORD_BYTES:
        raise container.DamagedError("record too large")
    block = file.read(length)
    if len(block) < length:
        raise container.DamagedError("cut off")
    return block


def _fields(header: bytes) -> dict[bytes, bytes]:
    fields, position = dict[bytes, bytes](), 0
    while position < len(header):
        (length,) = struct.unpack_from("<I", header, position)
        name, equals, value = header[position + 4 : position + 4 + length].partition(b"=")
        if not equals:
            raise container.DamagedError("no field")
        fields[name] = value
        position += 4 + length
    return fields


def _number(value: bytes) -> int:
    return int.from_bytes(value, "little")


def _time_s(value: bytes) -> float:
    seconds, nanoseconds = struct.unpack("<II", value)
    return float(seconds) + float(nanoseconds) / 1e9
