"""Evaluation of ranging methods on labelled boxes with known distances."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from track_range.detection.formats.tables.errors import LabelFileError
from track_range.foundation.arrays import FloatArray
from track_range.foundation.errors import UsageError
from track_range.foundation.files.input_files import quoted, read_text
from track_range.ranging.evaluation import box_evaluation
from track_range.ranging.evaluation.box_filters import filtered
from track_range.ranging.evaluation.box_methods import (
    MethodOptions,
    check_methods,
    measured_by,
    method_names,
)
from track_range.ranging.evaluation.image_methods import MethodInputs
from track_range.ranging.evaluation.settings import RangeEvaluationSettings
from track_range.ranging.fitting.cross_validation import folds
from track_range.ranging.fitting.prior_fit import STANDARD_SIZES
from track_range.ranging.registry import method_of
from track_range.ranging.size_models.plain_curves import PLAIN_CURVES
from track_range.ranging.truth.errors import MethodColumn
from track_range.ranging.truth.frame_times import TimeSource
from track_range.ranging.truth.labelled_boxes import BoxSelection, BoxSet, box_set

# value of --split: 3,712 training and 3,769 validation frames (Chen et al., 3DOP, NeurIPS 2015)
CHEN = "chen"
# folder of its lists in copies of KITTI, at most so many folders higher
_IMAGE_SETS, _N_PARENTS = "ImageSets", 3
# ratios of the width to the height of boxes of vehicles seen from behind, and from the side
_NARROW, _WIDE = 1.5, 2.2
_TRUTH: Mapping[str, str] = {  # definitions of the true distance
    "surface": "z at which the ray through the label's box centre meets its 3-D box",
    "centre": "z of the centre of the 3-D box",
    "lidar": "10th percentile of the depths of the lidar points in the 3-D box",
}


def evaluate_ranges(
    settings: RangeEvaluationSettings, inputs: MethodInputs | None = None
) -> dict[str, Any]:
    """Errors and calibration of sigma per method and class, with the settings and notes, as JSON
    values.

    `inputs` are the images and networks of the settings, opened by the caller; None = none. Raises
    LabelFileError, RigError, CurveError: labels, calibration or curves cannot be used;
    LabelledImageError: the images cannot be used; MethodError: a method cannot be loaded, or cannot
    measure; UsageError: an unknown method, or settings that contradict each other.
    """
    settings, inputs = _with_split(settings), inputs or MethodInputs()
    _check(settings)
    names = _names(settings, inputs)
    boxes = _boxes(settings, settings.frames)
    train = _training_boxes(settings, boxes)
    columns = measured_by(names, boxes, train, _method_options(settings), inputs)
    if settings.truth == "centre":
        columns = _at_centres(columns, boxes)
    boxes = boxes.with_reference()
    methods: dict[str, Any] = {}
    measured: dict[str, MethodColumn] = {}
    for name, column in columns.items():
        measured[name], closing_mps = filtered(boxes, column, settings.filter)
        methods[name] = box_evaluation.figures(boxes, measured[name], settings.seed)
        if settings.filter != "none":
            closing = box_evaluation.closing_figures(boxes, closing_mps, settings.seed)
            for class_name, scores in methods[name].items():
                scores |= closing.get(class_name, {})
    risks = {name: box_evaluation.distance_risk(boxes, c) for name, c in measured.items()}
    n_folds = len(list(folds(boxes)))
    return {
        "labels": str(settings.labels),
        "boxes": settings.boxes,
        "noise_px": settings.noise_px,
        "seed": settings.seed,
        "filter": settings.filter,
        "cross_validated": settings.cross_validate,
        "same_drive": settings.same_drive,
        "fit_on": settings.fit_on,
        "frames": None if settings.frames is None else str(settings.frames),
        "fit_frames": None if settings.fit_frames is None else str(settings.fit_frames),
        "objects": settings.objects,
        "truth": settings.truth,
        "camera_height_m": settings.camera_height_m,
        "region": settings.region,
        "n_boxes": len(boxes),
        "n_sequences": len(boxes.sequence_names),
        "time_step_s": boxes.time_step_s,
        "methods": methods,
        "comparison": box_evaluation.comparison(boxes, measured, settings.seed),
        "notes": [*_notes(settings, len(boxes.sequence_names), n_folds), *boxes.notes],
        "literature": box_evaluation.literature_metrics(boxes, measured),
        "risk_coverage": {name: curves for name, curves in risks.items() if curves},
    }


def _names(settings: RangeEvaluationSettings, inputs: MethodInputs) -> tuple[str, ...]:
    """The methods to evaluate: the chosen ones and those of networks, or all that can measure.

    UsageError: one of them is unknown, or lacks what it needs.
    """
    names = tuple(_registered(name) for name in settings.methods if name)
    if names:
        names = tuple(dict.fromkeys((*names, *inputs.networks)))
    check_methods((*names, *inputs.networks), inputs, settings.camera_height_m)
    return names or method_names(inputs, settings.camera_height_m)


def _registered(name: str) -> str:
    """The name of a method, or of methods joined by +, of which those by MODULE:OBJECT are
    registered.
    """
    return "+".join(method_of(part).name if ":" in part else part for part in name.split("+"))


def _training_boxes(settings: RangeEvaluationSettings, boxes: BoxSet) -> BoxSet:
    """The boxes to which methods are fitted: of other frames, `boxes`, or their exact labels."""
    if settings.fit_frames is not None:
        return _boxes(settings, settings.fit_frames, is_exact=settings.fit_on == "labels")
    is_exact = settings.boxes == "labels" and settings.noise_px == 0
    if settings.fit_on == "boxes" or is_exact:
        return boxes
    return _boxes(settings, settings.frames, is_exact=True)


def _method_options(settings: RangeEvaluationSettings) -> MethodOptions:
    return MethodOptions(
        curves=settings.curves,
        is_cross_validated=settings.cross_validate,
        is_same_drive=settings.same_drive,
        is_held_out=settings.fit_frames is not None,
        box_sigma_px=settings.noise_px if settings.boxes == "labels" else None,
        camera_height_m=settings.camera_height_m,
        region=settings.region,
    )


def _at_centres(columns: Mapping[str, MethodColumn], boxes: BoxSet) -> dict[str, MethodColumn]:
    """The columns with the distances of the objects' centres; plain curves are fitted to these."""
    offset_m = centre_offset_m(boxes.class_name, boxes.xyxy_px)
    return {
        name: c if name in PLAIN_CURVES else replace(c, distance_m=c.distance_m + offset_m)
        for name, c in columns.items()
    }


