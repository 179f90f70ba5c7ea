"""FileTree: names of all files and folders below a folder, and which of them are recordings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from track_range.fleet.storage.entry import Entry, is_hidden
from track_range.fleet.storage.location import Location
from track_range.foundation.files.images import IMAGE_SUFFIXES
from track_range.recording.segments.segmented_video import VIDEO_SUFFIXES
from track_range.results.events.event import CLIPS_FOLDER, is_clip_name

_VIDEO_SUFFIXES, _IMAGE_SUFFIXES = tuple(sorted(VIDEO_SUFFIXES)), tuple(sorted(IMAGE_SUFFIXES))
"""Suffixes as `str.endswith` needs them, which is called for every file."""

_BAG_SUFFIXES = (".mcap", ".db3", ".bag")
"""Suffixes of MCAP files and ROS bags."""

_RESULT_NAMES = frozenset(("overlay.mp4", "disparity.mp4", "run.mcap"))
"""Files that runs write, which are not recordings."""

_FLEET_STATE, _FLEET_FOLDERS = "fleet.json", ("tracks", "events", "runs", "journal", "unfinished")
"""File and folders in the results of a fleet, which may be below the recordings."""

_BAG_METADATA = "metadata.yaml"
"""File that makes a folder a ROS 2 bag."""

_MIN_IMAGES = 2
"""Smallest number of numbered images that make a folder a recording; a single one may be a preview."""


@dataclass(frozen=True, slots=True)
class FileTree:
    """Names relative to the folder, without hidden files and the results of fleets.

    Attributes:
        folder: the folder.
        files: names of the files.
        folders: names of the folders.
    """

    folder: Location
    files: frozenset[str]
    folders: frozenset[str]

    @classmethod
    def of(cls, folder: Location) -> FileTree:
        """All that is below a folder.

        Raises:
            StorageError: it cannot be read.
        """
        return cls.of_entries(folder, folder.list(recursive=True))

    @classmethod
    def of_entries(cls, folder: Location, entries: Iterable[Entry]) -> FileTree:
        """The tree of a listing of `folder`."""
        files: list[str] = []
        folders: list[str] = []
        for entry in entries:
            if not is_hidden(entry.name):
                (folders if entry.stat.is_folder else files).append(entry.name)
        fleets = {_folder(name) for name in files if _last(name) == _FLEET_STATE}
        results = tuple(f"{_joined(fleet, name)}/" for fleet in fleets for name in _FLEET_FOLDERS)
        return cls(folder, _outside(files, results), _outside(folders, results))

    def __contains__(self, name: str) -> bool:
        return name in self.files or name in self.folders

    def recordings(self) -> list[str]:
        """Names of the videos, bags and folders of numbered images, sorted; "" = the folder itself."""
        folders = self.recorded_folders()
        videos = (
            name
            for name in self.files
            if (is_video_name(name) or is_bag_name(name))
            and _last(name) not in _RESULT_NAMES
            and not (_last(_folder(name)) == CLIPS_FOLDER and is_clip_name(_last(name)))
            and not (is_bag_name(name) and _folder(name) in folders)
        )
        return sorted((*videos, *folders))

    def recorded_folders(self) -> set[str]:
        """Names of the folders that are one recording: numbered images without videos, or a ROS 2 bag."""
        n_images = Counter(_folder(name) for name in self.files if is_image_name(name) and _has_digit(_last(name)))
        with_videos = {_folder(name) for name in self.files if is_video_name(name)}
        images = {folder for folder, n in n_images.items() if n >= _MIN_IMAGES and folder not in with_videos}
        bags = {_folder(name) for name in self.files if is_bag_name(name)}
        return images | {folder for folder in bags if _joined(folder, _BAG_METADATA) in self.files}


def _outside(names: list[str], folders: tuple[str, ...]) -> frozenset[str]:
    """The names that are not in one of the folders, which end with a slash."""
    return frozenset(name for name in names if not name.startswith(folders)) if folders else frozenset(names)


def is_video_name(name: str) -> bool:
    """Whether a name has the suffix of a video file."""
    return name.lower().endswith(_VIDEO_SUFFIXES)


def is_bag_name(name: str) -> bool:
    """Whether a name has the suffix of an MCAP file or ROS bag."""
    return name.lower().endswith(_BAG_SUFFIXES)


def is_image_name(name: str) -> bool:
    """Whether a name has the suffix of an image."""
    return name.lower().endswith(_IMAGE_SUFFIXES)


def without_suffix(name: str) -> str:
    """A relative path without the suffix of its last part."""
    suffix = _suffix(name)
    return name[: len(name) - len(suffix)] if suffix else name


def _suffix(name: str) -> str:
    """Suffix in lower case, with its point; "" = none."""
    stem, point, suffix = _last(name).rpartition(".")
    return f".{suffix.lower()}" if stem and point else ""


def _last(name: str) -> str:
    return name.rpartition("/")[2]


def _folder(name: str) -> str:
    return name.rpartition("/")[0]


def _joined(folder: str, name: str) -> str:
    return f"{folder}/{name}" if folder else name


def _has_digit(name: str) -> bool:
    return any(character.isdigit() for character in without_suffix(name))
