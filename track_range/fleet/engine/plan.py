"""Plan of a fleet: the data for every worker, and the hash of the settings that all clips have in
common.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence, Sized
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

from track_range.detection.catalogue.lookup import find_model
from track_range.detection.classes import road_class_ids
from track_range.fleet.inputs.clip import Clip
from track_range.fleet.output.record import ClipRecord, Row
from track_range.fleet.settings import FleetSettings
from track_range.fleet.storage.location import Location
from track_range.foundation.errors import ConfigError, UsageError
from track_range.foundation.files.input_files import open_regular
from track_range.foundation.files.numeric_text import number
from track_range.foundation.schemas.options import is_file, option_of
from track_range.ranging.registry import origins
from track_range.ranging.size_models.curve import load_curves
from track_range.recording.speed_source import AUTO, OFF
from track_range.run.options.anonymity import without_folders
from track_range.run.options.detection import MASK_SUFFIXES
from track_range.run.options.opened import DetectorOptions, open_detector
from track_range.run.options.opened_methods import check_networks
from track_range.run.options.paths import NETWORKS, network_files, paths_of
from track_range.run.options.precedence import settings_from
from track_range.run.options.settings import RunSettings
from track_range.run.options.settings_file import read_settings

# of clips, or with another meaning
_NOT_TAKEN = RunSettings.fields_where(lambda field: option_of(field).instead) | (
    RunSettings.model_fields.keys() & FleetSettings.model_fields.keys()
)
_STAGES = {name: RunSettings.stage_of(name) for name in RunSettings.model_fields}
# options that select files of results; not taken from a settings.yaml
OUTPUTS = {name for name, stage in _STAGES.items() if stage == "outputs"}
# options of estimates of cameras besides those of detections
_OF_CAMERAS = ("curves", "camera_model", "lens_fov_deg")
# that are, or may be, files which all clips share
_SHARED_FILES = RunSettings.fields_where(is_file) - _NOT_TAKEN

# settings that fleet.json of an anonymized fleet does not contain, since they name folders
_WITH_FOLDERS = ("recordings", "out", "pattern", "rig", "settings", "cache_dir")


class FileNames:
    """Names of the videos of a clip ("" = one camera), if anonymized without folders, which may
    name a person.
    """

    def __init__(self, clip: Clip, *, is_anonymized: bool) -> None:
        self._is_anonymized = is_anonymized
        left, right = (
            Location.of(clip.left),
            None if clip.right is None else Location.of(clip.right),
        )
        self.left = left.name if is_anonymized else str(left)
        self.right = "" if right is None else right.name if is_anonymized else str(right)
        folders = {
            text
            for address in clip.named_files().values()
            for text in _folders(Location.of(address))
        }
        self._folders = sorted(folders, key=len, reverse=True) if is_anonymized else []

    def text(self, text: str) -> str:
        """A message about the clip, without the folders if names are anonymized."""
        if not self._is_anonymized:
            return text
        for folder in self._folders:
            text = text.replace(folder, "")
        return text.replace(str(Path.home()), "~")


def _folders(location: Location) -> Iterable[str]:
    """Texts before the name of a file, as messages contain them; for folders of images, before the
    folder's name.
    """
    if not location.is_local:
        return [f"{str(location).partition('?')[0].rpartition('/')[0]}/"]
    parents = (location.path.parent, Path(os.path.realpath(location.path)).parent)
    return [f"{parent}/" for parent in parents if parent != parent.parent]


@dataclass(frozen=True, slots=True, kw_only=True)
class StageKeys:
    """Hashes of what all clips have in common, by the stage that it changes; each stage is computed
    again if its key, or that of a stage before it, has changed.
    """

    detections: str = ""
    cameras: str = ""  # estimates of cameras by --camera
    tracks: str = ""  # tracks and distances, with the key of the detections in it
    events: str = ""
    # files besides tracks and events, by name and variant, such as "overlay, recorded images"
    outputs: tuple[str, ...] = ()
    settings: str = ""  # of tracks and events together
    former: str = ""  # of all options in one, as in records of earlier versions


# the first stage that is computed for a clip; "" = none, if its files are the same
Stage = Literal["detections", "tracks", "events", "outputs", ""]


@dataclass(frozen=True, slots=True)
class ClipTask:
    """A clip for a worker."""

    clip: Clip
    attempt: int = 1  # counted from 1
    # content hash of the complete result, if the files have only been touched since; "" = none
    known_hash: str = ""
    stage: Stage = "detections"
    made: tuple[str, ...] = ()  # outputs of the complete result
    is_replaced: bool = False  # whether parts of a complete result are replaced


def output_name(output: str) -> str:
    """Name of an output without its variant."""
    return output.partition(",")[0]


@dataclass(frozen=True, slots=True)
class ClipOutcome:
    """Answer of a worker about a clip, with its record; the record of a finished clip has been
    published.
    """

    row: Row
    # the complete result remains, with these columns; None = `row` replaces it
    changes: Mapping[str, Any] | None = None
    is_kept: bool = False  # the files have changed, but the complete result may not be replaced
    is_transient: bool = False  # the failure may not repeat itself
    defect: str = ""  # text of an exception that the processing has not caught; "" = none
    fatal: str = ""  # why the fleet cannot continue, one sentence; "" = it can


@dataclass(slots=True)
class ClipProgress:
    """Progress of the clip that a worker processes; written by one thread and read by another."""

    phase: str = "starting"  # or "fetching", "opening", "processing", "publishing"
    frames: int = 0
    video_s: float = 0.0  # 0 = not known yet
    fetch_bytes: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetPlan:
    """The data for every worker: settings of the fleet, and options of the runs by name of the
    setting.
    """

    settings: FleetSettings
    options: Mapping[str, Any]
    keys: StageKeys = field(default_factory=StageKeys)
    shared: Collection[str] = ()  # settings that are files
    version: str = field(default_factory=lambda: version("track-range"))

    @property
    def out(self) -> Location:
        """Folder of the results."""
        return Location.of(self.settings.out)

    @property
    def is_anonymized(self) -> bool:
        """Whether the results contain no folder names."""
        return bool(self.options.get("anonymize"))

    def record(self, clip: Clip, attempts: int) -> ClipRecord:
        """Record of a clip without a result."""
        names = FileNames(clip, is_anonymized=self.is_anonymized)
        return ClipRecord(
            clip=clip.name,
            status="failed",
            attempts=attempts,
            left=names.left,
            right=names.right,
            settings_hash=self.keys.settings,
            detections_key=self.keys.detections,
            tracks_key=self.keys.tracks,
            events_key=self.keys.events,
            version=self.version,
            labels=dict(clip.labels),
        )


Process = Callable[[ClipTask, FleetPlan, ClipProgress], ClipOutcome]  # processes a clip in a worker


def common_options(file: Path) -> dict[str, Any]:
    """Options of the settings.yaml of a run for all clips, without its inputs and outputs; raises
    ConfigError.
    """
    options = {
        key: value for key, value in read_settings(file).items() if key not in _NOT_TAKEN | OUTPUTS
    }
    try:
        _validated(options)
    except UsageError as error:
        raise ConfigError(f"{file}: {error}") from error
    return options


def fleet_plan(settings: FleetSettings, options: Mapping[str, Any]) -> FleetPlan:
    """Plan with given options of the runs, by name of the setting.

    Raises UsageError: an option is invalid, or one that a fleet does not take; ModelError,
    ConfigError, CurveError: a shared file cannot be used.
    """
    for name in options:
        field = RunSettings.model_fields.get(name)
        if field is not None and (instead := option_of(field).instead):
            raise UsageError(
                f"{RunSettings.flag(name)}: this is not an option of a fleet; {instead}."
            )
    given = {"overlay": False, **options, "threads": settings.threads}
    checked = _validated(given)
    if checked.ego_speed not in (AUTO, OFF) and math.isnan(number(checked.ego_speed)):
        raise UsageError(
            "--ego-speed: expected auto, off, or a number of km/h for all clips; give files in the "
            "column ego_speed of a manifest."
        )
    files = _shared_files(checked)
    hashes = {}
    for name, paths in files.items():
        contents = [_hash_of(path) for path in paths]
        hashes[name] = contents if name in NETWORKS else contents[0]
    # the detector and the size curves are checked once, instead of in every clip
    load_curves(checked.curves)
    road_class_ids(checked.classes)
    if "detector" in files:
        open_detector(files["detector"][0], replace(DetectorOptions.of(checked), device="cpu"))
    check_networks(checked)
    values = checked.model_dump(mode="json", exclude_none=True)
    # a camera of the settings is that of --rig-camera
    common = {key for key in values if key not in _NOT_TAKEN or key == "camera"}
    hashed = {key: value for key, value in values.items() if key in common} | hashes
    is_written = "write" in given
    return FleetPlan(
        settings=settings,
        options={**given, **_with_absolute(given, files)},
        keys=_keys(hashed, _outputs(settings, checked, is_written), has_reports=settings.reports),
        shared=tuple(files),
    )


def _hash_of(path: Path) -> str:
    with open_regular(path, UsageError, "a file of the settings") as file:
        return f"sha256:{hashlib.file_digest(file, 'sha256').hexdigest()}"


def _with_absolute(
    given: Mapping[str, Any], files: Mapping[str, Sequence[Path]]
) -> dict[str, str | list[str]]:
    """The given options that are files, with absolute paths."""
    named = {name: paths for name, paths in files.items() if name in given}
    return {
        name: [str(path.absolute()) for path in paths_of(given[name])]
        if name in NETWORKS
        else str(paths[0])
        for name, paths in named.items()
    }


def _keys(values: Mapping[str, Any], outputs: tuple[str, ...], *, has_reports: bool) -> StageKeys:
    """The keys of options, with the hash of the content in place of the name of a file."""
    origin: dict[str, Any] = {"version": version("track-range")}
    if extra := origins():
        origin["methods"] = extra

    def key(*stages: str, **others: object) -> str:
        of_stages = {name: value for name, value in values.items() if _STAGES[name] in stages}
        return hashed_text({"run": of_stages, **others, **origin})

    return StageKeys(
        detections=key("detections"),
        cameras=key("detections", **{name: values.get(name) for name in _OF_CAMERAS}),
        tracks=key("detections", "tracks"),
        events=key("events"),
        outputs=outputs,
        settings=key("detections", "tracks", "events"),
        former=key("detections", "tracks", "events", "outputs", reports=has_reports),
    )


def hashed_text(content: Mapping[str, Any]) -> str:
    """Hash of values in canonical JSON."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return f"sha256:{hashlib.sha256(text.encode()).hexdigest()}"


