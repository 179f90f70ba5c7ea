"""Settings of a run, from the command line, `--settings FILE` and the defaults, in this order of precedence.

`settings.yaml` in the folder of a run contains all of them; `track-range --settings DIR/settings.yaml` repeats the run.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, field_serializer, field_validator, model_validator

from track_range.foundation.errors import ConfigError, UsageError
from track_range.foundation.files.input_files import quoted
from track_range.foundation.files.output_files import write_text
from track_range.foundation.files.structured_text import read_yaml, yaml_text
from track_range.foundation.options import Options, option
from track_range.foundation.schema_version import SCHEMA_VERSION
from track_range.foundation.validation import chosen_numbers, first_problem
from track_range.ranging.warning.settings import WarningSettings
from track_range.recording.live.address import live_address
from track_range.recording.names import Segments, VideoName, files_of, stem_of, video_name
from track_range.recording.utc import parsed_utc
from track_range.results.events.event import EventSettings
from track_range.results.provenance import settings_hash
from track_range.run.options.detector_fields import (
    Device,
    anchors_option,
    device_option,
    letterbox_option,
    names_option,
    size_option,
    threads_option,
)
from track_range.run.options.tracker_fields import reid_option, tracker_option

_PATHS = ("rig", "detections", "curves", "truth", "table", "out", "reid")
_PATHS_OR_NAMES = ("detector", "names", "align", "lanes", "ego_speed")
"""Settings that are files or folders, and those that are a file or a name."""

_DETECTOR_OPTIONS: Mapping[str, str] = {
    "min_score": "--min-score",
    "names": "--names",
    "anchors": "--anchors",
    "letterbox": "--letterbox",
    "size_px": "--size",
}
"""Options of the detector by setting; None = not given."""

_INPUT, _DETECTION, _TRACKING, _RANGING, _OUTPUT = "Input", "Detection", "Tracking", "Ranging", "Output"
"""Headings of the help page under which the options are listed."""


def check_tracker(name: str, reid: Path | None) -> None:
    """Check that the tracker exists, and that it compares appearance if a re-identification network is given.

    Raises:
        UsageError: no such tracker, or it does not use the network.
    """
    from track_range.tracking.registry import TrackerError, find_tracker

    try:
        tracker = find_tracker(name)
    except TrackerError as error:
        raise UsageError(f"--tracker: {error}") from error
    if reid is not None and not tracker.uses_reid:
        raise UsageError(
            f"--reid: --tracker {name} does not compare appearance; omit --reid or use --tracker deepsort."
        )


class RunSettings(Options):
    """All settings that determine the results of a run: options of `track-range run` and keys of settings.yaml."""

    stereo: Annotated[
        tuple[VideoName, VideoName] | None,
        option(
            "Left and right video: files, folders of numbered images, camera numbers (0 1) or streams (rtsp://...); "
            "for recordings in several files, folders of videos, patterns such as 'DIR/*_L.mp4', or the option "
            "repeated for each pair of files.",
            metavar="LEFT RIGHT",
            panel=_INPUT,
            is_repeated=True,
        ),
    ] = None
    mono: Annotated[
        VideoName | None,
        option(
            "Video of a single camera: a file, a folder of numbered images, a camera number or a stream; for a "
            "recording in several files, a folder of videos, a pattern such as 'DIR/*_F.mp4', or the option repeated "
            "for each file.",
            metavar="VIDEO",
            panel=_INPUT,
            is_repeated=True,
        ),
    ] = None
    topics: Annotated[
        tuple[str, ...],
        option(
            "Topics of the images in an MCAP file or ROS bag: one for --mono, two for --stereo BAG; without --rig, the "
            "calibration is that of the topics camera_info beside them.",
            metavar="LEFT,RIGHT",
            panel=_INPUT,
        ),
    ] = ()
    rig: Annotated[
        Path | None,
        option(
            "Calibration file: rig.yaml, KITTI's calib.txt, ROS's camera_info, OpenCV's stereo calibration or Kalibr's "
            "camchain (default: rig.yaml or calib.txt in the folder of the left video; without one, distances are "
            "uncalibrated).",
            panel=_INPUT,
        ),
    ] = None
    focal_px: Annotated[
        float | None,
        option(
            "Focal length in pixels of a camera without a calibration file; the principal point is the image centre.",
            metavar="PX",
            panel=_INPUT,
            gt=0,
            allow_inf_nan=False,
        ),
    ] = None
    fov_deg: Annotated[
        float | None,
        option(
            "Horizontal field of view in degrees to which the images of a wide lens are undistorted (default: that of "
            "the lens, at most 120).",
            metavar="DEG",
            panel=_INPUT,
            ge=20,
            le=120,
        ),
    ] = None
    yaw_deg: Annotated[
        float,
        option(
            "With --mono, direction in degrees to the right of the camera's axis to which the images of a wide lens "
            "are undistorted.",
            metavar="DEG",
            panel=_INPUT,
            ge=-120,
            le=120,
        ),
    ] = 0.0
    start_s: Annotated[
        float,
        option(
            "Time in the video, in seconds, at which the run starts.",
            flag="--start",
            metavar="S",
            panel=_INPUT,
            ge=0,
            allow_inf_nan=False,
        ),
    ] = 0.0
    duration_s: Annotated[
        float | None,
        option(
            "Length of the run in seconds (default: to the end of the video).",
            flag="--duration",
            metavar="S",
            panel=_INPUT,
            gt=0,
            allow_inf_nan=False,
        ),
    ] = None
    folder_fps: Annotated[
        float,
        option(
            "Frame rate of folders of images, which have no timestamps.", metavar="FPS", panel=_INPUT, ge=0.01, le=1000
        ),
    ] = 10.0
    start_utc: Annotated[
        str | None,
        option(
            "Date and time (UTC) of the video's first frame, for the column utc (default: from the video's header, its "
            "name or its timestamps, where they state it).",
            metavar="2026-01-31T14:25:30Z",
            panel=_INPUT,
        ),
    ] = None
    ego_speed: Annotated[
        str,
        option(
            "Speed of the camera, for the absolute speeds of objects: from GPS records in the video or in a file "
            "beside it, else from the images (auto), "
            "unknown (off), a constant in km/h, a file (CSV, GPX, NMEA, SRT, ...), or KITTI's oxts "
            "folder.",
            metavar="auto|off|KMH|FILE|DIR",
            panel=_INPUT,
        ),
    ] = "auto"
    truth: Annotated[
        Path | None,
        option(
            "Ground truth to measure the errors against: KITTI tracking labels, or a CSV with the columns "
            "frame, id, class, x1, y1, x2, y2, distance_m and optionally visible_share, closing_mps (other columns "
            "are ignored); or COCO, CVAT for video or YOLO labels with track ids.",
            panel=_INPUT,
        ),
    ] = None
    detector: Annotated[
        str | None,
        option(
            "YOLO network: an ONNX file, or a name from `track-range models list` (default: road, which is packaged).",
            metavar="FILE|NAME",
            panel=_DETECTION,
        ),
    ] = None
    classes: Annotated[
        tuple[str, ...],
        option(
            "Road classes to track: person, bicycle, car, motorcycle, bus, truck, traffic light, traffic sign "
            "(default: all).",
            metavar="A,B,...",
            panel=_DETECTION,
        ),
    ] = ()
    min_score: Annotated[
        str | None,
        option(
            "Minimum detection confidence from 0 to 1, also by class: 0.1,car=0.3 (default: 0.1).",
            metavar="S[,CLASS=S...]",
            panel=_DETECTION,
        ),
    ] = None
    detections: Annotated[
        Path | None,
        option(
            "Recorded boxes instead of a detector: MOTChallenge's det.txt, KITTI labels or detections, a tracks.csv or "
            "tracks.parquet, COCO, CVAT for video, or a folder of YOLO labels.",
            panel=_DETECTION,
        ),
    ] = None
    names: Annotated[str | None, names_option(panel=_DETECTION)] = None
    anchors: Annotated[str | None, anchors_option(panel=_DETECTION)] = None
    letterbox: Annotated[str | None, letterbox_option(panel=_DETECTION)] = None
    size_px: Annotated[int | None, size_option(panel=_DETECTION)] = None
    threads: Annotated[int, threads_option(panel=_DETECTION)] = 0
    device: Annotated[Device, device_option(panel=_DETECTION)] = "auto"
    tracker: Annotated[str, tracker_option(panel=_TRACKING)] = "deepsort"
    reid: Annotated[Path | None, reid_option(panel=_TRACKING)] = None
    curves: Annotated[
        Path | None,
        option(
            "Size curves of the mono method, written by `track-range fit` (default: the packaged curves).",
            panel=_RANGING,
        ),
    ] = None
    sgbm: Annotated[
        bool,
        option(
            "Dense stereo matching (sgbm, slow) in addition to the patch matcher (stereo).",
            flag="--sgbm/--no-sgbm",
            panel=_RANGING,
        ),
    ] = True
    sgbm_options: Annotated[
        dict[str, Any],
        option(
            "Parameters of dense stereo that override those for the rig: fields of SgbmSettings.", is_file_only=True
        ),
    ] = Field(default_factory=dict)
    warning_options: Annotated[
        dict[str, Any],
        option(
            "Thresholds of the collision warning that override the defaults: fields of WarningSettings.",
            is_file_only=True,
        ),
    ] = Field(default_factory=dict)
    event_options: Annotated[
        dict[str, Any],
        option("Thresholds of the events that override the defaults: fields of EventSettings.", is_file_only=True),
    ] = Field(default_factory=dict)
    align: Annotated[
        str,
        option(
            "Disparity correction: estimated from the drive (auto), none (off), or read from a file written by "
            "`track-range align`.",
            metavar="auto|off|FILE",
            panel=_RANGING,
        ),
    ] = "auto"
    lanes: Annotated[
        str,
        option(
            "Detector of the lines of the ego lane, for distances by lane width: edge-based (classical), none (off), "
            "or a lane network (ONNX).",
            metavar="classical|off|FILE",
            panel=_RANGING,
        ),
    ] = "classical"
    lane_width_m: Annotated[
        float,
        option(
            "Width of the ego lane in metres; refined with stereo distances.",
            metavar="M",
            panel=_RANGING,
            ge=1.5,
            le=6.0,
        ),
    ] = 3.5
    camera_height_m: Annotated[
        float | None,
        option(
            "Height of the camera above the road in metres (default: estimated from the drive).",
            metavar="M",
            panel=_RANGING,
            ge=0.2,
            le=5.0,
        ),
    ] = None
    out: Annotated[
        Path | None,
        option(
            "Folder of the results (default: LEFT-track-range in the current folder).", metavar="DIR", panel=_OUTPUT
        ),
    ] = None
    write: Annotated[
        tuple[str, ...],
        option(
            "Formats of the result files: csv (tracks.csv), mot (mot.txt), parquet (tracks.parquet), kitti "
            "(kitti.txt), recorded (recorded_boxes.csv, in pixels of the video), mcap (run.mcap, for Foxglove and "
            "ROS 2), rrd (run.rrd, for rerun), or "
            "formats of installed packages.",
            metavar="A,B,...",
            panel=_OUTPUT,
        ),
    ] = ("csv", "mot", "parquet")
    anonymize: Annotated[
        bool,
        option(
            "Blur of heads and number plates in all images of the results, irreversibly, and no folder names in them; "
            "what is not detected is not covered.",
            panel=_OUTPUT,
        ),
    ] = False
    mcap_profile: Annotated[
        Literal["foxglove", "ros2"],
        option(
            "Message types of run.mcap: those of Foxglove, or of ROS 2 (CDR).",
            flag="--mcap-profile",
            metavar="foxglove|ros2",
            panel=_OUTPUT,
        ),
    ] = "foxglove"
    mcap_images: Annotated[
        bool, option("Images in run.mcap, as JPEG.", flag="--mcap-images/--no-mcap-images", panel=_OUTPUT)
    ] = False
    table: Annotated[
        Path | None, option("Markdown file for the tables of the run.", metavar="FILE.md", panel=_OUTPUT)
    ] = None
    keep_gps: Annotated[
        bool,
        option(
            "Positions of the recording in the results, telemetry.csv; without this option there are none.",
            flag="--keep-gps",
            panel=_OUTPUT,
        ),
    ] = False
    overlay: Annotated[bool, option("Annotated video, overlay.mp4.", flag="--overlay/--no-overlay", panel=_OUTPUT)] = (
        True
    )
    clips: Annotated[
        bool,
        option(
            "Short video of each event in the folder clips, cut from overlay.mp4: from 3 s before its start to 2 s "
            "after its end.",
            panel=_OUTPUT,
        ),
    ] = False
    disparity: Annotated[
        bool,
        option(
            "Video of the disparities of dense stereo, disparity.mp4.",
            flag="--disparity/--no-disparity",
            panel=_OUTPUT,
        ),
    ] = False
    overlay_disparity: Annotated[
        bool,
        option(
            "Colour-coded disparities of dense stereo below each frame of the overlay.",
            flag="--overlay-disparity/--no-overlay-disparity",
            panel=_OUTPUT,
            old_names=("overlay_side",),
        ),
    ] = False
    overlay_recorded: Annotated[
        bool,
        option(
            "Overlay on the recorded images of a wide lens instead of the undistorted ones.",
            flag="--overlay-recorded/--no-overlay-recorded",
            panel=_OUTPUT,
        ),
    ] = False

    @model_validator(mode="before")
    @classmethod
    def _packaged_detector(cls, values: Any) -> Any:
        """Use the packaged detector if neither a detector nor detections are given."""
        if isinstance(values, dict) and values.get("detector") is None and values.get("detections") is None:
            from track_range.detection.models.lookup import DEFAULT_MODEL  # imports onnxruntime

            return {**values, "detector": DEFAULT_MODEL}
        return values

    @field_validator("stereo", mode="before")
    @classmethod
    def _pair_of_names(cls, pair: Any) -> Any:
        """Convert names to paths, several files, or the addresses of cameras and streams; one bag is both videos."""
        if isinstance(pair, str | Path):
            pair = (pair,)
        if isinstance(pair, list | tuple) and len(pair) == 1:
            from track_range.recording.bags.bag import is_bag  # imports NumPy

            if not (isinstance(pair[0], str | Path) and is_bag(Path(pair[0]))):
                raise ValueError("expected LEFT and RIGHT, or one MCAP file or ROS bag with --topics LEFT,RIGHT")
            pair = (pair[0], pair[0])
        return tuple(_source_name(name) for name in pair) if isinstance(pair, list | tuple) else pair

    @field_validator("mono", mode="before")
    @classmethod
    def _name(cls, video: Any) -> Any:
        """Convert a name to a path, several files, or the address of a camera or stream."""
        return _source_name(video)

    @field_serializer("stereo", "mono")
    def _named(self, video: VideoName | tuple[VideoName, VideoName] | None) -> Any:
        """Names as text, several files as a list; addresses without passwords."""
        if isinstance(video, tuple):
            return [_plain_name(name, str) for name in video]
        return None if video is None else _plain_name(video, str)

    @field_validator("start_utc", mode="before")
    @classmethod
    def _date_and_time(cls, value: Any) -> Any:
        """Check the date and time; YAML reads an unquoted one as a datetime."""
        if isinstance(value, datetime):
            value = value.isoformat()
        if isinstance(value, str):
            parsed_utc(value)
        return value

    @field_validator("align", "lanes", "ego_speed", mode="before")
    @classmethod
    def _off_as_text(cls, value: Any) -> Any:
        """Convert False to "off", because YAML reads an unquoted `off` as false."""
        return "off" if value is False else value

    @field_validator("write")
    @classmethod
    def _known_writers(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        from track_range.results.writers import WRITERS

        known = WRITERS.names
        if unknown := [name for name in names if name not in known]:
            raise ValueError(f"unknown format {', '.join(unknown)}: expected {', '.join(known)}")
        return tuple(dict.fromkeys(names))

    @field_validator("sgbm_options")
    @classmethod
    def _known_parameters(cls, values: dict[str, Any]) -> dict[str, Any]:
        if values:
            from track_range.stereo.matching.sgbm import SgbmSettings  # imports OpenCV

            SgbmSettings.of(values)
        return values

    @field_validator("warning_options")
    @classmethod
    def _known_thresholds(cls, values: dict[str, Any]) -> dict[str, Any]:
        chosen_numbers(WarningSettings, values)
        return values

    @field_validator("event_options")
    @classmethod
    def _known_event_thresholds(cls, values: dict[str, Any]) -> dict[str, Any]:
        chosen_numbers(EventSettings, values)
        return values

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.stereo is None) == (self.mono is None):
            raise ValueError("give either --stereo LEFT RIGHT or --mono VIDEO")
        n_topics = 1 if self.stereo is None else 2
        if self.topics and len(self.topics) != n_topics:
            raise ValueError(f"--topics: expected {n_topics} topic{'s' * (n_topics - 1)}, got {len(self.topics)}")
        if self.stereo is not None and self.topics and len({*zip(self.stereo, self.topics, strict=True)}) == 1:
            raise ValueError(f"--topics: expected the topics of two cameras, got {quoted(self.topics[0])} twice")
        if self.detector is not None and self.detections is not None:
            raise ValueError("give --detector or --detections, not both")
        if self.rig is not None and self.focal_px is not None:
            raise ValueError("give --rig or --focal-px, not both")
        if self.yaw_deg and self.mono is None:
            raise ValueError(
                "--yaw-deg needs --mono: the right camera of a pair is to the side of the left one only ahead"
            )
        if self.keep_gps and self.anonymize:
            raise ValueError("give --keep-gps or --anonymize, not both: positions show where people live")
        check_tracker(self.tracker, self.reid)
        return self

    @model_validator(mode="after")
    def _possible_videos(self) -> Self:
        if self.clips and not self.overlay:
            raise ValueError("--clips cuts its videos from overlay.mp4: it cannot be combined with --no-overlay")
        if self.overlay_disparity and (self.stereo is None or not self.sgbm or not self.overlay):
            raise ValueError(
                "--overlay-disparity shows dense stereo below the overlay: it requires --stereo, and cannot be "
                "combined with --no-sgbm or --no-overlay"
            )
        if self.overlay_recorded and (not self.overlay or self.overlay_disparity or self.anonymize):
            raise ValueError(
                "--overlay-recorded draws on the images as recorded: it cannot be combined with --no-overlay, "
                "--overlay-disparity or --anonymize"
            )
        if self.disparity and (self.stereo is None or not self.sgbm):
            raise ValueError(
                "--disparity shows dense stereo: it requires --stereo, and cannot be combined with --no-sgbm"
            )
        return self

    @property
    def left(self) -> VideoName:
        """The left or only video; it gives the output folder its name."""
        video = self.mono if self.stereo is None else self.stereo[0]
        if video is None:
            raise ConfigError("expected a video, got none: give --stereo LEFT RIGHT or --mono VIDEO.")
        return video

    @property
    def warning_settings(self) -> WarningSettings:
        """Thresholds of the collision warning."""
        return chosen_numbers(WarningSettings, self.warning_options)

    @property
    def event_settings(self) -> EventSettings:
        """Thresholds of the events."""
        return chosen_numbers(EventSettings, self.event_options)

    @property
    def out_dir(self) -> Path:
        """Output folder."""
        return self.out or Path(f"{stem_of(self.left)}-track-range")


def settings_from(options: dict[str, Any], file: Path | None = None) -> RunSettings:
    """Settings from options (None = not given) over those of a settings.yaml.

    Raises:
        UsageError: an option is invalid, or options contradict each other.
        ConfigError: the file cannot be read, or contains an unknown key or an invalid value.
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
    """Check that the inputs of an anonymized run, which its settings name without folders, are in the current folder.

    Args:
        settings: all settings.
        keys: the settings that come from the file.
        file: the settings.yaml.

    Raises:
        ConfigError: an input does not exist.
    """
    for key in keys:
        value = getattr(settings, key, None)
        videos = (settings.stereo or ()) if key == "stereo" else (settings.mono,) if key == "mono" else ()
        files = [path for video in videos if video is not None for path in files_of(video)]
        files += [value] if key in _PATHS and key != "out" and value is not None else []
        missing = next((path for path in files if not path.exists()), None)
        if missing is not None:
            raise ConfigError(
                f"{file}: the settings of an anonymized run name files without folders, and the current folder "
                f"contains no {quoted(missing.name)}; give --{key} again."
            )


