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
from typing import TYPE_CHECKING, Any, BinaryIO, cast

import cv2
import numpy as np

from track_range.pipeline.frame_result import FrameResult
from track_range.results.formats.mcap import NANOSECONDS, PROFILES, Message
from track_range.results.formats.row_file import RowFile
from track_range.results.formats.run_info import RunInfo
from track_range.results.formats.scene import check_extra, track_objects
from track_range.results.rows.columns import viewer_columns

if TYPE_CHECKING:
    from track_range.results.formats.mcap.foxglove_profile import FoxgloveProfile
    from track_range.results.formats.mcap.ros2_profile import Ros2Profile

MCAP_FILE = "run.mcap"
_JPEG_QUALITY = 85  # quality of images, 0 to 100: about a tenth of a byte per pixel
# latest time of ROS, in 2038; times are from 1970 to this one
_MAX_TIME_NS = (2**31 - 1) * NANOSECONDS
# duration of a chunk in the recording, and maximum time between two chunks while writing, s
_CHUNK_S = 1.0


class McapWriter:
    """Writer of run.mcap; the settings `mcap_profile` and `mcap_images` choose its messages."""

    files = (MCAP_FILE,)

    def check_requirements(self) -> None:
        """Raise ExtraError unless the required packages are installed."""
        check_extra("mcap", "mcap", "foxglove", "rosbags.typesys")

    def open(self, info: RunInfo, folder: Path) -> None:
        """Create the file with its header."""
        self.check_requirements()
        import foxglove
        from foxglove.mcap import MCAPWriteOptions

        self._info = info
        self._has_images = bool(info.settings.get("mcap_images", False))
        profile = resolve_name(
            PROFILES.get(str(info.settings.get("mcap_profile")), PROFILES["foxglove"])
        )
        self._profile: FoxgloveProfile | Ros2Profile = profile(info.camera, info.mounting)
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
        self._mcap = foxglove.open_mcap(
            cast(BinaryIO, self._sink), context=self._context, writer_options=options
        )
        self._mcap.write_metadata("track_range", info.provenance.metadata())
        self._mcap.flush()
        self._file = RowFile(folder / MCAP_FILE, self._sink.pop())
        self._has_gap = False
        self._first_notes = info.notes
        self._columns = viewer_columns()

    def write(self, result: FrameResult) -> None:
        """Write the previous frame, and hold this frame."""
        self._release()
        time_ns = self._time_ns(result)
        objects = list(track_objects(result, self._columns))
        messages = list(self._profile.frame(objects, time_ns, result.ego_pose))
        image = self._info.shown_image(result) if self._has_images else None
        if image is not None:
            _, jpeg = cv2.imencode(
                ".jpg", np.ascontiguousarray(image), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
            )
            messages.append(self._profile.image(jpeg.tobytes(), time_ns))
        self._held = (time_ns, messages)

    def discard_last(self) -> None:
        """Discard the frame that is held."""
        self._held = None

    def close(self, summary: Mapping[str, Any] | None) -> None:
        """Write the last frame, the notes of the run and the index."""
        try:
            self._release()
            notes = (summary or {}).get("notes") or ()
            later = (note for note in notes if note not in self._info.notes)
            self._last_ns = self._last_ns or self._start_ns  # a run without frames
            self._log_notes((*self._first_notes, *later), self._last_ns)
            self._mcap.close()
            if not self._has_gap:  # otherwise the positions in the index are wrong
                self._file.write(self._sink.pop())
        finally:
            for channel in self._channels.values():
                channel.close()
            self._file.close()

    def _time_ns(self, result: FrameResult) -> int:
        """Time of a frame, which is never before the time of an earlier frame."""
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
            chunk = self._sink.pop()
            if not self._has_gap:  # later chunks may need the schemas of one that is missing
                self._has_gap = True
                self._file.write(chunk)
                self._has_gap = False
        self._log_notes(self._first_notes, time_ns)
        self._first_notes = ()
        self._log(messages, time_ns)
        self._held = None

    def _log_notes(self, notes: Iterable[str], time_ns: int) -> None:
        self._log((self._profile.note(note, time_ns) for note in notes), time_ns)

    def _log(self, messages: Iterable[Message], time_ns: int) -> None:
        from foxglove import Channel, Schema

        for topic, data in messages:
            if topic not in self._channels:
                name, schema_encoding, text, encoding = self._profile.schema(topic)
                schema = Schema(name=name, encoding=schema_encoding, data=text)
                self._channels[topic] = Channel(
                    topic, schema=schema, message_encoding=encoding, context=self._context
                )
            self._channels[topic].log(data, log_time=time_ns)


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
        self._parts.append(bytes(content))
        self._position += len(content)
        return len(content)

    def seek(self, offset: int, whence: int = 0) -> int:
        """The position, which does not change."""
        return self._position

    def flush(self) -> None:
        """Do nothing."""
