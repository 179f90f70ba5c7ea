"""SqliteFile: messages of a ROS 2 bag in SQLite's format (.db3)."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from urllib.parse import quote

from track_range.foundation.files.input_files import check_regular
from track_range.recording.bags.container import DAMAGE, EXPECTED, Topic, ros2_type
from track_range.recording.frame import VideoError

_MESSAGES = "SELECT timestamp, CASE WHEN timestamp >= ? THEN data END FROM messages WHERE topic_id = ? ORDER BY id"
"""Query for the messages of a topic; the content of the earlier ones is not read."""


class SqliteFile:
    """Messages of a .db3 file; see `Bag` for the attributes.

    Raises:
        VideoError: the file cannot be read.
    """

    def __init__(self, path: Path) -> None:
        check_regular(path, VideoError, EXPECTED)
        self.path, self.end_problem, self.n_damaged = path, "", 0
        self.topics: dict[str, Topic] = {}
        self._ids: dict[str, int] = {}
        try:
            with closing(self._connected()) as database:
                rows = database.execute("SELECT id, name, type, serialization_format FROM topics").fetchall()
                for topic_id, name, type_name, encoding in rows:
                    self._ids[str(name)] = int(topic_id)
                    self.topics[str(name)] = Topic(
                        str(name), ros2_type(str(type_name)), str(encoding), b"", _count(database, int(topic_id))
                    )
        except DAMAGE as error:
            raise VideoError(
                f"{path}: expected {EXPECTED}, found an SQLite file without readable topics ({type(error).__name__})."
            ) from error

    def _connected(self) -> sqlite3.Connection:
        """Connection that reads the file, with the journal that a recorder left that was killed."""
        address = f"file:{quote(str(self.path.absolute()))}?mode=ro"
        if Path(f"{self.path}-wal").exists():
            try:
                database = sqlite3.connect(address, uri=True)
                database.execute("SELECT id FROM topics").fetchall()
            except sqlite3.DatabaseError:  # such as a folder without write permission
                pass
            else:
                return database
        database = sqlite3.connect(f"{address}&immutable=1", uri=True)
        # otherwise SQLite refuses a file that is shorter than its header states, such as one that is cut off
        database.execute("PRAGMA writable_schema=ON")
        return database

    def messages(self, topic: str, from_s: float) -> Iterator[tuple[int, float, bytes]]:
        """Number, time and content of the messages of a topic; see `Bag.messages`."""
        self.end_problem, number, from_ns = "", 0, int(max(from_s, 0.0) * 1e9)
        with closing(self._connected()) as database:
            try:
                for stamp_ns, data in database.execute(_MESSAGES, (from_ns, self._ids[topic])):
                    if data is not None:
                        yield number, float(stamp_ns) / 1e9, bytes(data)
                    number += 1
            except DAMAGE as error:
                self.end_problem = f"the file is cut off or damaged after {number} messages ({type(error).__name__})"


def _count(database: sqlite3.Connection, topic_id: int) -> int | None:
    try:
        (count,) = database.execute("SELECT COUNT(*) FROM messages WHERE topic_id = ?", (topic_id,)).fetchone()
    except sqlite3.DatabaseError:
        return None
    return int(count)
