"""Detectors and options of trackers, opened from options as the command line takes them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Self

from track_range.detection.classes import (
    CLASS_LISTS,
    map_to_road_classes,
    road_class_id,
    road_class_ids,
)
from track_range.detection.models.devices import Device
from track_range.detection.models.onnx_session import Runtime
from track_range.detection.yolo.detector import YoloDetector, YoloSettings
from track_range.detection.yolo.metadata import ModelOptions
from track_range.foundation.errors import ConfigError, UsageError
from track_range.foundation.files.input_files import quoted, read_text, shortened
from track_range.foundation.files.numeric_text import number
from track_range.run.options.detection import DetectionOptions, input_size
from track_range.tracking.appearance.reid import ReidModel
from track_range.tracking.registry import TrackerOptions

_MAX_NAME = 200  # largest number of characters of a class name


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectorOptions:
    """Options of a detector as on the command line (see `DetectionOptions`); None = not given."""

    names: str | None = None
    anchors: str | None = None
    letterbox: str | None = None
    layout: str | None = None
    min_score: str | None = None
    size_px: int | str | None = None
    threads: int = 0
    device: Device = "auto"
    classes: tuple[str, ...] = ()

    @classmethod
    def of(cls, settings: DetectionOptions) -> Self:
        """Those of a run."""
        return cls(
            names=settings.names,
            anchors=settings.anchors,
            letterbox=settings.letterbox,
            layout=settings.layout,
            min_score=settings.min_score,
            size_px=None if settings.size_px == "auto" else settings.size_px,
            threads=settings.threads,
            device=settings.device,
            classes=settings.classes,
        )


def open_detector(
    path: Path, options: DetectorOptions, *, lowest_score: float | None = None
) -> YoloDetector:
    """The detector in `path`; a `lowest_score` replaces all thresholds, for evaluations over all
    confidences.

    ModelError: the model cannot be used; ClassNameError: a class is unknown; ConfigError: invalid
    names or thresholds.
    """
    min_score, by_class = thresholds(options.min_score, otherwise=YoloSettings().min_score)
    settings = YoloSettings(
        min_score=min_score if lowest_score is None else lowest_score,
        class_min_score=by_class if lowest_score is None else (),
        class_id=tuple(int(i) for i in road_class_ids(options.classes)),
        size_px=input_size(options.size_px),
    )
    model_options = ModelOptions(
        names=class_names(options.names),
        anchors=options.anchors,
        letterbox=options.letterbox,
        layout=options.layout,
    )
    runtime = Runtime(device=options.device, n_threads=options.threads)
    return YoloDetector(path, settings, options=model_options, runtime=runtime)


def class_names(option: str | None) -> tuple[str, ...] | None:
    """Class names from the name of a list (`CLASS_LISTS`), `a,b,c` or a file with one name per
    line; ConfigError for unreadable or empty files, and for one word that is neither a list nor a
    road class.
    """
    if option is None:
        return None
    if option.lower() in CLASS_LISTS:
        return CLASS_LISTS[option.lower()]
    path = Path(option)
    if "," in option or not path.suffix:
        source, names = shortened(option), tuple(name.strip() for name in option.split(","))
    else:
        text = read_text(path, ConfigError, "a text file with one class name per line (--names)")
        source, names = option, tuple(line.strip() for line in text.split("\n") if line.strip())
    if not all(names) or not names or max(map(len, names)) > _MAX_NAME:
        raise ConfigError(
            f"--names {source}: expected class names, a,b,c or a file with one name per line."
        )
    if names == (option,) and map_to_road_classes(names)[0] < 0:
        raise ConfigError(
            f"--names {source}: expected one of the lists {', '.join(CLASS_LISTS)}, names as "
            "a,b,c, a file with one name per line, or the name of a road class."
        )
    return names


def thresholds(
    option: str | None, *, otherwise: float
) -> tuple[float, tuple[tuple[int, float], ...]]:
    """Minimum confidence of boxes, and (class id, minimum confidence) of classes with separate
    thresholds.

    UsageError: a threshold is not from 0 to 1, or there are two without a class; ClassNameError: a
    class is unknown.
    """
    min_score, by_class = None, []
    for part in option.split(",") if option else ():
        name, separator, text = part.rpartition("=")
        score = number(text)
        if not 0 <= score <= 1:
            raise UsageError(
                "--min-score: expected confidences from 0 to 1, such as 0.25 or 0.1,car=0.3, "
                f"got {quoted(text.strip())}."
            )
        if separator:
            by_class.append((road_class_id(name), score))
        elif min_score is None:
            min_score = score
        else:
            raise UsageError(
                f"--min-score {shortened(option or '')}: expected one number for all classes, then "
                "class=number, separated by commas."
            )
    return (otherwise if min_score is None else min_score), tuple(by_class)


def open_tracker_options(
    reid: Path | None, runtime: Runtime | None = None, min_score: float | None = None
) -> TrackerOptions:
    """Options for trackers, with the re-identification network loaded if there is one; else
    ModelError.
    """
    model = None if reid is None else ReidModel(reid, runtime)
    return TrackerOptions(reid=model, min_score=min_score)


class OpenedDetectors:
    """The last opened detector, which the next run with the same file and options uses again; one
    run at a time.
    """

    def __init__(self) -> None:
        self._key: tuple[object, ...] | None = None
        self._detector: YoloDetector | None = None

    def __call__(self, path: Path, options: DetectorOptions) -> YoloDetector:
        """The detector of a file and options; errors as for `open_detector`."""
        key = (
            path,
            options,
            _state(path),
            None if options.names is None else _state(Path(options.names)),
        )
        if self._detector is None or key != self._key:
            self._detector = self._key = None  # two networks at a time would need twice the memory
            self._detector = open_detector(path, options)
            self._key = key
        self._detector.restart()
        return self._detector


def _state(path: Path) -> tuple[int, int] | None:
    """Size and time of change of a file; None if there is none."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return status.st_size, status.st_mtime_ns
