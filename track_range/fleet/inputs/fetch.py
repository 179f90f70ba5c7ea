"""Fetching of a clip's remote files into a local cache of limited size, for the time in which the
clip is processed.

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

from track_range.fleet.inputs.clip import TELEMETRY_ROLE, Clip, FleetInputError, file_title
from track_range.fleet.storage.errors import StorageError, storage_errors
from track_range.fleet.storage.location import Entry, FileStat, Location, folder_state, is_hidden
from track_range.foundation.files.input_files import open_regular, shortened

_N_CONNECTIONS = 8  # files of a folder that are downloaded at a time
# largest length of a file name in the cache, bytes; object stores allow longer ones
_MAX_NAME = 200


@dataclass(frozen=True, slots=True)
class FetchedFile:
    """A file of a clip as it was read, with the local path; size in bytes and time in ns as in
    `FileStat`.
    """

    address: str
    path: Path
    size: int
    mtime_ns: int
    sha256: str  # hexadecimal, of the content; of a folder, of the names and contents of its files


@contextmanager
def fetched(
    clip: Clip, cache_folder: Path, limit_bytes: int
) -> Iterator[tuple[Clip, Mapping[str, FetchedFile]]]:
    """A clip with local paths, and its files by role; remote files are downloaded, and removed at
    the end.

    Several processes may share the folder of the downloads, which is created. Raises
    FleetInputError: the clip has a problem that was found when it was listed; StorageError: a file
    is missing, cannot be read, or the downloads are larger than the limit or the free space.
    """
    if clip.problem:
        raise FleetInputError(clip.problem)
    with ExitStack() as stack:
        fetch = _Fetch(clip, limit_bytes)
        folder = None
        if not all(location.is_local for location in fetch.locations.values()):
            with storage_errors(cache_folder, "written"):
                cache_folder.mkdir(parents=True, exist_ok=True)
                folder = Path(
                    stack.enter_context(
                        TemporaryDirectory(dir=cache_folder, ignore_cleanup_errors=True)
                    )
                )
            fetch.check_space(folder)
        files = {role: fetch.file(role, folder) for role in fetch.locations}
        # a calibration that a run finds beside the left video is not a setting
        settings = {
            name: str(files[name].path) if name in files else value
            for name, value in clip.settings.items()
        }
        right = None if clip.right is None else str(files["right"].path)
        yield replace(clip, left=str(files["left"].path), right=right, settings=settings), files


class _Fetch:
    """Download of the files of one clip, which are in `locations` by role."""

    def __init__(self, clip: Clip, limit_bytes: int) -> None:
        self.locations = {role: Location.of(address) for role, address in clip.files().items()}
        self._limit_bytes = self._left_bytes = limit_bytes
        self._lock = threading.Lock()
        self._entries: dict[str, list[Entry]] = {}
        self._states = {
            role: self._state(role, location) for role, location in self.locations.items()
        }

    def _state(self, role: str, location: Location) -> FileStat:
        status = location.stat()
        if status is None:
            raise StorageError(
                f"{location}: no such file; expected {file_title(role)} of the clip.", "missing"
            )
        if not status.is_folder:
            return status
        entries = (entry for entry in location.list(recursive=True) if not entry.stat.is_folder)
        known = [entry for entry in entries if not is_hidden(entry.name) and _is_below(entry.name)]
        self._entries[role] = sorted(known, key=lambda entry: entry.name)
        return folder_state(known)

    def check_space(self, folder: Path) -> None:
        """Raise StorageError for downloads that are larger than the limit or the free space."""
        remote = [role for role, location in self.locations.items() if not location.is_local]
        size = sum(max(self._states[role].size, 0) for role in remote)
        left, needed = self.locations["left"], _megabytes(size)
        if size > self._limit_bytes:
            raise StorageError(
                f"{left}: expected a clip of at most {_megabytes(self._limit_bytes)}, found "
                f"{needed}; increase --cache-size, or cut the recording."
            )
        with storage_errors(folder, "read"):
            free = shutil.disk_usage(folder).free
        if size > free:
            raise StorageError(
                f"{folder}: no space left for the clip {left}, which needs {needed}, found "
                f"{_megabytes(free)}; free space, or choose another --cache-dir.",
                "full",
            )

    def file(self, role: str, folder: Path | None) -> FetchedFile:
        """The file of a role on this machine, downloaded to `folder` if it is remote, with its
        hash.
        """
        location, state, entries = self.locations[role], self._states[role], self._entries.get(role)
        if location.is_local or folder is None:
            path = location.path
        else:
            path = folder / self._cache_path(role)
            if entries is None:
                self._download(location, path, state.size)
            else:

                def download(entry: Entry) -> None:
                    self._download(location.child(entry.name), path / entry.name, entry.stat.size)

                with ThreadPoolExecutor(_N_CONNECTIONS) as threads:
                    list(threads.map(download, entries))
        sha256 = _file_hash(path) if entries is None else _folder_hash(path, entries)
        return FetchedFile(location.address, path, state.size, state.mtime_ns, sha256)

    def _cache_path(self, role: str) -> Path:
        """Relative path of a role's file in the cache; files that are found by their place stay
        beside their video.
        """
        location, name = self.locations[role], _safe_name(self.locations[role])
        video = role.removesuffix("_timestamps")
        if video != role:
            return self._cache_path(video).parent / name
        left = self.locations["left"]
        if role.startswith(TELEMETRY_ROLE) or (role == "rig" and location.parent == left.parent):
            return self._cache_path("left").parent / name
        if role == "rig" and location.parent == left:
            return self._cache_path("left") / name
        parent = location.parent
        return (
            Path(role, name)
            if role not in self._entries or parent is None
            else Path(role, _safe_name(parent), name)
        )

    def _download(self, location: Location, path: Path, size: int) -> None:
        with storage_errors(path, "written"):
            path.parent.mkdir(parents=True, exist_ok=True)
        n_bytes = location.download(path, max(self._left_bytes, 0))
        with self._lock:
            self._left_bytes -= n_bytes
        if size >= 0 and n_bytes != size:
            raise StorageError(
                f"{location}: changed while it was downloaded ({size}, then {n_bytes} bytes).",
                "network",
            )


def _file_hash(path: Path) -> str:
    with (
        storage_errors(path, "read"),
        open_regular(path, StorageError, "a file of the clip") as file,
    ):
        return hashlib.file_digest(file, "sha256").hexdigest()


def _folder_hash(folder: Path, entries: list[Entry]) -> str:
    digest = hashlib.sha256()
    for entry in entries:
        name = entry.name.encode("utf-8", "surrogateescape")
        digest.update(b"%d:%s%s" % (len(name), name, _file_hash(folder / entry.name).encode()))
    return digest.hexdigest()


def _is_below(name: str) -> bool:
    """Whether a relative name stays below its folder as a local path; names of objects may be `/x`
    or `../x`.
    """
    return not {"", ".", ".."}.intersection(name.split("/"))


def _safe_name(location: Location) -> str:
    """File name in the cache: the location's name, unless it is too long for a local file."""
    name = location.name.replace("\0", "_").replace("/", "_") or "file"
    if name in (".", ".."):
        return "file"
    data = name.encode("utf-8", "surrogateescape")
    if len(data) <= _MAX_NAME:
        return name
    stem, point, suffix = name.rpartition(".")
    short = stem.encode("utf-8", "surrogateescape")[: _MAX_NAME // 2].decode("utf-8", "ignore")
    return f"{short}-{hashlib.sha256(data).hexdigest()[:16]}{point}{shortened(suffix, 20)}"


def _megabytes(n_bytes: int) -> str:
    return f"{n_bytes / 1e6:.4g} MB"
