"""Fetching of a clip's remote files into a local cache of limited size, for the time in which the clip is processed.

CACHE/FOLDER/ROLE/name             a file, with the calibration beside the left video: left/video.mp4, left/rig.yaml
CACHE/FOLDER/ROLE/parent/name/...  a folder; timestamps.txt beside it: left/parent/timestamps.txt
"""

from __future__ import annotations

import hashlib
import shutil
import threading
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from track_range.fleet.inputs.clip import TELEMETRY_ROLE, Clip, FleetInputError
from track_range.fleet.storage.entry import Entry, FileStat, folder_state, is_hidden
from track_range.fleet.storage.errors import StorageError, storage_errors
from track_range.fleet.storage.location import Location
from track_range.foundation.files.input_files import open_regular, shortened

_N_CONNECTIONS = 8
"""Files of a folder that are downloaded at a time."""

_MAX_NAME = 200
"""Largest length of a file name in the cache, bytes; object stores allow longer ones."""


@dataclass(frozen=True, slots=True)
class FetchedFile:
    """A file of a clip as it was read.

    Attributes:
        address: where it is stored.
        path: local path.
        size: bytes as its storage states it; see `FileStat`.
        mtime_ns: time of the last change as its storage states it; see `FileStat`.
        sha256: hash of the content in hexadecimal digits; of a folder, of the names and contents of its files.
    """

    address: str
    path: Path
    size: int
    mtime_ns: int
    sha256: str


@dataclass(frozen=True, slots=True)
class FetchedClip:
    """A clip with all of its files on this machine.

    Attributes:
        clip: the clip, with local paths.
        files: its files by role, as in `Clip.files`.
    """

    clip: Clip
    files: Mapping[str, FetchedFile]


@contextmanager
def fetched(clip: Clip, cache_folder: Path, limit_bytes: int) -> Iterator[FetchedClip]:
    """A clip with its remote files downloaded; they are removed at the end. Local files are used in place.

    Args:
        clip: the clip.
        cache_folder: folder of the downloads, which is created; several processes may share it.
        limit_bytes: largest size of the clip's downloads.

    Raises:
        FleetInputError: the clip has a problem that was found when it was listed.
        StorageError: a file is missing, cannot be read, or the downloads are larger than the limit or the free space.
    """
    if clip.problem:
        raise FleetInputError(clip.problem)
    with ExitStack() as stack:
        fetch = _Fetch(clip, limit_bytes)
        folder = None
        if fetch.has_remote:
            with storage_errors(cache_folder, "written"):
                cache_folder.mkdir(parents=True, exist_ok=True)
                folder = Path(stack.enter_context(TemporaryDirectory(dir=cache_folder, ignore_cleanup_errors=True)))
            fetch.check_space(folder)
        files = {role: fetch.file(role, folder) for role in fetch.locations}
        yield FetchedClip(_with_paths(clip, files), files)


