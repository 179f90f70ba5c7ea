"""`track-range evaluate detections`: accuracy, calibration and speed of detectors on labelled
images.
"""

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from track_range.cli.commands.evaluate.result_files import JsonField, check_result_files
from track_range.cli.shared.console import console, print_grid, print_line
from track_range.cli.shared.parameters import command
from track_range.detection.evaluation.matching import SizeMeasure
from track_range.evaluation.sequences.detector_evaluation import evaluate_source, open_candidates
from track_range.evaluation.sequences.labelled_images import LabelledSource
from track_range.evaluation.sequences.settings import DetectionEvaluationSettings
from track_range.foundation.files.output_files import write_json
from track_range.foundation.schemas.options import option
from track_range.run.options.opened import DetectorOptions, class_names
from track_range.run.progress import frame_progress
from track_range.run.ready_model import ready_model
from track_range.views.report.detection_tables import (
    accuracy_grid,
    calibration_grids,
    class_grid,
    size_grids,
    speed_grid,
)


class DetectionsOptions(DetectionEvaluationSettings):
    """Options of `track-range evaluate detections`."""

    figure: Annotated[
        Path | None,
        option("SVG or PNG file for the reliability diagrams of the scores.", metavar="FILE.svg"),
    ] = None
    json_file: JsonField = None


def _detections(options: DetectionsOptions) -> None:
    check_result_files(options)
    # the confidence and the classes apply to the evaluation
    detector = DetectorOptions(
        names=options.names,
        anchors=options.anchors,
        letterbox=options.letterbox,
        layout=options.layout,
        size_px=options.size_px,
        threads=options.threads,
        device=options.device,
    )
    source = LabelledSource(
        images=options.images,
        labels=options.labels,
        label_format=options.label_format,
        label_names=class_names(options.label_names),
        manifest=options.manifest,
        split=options.split,
        classes=options.classes,
    )
    candidates = open_candidates(options.models, detector, lambda name: ready_model(name, console))
    figures = evaluate_source(
        candidates,
        source,
        min_score=options.min_score,
        progress=partial(frame_progress, console),
        min_height_px=options.min_height,
    )
    print_figures(figures, measure=options.by)
    write_json(options.json_file, figures, allow_nan=True)
    if options.figure is not None:
        # imports matplotlib: a third of a second
        from track_range.views.report.figures import reliability_chart

        reliability_chart(
            {name: row["calibration"] for name, row in figures["models"].items()}, options.figure
        )
        print_line(console, f"Written: {options.figure}")
    raise typer.Exit(0 if figures["is_complete"] else 1)


def print_figures(figures: dict[str, Any], *, measure: SizeMeasure | None = None) -> None:
    """Print the tables and notes of an evaluation of detectors; `measure` adds tables by size and
    of calibration.
    """
    details = (
        [] if measure is None else [*size_grids(figures, measure), *calibration_grids(figures)]
    )
    print_grid(console, accuracy_grid(figures), class_grid(figures), *details, speed_grid(figures))
    for note in figures["notes"]:
        console.print(f"- {note}", style="dim", highlight=False, markup=False)


app = command(DetectionsOptions, _detections)
