"""Evaluation of stereo matchers on pairs with known disparities."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from track_range.calibration.reference_pairs import LEFT, is_drive, read_drive
from track_range.calibration.settings import LEAVE_TWO_OUT, OFF, StereoEvaluationSettings
from track_range.foundation.errors import UsageError
from track_range.foundation.progress import StepProgress, no_progress
from track_range.ranging.methods.size_regression import SizeRanger
from track_range.ranging.methods.triangulation import disparities_by_size
from track_range.ranging.registry import network_names
from track_range.ranging.size_models.size_model import SIZE_CLASSES
from track_range.stereo.alignment.file import load_alignment
from track_range.stereo.alignment.from_reference import fit_reference
from track_range.stereo.evaluation.box_matchers import MATCHER_NAMES, MatcherResults, measure_pairs
from track_range.stereo.evaluation.dense_confidence import (
    BEST_MEASURE,
    DENSE_MATCHER,
    ConfidenceRecorder,
)
from track_range.stereo.evaluation.disparity_errors import (
    MatcherColumn,
    common_figures,
    comparison,
    corrected,
    left_out_alignments,
    matcher_figures,
    risk_coverage,
)
from track_range.stereo.evaluation.kitti_2015 import (
    PairFileError,
    StereoPair,
    is_kitti_2015,
    pair_names,
    read_pairs,
)
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.matching.patch_matches import BoxMatcher, ExpectedDisparity
from track_range.tracking.tracks import Tracks

_FEWEST_LEFT_OUT = 4  # pairs of a cross-validation that leaves two out at a time


def evaluate_stereo(
    settings: StereoEvaluationSettings, progress: StepProgress = no_progress
) -> dict[str, Any]:
    """Errors, calibration of sigma and times per matcher, with confidence intervals, as plain
    values for JSON.

    Raises UsageError: an unknown matcher, or leave-two-out for a drive or too few pairs. Raises
    PairFileError, RigError, VideoError, LabelFileError: the pairs, their rig or the alignment
    cannot be used; NetworkError, ModelError: a file is no usable stereo network.
    """
    for name in settings.matchers:
        if name not in MATCHER_NAMES:
            raise UsageError(f"--matcher {name}: expected one of {', '.join(MATCHER_NAMES)}.")
    if len(set(settings.matchers)) < len(settings.matchers):
        raise UsageError("--matcher: expected each matcher once, got duplicates.")
    known = None if settings.align in (OFF, LEAVE_TWO_OUT) else load_alignment(settings.align)
    n_pairs = _n_pairs(settings)
    recorder = ConfidenceRecorder() if DENSE_MATCHER in settings.matchers else None
    networks = _networks(settings.stereo_model)
    with progress("pairs") as advance:
        pairs = _pairs(settings, known, advance, n_pairs)
        pairs = pairs if recorder is None else recorder.recorded(pairs)
        measured = measure_pairs(
            pairs, settings.matchers, expected=expected_disparities, others=networks
        )
    if not len(measured.objects):
        raise PairFileError(
            f"{settings.pairs}: expected objects with known disparities, found none."
        )
    _check_left_out(settings, len(measured.objects.cameras))
    columns, alignment = _aligned(measured, settings, known)
    matchers = matcher_figures(columns, measured.objects, seed=settings.seed)
    for name, row in matchers.items():
        row["ms_per_frame"] = round(measured.ms_per_frame[name], 3)
    # curve and areas by matcher and by the measure that sorts its boxes: sigma, or a confidence
    # measure
    curves = {
        name: {"sigma": risk_coverage(column, measured.objects.true_px)}
        for name, column in columns.items()
    }
    for measure, uncertainty in () if recorder is None else recorder.measures.items():
        curves[DENSE_MATCHER][measure] = risk_coverage(
            columns[DENSE_MATCHER], measured.objects.true_px, uncertainty
        )
    return {
        "pairs": str(settings.pairs),
        "n_pairs": len(measured.objects.cameras),
        "n_objects": len(measured.objects),
        "align": settings.align,
        "alignment": alignment,
        "matchers": matchers,
        "common": common_figures(columns, measured.objects, seed=settings.seed)
        if len(columns) > 1
        else {},
        "comparison": comparison(columns, measured.objects, seed=settings.seed)
        if len(columns) > 1
        else {},
        "risk_coverage": curves,
        "best_confidence": {DENSE_MATCHER: BEST_MEASURE} if recorder is not None else {},
        "notes": list(measured.notes),
    }


def _networks(files: Sequence[Path]) -> dict[str, BoxMatcher]:
    """The stereo networks by name of their method."""
    if not files:
        return {}
    # imports onnxruntime
    from track_range.evaluation.network_matcher import NetworkMatcher

    return {name: NetworkMatcher(file) for name, file in network_names("disparity", files).items()}


def _n_pairs(settings: StereoEvaluationSettings) -> int | None:
    """Number of pairs; None = unknown before the drive is read."""
    if not (is_kitti_2015(settings.pairs) or is_drive(settings.pairs)):
        raise PairFileError(
            f"{settings.pairs}: expected a folder with KITTI 2015's image_2, image_3, disp_occ_0 "
            "and obj_map, or with a drive's left.mp4, right.mp4 (or folders left, right of images) "
            "and truth.csv or truth.txt."
        )
    if is_kitti_2015(settings.pairs) and settings.truth:
        raise UsageError(
            "--truth: expected a drive or single pairs with files of objects, but "
            f"{settings.pairs} "
            "has true disparities in KITTI 2015's layout."
        )
    if not is_kitti_2015(settings.pairs):
        if settings.align == LEAVE_TWO_OUT and (settings.pairs / LEFT).is_file():
            raise UsageError(
                f"--align {LEAVE_TWO_OUT}: expected a set of single pairs, but {settings.pairs} is "
                "a drive."
            )
        return None
    n_pairs = len(pair_names(settings.pairs))
    _check_left_out(settings, n_pairs)
    return n_pairs


def _check_left_out(settings: StereoEvaluationSettings, n_pairs: int) -> None:
    """UsageError: there are too few pairs for cross-validation."""
    if settings.align == LEAVE_TWO_OUT and n_pairs < _FEWEST_LEFT_OUT:
        raise UsageError(
            f"--align {LEAVE_TWO_OUT}: expected at least {_FEWEST_LEFT_OUT} pairs, but "
            f"{settings.pairs} has {n_pairs}."
        )


def _pairs(
    settings: StereoEvaluationSettings,
    known: Alignment | None,
    advance: Callable[[int, int | None], None],
    n_pairs: int | None,
) -> Iterator[StereoPair]:
    row_offset_px = 0.0 if known is None else known.row_correction_px
    if is_kitti_2015(settings.pairs):
        pairs = read_pairs(settings.pairs, rig=settings.rig, row_offset_px=row_offset_px)
    else:
        pairs = read_drive(
            settings.pairs, rig=settings.rig, row_offset_px=row_offset_px, truth=settings.truth
        )
    for number, pair in enumerate(pairs):
        yield pair
        advance(number + 1, n_pairs)


def _aligned(
    measured: MatcherResults, settings: StereoEvaluationSettings, known: Alignment | None
) -> tuple[dict[str, MatcherColumn], Any]:
    """The corrected disparities by matcher, and the applied alignment as plain values for JSON."""
    objects, columns = measured.objects, measured.columns
    n_pairs = len(objects.cameras)
    if settings.align != LEAVE_TWO_OUT:
        alignment = known or Alignment()
        everywhere = dict.fromkeys(range(n_pairs), alignment)
        return {
            name: corrected(column, objects, everywhere) for name, column in columns.items()
        }, alignment.to_dict()
    by_pair = {
        name: left_out_alignments(column, objects, fit_reference, seed=settings.seed)
        for name, column in columns.items()
    }
    means = {
        name: {
            "mean_offset_px": float(
                np.mean([alignment.offset_px for alignment in alignments.values()])
            )
        }
        for name, alignments in by_pair.items()
    }
    return {
        name: corrected(column, objects, by_pair[name]) for name, column in columns.items()
    }, means


def expected_disparities(pair: StereoPair) -> ExpectedDisparity:
    """Disparities by size of the objects of a pair; NaN for objects of unknown class."""
    n = len(pair.xyxy_px)
    ids = [SIZE_CLASSES.index(name) if name in SIZE_CLASSES else -1 for name in pair.class_names]
    class_id = np.array(ids, np.int64)
    if len(class_id) != n:
        return ExpectedDisparity.unknown(n)
    tracks = Tracks(np.arange(n), pair.xyxy_px, np.maximum(class_id, 0), np.ones(n), class_id >= 0)
    by_size = SizeRanger(pair.rig.left).measure(tracks, Frame(0, 0.0, pair.left, None))
    return disparities_by_size(
        by_size, pair.xyxy_px, pair.rig, (pair.left.shape[0], pair.left.shape[1])
    )
