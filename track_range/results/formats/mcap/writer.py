"""McapWriter: run.mcap, written with foxglove-sdk, in chunks of at most one second.

    frame result -> messages of the profile -> foxglove-sdk (chunks, indexes) -> file, whole chunks only

The messages of the last frame are held back until the next one, so that they can be discarded. A killed run leaves all
chunks but the last; a file without an index at its end is read by Foxglove and by `mcap recover`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, BinaryIO, cast

from track_range.pipeline.frame_result import FrameResult
from track_range.results.formats.extras import check_extra
from track_range.results.formats.mcap import PROFILES
from track_range.results.formats.mcap.messages import NANOSECONDS, Message, Profile, jpeg
from track_range.results.formats.row_file import FrameFile
from track_range.results.formats.scene import track_objects
from track_range.results.writers import RunInfo

MCAP_FILE = "run.mcap"

_EXTRA = "mcap"

_MAX_TIME_NS = (2**31 - 1) * NANOSECONDS
"""Latest time of ROS, in 2038; times are from 1970 to this one."""

_CHUNK_S = 1.0
"""Duration of a chunk in the recording, and maximum time between two chunks while writing, s."""


class McapWriter:
    """Writer of run.mcap; the settings `mcap_profile` and `mcap_images` choose its messages."""

    files = (MCAP_FILE,)

    def check_requirements(self) -> None:
        """Check that the required packages are installed.

        Raises:
            ExtraError: one is missing.
        """
        check_extra("mcap", _EXTRA, "foxglove", "rosbags.typesys")

    def open(self, info: RunInfo, folder: Path) -> None:
        """Create the file with its header."""
        self.check_requirements()
        import foxglove
        from foxglove.mcap import MCAPWriteOptions

        self._info = info
        self._has_images = bool(info.settings.get("mcap_images", False))
        profile = resolve_name(PROFILES.get(str(info.settings.get("mcap_profile")), PROFILES["foxglove"]))
        self._profile: Profile = profile(info.camera)
        start_us = round((info.start_utc_s or 0.0) * 1e6)  # float64 holds microseconds since 1970
        self._start_ns = min(max(start_us * 1000, 0), _MAX_TIME_NS)
        self._held: tuple[int, list[Message]] | None = None
        self._last_ns = 0
        self._chunk_ns, self._chunk_began_s = self._start_ns, time.monotonic()
        self._sink = _Sink()
        self._context = foxglove.Context()
        self._channels: dict[str, Any] = {}
        options = MCAPWriteOptions(
            profile=self._profile.name, chunk_size=None, disable_seeking=True, compression_threads=0
        )
        self._mcap = foxglove.open_mcap(cast(BinaryIO, self._sink), context=self._context, writer_options=options)
        self._mcap.write_metadata("track_range", info.provenance.metadata())
        self._mcap.flush()
        self._file = FrameFile(folder / MCAP_FILE, self._sink.pop())
        self._has_gap = False
        self._first_notes = info.notes

    def write(self, result: FrameResult) -> None:
        """Write the frame before this one, and hold this one."""
        self._release()
        time_ns = self._time_ns(result)
        messages = list(self._profile.frame(list(track_objects(result, self._info.camera)), time_ns))
        image = self._info.shown_image(result) if self._has_images else None
        if image is not None:
            messages.append(self._profile.image(jpeg(image), time_ns))
        self._held = (time_ns, messages)

    def discard_last(self) -> None:
        """Discard the frame that is held."""
        self._held = None

    def close(self, summary: Mapping[str, Any] | None) -> None:
        """Write the last frame, the notes of the run and the index."""
        try:
            self._release()
            self._last_ns = self._last_ns or self._start_ns  # a run without frames
            self._log_first_notes(self._last_ns)
            notes = (summary or {}).get("notes") or ()
            self._log_notes((note for note in notes if note not in self._info.notes), self._last_ns)
            self._mcap.close()
            if not self._has_gap:  # otherwise the positions in the index are wrong
                self._file.add(self._sink.pop())
        finally:
            for channel in self._channels.values():
                channel.close()
            self._file.close()

    def _time_ns(self, result: FrameResult) -> int:
        """Time of a frame, which is never before that of an earlier frame."""
        if math.isfinite(result.utc_s):
            time_ns = round(result.utc_s * 1e6) * 1000
        else:
            time_ns = self._start_ns + round(result.time_s * NANOSECONDS)
        self._last_ns = min(max(self._last_ns, time_ns), _MAX_TIME_NS)
        return self._last_ns

    def _release(self) -> None:
        """Write the held frame; the chunk is written to the file once it is a second long."""
        if self._held is None:
            return
        time_ns, messages = self._held
        is_due = time_ns - self._chunk_ns >= _CHUNK_S * NANOSECONDS
        if is_due or time.monotonic() - self._chunk_began_s >= _CHUNK_S:
            self._mcap.flush()
            self._chunk_ns, self._chunk_began_s = time_ns, time.monotonic()
            self._add(self._sink.pop())
        self._log_first_notes(time_ns)
        self._log(messages, time_ns)
        self._held = None

    def _add(self, chunk: bytes) -> None:
        if self._has_gap:  # later chunks may need the schemas of the one that is missing
            return
        try:
            self._file.add(chunk)
        except OSError:
            self._has_gap = True
            raise

    def _log_first_notes(self, time_ns: int) -> None:
        """Log the notes that precede the first frame, at its time."""
        self._log_notes(self._first_notes, time_ns)
        self._first_notes = ()

    def _log_notes(self, notes: Iterable[str], time_ns: int) -> None:
        for note in notes:
            self._log([self._profile.note(note, time_ns)], time_ns)

    def _log(self, messages: list[Message], time_ns: int) -> None:
        for topic, data in messages:
            if topic not in self._channels:
                self._channels[topic] = self._channel(topic)
            self._channels[topic].log(data, log_time=time_ns)

    def _channel(self, topic: str) -> Any:
        from foxglove import Channel, Schema

        name, encoding, data = self._profile.schema(topic)
        return Channel(
            topic,
            schema=Schema(name=name, encoding=encoding, data=data),
            message_encoding=self._profile.encoding(topic),
            context=self._context,
        )


class _Sink:
    """File of foxglove-sdk in memory, from which chunks are popped; it never fails."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._position = 0

    def pop(self) -> bytes:
        """Content since the last call, which is removed."""
        content = b"".join(self._parts)
        self._parts.clear()
        return content

    def write(self, content: bytes) -> int:
        """Add content."""
        self._parts.append(bytes(content))
        self._position += len(content)
        return len(content)

    def seek(self, offset: int, whence: int = 0) -> int:
        """The position, which does not change."""
        return self._position

    def flush(self) -> None:
        """Do nothing."""
