"""RunSettings: all options of a run in one object, and the rules between them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Self

from pydantic import model_validator

from track_range.foundation.files.input_files import quoted
from track_range.foundation.schemas.options import contradiction
from track_range.recording.sources.names import source_of
from track_range.run.options.detection import DetectionOptions, TrackingOptions
from track_range.run.options.fixed import FixedCameraOptions
from track_range.run.options.input import InputOptions
from track_range.run.options.methods import RunMethodOptions
from track_range.run.options.output import OutputOptions
from track_range.run.options.ranging import RangingOptions
from track_range.run.options.truth import TruthOptions

if TYPE_CHECKING:
    from track_range.recording.video.options import RecordingOptions


# pydantic lists the fields of the last base first
class PipelineOptions(
    FixedCameraOptions, RunMethodOptions, RangingOptions, TrackingOptions, DetectionOptions
):
    """Options of the processing of a frame, whether the frame comes from a file or from memory."""


class RunSettings(OutputOptions, PipelineOptions, TruthOptions, InputOptions):
    """All settings that determine the results of a run: options of `track-range run` and keys of
    settings.yaml.
    """

    @model_validator(mode="after")
    def _without_contradictions(self) -> Self:
        for options, is_broken, sentence in _CONTRADICTIONS:
            if is_broken(self):
                topic = quoted("".join(self.topics[:1]))
                raise contradiction(sentence.format(n=len(self.topics), topic=topic), options)
        return self

    @property
    def out_dir(self) -> Path:
        """Output folder."""
        return self.out or Path(f"{source_of(self.left).stem}-track-range")

    @property
    def recording(self) -> RecordingOptions:
        """How the recording is opened: the options of this name, which both have."""
        from track_range.recording.video.options import RecordingOptions  # imports NumPy

        names = [
            field.name
            for field in fields(RecordingOptions)
            if field.name in RunSettings.model_fields
        ]
        options = RecordingOptions(**{name: getattr(self, name) for name in names})
        layout = (self.stereo_layout or "auto") if self.has_both_in_one else None
        return replace(options, stereo_layout=layout)

    @property
    def has_dense_stereo(self) -> bool:
        """Whether dense stereo is requested for a pair."""
        is_chosen = not self.methods or "sgbm" in (*self.methods, *self.show_only)
        return self.stereo is not None and self.sgbm and is_chosen

    @property
    def has_dense_maps(self) -> bool:
        """Whether a method is requested that measures all pixels."""
        return self.has_dense_stereo or bool(self.stereo_model or self.depth_model)


NEEDS_PAIR = (
    "--stereo-model measures with two cameras: give a pair, or the network of one camera by "
    "--depth-model."
)


class Contradiction(NamedTuple):
    """A rule between options."""

    options: tuple[str, ...]  # fields on which it depends
    is_broken: Callable[[RunSettings], bool]
    sentence: str  # what to do instead


_CONTRADICTIONS = (
    Contradiction(
        ("ego_speed", "static_camera"),
        lambda run: run.static_camera and run.ego_speed not in ("auto", "off"),
        "--ego-speed is for a camera that drives; omit it, or --static-camera",
    ),
    Contradiction(
        ("stereo", "mono"),
        lambda run: (run.stereo is None) == (run.mono is None),
        "give either --stereo LEFT RIGHT or --mono VIDEO",
    ),
    Contradiction(
        ("mono", "topics"),
        lambda run: len(run.videos) == 1 and len(run.topics) > 1,
        "--topics: expected 1 topic, got {n}",
    ),
    Contradiction(
        ("stereo", "topics"),
        lambda run: (
            len(run.videos) > 1
            and len(run.topics) not in ((0, 1, 2) if run.has_both_in_one else (0, 2))
        ),
        "--topics: expected 2 topics, got {n}",
    ),
    Contradiction(
        ("stereo_layout", "stereo", "mono", "topics"),
        lambda run: run.stereo_layout is not None and not run.has_both_in_one,
        "--stereo-layout needs --stereo with one recording of both cameras; omit the option, or "
        "the right video",
    ),
    Contradiction(
        ("track", "mono", "stereo"),
        lambda run: run.track is not None and run.mono is None,
        "--track needs --mono; give --stereo FILE for two tracks",
    ),
    Contradiction(
        ("stereo", "topics"),
        lambda run: len(run.topics) > 1 and len({*zip(run.videos, run.topics, strict=True)}) == 1,
        "--topics: expected the topics of two cameras, got {topic} twice",
    ),
    Contradiction(
        ("detector", "detections"),
        lambda run: None not in (run.detector, run.detections),
        "give --detector or --detections, not both",
    ),
    Contradiction(
        ("rig", "focal_px"),
        lambda run: None not in (run.rig, run.focal_px),
        "give --rig or --focal-px, not both",
    ),
    Contradiction(
        ("known_distance", "rig", "focal_px"),
        lambda run: bool(run.known_distance) and (run.rig or run.focal_px) is not None,
        "--known-distance is for cameras without a calibration: omit it, or --rig and --focal-px",
    ),
    Contradiction(
        ("yaw_deg", "mono", "stereo"),
        lambda run: run.yaw_deg != 0 and run.mono is None,
        "--yaw-deg needs --mono: the cameras of a pair are side by side only when they look ahead",
    ),
    Contradiction(
        ("keep_gps", "anonymize"),
        lambda run: run.keep_gps and run.anonymize,
        "give --keep-gps or --anonymize, not both: positions show where people live",
    ),
    Contradiction(
        ("clips", "overlay"),
        lambda run: run.clips and not run.overlay,
        "--clips cuts its videos from overlay.mp4: it cannot be combined with --no-overlay",
    ),
    Contradiction(
        ("stereo_model", "stereo", "mono"),
        lambda run: bool(run.stereo_model) and run.stereo is None,
        NEEDS_PAIR.removesuffix("."),
    ),
    Contradiction(
        ("overlay_disparity", "stereo", "mono", "sgbm", "overlay"),
        lambda run: run.overlay_disparity and not (run.has_dense_maps and run.overlay),
        "--overlay-disparity shows dense stereo, or the depth of a network, below the overlay: it "
        "requires --stereo or --depth-model, and cannot be combined with --no-overlay, or with "
        "--no-sgbm without a network",
    ),
    Contradiction(
        ("overlay_recorded", "overlay", "overlay_disparity", "anonymize"),
        lambda run: (
            run.overlay_recorded and (not run.overlay or run.overlay_disparity or run.anonymize)
        ),
        "--overlay-recorded draws on the images as recorded: it cannot be combined with "
        "--no-overlay, --overlay-disparity or --anonymize",
    ),
    Contradiction(
        ("disparity", "stereo", "mono", "sgbm"),
        lambda run: run.disparity and not run.has_dense_maps,
        "--disparity shows dense stereo, or the depth of a network: it requires --stereo or "
        "--depth-model, and cannot be combined with --no-sgbm without a network",
    ),
)
