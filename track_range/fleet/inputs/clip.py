"""Clip: one recording of a fleet, with its calibration and other files."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from track_range.fleet.storage.location import FileStat, Location
from track_range.foundation.errors import UserError
from track_range.foundation.files.numeric_text import number
from track_range.foundation.options import is_file, option_of, value_type
from track_range.recording.telemetry.sidecars.reading import OXTS_NAME, TABLE_NAME, sidecar_names
from track_range.run.settings import RunSettings

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

        def exists(location: Location, *, is_folder: bool = False) -> bool:
            status = stat(location)
            return status is not None and status.is_folder == is_folder

        files = self.named_files()
        videos = {role: Location.of(files[role]) for role in ("left", "right") if role in files}
        left = videos["left"]
        # elsewhere than on this machine, only a name without a suffix may be a folder
        maybe = [
            role for role, video in videos.items() if video.is_local or "." not in video.name[1:]
        ]
        folders = [role for role in maybe if exists(videos[role], is_folder=True)]
        if "rig" not in files and "focal_px" not in self.settings:
            parents = (left if "left" in folders else None, left.parent)
            candidates = (
                parent.child(name)
                for parent in parents
                if parent is not None
                for name in _RIG_NAMES
            )
            if (rig := next(filter(exists, candidates), None)) is not None:
                files["rig"] = rig.address
        for role in sorted(folders):
            parent = videos[role].parent
            if parent is not None and exists(parent.child(_TIMESTAMPS)):
                files[f"{role}_timestamps"] = parent.child(_TIMESTAMPS).address
        if self.settings.get("ego_speed", "auto") == "auto" and left.parent is not None:
            names = [
                TABLE_NAME,
                OXTS_NAME,
                *(() if "left" in folders else sidecar_names(left.name)),
            ]
            sidecars = [left.parent.child(name) for name in names]
            telemetry = [
                path
                for path in sidecars
                if path != left and exists(path, is_folder=path.name == OXTS_NAME)
            ]
            if sidecars[1] in telemetry and exists(left.parent.child(_TIMESTAMPS)):
                telemetry.append(left.parent.child(_TIMESTAMPS))
            files.update(
                {f"{TELEMETRY_ROLE}{index}": path.address for index, path in enumerate(telemetry)}
            )
        return files


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
