"""Anonymized runs: their settings and notes name files without folders, whose names may be those of
people.
"""

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from track_range.foundation.errors import ConfigError
from track_range.foundation.files.input_files import quoted
from track_range.recording.sources.live.address import live_address
from track_range.recording.sources.names import source_of
from track_range.run.options.detection import MASK_SUFFIXES
from track_range.run.options.paths import FILES, INPUT_FILES, PATHS, paths_of
from track_range.run.options.settings import RunSettings

ANONYMIZED = (
    "Anonymized: the heads of detected or tracked people and riders and the number plates of "
    "detected or tracked vehicles are covered in all images of the results. Undetected heads and "
    "plates are not covered: check the videos before you share them."
)


def without_folders(run: Mapping[str, Any]) -> dict[str, Any]:
    """Settings or inputs with the names of files instead of their paths, which may contain the name
    of a person.
    """
    keys = FILES | {"stereo", "mono", "left", "right"}
    if not str(run.get("ignore")).lower().endswith(MASK_SUFFIXES):
        keys -= {"ignore"}
    return {key: _name(value) if key in keys else value for key, value in run.items()}


def _name(value: Any) -> Any:
    """File name of a path, or of each path of a list; addresses of streams are kept."""
    if isinstance(value, list | tuple):
        return [_name(path) for path in value]
    return value if live_address(value) else os.path.basename(os.path.normpath(value))


def check_named_files(settings: RunSettings, keys: list[str], file: Path | None) -> None:
    """Check that the current folder has the inputs that an anonymized run's file names by `keys`,
    without folders.
    """
    videos = [path for video in settings.videos for path in source_of(video).files]
    for key in keys:
        files = videos if key in ("stereo", "mono") else []
        if key in PATHS & INPUT_FILES:
            files = paths_of(getattr(settings, key))
        missing = next((path for path in files if not path.exists()), None)
        if missing is not None:
            raise ConfigError(
                f"{file}: the settings of an anonymized run name files without folders, and the "
                f"current folder contains no {quoted(missing.name)}; give {RunSettings.flag(key)} "
                "again."
            )


def without_paths(note: str, paths: Iterable[Path]) -> str:
    """A note with the names of files instead of their paths, and without the home folder."""
    for path in paths:
        for text in (os.path.realpath(path), str(path)):
            note = note.replace(text, path.name) if os.sep in text else note
    return note.replace(str(Path.home()), "~")