def _boxes(
    settings: RangeEvaluationSettings, frames: Path | None, *, is_exact: bool = False
) -> BoxSet:
    """Boxes of the listed frames (None = all): the boxes of the settings, or labelled boxes if
    `is_exact`.
    """
    selection = BoxSelection(
        frames=frames,
        has_all_objects=settings.objects == "all",
        reference=settings.truth,
        velodyne=settings.velodyne,
        times=TimeSource(settings.times, settings.frame_rate_hz),
    )
    return box_set(
        settings.labels,
        settings.calib,
        boxes="labels" if is_exact else settings.boxes,
        noise_px=0.0 if is_exact else settings.noise_px,
        seed=settings.seed,
        selection=selection,
    )


def centre_offset_m(class_name: npt.NDArray[np.str_], xyxy_px: FloatArray) -> FloatArray:
    """(N,) depth of the centre of objects behind their visible surface, by class and aspect ratio
    of their boxes.

    Half the typical length of the class for boxes of a rear view, half the width for boxes of a
    side view.
    """
    aspect = (xyxy_px[:, 2] - xyxy_px[:, 0]) / np.maximum(xyxy_px[:, 3] - xyxy_px[:, 1], 1.0)
    wide = np.clip((aspect - _NARROW) / (_WIDE - _NARROW), 0.0, 1.0)
    sizes = np.array([STANDARD_SIZES[str(name)][0] for name in class_name]).reshape(-1, 3)
    return np.asarray(((1 - wide) * sizes[:, 2] + wide * sizes[:, 1]) / 2)


