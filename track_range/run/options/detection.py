"""Options of a run for its boxes and their identities: detector, recorded detections, and tracker."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

from pydantic import model_validator

from track_range.foundation.options import Options, option
from track_range.run.options.detector_fields import (
    AnchorsField,
    DeviceField,
    LetterboxField,
    NamesField,
    SizeField,
    ThreadsField,
)
from track_range.run.options.tracker_fields import ReidField, TrackerField, check_tracker

_shared_option = partial(option, is_shared=True)


class DetectionOptions(Options):
    """The boxes of a run."""

    panel: ClassVar = "Detection"

    detector: Annotated[
        str | None,
        _shared_option(
            "YOLO network: an ONNX file, or a name from `track-range models list` (default: road, which is packaged).",
            metavar="FILE|NAME",
            is_file=True,
        ),
    ] = None
    classes: Annotated[
        tuple[str, ...],
        _shared_option(
            "Road classes to track: person, bicycle, car, motorcycle, bus, truck, traffic light, traffic sign "
            "(default: all).",
            metavar="A,B,...",
        ),
    ] = ()
    min_score: Annotated[
        str | None,
        _shared_option(
            "Minimum detection confidence from 0 to 1, also by class: 0.1,car=0.3 (default: 0.1).",
            metavar="S[,CLASS=S...]",
        ),
    ] = None
    detections: Annotated[
        Path | None,
        option(
            "Recorded boxes instead of a detector: MOTChallenge's det.txt, KITTI labels or detections, a tracks.csv or "
            "tracks.parquet, COCO, CVAT for video, or a folder of YOLO labels.",
            is_per_clip=True,
            instead="recorded detections belong to a clip; give them in the column detections of a manifest",
        ),
    ] = None
    names: NamesField = None
    anchors: AnchorsField = None
    letterbox: LetterboxField = None
    size_px: SizeField = None
    threads: ThreadsField = 0
    device: DeviceField = "auto"

    @model_validator(mode="before")
    @classmethod
    def _packaged_detector(cls, values: Any) -> Any:
        """Use the packaged detector if neither a detector nor detections are given."""
        if isinstance(values, dict) and values.get("detector") is None and values.get("detections") is None:
            from track_range.detection.models.lookup import DEFAULT_MODEL  # imports onnxruntime

            return {**values, "detector": DEFAULT_MODEL}
        return values


class TrackingOptions(Options):
    """The tracker that gives boxes identities."""

    panel: ClassVar = "Tracking"

    tracker: TrackerField = "deepsort"
    reid: ReidField = None

    @model_validator(mode="after")
    def _known_tracker(self) -> Self:
        check_tracker(self.tracker, self.reid)
        return self
