"""fit_sizes: fit of a size model to a user's labels, and the comparison of plain curves (Zhang et al.)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from track_range.detection.formats.errors import LabelFileError
from track_range.foundation.errors import UsageError
from track_range.ranging.evaluation.curve_comparison import CurveFit, compare_curves
from track_range.ranging.fitting.box_csv import read_box_csv
from track_range.ranging.fitting.box_labels import read_box_labels
from track_range.ranging.fitting.labelled_boxes import BoxSet, box_set
from track_range.ranging.fitting.model_fit import CUBOIDS, LOG_LINEAR, MODEL_NAMES, fit_model, usable_boxes
from track_range.ranging.fitting.settings import FitSettings
from track_range.ranging.size_models.curve import save_curves
from track_range.ranging.size_models.size_model import StoredSizeModel


@dataclass(frozen=True, slots=True)
class FittedSizes:
    """Result of `fit_sizes`."""

    boxes: BoxSet
    name: str  # name of the model, one of `MODEL_NAMES`
    model: StoredSizeModel | None  # the fitted model; None = comparison only
    comparison: Mapping[str, Sequence[CurveFit]]  # the plain curves by class; empty = no comparison
    notes: tuple[str, ...]


def fit_sizes(settings: FitSettings) -> FittedSizes:
    """Fit a size model to labelled boxes, and write it to `settings.out`, if given.

    Raises:
        LabelFileError, RigError, CurveError: labels or calibration cannot be used, or there are too few labels.
        UsageError: settings that contradict each other.
    """
    _check(settings)
    boxes, notes = _boxes(settings)
    usable = usable_boxes(boxes, settings.labels or settings.csv)
    comparison = {}
    if settings.compare or settings.picture is not None:
        names = [str(name) for name in np.unique(usable.boxes.class_name)]
        comparison = {name: compare_curves(usable.boxes, name) for name in names}
    name = settings.curve or (CUBOIDS if settings.calib else LOG_LINEAR)
    model = None
    if settings.out is not None:
        model = fit_model(usable.boxes, name, source=_source(settings, usable.boxes))
        save_curves(model, settings.out)
    rejected = (f"Too few samples to fit a curve for {reason}." for reason in usable.rejected)
    return FittedSizes(usable.boxes, name, model, comparison, (*notes, *rejected))


def _check(settings: FitSettings) -> None:
    if (settings.labels is None) == (settings.csv is None):
        raise UsageError("expected either --labels with --calib or --csv.")
    if settings.labels is not None and settings.calib is None and not settings.labels.is_file():
        raise UsageError("--labels requires --calib, the folder of calibration files with the focal lengths.")
    if settings.out is None and not settings.compare and settings.picture is None:
        raise UsageError("nothing to do; give --out FILE to write a curve file, --compare or --picture.")
    if settings.curve is not None and settings.curve not in MODEL_NAMES:
        raise UsageError(f"--curve {settings.curve}: expected one of {', '.join(MODEL_NAMES)}.")
    if settings.calib is None and settings.curve == CUBOIDS:
        raise UsageError("--curve cuboids requires KITTI labels with 3-D boxes (--labels); other files have none.")


def _boxes(settings: FitSettings) -> tuple[BoxSet, tuple[str, ...]]:
    if settings.csv is not None:
        boxes, notes = read_box_csv(settings.csv, focal_px=settings.focal_px)
    elif settings.labels is not None and settings.calib is not None:
        boxes, notes = box_set(settings.labels, settings.calib), ()
    elif settings.labels is not None:
        boxes, notes = read_box_labels(settings.labels, focal_px=settings.focal_px)
    else:
        raise UsageError("expected either --labels with --calib or --csv.")
    excluded = set(settings.leave_out) - {""}
    unknown = excluded - set(boxes.sequence_names)
    if unknown:  # an error, since a misspelt name would put test sequences into the fit
        raise LabelFileError(
            f"{settings.labels or settings.csv}: --leave-out names unknown sequences: {', '.join(sorted(unknown))}."
        )
    is_excluded = np.array([name in excluded for name in boxes.sequence_names])[boxes.sequence]
    return boxes.select(~is_excluded), notes


def _source(settings: FitSettings, boxes: BoxSet) -> str:
    path = settings.labels or settings.csv
    used = ", ".join(boxes.sequence_names[k] or "one" for k in np.unique(boxes.sequence))
    return f"{settings.source or (path.name if path else '')}, sequences {used}"
