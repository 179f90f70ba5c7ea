"""OsiWriter, OsiGroundTruthWriter, OsiMcapWriter: ASAM OSI traces of one type of message, and of
all types in one MCAP file.

A trace of one type is a sequence of messages with their lengths as 4-byte little-endian numbers.
Each frame is one system call. The names of the files end in the codes of their types, by which
readers know them.
"""

import struct
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from track_range.pipeline.frame_result import FrameResult
from track_range.results.formats.adas.osi_messages import OsiMessages
from track_range.results.formats.row_file import RowWriter
from track_range.results.formats.run_info import RunInfo
from track_range.results.formats.scene import check_extra

_CHUNK_BYTES = 65_536  # 10 to 100 frames; a killed run lacks those of the last chunk
_TRACE = "net.asam.osi.trace"  # prefix of ASAM's metadata


class OsiWriter(RowWriter):
    """Writer of run_sd.osi: messages SensorData."""

    files = ("run_sd.osi",)
    message_type = "SensorData"

    def check_requirements(self) -> None:
        """Raise ExtraError unless osi-python is installed."""
        check_extra("osi", "adas", "osi3")

    def open(self, info: RunInfo, folder: Path) -> None:
        """Create the file."""
        self.check_requirements()
        self._messages = OsiMessages(info)
        super().open(info, folder)

    def rows(self, result: FrameResult) -> bytes:
        """The message of a frame after its length; nothing if the frame has none."""
        message = self._messages.of(result, {self.message_type}).get(self.message_type)
        content: bytes = b"" if message is None else message.SerializeToString()
        return struct.pack("<I", len(content)) + content if content else b""


class OsiGroundTruthWriter(OsiWriter):
    """Writer of run_gt.osi: messages GroundTruth, of the frames with a known pose of the camera."""

    files = ("run_gt.osi",)
    message_type = "GroundTruth"


class OsiMcapWriter:
    """Writer of run_osi.mcap: all messages, in channels of their types. The last frame is held back,
    so that it can be discarded.
    """

    files = ("run_osi.mcap",)

    def check_requirements(self) -> None:
        """Raise ExtraError unless osi-python and asam-osi-utilities are installed."""
        check_extra("osi-mcap", "adas", "osi3", "osi_utilities")

    def open(self, info: RunInfo, folder: Path) -> None:
        """Create the file with its metadata and schemas."""
        self.check_requirements()
        from mcap.writer import Writer
        from osi_utilities import MCAPChannel

        self._messages = OsiMessages(info)
        self._held: dict[str, Any] = {}
        self._file = (folder / self.files[0]).open("wb")
        self._mcap: Any = Writer(self._file, chunk_size=_CHUNK_BYTES)
        self._mcap.start(library="track-range")
        osi = ".".join(str(number) for _, number in self._messages.version.ListFields())
        versions = {"osi_version": osi, "protobuf_version": version("protobuf")}
        metadata = {"version": osi, "description": "Measured from video with track-range"}
        metadata |= {f"{end}_{name}": versions[name] for end in ("min", "max") for name in versions}
        if info.start_utc_s is not None:
            metadata["zero_time"] = datetime.fromtimestamp(info.start_utc_s, UTC).isoformat()
        self._mcap.add_metadata(_TRACE, metadata)
        self._mcap.add_metadata("track_range", info.provenance.metadata())
        about = {f"{_TRACE}.channel.{name}": value for name, value in versions.items()}
        channels = MCAPChannel(self._mcap)
        self._channels = {
            name: channels.add_channel(name, message_type, about)
            for name, message_type in self._messages.types.items()
        }

    def write(self, result: FrameResult) -> None:
        """Write the previous frame, and hold this frame."""
        self._release()
        self._held = self._messages.of(result)

    def discard_last(self) -> None:
        """Discard the frame that is held."""
        self._held = {}

    def close(self, summary: Mapping[str, Any] | None) -> None:
        """Write the last frame and the index."""
        with self._file:
            self._release()
            self._mcap.finish()

    def _release(self) -> None:
        held, self._held = self._held, {}
        for name, message in held.items():
            time_ns = message.timestamp.seconds * 10**9 + message.timestamp.nanos
            content = message.SerializeToString()
            self._mcap.add_message(self._channels[name], time_ns, content, time_ns)
        self._file.flush()
