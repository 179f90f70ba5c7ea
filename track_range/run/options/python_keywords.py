"""Options of `Run` and `Pipeline` by keyword, in the place of a command line."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from track_range.detection.detector import ObjectDetector
from track_range.foundation.errors import ConfigError, UsageError
from track_range.foundation.schemas.options import Options
from track_range.run.options.settings import PipelineOptions
from track_range.stereo.geometry.rig import StereoRig
from track_range.tracking.registry import ObjectTracker

_OBJECTS: dict[str, tuple[type, str]] = {  # options that may be objects: of which type, in words
    "detector": (
        ObjectDetector,
        "the name or file of a model, or an object with detect(image) -> Detections",
    ),
    "tracker": (
        ObjectTracker,
        "a name, or an object with update(detections, time_s, image) -> Tracks",
    ),
    "rig": (StereoRig, "a calibration file or a StereoRig"),
}


def options_and_objects(
    model: type[Options], options: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Keywords of Python as values by field of `model`, and the detector, tracker and rig that are
    objects.

    ConfigError: one of the three is neither a text or path nor such an object.
    """
    objects = {}
    for name, (kind, expected) in _OBJECTS.items():
        value = options.get(name)
        is_class = isinstance(value, type)
        if isinstance(value, kind) and not is_class:
            objects[name] = value
        elif not isinstance(value, str | Path | None):
            given = f"the class {value.__name__}" if is_class else type(value).__name__
            raise ConfigError(f"{name}: expected {expected}, found {given}.")
    keywords = model.keywords()
    values = {
        keywords.get(name, name): value for name, value in options.items() if name not in objects
    }
    return values, objects


def pipeline_options(values: Mapping[str, Any]) -> PipelineOptions:
    """Options of detection, tracking and ranging from values by field (None = not given);
    ConfigError if invalid.
    """
    try:
        return PipelineOptions.of(values)
    except UsageError as error:
        raise ConfigError(str(error)) from error
