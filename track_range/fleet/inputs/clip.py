"""Clip: one recording of a fleet, with its calibration and other files."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

from track_range.fleet.storage.location import FileStat, Location
from track_range.foundation.errors import UserError
from track_range.foundation.files.numeric_text import number
from track_range.foundation.schemas.options import is_file, is_path, option_of
from track_range.recording.telemetry.companions import Role, companions
from track_range.recording.telemetry.sidecars.reading import OXTS_NAME
from track_range.recording.telemetry.speed_files import OXTS_TIMES
from track_range.run.options.settings import RunSettings

# that may differ between clips
CLIP_SETTINGS = RunSettings.fields_where(lambda field: option_of(field).is_per_clip)
# prefix of the roles of telemetry beside the left video, which a run finds by its place
TELEMETRY_ROLE = "telemetry_"


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
        beside = {role: _Neighbours.of(video, stat) for role, video in videos.items()}
        left = beside["left"]
        if "rig" not in files and "focal_px" not in self.settings:
            rig = next(left.existing("rig", is_inside=True), None)
            if rig is not None:
                files["rig"] = rig.address
        for role, neighbours in beside.items():
            times = next(neighbours.existing("times"), None)
            if times is not None:
                files[f"{role}_timestamps"] = times.address
        if self.settings.get("ego_speed", "auto") == "auto":
            for index, location in enumerate(left.telemetry()):
                files[f"{TELEMETRY_ROLE}{index}"] = location.address
        return files


@dataclass(frozen=True, slots=True)
class _Neighbours:
    """The files that a run finds by their places beside a video."""

    video: Location
    is_folder: bool  # whether the video is a folder of images
    stat: Callable[[Location], FileStat | None]

    @classmethod
    def of(cls, video: Location, stat: Callable[[Location], FileStat | None]) -> _Neighbours:
        """Those of a video, which `stat` looks up."""
        state = stat(video) if _may_be_folder(video) else None
        return cls(video, state is not None and state.is_folder, stat)

    def existing(self, role: Role, *, is_inside: bool = False) -> Iterator[Location]:
        """The existing files of a role, in order; `is_inside`: also in a folder of images."""
        folders = [self.video] if is_inside and self.is_folder else []
        if self.video.parent is not None:
            folders.append(self.video.parent)
        names = companions(self.video.name, is_folder=self.is_folder)[role]
        for folder in folders:
            for name in names:
                location = folder.child(name.rstrip("/"))
                is_folder = name.endswith("/")
                if location != self.video and self._exists(location, is_folder=is_folder):
                    yield location

    def telemetry(self) -> list[Location]:
        """Tables and folders of telemetry, with the times of OXTS files."""
        files = [*self.existing("speed"), *self.existing("telemetry")]
        times = [
            location.parent.child(OXTS_TIMES)
            for location in files
            if location.name == OXTS_NAME and location.parent is not None
        ]
        return [*files, *(location for location in times if self._exists(location))]

    def _exists(self, location: Location, *, is_folder: bool = False) -> bool:
        status = self.stat(location)
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
    if field is None or is_path(field):
        return field is not None
    return is_file(field) and value not in option_of(field).words and math.isnan(number(value))
