"""What the command line says of a detector: names, thresholds, and the words that mean a model."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from track_range.detection.classes import road_class_ids
from track_range.detection.models.lookup import models_folder
from track_range.detection.models.metadata import ModelOptions
from track_range.detection.models.onnx_session import Device, Runtime
from track_range.detection.yolo.detector import YoloDetector, YoloSettings
from track_range.foundation.errors import ConfigError, UsageError


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectorOptions:
    """Options that every command with a detector takes; None = not given.

    Attributes:
        names: class names of the network, `a,b,c` or a file with one per line.
        anchors, letterbox: see `detection.models.metadata`.
        min_score: `0.25`, or `0.1,car=0.3,person=0.2` where classes have thresholds of their own.
        size_px: longer side of the network's input where the model leaves it open; None = the model's own.
        threads: of the network; 0 = one per core.
        device: where it runs.
        classes: road classes wanted; empty = all.
    """

    names: str | None = None
    anchors: str | None = None
    letterbox: str | None = None
    min_score: str | None = None
    size_px: int | None = None
    threads: int = 0
    device: Device = "auto"
    classes: tuple[str, ...] = ()


def open_detector(path: Path, options: DetectorOptions, *, lowest_score: float | None = None) -> YoloDetector:
    """The detector in `path`; `lowest_score` sets all thresholds aside (an evaluation wants the weakest boxes too).

    Raises:
        ModelError: the model cannot be used.
        ClassNameError: a class in the options is unknown.
        ConfigError: names or thresholds are wrong.
    """
    default = YoloSettings()
    least, by_class = thresholds(options.min_score, otherwise=default.min_score)
    settings = YoloSettings(
        min_score=least if lowest_score is None else lowest_score,
        class_min_score=by_class if lowest_score is None else (),
        class_id=tuple(int(i) for i in road_class_ids(options.classes)),
        size_px=options.size_px,
    )
    told = ModelOptions(names=class_names(options.names), anchors=options.anchors, letterbox=options.letterbox)
    runtime = Runtime(device=options.device, n_threads=options.threads, engine_folder=_engine_folder(options.device))
    return YoloDetector(path, settings, options=told, runtime=runtime)


def _engine_folder(device: Device) -> Path | None:
    """Where TensorRT's engines are kept, beside the downloaded models."""
    if device != "tensorrt":
        return None
    folder = models_folder().with_name("engines")
    with suppress(OSError):  # without it, TensorRT builds its engine anew each time
        folder.mkdir(parents=True, exist_ok=True)
    return folder if folder.is_dir() else None


def class_names(option: str | None) -> tuple[str, ...] | None:
    """Class names from `a,b,c` or from a file with one per line.

    Raises:
        ConfigError: no such file, or nothing in it.
    """
    if option is None:
        return None
    path = Path(option)
    if "," in option or not path.suffix:
        names = tuple(name.strip() for name in option.split(","))
    else:
        try:
            names = tuple(line.strip() for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip())
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(f"--names {option}: no readable text file with one name per line.") from error
    if not all(names) or not names:
        raise ConfigError(f"--names {option}: class names wanted, a,b,c or a file with one per line.")
    return names


def thresholds(option: str | None, *, otherwise: float) -> tuple[float, tuple[tuple[int, float], ...]]:
    """The score below which boxes are dropped, and (class id, score) of the classes with one of their own.

    Raises:
        UsageError: a number is not from 0 to 1, or there are two without a class.
        ClassNameError: a class is unknown.
    """
    least, by_class = None, []
    for part in option.split(",") if option else ():
        name, is_of_class, number = part.rpartition("=")
        score = _score(number)
        if is_of_class:
            by_class += [(int(class_id), score) for class_id in road_class_ids([name])]
        elif least is None:
            least = score
        else:
            raise UsageError(f"--min-score {option}: one number for all classes, then class=number, parted by commas.")
    return (otherwise if least is None else least), tuple(by_class)


def _score(text: str) -> float:
    try:
        score = float(text)
    except ValueError:
        score = -1.0
    if not 0 <= score <= 1:
        raise UsageError(f"--min-score: '{text.strip()}' is no score from 0 to 1, such as 0.25 or 0.1,car=0.3.")
    return score
