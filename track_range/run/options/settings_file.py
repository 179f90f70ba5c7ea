"""settings.yaml, which contains all settings of a run; `track-range --settings DIR/settings.yaml`
repeats the run.
"""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from track_range.foundation.errors import ConfigError
from track_range.foundation.files.output_files import OutputError, write_text
from track_range.foundation.files.structured_text import read_yaml, yaml_text
from track_range.foundation.schemas.schema_version import SCHEMA_VERSION
from track_range.recording.sources.names import VideoName
from track_range.results.formats.provenance import settings_hash
from track_range.run.options.anonymity import without_folders
from track_range.run.options.input import plain_name
from track_range.run.options.paths import FILES, PATHS
from track_range.run.options.settings import RunSettings

# of `folder_fps`, which files of earlier versions also have for videos with a rate of their own
_FORMER_DEFAULT_HZ = 10.0


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
    if run.get("folder_fps") == _FORMER_DEFAULT_HZ:
        del run["folder_fps"]
    return RunSettings.with_current_names(run)


def save_settings(
    settings: RunSettings,
    path: Path,
    *,
    detected: dict[str, Any] | None = None,
    file_hashes: Mapping[str, Sequence[str]] | None = None,
) -> None:
    """Write settings.yaml: the settings with absolute paths under `run`, properties of the inputs
    under `found`.

    `methods` are the origins of the ranging methods that are not built in. `file_hashes` are the
    hashes of the files that the run reads, which `settings_hash` covers.
    """
    from track_range.ranging.registry import origins  # imports numpy, which --help does not need

    run, methods = absolute_settings(settings), origins()
    head = {
        "track_range_settings": 1,
        "schema_version": SCHEMA_VERSION,
        "settings_hash": settings_hash(run, methods, file_hashes),
    }
    others = ({"methods": methods} if methods else {}) | (
        {} if detected is None else {"found": detected}
    )
    write_text(path, yaml_text({**head, "run": run, **others}))


def check_replaceable(settings: RunSettings, folder: Path) -> None:
    """Raise OutputError if a folder has the results of another recording, which a run would
    replace.
    """
    try:
        earlier = read_settings(folder / "settings.yaml")
    except ConfigError:
        return
    present = absolute_settings(settings)
    if earlier.get("anonymize") or settings.anonymize:
        earlier, present = without_folders(earlier), without_folders(present)
    # a pair with the left recording of an earlier run is of the same drive
    before, now = ((run.get("stereo") or [run.get("mono")])[0] for run in (earlier, present))
    if settings.overwrite or before is None or before == now:
        return
    name = ", ".join(map(str, before)) if isinstance(before, list) else before
    raise OutputError(
        f"{folder}: expected no results, or those of this recording, found those of {name}; give "
        "another folder (--out), or replace them (--overwrite)."
    )


def absolute_settings(settings: RunSettings) -> dict[str, Any]:
    """Settings as in settings.yaml: plain values, with absolute paths; file names only if the run
    is anonymized.
    """
    run: dict[str, Any] = settings.model_dump(mode="json", exclude_none=True)
    for key in FILES & run.keys():
        if isinstance(run[key], list):
            run[key] = [os.path.realpath(path) for path in run[key]]
        elif key in PATHS or os.path.exists(run[key]):  # False for a name that is too long
            run[key] = os.path.realpath(run[key])

    def absolute(video: VideoName) -> str | list[str]:
        return plain_name(video, os.path.realpath)

    if settings.stereo:
        run["stereo"] = [absolute(video) for video in settings.stereo]
    if settings.mono:
        run["mono"] = absolute(settings.mono)
    return without_folders(run) if settings.anonymize else run
