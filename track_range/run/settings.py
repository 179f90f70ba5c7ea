"""Settings of a run: what the command line says, what `--settings FILE` says, and the defaults, in that order.

`settings.yaml` in a run's folder holds all of it, so that `track-range --settings DIR/settings.yaml` repeats the run.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, Self

import yaml
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    field_serializer,
    field_validator,
    model_validator,
)

from track_range.detection.models.lookup import DEFAULT_MODEL
from track_range.foundation.errors import ConfigError, UsageError
from track_range.results.output_files import write_text
from track_range.results.writers import DEFAULT_WRITERS, writer_names
from track_range.stereo.matching.sgbm import SgbmSettings
from track_range.tracking.registry import TrackerError, find_tracker
from track_range.video.live.address import LiveAddress, live_address

VideoName = Path | LiveAddress
"""A video file or folder of images, or a camera or stream."""

_NO_OPTION = ("sgbm_options",)
"""Fields that are set in settings.yaml alone."""


def check_tracker(name: str, reid: Path | None) -> None:
    """Check that there is a tracker of this name, and that it uses a re-identification network where one is given.

    Raises:
        UsageError: there is none, or it does not.
    """
    try:
        tracker = find_tracker(name)
    except TrackerError as error:
        raise UsageError(f"--tracker: {error}") from error
    if reid is not None and not tracker.uses_reid:
        raise UsageError(f"--reid: --tracker {name} does not compare appearance; give one of the two.")


class RunSettings(BaseModel):
    """Everything that decides what a run computes; units are in the names."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    stereo: tuple[VideoName, VideoName] | None = None
    """Left and right video, folders of numbered images, cameras or streams."""
    mono: VideoName | None = None
    """The video of a single camera."""
    rig: Path | None = None
    """rig.yaml, KITTI calib.txt or OpenCV's stereo calibration; None = looked for beside the left video."""
    focal_px: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    """Focal length of cameras without a rig file; the principal point is taken as the image's centre."""
    detector: str | None = None
    """An ONNX file, or a name of `track-range models list`; None only where `detections` is given."""
    detections: Path | None = None
    """Boxes from a file in place of a detector."""
    names: str | None = None
    """Class names of the detector: a,b,c or a file with one per line."""
    anchors: str | None = None
    """Anchors of a detector with raw heads: 81,82 135,169 344,319 / 23,27 37,58 81,82."""
    letterbox: str | None = None
    """Where the image lies in the detector's input, such as centred-114."""
    min_score: str | None = None
    """Weakest boxes taken from the detector: 0.1, or 0.1,car=0.3; None = 0.1."""
    curves: Path | None = None
    """Size curves for the monocular distance, as `track-range fit` writes them; None = the packaged ones."""
    truth: Path | None = None
    """KITTI tracking labels or a CSV of true distances to measure against."""
    table: Path | None = None
    """A Markdown file for the tables."""
    out: Path | None = None
    """Folder of the results; None = named after the left video."""
    write: tuple[str, ...] = DEFAULT_WRITERS
    """Formats of the results (`track_range.results.writers`); summary.json and settings.yaml are always written."""
    classes: tuple[str, ...] = ()
    """Road classes wanted; empty = all."""
    start_s: float = Field(default=0.0, ge=0, allow_inf_nan=False)
    duration_s: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    folder_fps: float = Field(default=10.0, ge=0.01, le=1000)
    """Frames per second of folders of images, which carry no times."""
    size_px: int | None = Field(default=None, ge=32, le=4096)
    """Longer side of the network's input where the model leaves it open; None = the model's own, else 640."""
    threads: int = Field(default=0, ge=0, le=256)
    """Threads of the network; 0 = one per core."""
    device: Literal["auto", "cpu", "cuda", "tensorrt"] = "auto"
    tracker: str = "deepsort"
    """A name of `tracking.registry`, or package.module:Class."""
    reid: Path | None = None
    """A re-identification network for looks; None = the built-in descriptor."""
    overlay: bool = True
    lanes: str = "classical"
    """The own lane's lines: classical, off, or a lane network's file."""
    lane_width_m: float = Field(default=3.5, ge=1.5, le=6.0)
    """Width of a lane, until stereo teaches it."""
    camera_height_m: float | None = Field(default=None, ge=0.2, le=5.0)
    """Of the camera above the road; None = estimated with the horizon."""
    ego_speed: str | None = None
    """How fast the camera moves: km/h, a CSV file, or a folder of KITTI's oxts; None = unknown."""
    sgbm: bool = True
    """Dense matching beside the patch matcher, in stereo runs."""
    sgbm_options: dict[str, Any] = {}
    """Dense stereo's parameters that the rig does not choose: fields of `stereo.sgbm.SgbmSettings`."""
    overlay_side: bool = False
    """The overlay with the disparities below it."""
    disparity: bool = False
    """Dense stereo's disparity picture of each frame, as disparity.mp4."""
    align: str = "auto"
    """Correction of the disparities: auto = estimated from the drive, off, or an alignment file."""

    @model_validator(mode="before")
    @classmethod
    def _packaged_detector(cls, given: Any) -> Any:
        """Where neither a detector nor boxes are given, the packaged detector."""
        if isinstance(given, dict) and given.get("detector") is None and given.get("detections") is None:
            return {**given, "detector": DEFAULT_MODEL}
        return given

    @field_validator("stereo", "mono", mode="before")
    @classmethod
    def _cameras_and_streams(cls, given: Any) -> Any:
        """A name may be a camera's number, a device or an address."""
        if isinstance(given, list | tuple):
            return tuple((live_address(name) or Path(name)) if isinstance(name, str) else name for name in given)
        return (live_address(given) or Path(given)) if isinstance(given, str) else given

    @field_serializer("stereo", "mono")
    def _named(self, video: VideoName | tuple[VideoName, VideoName] | None) -> Any:
        """Without passwords."""
        return [str(eye) for eye in video] if isinstance(video, tuple) else video and str(video)

    @field_validator("align", "lanes", mode="before")
    @classmethod
    def _off_is_a_word(cls, given: Any) -> Any:
        """YAML takes a bare `off` for false."""
        return "off" if given is False else given

    @field_validator("write", mode="before")
    @classmethod
    def _known_writers(cls, given: Any) -> Any:
        names = tuple(name.strip() for name in given.split(",")) if isinstance(given, str) else given
        known = writer_names()
        if unknown := [str(name) for name in names if name not in known]:
            raise ValueError(f"unknown format {', '.join(unknown)}: expected {', '.join(known)}")
        return tuple(dict.fromkeys(names))

    @field_validator("sgbm_options")
    @classmethod
    def _known_parameters(cls, given: dict[str, Any]) -> dict[str, Any]:
        SgbmSettings.of(given)
        return given

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.stereo is None) == (self.mono is None):
            raise ValueError("give either --stereo LEFT RIGHT or --mono VIDEO")
        if self.detector is not None and self.detections is not None:
            raise ValueError("give --detector or --detections, not both")
        if self.rig is not None and self.focal_px is not None:
            raise ValueError("give --rig or --focal-px, not both")
        if self.overlay_side and (self.stereo is None or not self.sgbm or not self.overlay):
            raise ValueError(
                "--overlay-side shows dense stereo below the overlay; it needs --stereo, and goes not with --no-sgbm "
                "or --no-overlay"
            )
        if self.disparity and (self.stereo is None or not self.sgbm):
            raise ValueError(
                "--disparity shows what dense stereo finds; it needs --stereo, and goes not with --no-sgbm"
            )
        check_tracker(self.tracker, self.reid)
        return self

    @property
    def left(self) -> VideoName:
        """The video that everything is named after."""
        video = self.mono if self.stereo is None else self.stereo[0]
        if video is None:
            raise ConfigError("no video given")
        return video

    @property
    def out_dir(self) -> Path:
        """Where the results go."""
        return self.out or Path(f"{self.left.stem}-track-range")


