"""`track-range models quantize`: INT8 and FP16 copies of a detector, compared with the original."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from track_range.cli.commands.evaluate.detections import print_figures
from track_range.cli.shared.console import console
from track_range.cli.shared.parameters import command
from track_range.detection.formats.image_labels.image_truth import ImageTruth
from track_range.detection.formats.image_labels.labelled_images import ImageFileError, read_image
from track_range.detection.models.quantize import (
    N_CALIBRATION,
    calibration_images,
    convert_fp16,
    input_blobs,
    quantize_int8,
)
from track_range.detection.yolo.detector import YoloDetector
from track_range.evaluation.sequences.detector_evaluation import (
    WORKING_SCORE,
    evaluate,
    open_candidates,
)
from track_range.evaluation.sequences.labelled_images import LabelledFrames, LabelledSource
from track_range.evaluation.sequences.settings import (
    LabelFormatField,
    LabelNamesField,
    ManifestField,
    SplitField,
)
from track_range.foundation.arrays import Image
from track_range.foundation.files.output_files import make_folder, write_json
from track_range.foundation.schemas.options import Options, option
from track_range.run.options import detection as fields
from track_range.run.options.opened import DetectorOptions, class_names, open_detector
from track_range.run.progress import frame_progress
from track_range.run.ready_model import ready_model

# maximum number of images on which copies are compared with the original if there are no labels
N_COMPARED = 100


@dataclass(slots=True)
class _OriginalsBoxes:
    """Images without labels: the original's boxes are the truth, so that AP measures agreement with
    the original.
    """

    original: YoloDetector
    paths: Sequence[Path]
    unreadable: list[str] = field(default_factory=list)

    @property
    def n_images(self) -> int:
        return len(self.paths)

    def __iter__(self) -> Iterator[tuple[Image, ImageTruth]]:
        for path in self.paths:
            try:
                image = read_image(path)
            except ImageFileError as error:
                self.unreadable.append(str(error))
                continue
            boxes = self.original.detect(image)
            yield image, ImageTruth.of(boxes.xyxy_px, boxes.class_id)


class QuantizeOptions(Options):
    """Options of `track-range models quantize`."""

    model: Annotated[
        str,
        option(
            "Float32 detector: an ONNX file, or a name from `track-range models list`.",
            metavar="FILE|NAME",
            is_argument=True,
        ),
    ]
    images: Annotated[
        Path,
        option(
            f"Folder of images typical of the detector's use; {N_CALIBRATION} are used for "
            "calibration.",
            metavar="DIR",
        ),
    ]
    out: Annotated[
        Path, option("Folder of the copies (default: the current folder).", metavar="DIR")
    ] = Path()
    labels: Annotated[
        Path | None,
        option(
            "Labels of the images (default: the boxes of the original detector).",
            metavar="DIR|FILE",
        ),
    ] = None
    label_format: LabelFormatField = None
    label_names: LabelNamesField = None
    manifest: ManifestField = None
    split: SplitField = "val"
    names: fields.NamesField = None
    anchors: fields.AnchorsField = None
    letterbox: fields.LetterboxField = None
    layout: fields.LayoutField = None
    size_px: fields.SizeField = None
    threads: fields.ThreadsField = 0
    json_file: Annotated[
        Path | None, option("JSON file for the results.", flag="--json", metavar="FILE")
    ] = None


def _quantize(options: QuantizeOptions) -> None:
    """Calibrate on at most half of the images, drawn with a fixed seed; accuracy is measured on the
    other images.
    """
    images, out = options.images, options.out
    detector = DetectorOptions(
        names=options.names,
        anchors=options.anchors,
        letterbox=options.letterbox,
        layout=options.layout,
        size_px=options.size_px,
        threads=options.threads,
        device="cpu",
    )
    source = None
    if options.labels is not None:
        source = LabelledSource(
            images=images,
            labels=options.labels,
            label_format=options.label_format,
            label_names=class_names(options.label_names),
            manifest=options.manifest,
            split=options.split,
        )
    make_folder(out)
    path = ready_model(options.model, console)
    original = open_detector(path, replace(detector, min_score=str(WORKING_SCORE)))
    measured = frozenset(item.path for item in source.labelled_files()) if source else frozenset()
    calibration, others = calibration_images(images, measured)
    int8, fp16 = (out / f"{path.stem}-{kind}.onnx" for kind in ("int8", "fp16"))
    with console.status(f"Calibrating on {len(calibration)} images") as status:
        quantize_int8(
            path,
            int8,
            blobs=input_blobs(original.input_blob, calibration),
            progress=lambda done, total: status.update(
                f"Correcting the biases of convolution {done + 1} of {total}"
            ),
        )
        convert_fp16(path, fp16)
    frames: LabelledFrames = _OriginalsBoxes(original, others[:N_COMPARED])
    if source is not None:
        frames = replace(source, leave_out=frozenset(calibration)).open()
    candidates = open_candidates([str(model) for model in (path, int8, fp16)], detector, Path)
    figures = evaluate(
        candidates, frames, min_score=None, progress=partial(frame_progress, console)
    )
    truth = (
        "the labels"
        if source
        else f"the original's boxes with a confidence of {WORKING_SCORE} or more"
    )
    figures["notes"].append(
        f"Accuracy is measured against {truth}, on images that were not used for calibration."
    )
    print_figures(figures)
    console.print(f"Written: {int8}, {fp16}", highlight=False, soft_wrap=True)
    write_json(options.json_file, figures, allow_nan=True)
    raise typer.Exit(0 if figures["is_complete"] else 1)


app = command(QuantizeOptions, _quantize)