def _outputs(settings: FleetSettings, run: RunSettings, is_written: bool) -> tuple[str, ...]:
    """The files of a clip besides its tracks and events, by name and variant."""
    variants = {"mcap": f"mcap, {run.mcap_profile}{', images' * run.mcap_images}"}
    names = [name for name in run.write if name != "parquet"] if is_written else []
    overlay = f"overlay{', disparity' * run.overlay_disparity}{', cuboids' * run.overlay_cuboids}"
    others = {
        f"{overlay}{', recorded images' * run.overlay_recorded}": run.overlay,
        "clips": run.clips,
        "counts": bool(run.count_line or run.zone),
        "disparity": run.disparity,
        "telemetry": run.keep_gps,
        "reports": settings.reports,
    }
    written = [variants.get(name, name) for name in names]
    return (*written, *(name for name, is_made in others.items() if is_made))


def _validated(options: Mapping[str, Any]) -> RunSettings:
    """Settings of a run with the given options; the names of its videos do not matter. Raises
    UsageError.
    """
    topics = options.get("topics") or ()
    n_topics = (
        len(topics.split(","))
        if isinstance(topics, str)
        else len(topics)
        if isinstance(topics, Sized)
        else 0
    )
    of_pairs = ("disparity", "overlay_disparity", "stereo_model")
    is_pair = any(options.get(name) for name in of_pairs) or n_topics > 1
    video = {"stereo": ("left.mp4", "right.mp4")} if is_pair else {"mono": "clip.mp4"}
    return settings_from(
        {**options, **({"stereo": "both.mp4"} if options.get("stereo_layout") else video)}
    )