def _error_of(
    error: ValidationError | UsageError, given: dict[str, Any], base: dict[str, Any], file: Path | None
) -> ConfigError:
    """The error of invalid settings: of the file if a value in it or a contradiction within it is the reason."""
    sentence = RunSettings.problem(error) if isinstance(error, ValidationError) else str(error)
    if file is None:
        return UsageError(sentence)
    if isinstance(error, ValidationError) and (place := error.errors(include_url=False)[0]["loc"]):
        if str(place[0]) in given:
            return UsageError(sentence)
        key, problem = first_problem(error)
        is_unknown = error.errors()[0]["type"] == "extra_forbidden"
        return ConfigError(f"{file}: {sentence}" if is_unknown else f"{file}: 'run.{key}': {problem}.")
    try:
        RunSettings(**base)
    except (ValidationError, UsageError):
        return ConfigError(f"{file}: {sentence}")
    return UsageError(f"{sentence.removesuffix('.')} (with the settings of {file}).")


def save_settings(settings: RunSettings, path: Path, *, detected: dict[str, Any] | None = None) -> None:
    """Write settings.yaml: the settings with absolute paths under `run`, the detected properties under `found`.

    Args:
        settings: settings of the run.
        path: the file.
        detected: properties of the opened inputs; None = not known yet.
    """
    run = absolute_settings(settings)
    content = {
        "track_range_settings": 1,
        "schema_version": SCHEMA_VERSION,
        "settings_hash": settings_hash(run),
        "run": run,
    }
    if detected is not None:
        content["found"] = detected
    write_text(path, yaml_text(content))