def _check(settings: RangeEvaluationSettings) -> None:
    """UsageError for settings that contradict each other."""
    is_fitted = settings.cross_validate or settings.same_drive
    is_refitted, fit_frames = settings.fit_frames is not None, settings.fit_frames
    is_rrc = settings.boxes.startswith("rrc:") and settings.boxes != "rrc:"
    has_lidar = settings.velodyne is not None
    faults = {
        "--right-images: expected the images of the left cameras too; give them with --images.": (
            settings.right_images is not None and settings.images is None
        ),
        f"--boxes {settings.boxes}: expected labels or rrc:DIR.": (
            settings.boxes != "labels" and not is_rrc
        ),
        "--curves: not allowed with --cross-validate or --same-drive, which fit the curves "
        "themselves.": is_fitted and settings.curves is not None,
        "--cross-validate: not allowed with --same-drive; give only one of them.": (
            settings.cross_validate and settings.same_drive
        ),
        "expected --truth lidar with --velodyne DIR, or neither.": (
            (settings.truth == "lidar") != has_lidar
        ),
        "--fit-frames: not allowed with --cross-validate, --same-drive or --curves.": (
            is_refitted and (is_fitted or settings.curves is not None)
        ),
        "--fit-frames: expected --frames with other frames to evaluate, found none.": (
            is_refitted and settings.frames is None
        ),
    }
    for message, is_fault in faults.items():
        if is_fault:
            raise UsageError(message)
    if fit_frames is not None and settings.frames is not None:
        lists = (fit_frames, settings.frames)
        fitted, evaluated = (
            set(read_text(path, LabelFileError, "a list of frames").split()) for path in lists
        )
        if common := sorted(fitted & evaluated):
            raise UsageError(
                f"--fit-frames {fit_frames}: expected frames that are not in --frames, got "
                f"{quoted(common[0])}."
            )


def _with_split(settings: RangeEvaluationSettings) -> RangeEvaluationSettings:
    """The settings with the lists of frames of --split; UsageError if they are given twice, or not
    found.
    """
    if settings.split is None:
        return settings
    if settings.frames is not None or settings.fit_frames is not None:
        raise UsageError(
            "--split: not allowed with --frames or --fit-frames, because it sets both."
        )
    folders = [Path(settings.split)]
    if settings.split == CHEN:
        folders = [
            parent / _IMAGE_SETS for parent in settings.labels.absolute().parents[:_N_PARENTS]
        ]
    for folder in folders:
        train, val = folder / "train.txt", folder / "val.txt"
        if train.is_file() and val.is_file():
            return settings.model_copy(update={"frames": val, "fit_frames": train})
    raise UsageError(
        f"--split {settings.split}: expected train.txt and val.txt in {folders[0]}, found none; "
        "give their folder."
    )


def _notes(settings: RangeEvaluationSettings, n_sequences: int, n_folds: int) -> list[str]:
    scheme = f"cross-validated in {n_folds} folds over {n_sequences} sequences"
    if settings.fit_frames is not None:
        scheme = f"fitted to the frames of {settings.fit_frames}"
    elif settings.same_drive:
        scheme = (
            "fitted and tested on the same drive, as Zhang et al. did (no measure of the error on "
            "other drives)"
        )
    elif n_sequences == 1:
        scheme = "fitted and tested on the only sequence"
    fitted = (
        "the labels' exact boxes"
        if settings.fit_on == "labels"
        else "boxes like the measured boxes"
    )
    is_refitted = settings.cross_validate or settings.same_drive or settings.fit_frames is not None
    mono_curves = "fitted in the same way" if is_refitted else f"{settings.curves or 'packaged'}"
    objects = "labels at 5-100 m, not truncated, occluded <= 1"
    if settings.objects == "all":
        objects = "all labels with a 3-D box"
    notes = [
        f"Ground truth: {_TRUTH[settings.truth]}, for {objects}. Metrics by class cover 10-100 m, "
        "metrics of far objects 30-100 m, bands 5-100 m.",
        f"Plain curves are fitted to {fitted}, {scheme}. Size curves of mono: {mono_curves}.",
    ]
    if settings.frames is not None and not is_refitted:
        notes.append(
            "The packaged size curves were fitted to drives of KITTI's tracking set, some of which "
            "are also in its object set; for comparable figures, fit them to the training frames "
            "(--fit-frames)."
        )
    if settings.filter != "none":
        notes.append(
            "Distances are filtered over time with unknown ego speed; the true closing speed is "
            "the mean over half a second before and after each label."
        )
    return notes
