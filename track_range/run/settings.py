"""RunSettings: all options of a run in one object, declared by group in `run.options`, and the rules between them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Self

from pydantic import model_validator

from track_range.foundation.files.input_files import quoted
from track_range.recording.names import stem_of
from track_range.run.options.detection import DetectionOptions, TrackingOptions
from track_range.run.options.input import InputOptions
from track_range.run.options.output import OutputOptions
from track_range.run.options.ranging import RangingOptions


# pydantic lists the fields of the last base first
class PipelineOptions(RangingOptions, TrackingOptions, DetectionOptions):
    """Options of what happens to a frame, whether it comes from a file or from memory."""


class RunSettings(OutputOptions, PipelineOptions, InputOptions):
    """All settings that determine the results of a run: options of `track-range run` and keys of settings.yaml."""

    @model_validator(mode="after")
    def _without_contradictions(self) -> Self:
        for is_broken, sentence in _CONTRADICTIONS:
            if is_broken(self):
                raise ValueError(sentence.format(n=len(self.topics), topic=quoted("".join(self.topics[:1]))))
        return self

    @property
    def out_dir(self) -> Path:
        """Output folder."""
        return self.out or Path(f"{stem_of(self.left)}-track-range")

    @property
    def has_dense_stereo(self) -> bool:
        """Whether dense stereo is requested for a pair."""
        return self.stereo is not None and self.sgbm


_CONTRADICTIONS: tuple[tuple[Callable[[RunSettings], bool], str], ...] = (
    (lambda run: len(run.videos) == 0, "give either --stereo LEFT RIGHT or --mono VIDEO"),
    (lambda run: None not in (run.stereo, run.mono), "give either --stereo LEFT RIGHT or --mono VIDEO"),
    (lambda run: len(run.videos) == 1 and len(run.topics) > 1, "--topics: expected 1 topic, got {n}"),
    (lambda run: len(run.videos) > 1 and len(run.topics) not in (0, 2), "--topics: expected 2 topics, got {n}"),
    (
        lambda run: len(run.topics) > 1 and len({*zip(run.videos, run.topics, strict=True)}) == 1,
        "--topics: expected the topics of two cameras, got {topic} twice",
    ),
    (lambda run: None not in (run.detector, run.detections), "give --detector or --detections, not both"),
    (lambda run: None not in (run.rig, run.focal_px), "give --rig or --focal-px, not both"),
    (
        lambda run: run.yaw_deg != 0 and run.mono is None,
        "--yaw-deg needs --mono: the right camera of a pair is to the side of the left one only ahead",
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
        "--overlay-disparity shows dense stereo below the overlay: it requires --stereo, and cannot be combined with "
        "--no-sgbm or --no-overlay",
    ),
    (
        lambda run: run.overlay_recorded and (not run.overlay or run.overlay_disparity or run.anonymize),
        "--overlay-recorded draws on the images as recorded: it cannot be combined with --no-overlay, "
        "--overlay-disparity or --anonymize",
    ),
    (
        lambda run: run.disparity and not run.has_dense_stereo,
        "--disparity shows dense stereo: it requires --stereo, and cannot be combined with --no-sgbm",
    ),
)
"""Options that contradict each other: whether settings do, and what to do instead; the first one is reported."""
