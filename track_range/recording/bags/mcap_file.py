"""McapFile: messages of an MCAP file, read chunk by chunk; files without a summary, such as cut ones, in sequence."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from track_range.foundation.files.input_files import open_regular
from track_range.recording.bags.container import (
    DAMAGE,
    MAX_RECORD_BYTES,
    SCAN_BYTES,
    DamagedError,
    Topic,
    decompressed,
    missing_library,
    ros2_type,
)
from track_range.recording.frame import VideoError

if TYPE_CHECKING:
    from mcap.records import Channel, Chunk, ChunkIndex, Schema

EXPECTED = "an MCAP file or ROS bag"


class McapFile:
    """Messages of an MCAP file; see `Bag` for the attributes.

    Raises:
        VideoError: the file cannot be read, or the library mcap is missing.
    """

    def __init__(self, path: Path) -> None:
        try:
            import mcap.stream_reader  # noqa: F401
            from mcap.exceptions import McapError
        except ImportError as error:
            missing_library(error)
        self.path, self.end_problem, self.n_damaged = path, "", 0
        self._damage = (*DAMAGE, McapError)
        self.topics: dict[str, Topic] = {}
        self._channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}
        self._chunks: list[ChunkIndex] = []
        self._has_summary = False
        with open_regular(path, VideoError, EXPECTED) as file:
            try:
                self._read_summary(file)
            except self._damage:
                self._has_summary = False
            if not self._has_summary:
                self._scan(file)
                if self.topics:
                    self.end_problem = ""  # reported when the messages are read

    def _read_summary(self, file: BinaryIO) -> None:
        from mcap.reader import SeekingReader

        summary = SeekingReader(file, record_size_limit=MAX_RECORD_BYTES).get_summary()
        if summary is None or not summary.channels:
            return
        self._channels, self._schemas = dict(summary.channels), dict(summary.schemas)
        self._chunks = sorted(summary.chunk_indexes, key=lambda chunk: chunk.chunk_start_offset)
        self._has_summary = True
        counts = {} if summary.statistics is None else summary.statistics.channel_message_counts
        for channel in self._channels.values():
            self._add_topic(channel, counts.get(channel.id, 0) if counts else None)

    def _add_topic(self, channel: Channel, n_messages: int | None) -> None:
        schema = self._schemas.get(channel.schema_id)
        known = self.topics.get(channel.topic)
        if known is not None and known.n_messages and n_messages is not None:
            n_messages += known.n_messages
        name, definition = ("unknown", b"") if schema is None else (schema.name, schema.data)
        self.topics[channel.topic] = Topic(
            channel.topic, ros2_type(name), channel.message_encoding, definition, n_messages
        )

    def _scan(self, file: BinaryIO) -> None:
        for _ in self._in_sequence(file, set(), max_bytes=SCAN_BYTES):
            pass

    def messages(self, topic: str, from_s: float) -> Iterator[tuple[int, float, bytes]]:
        """Number, time and content of the messages of a topic; see `Bag.messages`."""
        self.end_problem, self.n_damaged, number = "", 0, 0
        channels = {channel.id for channel in self._channels.values() if channel.topic == topic}
        with open_regular(self.path, VideoError, EXPECTED) as file:
            if not (self._has_summary and self._chunks):
                for message in self._in_sequence(file, channels, topic=topic):
                    yield number, message.log_time / 1e9, message.data
                    number += 1
                return
            for index in self._chunks:
                offsets = index.message_index_offsets
                if offsets and channels.isdisjoint(offsets):
                    continue
                try:
                    if offsets and index.message_end_time / 1e9 < from_s:
                        number += self._n_indexed(file, index, channels)
                        continue
                    messages = list(self._of_chunk(self._chunk_at(file, index), channels))
                except self._damage:
                    self.n_damaged += 1
                    continue
                for message in messages:
                    yield number, message.log_time / 1e9, message.data
                    number += 1

    def _chunk_at(self, file: BinaryIO, index: ChunkIndex) -> Chunk:
        from mcap.data_stream import ReadDataStream
        from mcap.records import Chunk

        if index.chunk_length > MAX_RECORD_BYTES:
            raise DamagedError("chunk too large")
        file.seek(index.chunk_start_offset + 9)  # after operation code and length
        chunk: Chunk = Chunk.read(ReadDataStream(file))
        return chunk

    def _n_indexed(self, file: BinaryIO, index: ChunkIndex, channels: set[int]) -> int:
        """Number of messages of the channels in a chunk, from its message indexes."""
        from mcap.data_stream import ReadDataStream

        n_messages = 0
        for channel in channels & set(index.message_index_offsets):
            file.seek(index.message_index_offsets[channel] + 9 + 2)  # after operation code, length and channel
            n_messages += ReadDataStream(file).read4() // 16  # two numbers of 8 bytes per message
        return n_messages

    def _of_chunk(self, chunk: Chunk, channels: set[int], topic: str | None = None) -> Iterator[Any]:
        """The messages of some channels in a chunk; schemas and channels are collected."""
        from mcap.stream_reader import breakup_chunk

        data = decompressed(chunk.data, chunk.compression, chunk.uncompressed_size)
        records = breakup_chunk(replace(chunk, compression="", data=data), validate_crc=True)
        yield from self._of_records(records, channels, topic)

    def _of_records(self, records: Iterable[Any], channels: set[int], topic: str | None) -> Iterator[Any]:
        """The messages of some channels; schemas and channels are collected."""
        from mcap.records import Channel, Message, Schema

        for record in records:
            if isinstance(record, Schema):
                self._schemas.setdefault(record.id, record)
            elif isinstance(record, Channel):
                self._add_channel(record, channels, topic)
            elif isinstance(record, Message) and record.channel_id in channels:
                yield record

    def _add_channel(self, channel: Channel, channels: set[int], topic: str | None) -> None:
        if channel.id not in self._channels:
            self._channels[channel.id] = channel
            self._add_topic(channel, None)
        if channel.topic == topic:
            channels.add(channel.id)

    def _in_sequence(
        self, file: BinaryIO, channels: set[int], *, topic: str | None = None, max_bytes: int | None = None
    ) -> Iterator[Any]:
        """The messages of some channels from the beginning of the file to its end, or to the first damaged record."""
        from mcap.records import Chunk, DataEnd
        from mcap.stream_reader import StreamReader

        file.seek(0)
        try:
            for record in StreamReader(file, emit_chunks=True, record_size_limit=MAX_RECORD_BYTES).records:
                if isinstance(record, Chunk):
                    yield from self._of_chunk(record, channels, topic)
                else:
                    yield from self._of_records([record], channels, topic)
                if isinstance(record, DataEnd):
                    return
                if max_bytes is not None and file.tell() > max_bytes:
                    return
        except self._damage as error:
            self.end_problem = (
                f"the file is cut off or damaged after {file.tell() / 1e6:.1f} MB ({type(error).__name__})"
            )
