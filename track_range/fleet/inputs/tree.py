"""FileTree: names of all files and folders that are below a folder or match a pattern such as
`DIR/*/front_*.mp4`.
"""

from __future__ import annotations

import posixpath
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

from track_range.fleet.storage.location import Entry, Location, is_hidden
from track_range.foundation.files.images import IMAGE_SUFFIXES
from track_range.recording.video.file_names import VIDEO_SUFFIXES
from track_range.results.events.event import CLIPS_FOLDER, is_clip_name

# for str.endswith
_VIDEO_SUFFIXES, _IMAGE_SUFFIXES = tuple(sorted(VIDEO_SUFFIXES)), tuple(sorted(IMAGE_SUFFIXES))
_BAG_SUFFIXES = (".mcap", ".db3", ".bag")  # suffixes of MCAP files and ROS bags
# files that runs write, which are not recordings
_RESULT_NAMES = ("overlay.mp4", "disparity.mp4", "run.mcap")
# file and folders in the results of a fleet, which may be below the recordings
_FLEET_STATE, _FLEET_FOLDERS = "fleet.json", ("tracks", "events", "runs", "journal", "unfinished")
_BAG_METADATA = "metadata.yaml"  # file that makes a folder a ROS 2 bag
# smallest number of numbered images that make a folder a recording; a single one may be a preview
_MIN_IMAGES = 2
_MAGIC = re.compile(r"[*?\[]")


@dataclass(frozen=True, slots=True)
class FileTree:
    """Names of files and folders relative to a folder, without hidden files and the results of
    fleets.
    """

    folder: Location
    files: frozenset[str]
    folders: frozenset[str]

    @classmethod
    def of_entries(cls, folder: Location, entries: Iterable[Entry]) -> FileTree:
        """The tree of a listing of `folder`."""
        # of files, and of folders: a key may be both
        names: dict[bool, set[str]] = {False: set(), True: set()}
        for entry in entries:
            if not is_hidden(entry.name):
                names[entry.stat.is_folder].add(entry.name)
        fleets = [
            posixpath.dirname(name)
            for name in names[False]
            if posixpath.basename(name) == _FLEET_STATE
        ]
        results = tuple(
            f"{posixpath.join(fleet, name)}/" for fleet in fleets for name in _FLEET_FOLDERS
        )
        return cls(
            folder,
            *(
                frozenset(n for n in names[kind] if not n.startswith(results))
                for kind in (False, True)
            ),
        )

    def __contains__(self, name: str) -> bool:
        return name in self.files or name in self.folders

    def recordings(self) -> list[str]:
        """Names of the videos, bags and folders of numbered images, sorted; "" = the folder
        itself.
        """
        folders = self.recorded_folders()
        names = list(folders)
        for name in self.files:
            folder, last = posixpath.split(name)
            if last in _RESULT_NAMES or (
                posixpath.basename(folder) == CLIPS_FOLDER and is_clip_name(last)
            ):
                continue
            if _is_video_name(name) or (_is_bag_name(name) and folder not in folders):
                names.append(name)
        return sorted(names)

    def recorded_folders(self) -> set[str]:
        """Names of the folders that are one recording: numbered images without videos, or a ROS 2
        bag.
        """
        n_images: Counter[str] = Counter()
        with_videos, bags = set[str](), set[str]()
        for name in self.files:
            folder, last = posixpath.split(name)
            n_images[folder] += is_image_name(name) and any(map(str.isdigit, without_suffix(last)))
            if _is_video_name(name):
                with_videos.add(folder)
            if _is_bag_name(name):
                bags.add(folder)
        images = {
            folder
            for folder, n in n_images.items()
            if n >= _MIN_IMAGES and folder not in with_videos
        }
        return images | {
            folder for folder in bags if posixpath.join(folder, _BAG_METADATA) in self.files
        }


def _is_video_name(name: str) -> bool:
    return name.lower().endswith(_VIDEO_SUFFIXES)


def _is_bag_name(name: str) -> bool:
    return name.lower().endswith(_BAG_SUFFIXES)


def is_image_name(name: str) -> bool:
    """Whether a name has the suffix of an image."""
    return name.lower().endswith(_IMAGE_SUFFIXES)


def without_suffix(name: str) -> str:
    """A relative path without the suffix of its last part."""
    return posixpath.splitext(name)[0]


def wildcard_tree(location: Location) -> FileTree | None:
    """The files that match a pattern, and all files in folders that match; None = no wildcard, or
    an existing path.

    `**` matches any number of folders. Hidden files match no `*`. Raises StorageError.
    """
    address, query = location.address_and_options()
    if not _MAGIC.search(address) or location.exists():
        return None
    parts = address.split("/")
    first = next(index for index, part in enumerate(parts) if _MAGIC.search(part))
    folder = Location.of("/".join(parts[:first]) + query if any(parts[:first]) else "/")
    entries: list[Entry] = []
    for entry in _matching(folder, "", parts[first:]):
        entries.append(entry)
        if entry.stat.is_folder:
            below = folder.child(entry.name).list(recursive=True)
            entries += (Entry(f"{entry.name}/{inner.name}", inner.stat) for inner in below)
    return FileTree.of_entries(folder, entries)


def _matching(folder: Location, prefix: str, patterns: Sequence[str]) -> Iterator[Entry]:
    if patterns[0] == "**":
        for entry in folder.list(recursive=True):
            if not is_hidden(entry.name) and _is_match(entry.name.split("/"), patterns):
                yield Entry(prefix + entry.name, entry.stat)
        return
    for entry in folder.list():
        if not fnmatchcase(entry.name, patterns[0]) or (
            is_hidden(entry.name) and not patterns[0].startswith(".")
        ):
            continue
        if len(patterns) == 1:
            yield Entry(prefix + entry.name, entry.stat)
        elif entry.stat.is_folder:
            yield from _matching(folder.child(entry.name), f"{prefix}{entry.name}/", patterns[1:])


def _is_match(parts: Sequence[str], patterns: Sequence[str]) -> bool:
    if not patterns:
        return not parts
    if patterns[0] == "**":
        return any(_is_match(parts[n:], patterns[1:]) for n in range(len(parts) + 1))
    return bool(parts) and fnmatchcase(parts[0], patterns[0]) and _is_match(parts[1:], patterns[1:])
