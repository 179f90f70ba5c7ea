"""Clip: one recording of a fleet, with its calibration and other files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from track_range.fleet.storage.location import Location
from track_range.foundation.errors import UserError
from track_range.foundation.files.numeric_text import number

FILE_SETTINGS = frozenset(("rig", "truth", "detections", "curves"))
"""Settings of a clip that are files."""

_FILE_OR_WORD_SETTINGS: Mapping[str, frozenset[str]] = {"ego_speed": frozenset(), "align": frozenset(("auto", "off"))}
"""Settings of a clip that are a file, a number, or one of these words."""

CLIP_SETTINGS = (
    FILE_SETTINGS
    | _FILE_OR_WORD_SETTINGS.keys()
    | frozenset(
        ("topics", "focal_px", "start_s", "duration_s", "folder_fps", "start_utc", "camera_height_m", "lane_width_m")
    )
)
"""Names of the run settings that may differ from clip to clip."""

_RIG_NAMES = ("rig.yaml", "calib.txt")
"""Calibration files that a run uses if they lie beside the left video, in order of precedence."""


class FleetInputError(UserError):
    """Recordings, a pattern or a manifest that cannot be used."""


@dataclass(frozen=True, slots=True)
class Clip:
    """One recording.

    Attributes:
        name: name that is unique in the fleet.
        left: the left or only video: absolute local path, or address (`s3://...`).
        right: the right video; None = one camera.
        settings: run settings that apply only to this clip, as text by name; see `CLIP_SETTINGS`. Files are absolute.
        labels: other properties, such as the vehicle; columns of clips.parquet.
        problem: reason why the clip cannot be processed, one sentence; "" = none is known.
    """

    name: str
    left: str
    right: str | None = None
    settings: Mapping[str, str] = field(default_factory=dict)
    labels: Mapping[str, str] = field(default_factory=dict)
    problem: str = ""

    def named_files(self) -> dict[str, str]:
        """The files that the clip names, by role: left, right, and settings that are files."""
        right = {} if self.right is None else {"right": self.right}
        given = {name: value for name, value in self.settings.items() if is_file_setting(name, value)}
        return {"left": self.left, **right, **given}

    def files(self, existing: Iterable[str] | None = None) -> dict[str, str]:
        """All files on which the results depend, by role, including a calibration file beside the left video.

        Args:
            existing: paths of the files that exist, from a listing; None = look the calibration file up.

        Raises:
            StorageError: the storage cannot be reached.
        """
        files = self.named_files()
        if "rig" not in files and "focal_px" not in self.settings and (rig := self._rig_beside(existing)) is not None:
            files["rig"] = rig
        return files

    def _rig_beside(self, existing: Iterable[str] | None) -> str | None:
        """The calibration file that a run without --rig uses; None = there is none."""
        left = Location.of(self.left)
        folders = (left.parent, left) if left.parent is None or left.is_folder() else (left.parent,)
        for folder in (folder for folder in folders if folder is not None):
            for name in _RIG_NAMES:
                candidate = folder.child(name)
                is_there = candidate.exists() if existing is None else candidate.address in existing
                if is_there:
                    return candidate.address
        return None


def is_file_setting(name: str, value: str) -> bool:
    """Whether the value of a clip's setting is the path of a file or folder."""
    if name in FILE_SETTINGS:
        return True
    words = _FILE_OR_WORD_SETTINGS.get(name)
    return words is not None and value not in words and number(value) != number(value)
