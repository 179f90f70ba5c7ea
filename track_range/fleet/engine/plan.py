"""Plan of a fleet: what every worker has to know, and the hash of the settings that all clips have in common."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from track_range.detection.classes import road_class_ids
from track_range.detection.models.lookup import find_model
from track_range.fleet.inputs.clip import Clip
from track_range.fleet.output.record import Row
from track_range.fleet.settings import FleetSettings
from track_range.foundation.errors import ConfigError, UsageError
from track_range.foundation.files.input_files import open_regular
from track_range.foundation.files.numeric_text import number
from track_range.foundation.options import is_file, option_of
from track_range.ranging.size_models.curve import load_curves
from track_range.recording.telemetry.speed_source import AUTO, OFF
from track_range.run.options.opened import DetectorOptions, open_detector
from track_range.run.settings import RunSettings
from track_range.run.settings_files import read_settings, settings_from

_NOT_TAKEN = RunSettings.fields_where(lambda field: option_of(field).instead) | (
    RunSettings.model_fields.keys() & FleetSettings.model_fields.keys()
)
"""Options of a run that belong to its clips, or are options of a fleet with another meaning."""

_OUTPUTS = RunSettings.fields_where(lambda field: option_of(field).is_output)
"""Options of a run for its outputs, which a fleet does not take from the settings.yaml of a run."""

_SHARED_FILES = RunSettings.fields_where(is_file) - _NOT_TAKEN
"""Settings of a run that are, or may be, files which all clips share."""


@dataclass(frozen=True, slots=True)
class ClipTask:
    """A clip for a worker.

    Attributes:
        clip: the clip.
        attempt: number of the attempt, from 1.
        known_hash: content hash of the complete result, if the files have only been touched since; "" = none.
    """

    clip: Clip
    attempt: int = 1
    known_hash: str = ""


@dataclass(frozen=True, slots=True)
class ClipOutcome:
    """Answer of a worker about a clip.

    Attributes:
        row: record of the clip, by column.
        is_published: whether the worker has published the record.
        is_unchanged: whether the content of the files is that of the complete result; only `inputs` of the row counts.
        is_transient: whether the failure may not repeat itself.
        fatal: why the fleet cannot continue, one sentence; "" = it can.
    """

    row: Row
    is_published: bool = False
    is_unchanged: bool = False
    is_transient: bool = False
    fatal: str = ""


@dataclass(slots=True)
class ClipProgress:
    """Progress of the clip that a worker is at; written by one thread and read by another.

    Attributes:
        clip: name of the clip; "" = none.
        phase: "idle", "fetching", "opening", "processing" or "publishing".
        frames: frames processed.
        video_s: duration of the video, s; 0 = not known yet.
        fetch_bytes: bytes to download.
    """

    clip: str = ""
    phase: str = "idle"
    frames: int = 0
    video_s: float = 0.0
    fetch_bytes: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetPlan:
    """What every worker has to know.

    Attributes:
        out: folder of the results, as text.
        options: options of the runs by name of the setting.
        threads: CPU threads of a worker.
        has_reports: whether the report of each run is published.
        cache_dir: folder for remote recordings; None = the temporary folder.
        cache_bytes: size limit of a remote clip.
        settings_hash: hash of the settings that all clips have in common.
        shared: SHA-256 of the files that all clips share, by setting.
        version: version of track-range.
    """

    out: str
    options: Mapping[str, Any]
    threads: int = 1
    has_reports: bool = False
    cache_dir: Path | None = None
    cache_bytes: int = 20 * 10**9
    settings_hash: str = ""
    shared: Mapping[str, str] = field(default_factory=dict)
    version: str = field(default_factory=lambda: version("track-range"))

    @property
    def is_anonymized(self) -> bool:
        """Whether the results contain no folder names."""
        return bool(self.options.get("anonymize"))


Process = Callable[[ClipTask, FleetPlan, ClipProgress], ClipOutcome]
"""Processes a clip in a worker."""


def common_options(file: Path) -> dict[str, Any]:
    """Options of the settings.yaml of a run for all clips: without its inputs and outputs.

    Raises:
        ConfigError: the file cannot be read, or contains an unknown key or an invalid value.
    """
    values = read_settings(file)
    options = {key: value for key, value in values.items() if key not in _NOT_TAKEN | _OUTPUTS}
    try:
        _validated(options)
    except UsageError as error:
        raise ConfigError(f"{file}: {error}") from error
    return options


def fleet_plan(settings: FleetSettings, options: Mapping[str, Any]) -> FleetPlan:
    """Plan of the settings.

    Args:
        settings: of the fleet.
        options: given options of the runs, by name of the setting.

    Raises:
        UsageError: an option is invalid, or one that a fleet does not take.
        ModelError, ConfigError: a shared file cannot be read.
    """
    for name in options:
        field = RunSettings.model_fields.get(name)
        if field is not None and (instead := option_of(field).instead):
            raise UsageError(f"{RunSettings.flag(name)}: not an option of a fleet; {instead}.")
    given = {"overlay": False, **options, "threads": settings.threads}
    checked = _validated(given)
    _check_ego_speed(checked.ego_speed)
    files = _shared_files(checked)
    shared = {name: _sha256(path) for name, path in files.items()}
    _check_models(checked, files)
    return FleetPlan(
        out=settings.out,
        options={**given, **{name: str(path) for name, path in files.items() if name in given}},
        threads=settings.threads,
        has_reports=settings.reports,
        cache_dir=settings.cache_dir,
        cache_bytes=settings.cache_bytes,
        settings_hash=_settings_hash(checked, shared, has_reports=settings.reports),
        shared=shared,
    )


def _validated(options: Mapping[str, Any]) -> RunSettings:
    """Settings of a run with these options; the names of its videos do not matter.

    Raises:
        UsageError: an option is unknown or invalid.
    """
    topics = options.get("topics") or ()
    n_topics = (
        len(topics.split(",")) if isinstance(topics, str) else len(topics) if isinstance(topics, list | tuple) else 0
    )
    is_pair = options.get("disparity") or options.get("overlay_disparity") or n_topics > 1
    return settings_from({**options, **({"stereo": ("left.mp4", "right.mp4")} if is_pair else {"mono": "clip.mp4"})})


def _check_ego_speed(setting: str) -> None:
    if setting not in (AUTO, OFF) and math.isnan(number(setting)):
        raise UsageError(
            "--ego-speed: expected auto, off, or a number of km/h for all clips; give files in the column ego_speed of "
            "a manifest."
        )


def _shared_files(settings: RunSettings) -> dict[str, Path]:
    """Files of the settings that all clips share; the others are words."""
    files: dict[str, Path] = {}
    for name in sorted(_SHARED_FILES):
        value = getattr(settings, name)
        if name == "detector" and value is not None:
            model = find_model(value)
            if model.origin != "catalogue" or model.entry is None:
                files[name] = model.path.absolute()
        elif isinstance(value, Path) or (value is not None and Path(value).suffix and math.isnan(number(value))):
            files[name] = Path(value).absolute()
    return files


def _check_models(settings: RunSettings, files: Mapping[str, Path]) -> None:
    """Check the detector and the size curves once, instead of in every clip.

    Raises:
        ModelError, ConfigError, CurveError, ...: they cannot be used.
    """
    load_curves(settings.curves)
    road_class_ids(settings.classes)
    if (detector := files.get("detector")) is not None:
        open_detector(detector, replace(DetectorOptions.of(settings), device="cpu"))


def _sha256(path: Path) -> str:
    with open_regular(path, UsageError, "a file of the settings") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _settings_hash(settings: RunSettings, shared: Mapping[str, str], *, has_reports: bool) -> str:
    """Hash of the settings in canonical JSON: files by their content, and the version of track-range."""
    values = settings.model_dump(mode="json", exclude_none=True)
    hashed = {key: value for key, value in values.items() if key not in _NOT_TAKEN}
    hashed.update({name: f"sha256:{digest}" for name, digest in shared.items()})
    content = {"run": hashed, "reports": has_reports, "version": version("track-range")}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return f"sha256:{hashlib.sha256(text.encode()).hexdigest()}"