def settings_from(given: dict[str, Any], file: Path | None = None) -> RunSettings:
    """Settings from options (None = not given) over those of a settings.yaml.

    Raises:
        UsageError: options that are wrong, or contradict each other.
        ConfigError: an unreadable file, or an unknown key or wrong value in it.
    """
    base = _read(file) if file else {}
    chosen = {key: value for key, value in given.items() if value is not None}
    for one, other in (("mono", "stereo"), ("detections", "detector"), ("rig", "focal_px")):
        for given_one, replaced in ((one, other), (other, one)):
            if given_one in chosen and replaced not in chosen:
                base.pop(replaced, None)
    try:
        return RunSettings(**{**base, **chosen})
    except ValidationError as error:
        first = error.errors()[0]
        reason = first["msg"].removeprefix("Value error, ")
        in_file = bool(first["loc"]) and str(first["loc"][0]) not in chosen
        raise (ConfigError if in_file else UsageError)(f"{_option(first['loc'])}{reason}.") from error


def _option(place: tuple[int | str, ...]) -> str:
    """The option that a field stands for, with a colon; empty for the settings as a whole."""
    if not place:
        return ""
    name = str(place[0])
    if name not in RunSettings.model_fields or name in _NO_OPTION:
        return f"{name}: "
    return f"--{name.removesuffix('_s').replace('_', '-').replace('size-px', 'size')}: "


def save_settings(settings: RunSettings, path: Path, *, found: dict[str, Any]) -> None:
    """Write settings.yaml: the run's settings with absolute paths, and under `found` what the run saw."""
    run = absolute_settings(settings)
    write_text(path, yaml.safe_dump({"track_range_settings": 1, "run": run, "found": found}, sort_keys=False))


def absolute_settings(settings: RunSettings) -> dict[str, Any]:
    """The settings as settings.yaml keeps them: plain values, with absolute paths."""
    run: dict[str, Any] = settings.model_dump(mode="json", exclude_none=True)
    for key in ("rig", "detections", "curves", "truth", "table", "out", "reid"):
        if key in run:
            run[key] = str(Path(run[key]).resolve())
    for key in ("detector", "names", "align", "lanes", "ego_speed"):  # a file, or a word
        if key in run and Path(run[key]).exists():
            run[key] = str(Path(run[key]).resolve())
    if settings.stereo:
        run["stereo"] = [_absolute(video) for video in settings.stereo]
    if settings.mono:
        run["mono"] = _absolute(settings.mono)
    return run


def _absolute(video: VideoName) -> str:
    return str(video.resolve() if isinstance(video, Path) else video)


def _read(file: Path) -> dict[str, Any]:
    try:
        document = yaml.safe_load(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{file}: cannot be read ({error.strerror or error}).") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"{file}: not YAML.") from error
    if not isinstance(document, dict) or document.get("track_range_settings") != 1:
        raise ConfigError(f"{file}: not a settings.yaml of track-range (no 'track_range_settings: 1').")
    run = document.get("run")
    if not isinstance(run, dict) or not all(isinstance(key, str) for key in run):
        raise ConfigError(f"{file}: a section 'run:' wanted.")
    return run
