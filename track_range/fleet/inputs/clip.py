"""Clip: one recording of a fleet, with its calibration and other files."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from track_range.fleet.storage.location import FileStat, Location
from track_range.foundation.errors import UserError
from track_range.foundation.files.numeric_text import number
from track_range.foundation.schemas.options import is_file, option_of, value_type
from track_range.recording.telemetry.sidecars.reading import OXTS_NAME, TABLE_NAME, sidecar_names
from track_range.run.options.settings import RunSettings

# that may differ between clips
CLIP_SETTINGS = RunSettings.fields_where(lambda field: option_of(field).is_per_clip)
# prefix of the roles of telemetry beside the left video, which a run finds by its place
TELEMETRY_ROLE = "telemetry_"
# calibration files that a run finds beside the left video, the first counts
_RIG_NAMES = ("rig.yaml", "calib.txt")
# file with the times of the images in a folder, which may lie beside it (KITTI)
_TIMESTAMPS = "timestamps.txt"


class FleetInputError(UserError):
    """Recordings, a pattern or a manifest that cannot be used."""


@dataclass(frozen=True, slots=True)
class Clip:
    """One recording, with a name that is unique in the fleet."""

    name: str
    left: str  # the left or only video: absolute local path, or address (`s3://...`)
    right: str | None = None  # None = one camera
    # as text (`CLIP_SETTINGS`), files absolute
    settings: Mapping[str, str] = field(default_factory=dict)
    # such as the vehicle; columns of clips.parquet
    labels: Mapping[str, str] = field(default_factory=dict)
    problem: str = ""  # why the clip cannot be processed, one sentence; "" = none is known

    def named_files(self) -> dict[str, str]:
        """The files that the clip names, by role: left, right, and settings that are files."""
        videos = (
            {"left": self.left} if self.right is None else {"left": self.left, "right": self.right}
        )
        return videos | {
            name: value for name, value in self.settings.items() if is_file_setting(name, value)
        }

    def files(self, stat: Callable[[Location], FileStat | None] = Location.stat) -> dict[str, str]:
        """All files on which the results depend, by role.

        These are the named files, a calibration file and telemetry beside the left video, and the
        timestamps.txt beside a folder of images. `stat` looks a file up; `FolderListings.stat` does
        it with fewer requests. Raises StorageError.
        """
        files = self.named_files()
        videos: dict[str, Location] = {
            role: Location.of(files[role]) for role in ("left", "right") if role in files
        }
        beside = _FilesBeside(videos, stat)
        if "rig" not in files and "focal_px" not in self.settings:
            rig = beside.calibration()
            if rig is not None:
                files["rig"] = rig.address
        for role, timestamps in beside.timestamps().items():
            files[f"{role}_timestamps"] = timestamps.address
        if self.settings.get("ego_speed", "auto") == "auto":
            for index, location in enumerate(beside.telemetry()):
                files[f"{TELEMETRY_ROLE}{index}"] = location.address
        return files


class _FilesBeside:
    """Looks up the files that a run finds by their places beside the videos of a clip, "left" and
    perhaps "right".
    """

    def __init__(
        self, videos: Mapping[str, Location], stat: Callable[[Location], FileStat | None]
    ) -> None:
        self._videos, self._stat, self._left = videos, stat, videos["left"]
        self._folders = [
            role
            for role, video in sorted(videos.items())
            if _may_be_folder(video) and self._exists(video, is_folder=True)
        ]

    def calibration(self) -> Location | None:
        """The calibration in the left folder of images, or beside the left video."""
        folders = [self._left] if "left" in self._folders else []
        if self._left.parent is not None:
            folders.append(self._left.parent)
        candidates = (folder.child(name) for folder in folders for name in _RIG_NAMES)
        return next(filter(self._exists, candidates), None)

    def timestamps(self) -> dict[str, Location]:
        """The times of the images in folders, by the role of the folder."""
        beside = {role: self._timestamps_in(self._videos[role].parent) for role in self._folders}
        return {role: location for role, location in beside.items() if location is not None}

    def telemetry(self) -> list[Location]:
        """Tables and folders of telemetry beside the left video, with the times of OXTS files."""
        folder = self._left.parent
        if folder is None:
            return []
        names = [TABLE_NAME, OXTS_NAME]
        if "left" not in self._folders:
            names += sidecar_names(self._left.name)
        files = [
            folder.child(name)
            for name in names
            if folder.child(name) != self._left
            and self._exists(folder.child(name), is_folder=name == OXTS_NAME)
        ]
        timestamps = self._timestamps_in(folder) if folder.child(OXTS_NAME) in files else None
        return files if timestamps is None else [*files, timestamps]

    def _timestamps_in(self, folder: Location | None) -> Location | None:
        if folder is None or not self._exists(folder.child(_TIMESTAMPS)):
            return None
        return folder.child(_TIMESTAMPS)

    def _exists(self, location: Location, *, is_folder: bool = False) -> bool:
        status = self._stat(location)
        return status is not None and status.is_folder == is_folder


def _may_be_folder(video: Location) -> bool:
    """Elsewhere than on this machine, only a name without a suffix may be a folder."""
    return video.is_local or "." not in video.name[1:]


def file_title(role: str) -> str:
    """Name of the file of a role, for messages."""
    return {"left": "the left video", "right": "the right video", "rig": "the calibration"}.get(
        role, f"the {role} file"
    )


def is_file_setting(name: str, value: str) -> bool:
    """Whether the value of a clip's setting is the path of a file or folder."""
    field = RunSettings.model_fields.get(name)
    if field is None or value_type(field) is Path:
        return field is not None
    return is_file(field) and value not in option_of(field).words and math.isnan(number(value))
