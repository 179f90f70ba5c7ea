"""`track-range models quantize`: INT8 and FP16 copies of a detector, and what they cost in accuracy, side by side."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from track_range.commands.evaluate import WORKING_SCORE, evaluate, open_candidates, tell_figures
from track_range.commands.ready_model import ready_model
from track_range.detection.formats.image_truth import ImageTruth
from track_range.detection.formats.labelled_images import ImageFileError, images_in, read_image
from track_range.detection.models.onnx_session import ModelError
from track_range.detection.models.quantize import convert_fp16, quantize_int8
from track_range.detection.yolo.detector import YoloDetector
from track_range.foundation.arrays import FloatArray32, Image
from track_range.results.output_files import make_folder
from track_range.run.detector_options import DetectorOptions, open_detector
from track_range.sequences.labelled_images import LabelledFrames, LabelledSource

N_CALIBRATION = 60
"""Images that tell the range of every layer's numbers; more change nothing (see detection/models/quantize.py)."""

N_COMPARED = 100
"""Images on which a copy is compared with its original where there are no labels."""


@dataclass(slots=True)
class _OriginalsBoxes:
    """Images without labels: the original's own boxes are the truth, so that AP measures agreement with it."""

    original: YoloDetector
    paths: Sequence[Path]
    unreadable: list[str] = field(default_factory=list)

    @property
    def n_images(self) -> int:
        """To expect."""
        return len(self.paths)

    def __iter__(self) -> Iterator[tuple[Image, ImageTruth]]:
        for path in self.paths:
            try:
                image = read_image(path)
            except ImageFileError as error:
                self.unreadable.append(str(error))
                continue
            found = self.original.detect(image)
            yield image, ImageTruth.of(found.xyxy_px, found.class_id)


def quantize_model(
    model: str, images: Path, out: Path, *, source: LabelledSource | None, options: DetectorOptions, console: Console
) -> dict[str, Any]:
    """Write NAME-int8.onnx and NAME-fp16.onnx into `out`, print size, speed and accuracy beside the original's.

    Calibration uses 60 images of the folder (half of them, if they are fewer), drawn with a fixed seed; accuracy is
    measured on others: against labels where there are some, else against the original's boxes of score 0.25 and more.

    Raises:
        ModelError: the model cannot be converted.
        ImageFileError, LabelFileError: images or labels cannot be read.
        OutputError: `out` cannot be written to.
    """
    make_folder(out)
    path = ready_model(model, console)
    original = open_detector(path, replace(options, min_score=str(WORKING_SCORE)))
    measured = frozenset(item.path for item in source.labelled_files()) if source else frozenset()
    calibration, others = _calibration_images(images, measured)
    int8, fp16 = (out / f"{path.stem}-{kind}.onnx" for kind in ("int8", "fp16"))
    with console.status(f"calibrating on {len(calibration)} images") if console.is_terminal else nullcontext():
        quantize_int8(path, int8, blobs=_blobs(original, calibration))
        convert_fp16(path, fp16)
    frames: LabelledFrames = _OriginalsBoxes(original, others[:N_COMPARED])
    if source is not None:
        frames = replace(source, leave_out=frozenset(calibration)).open()
    candidates = open_candidates([str(each) for each in (path, int8, fp16)], options, console)
    figures = evaluate(candidates, frames, min_score=None, console=console)
    truth = "the labels" if source else f"the original's boxes of score {WORKING_SCORE} and more"
    figures["notes"].append(f"Accuracy is against {truth}, on images that calibration did not see.")
    tell_figures(figures, console)
    console.print(f"Written: {int8}, {fp16}", highlight=False, soft_wrap=True)
    return figures


def _calibration_images(folder: Path, measured: frozenset[Path]) -> tuple[list[Path], list[Path]]:
    """Images to calibrate on, and the rest; those to be measured on are taken only if there are no others."""
    paths = images_in(folder)
    pool = [path for path in paths if path not in measured] or paths
    n = min(N_CALIBRATION, len(paths) // 2)
    if n == 0:
        raise ModelError(
            f"{folder}: at least 2 images wanted, to calibrate on and to compare on; better {N_CALIBRATION}."
        )
    drawn = [pool[i] for i in np.random.default_rng(0).permutation(len(pool))]
    return drawn[:n], drawn[n:] or [path for path in paths if path not in drawn[:n]]


def _blobs(detector: YoloDetector, paths: Sequence[Path]) -> Iterator[FloatArray32]:
    for path in paths:
        with suppress(ImageFileError):  # one damaged image of many changes nothing; with none left, ModelError
            yield detector.input_of(read_image(path))