def input_files(settings: RunSettings) -> list[Path]:
    """All files that a run reads."""
    files = (
        *(file for video in (*(settings.stereo or ()), settings.mono) if video is not None for file in files_of(video)),
        *(settings.rig, settings.detections, settings.truth, settings.curves, settings.reid),
    )
    names = (settings.detector, settings.names, settings.align, settings.lanes, settings.ego_speed)
    return [*(path for path in files if path is not None), *(Path(name) for name in names if name is not None)]


def unused_options(settings: RunSettings) -> tuple[str, ...]:
    """Notes on options that were given but have no effect on the run."""
    notes = []
    if settings.mono is not None and settings.align not in ("auto", "off"):
        notes.append("--align is not used with one camera.")
    given = [flag for key, flag in _DETECTOR_OPTIONS.items() if getattr(settings, key) is not None]
    if settings.detections is not None and given:
        notes.append(f"{', '.join(given)} {'is' if len(given) == 1 else 'are'} not used with --detections.")
    return tuple(notes)


def absolute_settings(settings: RunSettings) -> dict[str, Any]:
    """Settings as in settings.yaml: plain values, with absolute paths; file names only if the run is anonymized."""
    run: dict[str, Any] = settings.model_dump(mode="json", exclude_none=True)
    for key in _PATHS:
        if key in run:
            run[key] = os.path.realpath(run[key])
    for key in _PATHS_OR_NAMES:
        if key in run and os.path.exists(run[key]):  # False for a name that is too long
            run[key] = os.path.realpath(run[key])
    if settings.stereo:
        run["stereo"] = [_absolute(video) for video in settings.stereo]
    if settings.mono:
        run["mono"] = _absolute(settings.mono)
    return without_folders(run) if settings.anonymize else run


