"""`track-range models calibrate-scores`: a copy of a detector whose scores are probabilities."""

from pathlib import Path
from typing import Annotated

import numpy as np

from track_range.cli.commands.evaluate.result_files import check_result_files
from track_range.cli.shared.console import console, print_grid, print_line, print_notes
from track_range.cli.shared.parameters import command
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.evaluation import score_fit
from track_range.detection.evaluation.calibrated_copy import (
    check_attributes,
    score_outputs,
    write_calibrated_copy,
)
from track_range.detection.evaluation.score_calibration import MIN_SCORE, Reliability
from track_range.detection.formats.image_labels.image_truth import ImageTruth
from track_range.detection.models.onnx_session import ModelError
from track_range.detection.yolo.detector import YoloDetector
from track_range.evaluation.sequences.labelled_images import LabelledSource
from track_range.evaluation.sequences.settings import (
    LabelFormatField,
    LabelNamesField,
    ManifestField,
    SplitField,
)
from track_range.foundation.files.input_files import counted
from track_range.foundation.files.output_files import write_json
from track_range.foundation.schemas.options import Options, option
from track_range.run.options.detection import ThreadsField
from track_range.run.options.opened import DetectorOptions, class_names, open_detector
from track_range.run.progress import frame_progress
from track_range.run.ready_model import ready_model
from track_range.views.tables import Column, Grid, grid_of


class CalibrateScoresOptions(Options):
    """Options of `track-range models calibrate-scores`."""

    model: Annotated[
        str,
        option(
            "Detector with separate outputs for the class scores (RoadNet, NanoDet, PicoDet): an "
            "ONNX file, or a name from `track-range models list`.",
            metavar="FILE|NAME",
            is_argument=True,
        ),
    ]
    images: Annotated[
        Path,
        option(
            "Labelled images that were not used for training: a folder or a video.",
            metavar="DIR|FILE",
        ),
    ]
    labels: Annotated[Path, option("Labels of the images.", metavar="DIR|FILE")]
    out: Annotated[Path, option("File to write.", metavar="FILE.onnx")]
    label_format: LabelFormatField = None
    label_names: LabelNamesField = None
    manifest: ManifestField = None
    split: SplitField = "val"
    threads: ThreadsField = 0
    json_file: Annotated[
        Path | None, option("JSON file for the coefficients.", flag="--json", metavar="FILE")
    ] = None


def _calibrate_scores(options: CalibrateScoresOptions) -> None:
    check_result_files(options)
    path = ready_model(options.model, console)
    check_attributes(path, options.out)
    detector = open_detector(
        path,
        DetectorOptions(
            min_score=str(score_fit.LOWEST_SCORE), threads=options.threads, device="cpu"
        ),
    )
    score_outputs(detector)
    frames = _labelled_source(options).open()
    detections: list[Detections] = []
    truth: list[ImageTruth] = []
    with frame_progress(console, frames.n_images) as advance:
        for image, labels in frames:
            detections.append(detector.detect(image))
            truth.append(labels)
            advance()
    samples = score_fit.ScoreSamples.of(detections, truth, detector.known_class_id)
    fit = score_fit.fit_scores(samples)
    if fit is None:
        unreadable = (
            f" ({counted(len(frames.unreadable), 'image')} cannot be read)"
            if frames.unreadable
            else ""
        )
        raise ModelError(
            f"{options.images}: expected at least {score_fit.MIN_POSITIVES} detections that match "
            f"a label, and some that do not, got {np.count_nonzero(samples.is_match)} and "
            f"{np.count_nonzero(~samples.is_match)}{unreadable}; give more images with labels of "
            "classes that the detector knows."
        )
    write_calibrated_copy(detector, fit, options.out, images=options.images)
    before = score_fit.reliability(samples.score, samples.is_match)
    after = score_fit.cross_validated(detections, truth, detector.known_class_id)
    print_grid(console, _coefficient_grid(fit, detector), _error_grid(before, after))
    validation = (
        "Cross-validated: fitted to one half of the images and measured on the other half; the "
        "file has the fit to all images."
        if after
        else f"Not cross-validated: half of the images have fewer than {score_fit.MIN_POSITIVES} "
        "matches."
    )
    print_notes(
        console,
        [
            f"{len(truth)} images. Classes with fewer than {score_fit.MIN_POSITIVES} matches share "
            "their coefficients.",
            f"ECE of boxes with a score of {MIN_SCORE} or more: mean difference between score and "
            f"precision; chance: ECE of perfectly calibrated scores. {validation}",
            *(
                f"Skipped {counted(len(frames.unreadable), 'image')}; the first: {one}"
                for one in frames.unreadable[:1]
            ),
        ],
    )
    print_line(console, f"Written: {options.out}")
    figures = {
        "n_images": len(truth),
        "classes": fit.as_dict(),
        "before": before.as_dict(),
        "cross_validated": None if after is None else after.as_dict(),
    }
    write_json(options.json_file, figures, allow_nan=True)


def _labelled_source(options: CalibrateScoresOptions) -> LabelledSource:
    return LabelledSource(
        images=options.images,
        labels=options.labels,
        label_format=options.label_format,
        label_names=class_names(options.label_names),
        manifest=options.manifest,
        split=options.split,
    )


def _coefficient_grid(fit: score_fit.ScoreFit, detector: YoloDetector) -> Grid:
    ids = [i for i in range(len(ROAD_CLASSES)) if i in detector.known_class_id]
    columns = [
        Column("matches", fit.n_positives[ids].tolist(), "{:.0f}"),
        Column("slope", fit.slope[ids].tolist(), "{:.2f}"),
        Column("offset", fit.offset[ids].tolist(), "{:.2f}"),
    ]
    return grid_of(
        "Calibrated score = sigmoid(slope logit(score) + offset)",
        "class",
        [ROAD_CLASSES[i] for i in ids],
        columns,
    )


def _error_grid(before: Reliability, after: Reliability | None) -> Grid:
    rows = {"original": before} | ({} if after is None else {"calibrated, cross-validated": after})
    columns = [
        Column("detections", [float(row.n.sum()) for row in rows.values()], "{:.0f}"),
        Column("ECE %", [row.ece for row in rows.values()], scale=100),
        Column("chance %", [row.ece_if_calibrated for row in rows.values()], scale=100),
    ]
    return grid_of("Calibration", "scores", list(rows), columns)


app = command(CalibrateScoresOptions, _calibrate_scores)