class _Fetch:
    """Download of the files of one clip.

    Attributes:
        locations: the files by role.
        has_remote: whether some of them are not on this machine.
    """

    def __init__(self, clip: Clip, limit_bytes: int) -> None:
        self.locations = {role: Location.of(address) for role, address in clip.files().items()}
        self._limit_bytes = self._left_bytes = limit_bytes
        self._lock = threading.Lock()
        self._entries: dict[str, list[Entry]] = {}
        self._states = {role: self._state(role, location) for role, location in self.locations.items()}
        self.has_remote = not all(location.is_local for location in self.locations.values())

    def _state(self, role: str, location: Location) -> FileStat:
        status = location.stat()
        if status is None:
            raise StorageError(f"{location}: no such file; expected {_title(role)} of the clip.", "missing")
        if not status.is_folder:
            return status
        self._entries[role] = sorted(
            (
                entry
                for entry in location.list(recursive=True)
                if not (entry.stat.is_folder or is_hidden(entry.name)) and _is_below(entry.name)
            ),
            key=lambda entry: entry.name,
        )
        return folder_state(self._entries[role])

    def check_space(self, folder: Path) -> None:
        """Check the size of the downloads against the limit and the free space.

        Raises:
            StorageError: they are larger.
        """
        size = sum(max(self._states[role].size, 0) for role, place in self.locations.items() if not place.is_local)
        if size > self._limit_bytes:
            raise StorageError(
                f"{self.locations['left']}: expected a clip of at most {_megabytes(self._limit_bytes)}, found "
                f"{_megabytes(size)}; increase --cache-size, or cut the recording."
            )
        with storage_errors(folder, "read"):
            free = shutil.disk_usage(folder).free
        if size > free:
            raise StorageError(
                f"{folder}: no space left for the clip {self.locations['left']}, which needs {_megabytes(size)}, found "
                f"{_megabytes(free)}; free space, or choose another --cache-dir.",
                "full",
            )

    def file(self, role: str, folder: Path | None) -> FetchedFile:
        """The file of a role on this machine, with its hash.

        Raises:
            StorageError: it cannot be read.
        """
        location, state = self.locations[role], self._states[role]
        path = location.path if location.is_local or folder is None else self._downloaded(role, folder)
        entries = self._entries.get(role)
        sha256 = _file_hash(path) if entries is None else _folder_hash(path, entries)
        return FetchedFile(location.address, path, state.size, state.mtime_ns, sha256)

    def _downloaded(self, role: str, folder: Path) -> Path:
        location = self.locations[role]
        path = folder / self._place(role)
        if role in self._entries:
            entries = self._entries[role]
            with ThreadPoolExecutor(_N_CONNECTIONS) as threads:
                # the list re-raises the first error
                list(threads.map(lambda e: self._download(location.child(e.name), path / e.name, e.stat.size), entries))
        else:
            self._download(location, path, self._states[role].size)
        return path

    def _place(self, role: str) -> Path:
        """Relative path of a role's file in the cache; files that are found by their place stay beside their video."""
        video = role.removesuffix("_timestamps")
        if video != role:
            return self._place(video).parent / _safe_name(self.locations[role])
        location = self.locations[role]
        if role.startswith(TELEMETRY_ROLE):
            return self._place("left").parent / _safe_name(location)
        if role == "rig" and self._is_beside_left():
            left = self._place("left")
            return (left if location.parent == self.locations["left"] else left.parent) / _safe_name(location)
        parent = location.parent
        if role in self._entries and parent is not None:
            return Path(role, _safe_name(parent), _safe_name(location))
        return Path(role, _safe_name(location))

    def _is_beside_left(self) -> bool:
        left = self.locations["left"]
        return self.locations["rig"].parent in (left.parent, left)

    def _download(self, location: Location, path: Path, size: int) -> None:
        with storage_errors(path, "written"):
            path.parent.mkdir(parents=True, exist_ok=True)
        n_bytes = location.download(path, max(self._left_bytes, 0))
        with self._lock:
            self._left_bytes -= n_bytes
        if size >= 0 and n_bytes != size:
            raise StorageError(
                f"{location}: changed while it was downloaded ({size}, then {n_bytes} bytes).", "network"
            )


def _with_paths(clip: Clip, files: Mapping[str, FetchedFile]) -> Clip:
    """The clip with local paths; a calibration that a run finds beside the left video is not a setting."""
    settings = {name: str(files[name].path) if name in files else value for name, value in clip.settings.items()}
    right = None if clip.right is None else str(files["right"].path)
    return replace(clip, left=str(files["left"].path), right=right, settings=settings)


def _file_hash(path: Path) -> str:
    with storage_errors(path, "read"), open_regular(path, StorageError, "a file of the clip") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _folder_hash(folder: Path, entries: list[Entry]) -> str:
    digest = hashlib.sha256()
    for entry in entries:
        path = folder / entry.name
        name = entry.name.encode("utf-8", "surrogateescape")
        digest.update(b"%d:%s%s" % (len(name), name, _file_hash(path).encode()))
    return digest.hexdigest()


def _is_below(name: str) -> bool:
    """Whether a relative name stays below its folder as a local path; names of objects may be `/x` or `../x`."""
    return not {"", ".", ".."}.intersection(name.split("/"))


def _safe_name(location: Location) -> str:
    """File name in the cache: that of the location, unless it is too long for a local file."""
    name = location.name.replace("\0", "_").replace("/", "_") or "file"
    if name in (".", ".."):
        return "file"
    data = name.encode("utf-8", "surrogateescape")
    if len(data) <= _MAX_NAME:
        return name
    stem, point, suffix = name.rpartition(".")
    short = stem.encode("utf-8", "surrogateescape")[: _MAX_NAME // 2].decode("utf-8", "ignore")
    return f"{short}-{hashlib.sha256(data).hexdigest()[:16]}{point}{shortened(suffix, 20)}"


def _title(role: str) -> str:
    return {"left": "the left video", "right": "the right video", "rig": "the calibration"}.get(
        role, f"the {role} file"
    )


def _megabytes(n_bytes: int) -> str:
    return f"{n_bytes / 1e6:.4g} MB"
