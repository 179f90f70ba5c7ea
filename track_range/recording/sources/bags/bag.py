"""open_bag: the files of an MCAP file or ROS bag, which may be a folder with several files, as one
`Bag`.

ROS 2 bags in SQLite's format (.db3) are read here.
"""

import re
import sqlite3
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote

import yaml

from track_range.foundation.errors import UserError
from track_range.foundation.files.input_files import check_regular, counted, open_regular, shortened
from track_range.foundation.files.structured_text import read_yaml
from track_range.recording.sources.bags.container import (
    DAMAGE,
    EXPECTED,
    ZSTD_MAGIC,
    Bag,
    Topic,
    missing_library,
    ros2_type,
)
from track_range.recording.sources.bags.ros1_file import MAGIC as ROS1_MAGIC, Ros1File
from track_range.recording.video.frame import VideoError

_MCAP_MAGIC, _SQLITE_MAGIC = b"\x89MCAP0\r\n", b"SQLite format 3\0"
# suffixes of the files in the folder of a bag; those of ROS 1 also lie beside videos and images,
# which are then the recording, but not beside these
_ROS2_SUFFIXES, _ROS1_SUFFIX = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd"), ".bag"
_TEXT_SUFFIXES = (".active", ".csv", ".json", ".md", ".txt", ".yaml", ".yml")
# number of a file of a bag, in ROS 1 after the time at which the file begins
_NUMBER = re.compile(r"(?:_?\d{4}(?:-\d{2}){5})?_(\d+)$")

_MESSAGES = (
    "SELECT timestamp, CASE WHEN id >= (SELECT MIN(id) FROM messages WHERE timestamp >= ?) "
    "THEN data END FROM messages WHERE topic_id = ? ORDER BY id"
)
"""Query for the messages of a topic; the content before the first late enough message is not
read."""


def is_bag(path: Path) -> bool:
    """Whether a path is an MCAP file, a ROS bag, or the folder of a bag; files are recognised by
    content.
    """
    try:
        if path.is_dir():
            return bool(_files_in(path))
        with open_regular(path, VideoError, EXPECTED) as file:
            start = file.read(16)
    except (OSError, ValueError, VideoError):
        return False
    return start.startswith((_MCAP_MAGIC, _SQLITE_MAGIC, ROS1_MAGIC, b"#ROSBAG"))


def open_bag(path: Path) -> Bag:
    """The opened bag; VideoError for an unreadable or compressed file, several bags, or a missing
    package.
    """
    if not path.is_dir():
        return _open_file(path)
    files = _files_in(path)
    series = [_series(file.name) for file in files]
    is_one = len({name for name, _ in series}) == 1 and len(set(series)) == len(series)
    if not (is_one or (path / "metadata.yaml").exists()):
        raise VideoError(
            f"{path}: expected the files of one bag, numbered as in drive_0 and drive_1, found "
            f"{shortened(files[0].name, 50)} and {shortened(files[-1].name, 50)} without "
            "metadata.yaml; give one file."
        )
    return (
        _open_file(files[0])
        if len(files) == 1
        else SplitBag(path, [_open_file(file) for file in files])
    )


class SqliteFile:
    """Messages of a .db3 file; see `Bag` for the attributes. Raises VideoError if it cannot be
    read.
    """

    def __init__(self, path: Path) -> None:
        check_regular(path, VideoError, EXPECTED)
        self.path, self.end_problem, self.n_damaged = path, "", 0
        self.topics: dict[str, Topic] = {}
        self._ids: dict[str, int] = {}
        try:
            with closing(self._connected()) as database:
                rows = database.execute(
                    "SELECT id, name, type, serialization_format FROM topics"
                ).fetchall()
                for topic_id, name, type_name, encoding in rows:
                    self._ids[str(name)] = int(topic_id)
                    self.topics[str(name)] = Topic(
                        str(name),
                        ros2_type(str(type_name)),
                        str(encoding),
                        b"",
                        _count(database, int(topic_id)),
                    )
        except DAMAGE as error:
            raise VideoError(
                f"{path}: expected {EXPECTED}, found an SQLite file without readable topics "
                f"({type(error).__name__})."
            ) from error

    def _connected(self) -> sqlite3.Connection:
        """Connection that reads the file, with the journal that a killed recorder has left."""
        address = f"file:{quote(str(self.path.absolute()))}?mode=ro"
        if Path(f"{self.path}-wal").exists():
            with suppress(sqlite3.DatabaseError):  # such as a folder without write permission
                database = sqlite3.connect(address, uri=True)
                database.execute("SELECT id FROM topics").fetchall()
                return database
        database = sqlite3.connect(f"{address}&immutable=1", uri=True)
        # otherwise SQLite refuses a file that is shorter than its header states, such as one that
        # is cut off
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
                self.end_problem = (
                    f"the file is cut off or damaged after {number} messages "
                    f"({type(error).__name__})"
                )