def without_folders(run: Mapping[str, Any]) -> dict[str, Any]:
    """Settings or inputs with the names of files instead of their paths, which may contain the name of a person."""
    keys = {*_PATHS, *_PATHS_OR_NAMES, "stereo", "mono", "left", "right"}
    return {key: _name(value) if key in keys else value for key, value in run.items()}


def _name(value: Any) -> Any:
    """File name of a path, or of each path of a list; addresses of streams stay."""
    if isinstance(value, list | tuple):
        return [_name(path) for path in value]
    return value if live_address(value) else os.path.basename(os.path.normpath(value))


def _absolute(video: VideoName) -> str | list[str]:
    return _plain_name(video, lambda path: os.path.realpath(path) if isinstance(path, Path) else str(path))


def _source_name(value: Any) -> Any:
    """A recording or live source from text or a list of texts; other values are left to the validation."""
    is_list = isinstance(value, list | tuple) and all(isinstance(part, str | Path) for part in value)
    return video_name(value) if isinstance(value, str) or is_list else value


def _plain_name(video: VideoName, text: Callable[[VideoName], str]) -> str | list[str]:
    """The name of a recording as text, several files as a list."""
    return [text(path) for path in video.paths] if isinstance(video, Segments) else text(video)


def read_settings(file: Path) -> dict[str, Any]:
    """Values in a settings.yaml, which are not validated.

    Raises:
        ConfigError: the file cannot be read, or is another one.
    """
    document = read_yaml(file, ConfigError, "the settings.yaml of a run")
    if not isinstance(document, dict) or document.get("track_range_settings") != 1:
        raise ConfigError(f"{file}: expected the settings.yaml of a run, with the key 'track_range_settings: 1'.")
    run = document.get("run")
    if not isinstance(run, dict) or not all(isinstance(key, str) for key in run):
        raise ConfigError(f"{file}: expected a section 'run:' with the settings of the run.")
    return run