def _shared_files(settings: RunSettings) -> dict[str, list[Path]]:
    """Files of the settings that all clips share, of networks with those beside them; the other
    values are words.
    """
    listed = {name: _paths(name, getattr(settings, name)) for name in sorted(_SHARED_FILES)}
    return {name: [path.absolute() for path in paths] for name, paths in listed.items() if paths}


def _paths(name: str, value: Any) -> list[Path]:
    """The files that the value of a setting names; of a model of the catalogue none."""
    if name in NETWORKS:
        return network_files(value)
    if value is None:
        return []
    if name == "detector":
        model = find_model(value)
        is_of_catalogue = model.origin == "catalogue" and model.entry is not None
        return [] if is_of_catalogue else [model.path]
    if name == "ignore":
        is_file = str(value).lower().endswith(MASK_SUFFIXES)
    else:
        is_file = isinstance(value, Path) or bool(Path(value).suffix and math.isnan(number(value)))
    return [Path(value)] if is_file else []


def named_options(plan: FleetPlan) -> dict[str, Any]:
    """The options for fleet.json, those of the runs in `run`."""
    own = plan.settings.model_dump(mode="json", exclude_none=True)
    own["recordings"] = own["recordings"][:10]
    plain = (str, int, float, bool, list, dict, type(None))
    run = {
        key: value if isinstance(value, plain) else str(value)
        for key, value in plan.options.items()
    }
    if plan.is_anonymized:
        own = {key: value for key, value in own.items() if key not in _WITH_FOLDERS}
        run = without_folders(run)
    return {**own, "run": run}