def _series(name: str) -> tuple[str, int]:
    """Name of a recording and number of a file of it: trip_2.mcap -> trip, 2; -1 = no number."""
    stem = next(
        (
            name[: -len(end)]
            for end in (*_ROS2_SUFFIXES, _ROS1_SUFFIX)
            if name.lower().endswith(end)
        ),
        name,
    )
    number = _NUMBER.search(stem)
    return (stem, -1) if number is None else (stem[: number.start()], int(number[1]))


def _count(database: sqlite3.Connection, topic_id: int) -> int | None:
    try:
        (count,) = database.execute(
            "SELECT COUNT(*) FROM messages WHERE topic_id = ?", (topic_id,)
        ).fetchone()
    except sqlite3.DatabaseError:
        return None
    return int(count)


class SplitBag:
    """Several files of one bag in the order of time; see `Bag` for the attributes."""

    def __init__(self, path: Path, bags: list[Bag]) -> None:
        self.path, self._bags = path, bags
        self.topics: dict[str, Topic] = {}
        for bag in bags:
            for name, topic in bag.topics.items():
                known = self.topics.get(name)
                counts = (
                    [topic.n_messages] if known is None else [known.n_messages, topic.n_messages]
                )
                n_messages = None if None in counts else sum(count or 0 for count in counts)
                self.topics[name] = replace(topic, n_messages=n_messages)

    @property
    def end_problem(self) -> str:
        """Reason why reading of a file ended early; empty = it did not."""
        return next(
            (f"{bag.path.name}: {bag.end_problem}" for bag in self._bags if bag.end_problem), ""
        )

    @property
    def n_damaged(self) -> int:
        """Damaged parts that were skipped."""
        return sum(bag.n_damaged for bag in self._bags)

    def messages(self, topic: str, from_s: float) -> Iterator[tuple[int, float, bytes]]:
        """Number, time and content of the messages of a topic; see `Bag.messages`."""
        n_before = 0
        for bag in self._bags:
            number = -1
            if topic not in bag.topics:
                continue
            for number, time_s, data in bag.messages(topic, from_s):
                yield n_before + number, time_s, data
            n_before += max(number + 1, bag.topics[topic].n_messages or 0)


def topic_list(bag: Bag, types: tuple[str, ...] = ()) -> str:
    """The first topics of a bag with their types for messages, topics of `types` first."""
    topics = sorted(bag.topics.values(), key=lambda topic: (topic.type not in types, topic.name))
    shown = [
        f"{shortened(topic.name, 40)} ({shortened(topic.type.replace('/msg/', '/'), 30)})"
        for topic in topics[:4]
    ]
    others = f" and {counted(len(topics) - 4, 'other')}" if len(topics) > 4 else ""
    return ", ".join(shown) + others or "no topics"


def _open_file(path: Path) -> Bag:
    with open_regular(path, VideoError, EXPECTED) as file:
        start = file.read(16)
    if start.startswith(_MCAP_MAGIC):
        try:
            from track_range.recording.sources.bags.mcap_file import McapFile
        except ImportError as error:
            missing_library(error)
        return McapFile(path)
    if start.startswith(_SQLITE_MAGIC):
        return SqliteFile(path)
    if start.startswith(ROS1_MAGIC):
        return Ros1File(path)
    if start.startswith(b"#ROSBAG"):
        raise VideoError(
            f"{path}: expected a ROS bag of version 2.0, found another version; "
            "convert it with rosbag."
        )
    if start.startswith(ZSTD_MAGIC):
        raise VideoError(
            f"{path}: expected {EXPECTED}, found a file compressed as a whole; decompress it with "
            "zstd -d."
        )
    raise VideoError(
        f"{path}: expected {EXPECTED}, found an empty file, another format or a damaged file."
    )


def _files_in(folder: Path) -> list[Path]:
    """Files of the folder of a bag in the order of metadata.yaml, else of their numbers."""
    names = [path.name.lower() for path in folder.iterdir()]
    suffixes: tuple[str, ...] = _ROS2_SUFFIXES
    if all(name.endswith((_ROS1_SUFFIX, *_TEXT_SUFFIXES)) for name in names):
        suffixes = (_ROS1_SUFFIX,)
    files = sorted(
        (path for path in folder.iterdir() if path.name.lower().endswith(suffixes)),
        key=lambda path: (_series(path.name)[1], len(path.name), path.name),
    )
    if not files:
        return []
    try:
        content = read_yaml(folder / "metadata.yaml", VideoError, "the metadata of a ROS 2 bag")
        names = [
            str(name) for name in content["rosbag2_bagfile_information"]["relative_file_paths"]
        ]
    except (UserError, yaml.YAMLError, LookupError, TypeError):
        return files
    listed = [folder / Path(name).name for name in names]
    return [path for path in listed if path in files] or files
