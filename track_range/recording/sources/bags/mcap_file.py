"""McapFile: messages of an MCAP file, read chunk by chunk; files without a summary (cut-off files)
in sequence.
"""

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, ChunkIndex, DataEnd, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from track_range.foundation.files.input_files import open_regular
from track_range.recording.sources.bags import container
from track_range.recording.video.frame import VideoError

# number of bytes of a file without a summary that are searched for topics
_SCAN_BYTES = 500_000_000

_DAMAGE = (*container.DAMAGE, McapError)


class McapFile:
    """Messages of an MCAP file; see `Bag` for the attributes. Raises VideoError if it cannot be
    read.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.end_problem, self.n_damaged = path, "", 0
        self.topics: dict[str, container.Topic] = {}
        self._channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}
        self._chunks: list[ChunkIndex] = []
        with open_regular(path, VideoError, container.EXPECTED) as file:
            with suppress(*_DAMAGE):
                self._read_summary(file)
            if not self.topics:
                for _ in self._in_sequence(file, "", max_bytes=_SCAN_BYTES):
                    pass
                if self.topics:
                    self.end_problem = ""  # reported when the messages are read

    def _read_summary(self, file: BinaryIO) -> None:
        summary = SeekingReader(file, record_size_limit=container.MAX_RECORD_BYTES).get_summary()
        if summary is None:
            return
        self._schemas = dict(summary.schemas)
        counts = {} if summary.statistics is None else summary.statistics.channel_message_counts
        for channel in summary.channels.values():
            self._add_channel(channel, counts.get(channel.id, 0) if counts else None)
        self._chunks = sorted(summary.chunk_indexes, key=lambda chunk: chunk.chunk_start_offset)

    def _add_channel(self, channel: Channel, n_messages: int | None) -> None:
        """Add a channel and its topic, which may have several channels."""
        self._channels[channel.id] = channel
        schema = self._schemas.get(channel.schema_id)
        name, definition = ("unknown", b"") if schema is None else (schema.name, schema.data)
        known = self.topics.get(channel.topic)
        if known is not None and known.n_messages and n_messages is not None:
            n_messages += known.n_messages
        encoding = channel.message_encoding
        self.topics[channel.topic] = container.Topic(
            channel.topic, container.ros2_type(name), encoding, definition, n_messages
        )

    def messages(self, topic: str, from_s: float) -> Iterator[tuple[int, float, bytes]]:
        """Number, time and content of the messages of a topic; see `Bag.messages`."""
        self.end_problem, self.n_damaged, number = "", 0, 0
        channels = {channel.id for channel in self._channels.values() if channel.topic == topic}
        with open_regular(self.path, VideoError, container.EXPECTED) as file:
            if not self._chunks:
                for number, message in enumerate(self._in_sequence(file, topic)):
                    yield number, message.log_time / 1e9, message.data
                return
            is_late = False
            for index in self._chunks:
                # and so are all later chunks, if the clock is set back
                is_late |= index.message_end_time / 1e9 >= from_s
                offsets, messages = index.message_index_offsets, list[Message]()
                if offsets and channels.isdisjoint(offsets):
                    continue
                try:
                    if offsets and not is_late:
                        for channel in channels & offsets.keys():
                            number += _n_indexed(file, offsets[channel])
                    else:
                        messages = list(self._messages_in([_chunk_at(file, index)], topic))
                except _DAMAGE:
                    self.n_damaged += 1
                for message in messages:
                    yield number, message.log_time / 1e9, message.data
                    number += 1

    def _messages_in(self, records: Iterable[Any], topic: str) -> Iterator[Message]:
        """The messages of a topic in records and chunks of records; schemas and channels are
        collected.
        """
        for record in records:
            if isinstance(record, Chunk):
                data = container.decompressed(
                    record.data, record.compression, record.uncompressed_size
                )
                whole = replace(record, compression="", data=data)
                yield from self._messages_in(breakup_chunk(whole, validate_crc=True), topic)
            elif isinstance(record, Schema):
                self._schemas.setdefault(record.id, record)
            elif isinstance(record, Channel) and record.id not in self._channels:
                self._add_channel(record, None)
            elif isinstance(record, Message):
                channel = self._channels.get(record.channel_id)
                if channel is not None and channel.topic == topic:
                    yield record

    def _in_sequence(
        self, file: BinaryIO, topic: str, max_bytes: int | None = None
    ) -> Iterator[Message]:
        """The messages of a topic from the beginning of the file to its end, or to the first
        damaged record.
        """
        file.seek(0)
        try:
            for record in StreamReader(
                file, emit_chunks=True, record_size_limit=container.MAX_RECORD_BYTES
            ).records:
                yield from self._messages_in([record], topic)
                if isinstance(record, DataEnd) or (
                    max_bytes is not None and file.tell() > max_bytes
                ):
                    return
        except _DAMAGE as error:
            self.end_problem = (
                f"the file is cut off or damaged after {file.tell() / 1e6:.1f} MB "
                f"({type(error).__name__})"
            )


def _n_indexed(file: BinaryIO, offset: int) -> int:
    """Number of messages in the index of a channel at this place of the file."""
    file.seek(offset + 9 + 2)  # after operation code, length and channel
    return ReadDataStream(file).read4() // 16  # two numbers of 8 bytes per message


def _chunk_at(file: BinaryIO, index: ChunkIndex) -> Chunk:
    if index.chunk_length > container.MAX_RECORD_BYTES:
        raise container.DamagedError("chunk too large")
    file.seek(index.chunk_start_offset + 9)  # after operation code and length
    chunk: Chunk = Chunk.read(ReadDataStream(file))
    return chunk
