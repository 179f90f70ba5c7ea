"""RunSettings: all options of a run in one object, and the rules between them.

The options of input, detection and tracking are in `run.options`; options of ranging and output are
here.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from track_range.foundation.files.input_files import quoted
from track_range.foundation.schemas.options import Options, option
from track_range.foundation.schemas.validation import chosen_numbers
from track_range.ranging.size_models.region import Region
from track_range.ranging.warning.settings import WarningSettings
from track_range.recording.video.names import stem_of
from track_range.results.events.event import EventSettings
from track_range.results.formats.mcap import PROFILES
from track_range.results.writers import DEFAULT_WRITERS, FILES_OF_WRITERS, WRITERS
from track_range.run.options.detection import DetectionOptions, TrackingOptions
from track_range.run.options.input import InputOptions

_clip_option = partial(option, is_per_clip=True)
_file_option = partial(option, is_output=True)


class RangingOptions(Options):
    """Options of the measurement of distances, and of warnings and events."""

    panel: ClassVar = "Ranging"

    curves: Annotated[
        Path | None,
        _clip_option(
            "Size curves of the mono method, written by `track-range fit` (default: the "
            "packaged curves)."
        ),
    ] = None
    region: Annotated[
        Region | None,
        _clip_option(
            "Region of the recording, since sizes of vehicles, people and lanes differ between "
            "regions (default: from GPS positions, which --ego-speed auto reads; else unknown, "
            "with larger sigmas for one camera). Size curves in a file override the region."
        ),
    ] = None
    sgbm: Annotated[
        bool,
        option(
            "Dense stereo matching (sgbm, slow) in addition to the patch matcher (stereo).",
            flag="--sgbm/--no-sgbm",
            is_shared=True,
        ),
    ] = True
    sgbm_options: Annotated[
        dict[str, Any],
        option(
            "Parameters of dense stereo that override the rig's parameters: fields of "
            "SgbmSettings.",
            is_file_only=True,
        ),
    ] = Field(default_factory=dict)
    warning_options: Annotated[
        dict[str, Any],
        option(
            "Thresholds of the collision warning that override the defaults: fields of "
            "WarningSettings.",
            is_file_only=True,
        ),
    ] = Field(default_factory=dict)
    event_options: Annotated[
        dict[str, Any],
        option(
            "Thresholds of the events that override the defaults: fields of EventSettings.",
            is_file_only=True,
        ),
    ] = Field(default_factory=dict)
    align: Annotated[
        str,
        _clip_option(
            "Disparity correction: estimated from the drive (auto), none (off), or read from a "
            "file written by `track-range align`.",
            words=("auto", "off"),
            metavar="FILE",
            is_file=True,
        ),
    ] = "auto"
    lanes: Annotated[
        str,
        option(
            "Detector of the lines of the ego lane, for distances by lane width: edge-based "
            "(classical), none (off), or a lane network (ONNX).",
            words=("classical", "off"),
            metavar="FILE",
            is_file=True,
        ),
    ] = "classical"
    lane_width_m: Annotated[
        float | None,
        _clip_option(
            "Width of the ego lane in metres (default: estimated from the drive, region and "
            "speed).",
            metavar="M",
            ge=1.5,
            le=6.0,
        ),
    ] = None
    camera_height_m: Annotated[
        float | None,
        _clip_option(
            "Height of the camera above the road in metres (default: estimated from the drive).",
            metavar="M",
            ge=0.2,
            le=5.0,
        ),
    ] = None

    @field_validator("sgbm_options", "warning_options", "event_options")
    @classmethod
    def _known_parameters(cls, values: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        if values and info.field_name == "sgbm_options":
            from track_range.stereo.matching.sgbm import SgbmSettings  # imports OpenCV

            SgbmSettings.of(values)
        elif values:
            chosen_numbers(
                WarningSettings if info.field_name == "warning_options" else EventSettings, values
            )
        return values

    @property
    def warning_settings(self) -> WarningSettings:
        """Thresholds of the collision warning."""
        return chosen_numbers(WarningSettings, self.warning_options)

    @property
    def event_settings(self) -> EventSettings:
        """Thresholds of the events."""
        return chosen_numbers(EventSettings, self.event_options)


class OutputOptions(Options):
    """The files of a run."""

    panel: ClassVar = "Output"

    out: Annotated[
        Path | None,
        _file_option(
            "Folder of the results (default: LEFT-track-range in the current folder).",
            metavar="DIR",
            is_shared=True,
        ),
    ] = None
    write: Annotated[
        tuple[str, ...],
        _file_option(
            "Formats of the result files: "
            f"{', '.join(f'{name} ({text})' for name, text in FILES_OF_WRITERS.items())}, or "
            "formats of installed packages.",
            metavar="A,B,...",
        ),
    ] = DEFAULT_WRITERS
    anonymize: Annotated[
        bool,
        option(
            "Irreversible blur of heads and number plates in all images of the results, and no "
            "folder names in the results; undetected heads and plates are not blurred."
        ),
    ] = False
    mcap_profile: Annotated[
        str,
        _file_option(
            "Message types of run.mcap: Foxglove's, or ROS 2's (CDR).", choices=PROFILES.keys
        ),
    ] = "foxglove"
    mcap_images: Annotated[
        bool, _file_option("Images in run.mcap, as JPEG.", flag="--mcap-images/--no-mcap-images")
    ] = False
    table: Annotated[
        Path | None,
        _file_option(
            "Markdown file for the tables of the run.",
            metavar="FILE.md",
            instead="every clip would overwrite the file; use `track-range fleet report`",
        ),
    ] = None
    keep_gps: Annotated[
        bool,
        _file_option(
            "Output of the recording's positions in telemetry.csv; without this option, results "
            "have no positions."
        ),
    ] = False
    overlay: Annotated[
        bool, _file_option("Annotated video, overlay.mp4.", flag="--overlay/--no-overlay")
    ] = True
    clips: Annotated[
        bool,
        _file_option(
            "Short video of each event in the folder clips, cut from overlay.mp4: from 3 s before "
            "its start to 2 s after its end."
        ),
    ] = False
    disparity: Annotated[
        bool,
        _file_option(
            "Video of the disparities of dense stereo, disparity.mp4.",
            flag="--disparity/--no-disparity",
        ),
    ] = False
    overlay_disparity: Annotated[
        bool,
        _file_option(
            "Colour-coded disparities of dense stereo below each frame of the overlay.",
            flag="--overlay-disparity/--no-overlay-disparity",
            old_names=("overlay_side",),
        ),
    ] = False
    overlay_recorded: Annotated[
        bool,
        option(
            "Overlay on the recorded images of a wide lens instead of the undistorted images.",
            flag="--overlay-recorded/--no-overlay-recorded",
        ),
    ] = False

    @field_validator("write")
    @classmethod
    def _known_writers(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        known = WRITERS.names
        if unknown := [name for name in names if name not in known]:
            raise ValueError(f"unknown format {', '.join(unknown)}: expected {', '.join(known)}")
        return tuple(dict.fromkeys(names))


# pydantic lists the fields of the last base first
class PipelineOptions(RangingOptions, TrackingOptions, DetectionOptions):
    """Options of the processing of a frame, whether the frame comes from a file or from memory."""


class RunSettings(OutputOptions, PipelineOptions, InputOptions):
    """All settings that determine the results of a run: options of `track-range run` and keys of
    settings.yaml.
    """

    @model_validator(mode="after")
    def _without_contradictions(self) -> Self:
        for is_broken, sentence in _CONTRADICTIONS:
            if is_broken(self):
                raise ValueError(
                    sentence.format(n=len(self.topics), topic=quoted("".join(self.topics[:1])))
                )
        return self

    @property
    def out_dir(self) -> Path:
        """Output folder."""
        return self.out or Path(f"{stem_of(self.left)}-track-range")

    @property
    def has_dense_stereo(self) -> bool:
        """Whether dense stereo is requested for a pair."""
        return self.stereo is not None and self.sgbm


# whether they do, and what to do instead
_CONTRADICTIONS: tuple[tuple[Callable[[RunSettings], bool], str], ...] = (
    (lambda run: len(run.videos) == 0, "give either --stereo LEFT RIGHT or --mono VIDEO"),
    (
        lambda run: None not in (run.stereo, run.mono),
        "give either --stereo LEFT RIGHT or --mono VIDEO",
    ),
    (
        lambda run: len(run.videos) == 1 and len(run.topics) > 1,
        "--topics: expected 1 topic, got {n}",
    ),
    (
        lambda run: (
            len(run.videos) > 1
            and len(run.topics) not in ((0, 1, 2) if run.has_both_in_one else (0, 2))
        ),
        "--topics: expected 2 topics, got {n}",
    ),
    (
        lambda run: run.stereo_layout is not None and not run.has_both_in_one,
        "--stereo-layout needs --stereo with one recording of both cameras; omit the option, or "
        "the right video",
    ),
    (
        lambda run: run.track is not None and run.mono is None,
        "--track needs --mono; give --stereo FILE for two tracks",
    ),
    (
        lambda run: len(run.topics) > 1 and len({*zip(run.videos, run.topics, strict=True)}) == 1,
        "--topics: expected the topics of two cameras, got {topic} twice",
    ),
    (
        lambda run: None not in (run.detector, run.detections),
        "give --detector or --detections, not both",
    ),
    (lambda run: None not in (run.rig, run.focal_px), "give --rig or --focal-px, not both"),
    (
        lambda run: run.yaw_deg != 0 and run.mono is None,
        "--yaw-deg needs --mono: the cameras of a pair are side by side only when they look ahead",
    ),
    (
        lambda run: run.keep_gps and run.anonymize,
        "give --keep-gps or --anonymize, not both: positions show where people live",
    ),
    (
        lambda run: run.clips and not run.overlay,
        "--clips cuts its videos from overlay.mp4: it cannot be combined with --no-overlay",
    ),
    (
        lambda run: run.overlay_disparity and not (run.has_dense_stereo and run.overlay),
        "--overlay-disparity shows dense stereo below the overlay: it requires --stereo, and "
        "cannot be combined with --no-sgbm or --no-overlay",
    ),
    (
        lambda run: (
            run.overlay_recorded and (not run.overlay or run.overlay_disparity or run.anonymize)
        ),
        "--overlay-recorded draws on the images as recorded: it cannot be combined with "
        "--no-overlay, --overlay-disparity or --anonymize",
    ),
    (
        lambda run: run.disparity and not run.has_dense_stereo,
        "--disparity shows dense stereo: it requires --stereo, and cannot be combined with "
        "--no-sgbm",
    ),
)
