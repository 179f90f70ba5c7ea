"""Settings of a run from the command line, `--settings FILE` and the defaults, in this order of
precedence.

`settings.yaml` in the folder of a run contains all of them; `track-range --settings
DIR/settings.yaml` repeats the run.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from track_range.foundation.errors import ConfigError, UsageError
from track_range.foundation.files.input_files import quoted
from track_range.foundation.files.output_files import write_text
from track_range.foundation.files.structured_text import read_yaml, yaml_text
from track_range.foundation.schemas.options import is_file, option_of, value_type
from track_range.foundation.schemas.schema_version import SCHEMA_VERSION
from track_range.foundation.schemas.validation import first_problem
from track_range.recording.video.address import live_address
from track_range.recording.video.names import VideoName, files_of
from track_range.results.formats.provenance import settings_hash
from track_range.run.options.detection import MASK_SUFFIXES
from track_range.run.options.input import plain_name
from track_range.run.options.settings import RunSettings

_FILES = RunSettings.fields_where(is_file)
_INPUT_FILES = _FILES - RunSettings.fields_where(lambda field: option_of(field).is_output)
_PATHS = RunSettings.fields_where(lambda field: value_type(field) is Path)
"""Settings that are, or may be, paths; settings that the run reads; and settings that are always
paths."""


def settings_from(options: Mapping[str, Any], file: Path | None = None) -> RunSettings:
    """Settings from options (None = not given), which override a settings.yaml.

    Invalid or contradicting options raise UsageError, an unreadable file, an unknown key or an
    invalid value in it ConfigError.
    """
    base = read_settings(file) if file else {}
    given = {key: value for key, value in options.items() if value is not None}
    for one, other in (("mono", "stereo"), ("detections", "detector"), ("rig", "focal_px")):
        for key, alternative in ((one, other), (other, one)):
            if key in given and alternative not in given:
                base.pop(alternative, None)
    try:
        settings = RunSettings(**{**base, **given})
    except (ValidationError, UsageError) as error:
        raise _error_of(error, given, base, file) from error
    if base.get("anonymize"):
        _check_anonymized(settings, [key for key in base if key not in given], file)
    return settings


def _check_anonymized(settings: RunSettings, keys: list[str], file: Path | None) -> None:
    """Check that the current folder has the inputs that an anonymized run's file names by `keys`,
    without folders.
    """
    videos = [path for video in settings.videos for path in files_of(video)]
    for key in keys:
        files = videos if key in ("stereo", "mono") else []
        if key in _PATHS & _INPUT_FILES and (path := getattr(settings, key)) is not None:
            files = [path]
        missing = next((path for path in files if not path.exists()), None)
        if missing is not None:
            raise ConfigError(
                f"{file}: the settings of an anonymized run name files without folders, and the "
                f"current folder contains no {quoted(missing.name)}; give {RunSettings.flag(key)} "
                "again."
            )


def _error_of(
    error: ValidationError | UsageError,
    given: dict[str, Any],
    base: dict[str, Any],
    file: Path | None,
) -> ConfigError:
    """The error for invalid settings; it names the file if a value or a contradiction within the
    file is the cause.
    """
    sentence = RunSettings.problem(error) if isinstance(error, ValidationError) else str(error)
    if file is None:
        return UsageError(sentence)
    if isinstance(error, ValidationError) and (place := error.errors(include_url=False)[0]["loc"]):
        if str(place[0]) in given:
            return UsageError(sentence)
        key, problem = first_problem(error)
        is_unknown = error.errors()[0]["type"] == "extra_forbidden"
        return ConfigError(
            f"{file}: {sentence}" if is_unknown else f"{file}: 'run.{key}': {problem}."
        )
    try:
        RunSettings(**base)
    except (ValidationError, UsageError):
        return ConfigError(f"{file}: {sentence}")
    return UsageError(f"{sentence.removesuffix('.')} (with the settings of {file}).")


def read_settings(file: Path) -> dict[str, Any]:
    """Values in a settings.yaml, which are not validated; ConfigError if it cannot be read, or is
    another file.
    """
    document = read_yaml(file, ConfigError, "the settings.yaml of a run")
    if not isinstance(document, dict) or document.get("track_range_settings") != 1:
        raise ConfigError(
            f"{file}: expected the settings.yaml of a run, with the key 'track_range_settings: 1'."
        )
    run, methods = document.get("run"), document.get("methods")
    if isinstance(methods, dict) and methods:
        from track_range.ranging.registry import methods as registered

        known = {method.name for method in registered()}
        for name in methods.keys() - known:
            raise ConfigError(
                f"{file}: expected the ranging method {name!r} ({methods[name]}), but it is not "
                "registered; install its package, register it before the run, or delete it from "
                "the section 'methods'."
            )
    if not isinstance(run, dict) or not all(isinstance(key, str) for key in run):
        raise ConfigError(f"{file}: expected a section 'run:' with the settings of the run.")
    return run


def save_settings(
    settings: RunSettings, path: Path, *, detected: dict[str, Any] | None = None
) -> None:
    """Write settings.yaml: the settings with absolute paths under `run`, properties of the inputs
    under `found`.

    `methods` are the origins of the ranging methods that are not built in.
    """
    from track_range.ranging.registry import origins  # imports numpy, which --help does not need

    run, methods = absolute_settings(settings), origins()
    head = {
        "track_range_settings": 1,
        "schema_version": SCHEMA_VERSION,
        "settings_hash": settings_hash(run, methods),
    }
    others = ({"methods": methods} if methods else {}) | (
        {} if detected is None else {"found": detected}
    )
    write_text(path, yaml_text({**head, "run": run, **others}))


def absolute_settings(settings: RunSettings) -> dict[str, Any]:
    """Settings as in settings.yaml: plain values, with absolute paths; file names only if the run
    is anonymized.
    """
    run: dict[str, Any] = settings.model_dump(mode="json", exclude_none=True)
    for key in _FILES & run.keys():
        if key in _PATHS or os.path.exists(run[key]):  # False for a name that is too long
            run[key] = os.path.realpath(run[key])

    def absolute(video: VideoName) -> str | list[str]:
        return plain_name(
            video, lambda path: os.path.realpath(path) if isinstance(path, Path) else str(path)
        )

    if settings.stereo:
        run["stereo"] = [absolute(video) for video in settings.stereo]
    if settings.mono:
        run["mono"] = absolute(settings.mono)
    return without_folders(run) if settings.anonymize else run


def without_folders(run: Mapping[str, Any]) -> dict[str, Any]:
    """Settings or inputs with the names of files instead of their paths, which may contain the name
    of a person.
    """
    keys = _FILES | {"stereo", "mono", "left", "right"}
    if not str(run.get("ignore")).lower().endswith(MASK_SUFFIXES):
        keys -= {"ignore"}
    return {key: _name(value) if key in keys else value for key, value in run.items()}


def _name(value: Any) -> Any:
    """File name of a path, or of each path of a list; addresses of streams are kept."""
    if isinstance(value, list | tuple):
        return [_name(path) for path in value]
    return value if live_address(value) else os.path.basename(os.path.normpath(value))


def input_files(settings: RunSettings) -> list[Path]:
    """All files that a run reads, and words given instead of files."""
    named = (getattr(settings, name) for name in RunSettings.model_fields if name in _INPUT_FILES)
    videos = (file for video in settings.videos for file in files_of(video))
    return [*videos, *(Path(name) for name in named if name is not None)]
