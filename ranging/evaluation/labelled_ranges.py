"""Evaluation of box-only methods on labelled boxes with known distances."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from track_range.foundation.errors import UsageError
from track_range.ranging.evaluation.box_evaluation import closing_figures, figures, folds
from track_range.ranging.evaluation.box_filters import filtered
from track_range.ranging.evaluation.box_methods import MethodOptions, measured_by, method_names
from track_range.ranging.evaluation.settings import RangeEvaluationSettings
from track_range.ranging.fitting.labelled_boxes import BoxSet, box_set


def evaluate_ranges(settings: RangeEvaluationSettings) -> dict[str, Any]:
    """Errors and calibration of sigma per method and class, with the settings and notes, as JSON values.

    Raises:
        LabelFileError, RigError, CurveError: labels, calibration or curves cannot be used.
        UsageError: an unknown method, or settings that contradict each other.
    """
    _check(settings)
    boxes = box_set(
        settings.labels, settings.calib, boxes=settings.boxes, noise_px=settings.noise_px, seed=settings.seed
    )
    is_exact = settings.boxes == "labels" and settings.noise_px == 0
    train = boxes if settings.fit_on == "boxes" or is_exact else box_set(settings.labels, settings.calib)
    options = MethodOptions(
        curves=settings.curves,
        is_cross_validated=settings.cross_validate,
        is_same_drive=settings.same_drive,
        box_sigma_px=settings.noise_px if settings.boxes == "labels" else None,
        camera_height_m=settings.camera_height_m,
    )
    columns = measured_by(_selected(settings) or method_names(), boxes, train, options)
    methods: dict[str, Any] = {}
    for name, column in columns.items():
        output = filtered(boxes, column, settings.filter)
        scores = figures(boxes, output.column.distance_m, output.column.sigma_m)
        closing = closing_figures(boxes, output.closing_mps) if settings.filter != "none" else {}
        methods[name] = {class_name: {**score, **closing.get(class_name, {})} for class_name, score in scores.items()}
    return _figures(settings, boxes, methods)


def _selected(settings: RangeEvaluationSettings) -> tuple[str, ...]:
    """Methods named in the settings; empty = all."""
    return tuple(name for name in settings.methods if name)


def _check(settings: RangeEvaluationSettings) -> None:
    unknown = [name for name in _selected(settings) if name not in method_names()]
    if unknown:
        raise UsageError(f"--method {','.join(unknown)}: expected methods from {', '.join(method_names())}.")
    if settings.boxes != "labels" and not (settings.boxes.startswith("rrc:") and settings.boxes != "rrc:"):
        raise UsageError(f"--boxes {settings.boxes}: expected labels or rrc:DIR.")
    if (settings.cross_validate or settings.same_drive) and settings.curves is not None:
        raise UsageError(
            "--curves: not allowed with --cross-validate or --same-drive, which fit the curves themselves."
        )
    if settings.cross_validate and settings.same_drive:
        raise UsageError("--cross-validate: not allowed with --same-drive; give only one of them.")


def _figures(settings: RangeEvaluationSettings, boxes: BoxSet, methods: Mapping[str, Any]) -> dict[str, Any]:
    n_sequences = len(boxes.sequence_names)
    return {
        "labels": str(settings.labels),
        "boxes": settings.boxes,
        "noise_px": settings.noise_px,
        "seed": settings.seed,
        "filter": settings.filter,
        "cross_validated": settings.cross_validate,
        "same_drive": settings.same_drive,
        "fit_on": settings.fit_on,
        "camera_height_m": settings.camera_height_m,
        "n_boxes": len(boxes),
        "n_sequences": n_sequences,
        "methods": dict(methods),
        "notes": list(_notes(settings, n_sequences, len(list(folds(boxes))))),
    }


def _notes(settings: RangeEvaluationSettings, n_sequences: int, n_folds: int) -> list[str]:
    scheme = f"cross-validated in {n_folds} folds over {n_sequences} sequences"
    if settings.same_drive:
        scheme = "fitted and tested on the same drive, as by Zhang et al. (no measure of the error on other drives)"
    elif n_sequences == 1:
        scheme = "fitted and tested on the only sequence"
    fitted = "the labels' exact boxes" if settings.fit_on == "labels" else "boxes of the same kind as the measured ones"
    is_refitted = settings.cross_validate or settings.same_drive
    mono_curves = "fitted in the same way" if is_refitted else f"{settings.curves or 'packaged'}"
    notes = [
        "Ground truth: z at which the ray through the label's box centre meets its 3-D box, for labels at 5-100 m, not "
        "truncated, occluded <= 1. Metrics by class cover 10-100 m, metrics of far objects 30-100 m, bands 5-100 m.",
        f"Plain curves: fitted to {fitted}, {scheme}. Size curves of mono: {mono_curves}.",
    ]
    if settings.filter != "none":
        notes.append(
            "Filtered over time with unknown ego speed; the true closing speed is the mean over half a second before "
            "and after each label."
        )
    return notes
