"""Methods that need boxes alone, run over labelled boxes: the registered ones as in a run, and plain curves."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from track_range.foundation.arrays import IntArray
from track_range.ranging.evaluation.box_evaluation import Fitter, Predictor, cross_validated, frame_rows, within_drives
from track_range.ranging.evaluation.errors import MethodColumn
from track_range.ranging.fitting.labelled_boxes import BoxSet
from track_range.ranging.fitting.prior_fit import LabelledSizes, fit_size_priors
from track_range.ranging.fusion.fusion import Fusion
from track_range.ranging.method import MethodContext, RangingMethod, checked_ranges
from track_range.ranging.ranger import Ranger
from track_range.ranging.ranges import Ranges
from track_range.ranging.registry import create_rangers, methods
from track_range.ranging.size_models.curve import CurveError, load_curves
from track_range.ranging.size_models.plain_curves import PLAIN_CURVES, PlainCurve
from track_range.ranging.size_models.size_model import SIZE_CLASSES, SizeModel
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

MIN_PLAIN_SAMPLES = 20


def box_methods() -> tuple[RangingMethod, ...]:
    """The registered methods that need nothing but boxes and a camera."""
    return tuple(method for method in methods() if not method.needs)


def method_names() -> tuple[str, ...]:
    """What can be measured, in the order of the tables; the last one is the fusion of the box methods."""
    names = [method.name for method in box_methods()]
    return (*PLAIN_CURVES, *names, "+".join(names))


@dataclass(frozen=True, slots=True, kw_only=True)
class MethodOptions:
    """How methods are fitted, and what is given to them.

    Attributes:
        curves: a curve file for mono; None = the packaged one.
        is_cross_validated: mono is fitted anew instead, leaving out what it is tested on, as plain curves always are.
        is_same_drive: mono and plain curves are fitted on the very drive that they are tested on.
        box_sigma_px: standard deviation of one edge of the boxes; None = a detector's.
        camera_height_m: for the ground plane; None = not known.
    """

    curves: Path | None = None
    is_cross_validated: bool = False
    is_same_drive: bool = False
    box_sigma_px: float | None = None
    camera_height_m: float | None = None


def measured_by(
    names: Sequence[str], boxes: BoxSet, train: BoxSet, options: MethodOptions | None = None
) -> dict[str, MethodColumn]:
    """(N,) distances and sigmas of `boxes` by every one of `names` (of `method_names`).

    `train` are boxes of the same sequences, perhaps exact ones, that curves are fitted on.
    """
    options = options or MethodOptions()
    tested = within_drives if options.is_same_drive else cross_validated
    found = {name: tested(boxes, train, plain_fitter(PLAIN_CURVES[name])) for name in names if name in PLAIN_CURVES}
    if not set(names) <= found.keys():
        found |= _measured_by_rangers(boxes, train, options)
    return {name: found[name] for name in names}


def _measured_by_rangers(boxes: BoxSet, train: BoxSet, options: MethodOptions) -> dict[str, MethodColumn]:
    """The columns of all box methods and of their fusion; those that use a size model first, fitted as asked."""
    measured: dict[str, MethodColumn] = {}
    for method in box_methods():
        if method.uses_size_model and options.is_same_drive:
            measured[method.name] = within_drives(boxes, train, size_fitter(method, options))
        elif method.uses_size_model and options.is_cross_validated:
            measured[method.name] = cross_validated(boxes, train, size_fitter(method, options))
        elif method.uses_size_model:
            measured |= ranger_columns(boxes, [method], options, size_model=load_curves(options.curves))
    others = [method for method in box_methods() if not method.uses_size_model]
    measured |= ranger_columns(boxes, others, options, measured=measured)
    measured = {method.name: measured[method.name] for method in box_methods()}
    return {**measured, "+".join(measured): fused_column(boxes, measured)}


def ranger_columns(
    boxes: BoxSet,
    listed: Sequence[RangingMethod],
    options: MethodOptions,
    *,
    size_model: SizeModel | None = None,
    measured: Mapping[str, MethodColumn] | None = None,
) -> dict[str, MethodColumn]:
    """Columns of the listed methods, measured frame by frame as in a run; every sequence has new rangers.

    Args:
        boxes: N boxes.
        listed: methods that need nothing but boxes.
        options: how unsure the edges of the boxes are, and the height of the camera.
        size_model: for methods that use one; they see the labels' own classes, the others those of a detector.
        measured: columns of methods measured before, which the listed ones may read.

    Raises:
        MethodError: a ranger of another package returned no ranges, or those of other tracks.
    """
    columns = {method.name: np.full((3, len(boxes)), np.nan) for method in listed}
    reads = {method.name: method.reads for method in listed}
    class_id = boxes.class_id if size_model is None else _size_classes(boxes)
    rangers: dict[str, Ranger] = {}
    for rows, tracks, frame, is_first in as_frames(boxes, class_id):
        if is_first:
            context = MethodContext(
                camera=boxes.camera_at(rows[0]),
                size_model=size_model,
                box_sigma_px=options.box_sigma_px,
                camera_height_m=options.camera_height_m,
                has_images=False,
            )
            rangers = create_rangers(context, listed)
        ranges = {name: _ranges(column, tracks, rows) for name, column in (measured or {}).items()}
        for name, ranger in rangers.items():
            others = {other: ranges[other] for other in reads[name] if other in ranges}
            ranges[name] = found = checked_ranges(name, ranger.measure_with(tracks, frame, others), tracks)
            columns[name][:2, rows] = found.distance_m, found.sigma_m
            columns[name][2, rows] = np.nan if found.sigma_systematic_m is None else found.sigma_systematic_m
    return {
        name: MethodColumn(column[0], column[1], column[2] if np.isfinite(column[2]).any() else None)
        for name, column in columns.items()
    }


def fused_column(boxes: BoxSet, measured: Mapping[str, MethodColumn]) -> MethodColumn:
    """The fusion of the columns, frame by frame as in a run."""
    fused = MethodColumn(*np.full((2, len(boxes)), np.nan))
    fusion = Fusion()
    for rows, tracks, frame, is_first in as_frames(boxes, boxes.class_id):
        if is_first:
            fusion = Fusion()
        ranges = {name: _ranges(column, tracks, rows) for name, column in measured.items()}
        found = fusion.fuse(ranges, tracks.track_id, frame.time_s).ranges
        fused.distance_m[rows], fused.sigma_m[rows] = found.distance_m, found.sigma_m
    return fused


def _ranges(column: MethodColumn, tracks: Tracks, rows: IntArray) -> Ranges:
    systematic_m = None if column.sigma_systematic_m is None else column.sigma_systematic_m[rows]
    return Ranges(tracks.track_id, column.distance_m[rows], column.sigma_m[rows], systematic_m)


def plain_fitter(curve: PlainCurve) -> Fitter:
    """One plain curve per class, without a sigma; NaN for a class that the boxes fitted on do not have."""

    def fit(train: BoxSet) -> Predictor:
        fitted = {}
        for name in np.unique(train.class_name):
            mine = train.select(train.class_name == name)
            if len(mine) >= MIN_PLAIN_SAMPLES:
                fitted[name] = curve.fit(mine.wh_over_f, mine.bearing, mine.distance_m)

        def predict(boxes: BoxSet) -> MethodColumn:
            distance_m = np.full(len(boxes), np.nan)
            for name, one in fitted.items():
                rows = boxes.class_name == name
                distance_m[rows] = one.predict(boxes.wh_over_f[rows], boxes.bearing[rows])
            return MethodColumn(distance_m, np.full(len(boxes), np.nan))

        return predict

    return fit


def size_fitter(method: RangingMethod, options: MethodOptions) -> Fitter:
    """A method that uses a size model, with priors fitted to the training boxes."""

    def fit(train: BoxSet) -> Predictor:
        try:
            model = fit_size_priors(labelled_sizes(train), source="left-out sequences not fitted on")
        except CurveError:
            return lambda boxes: MethodColumn(*np.full((2, len(boxes)), np.nan))
        return lambda boxes: ranger_columns(boxes, [method], options, size_model=model)[method.name]

    return fit


def _size_classes(boxes: BoxSet) -> IntArray:
    """(N,) index into `SIZE_CLASSES` of the labels' own classes: a van is a van."""
    return np.array([SIZE_CLASSES.index(str(name)) for name in boxes.class_name], np.int64)


def as_frames(boxes: BoxSet, class_id: IntArray) -> Iterator[tuple[IntArray, Tracks, Frame, bool]]:
    """Frame by frame: rows, tracks, frame (blank, as wide as the image), and whether it is the first of a sequence."""
    sequence = -1
    for rows in frame_rows(boxes):
        n = len(rows)
        named = boxes.track_id[rows]
        track_id = named + 1 if (named >= 0).all() else np.arange(1, n + 1)
        tracks = Tracks(track_id, boxes.xyxy_px[rows], class_id[rows], np.ones(n), np.ones(n, np.bool_))
        width_px, height_px = boxes.size_px[rows[0]].tolist()
        blank = np.broadcast_to(np.zeros(1, np.uint8), (height_px, width_px, 3))
        frame = Frame(int(boxes.frame[rows[0]]), float(boxes.time_s[rows[0]]), blank, None)
        yield rows, tracks, frame, int(boxes.sequence[rows[0]]) != sequence
        sequence = int(boxes.sequence[rows[0]])


def labelled_sizes(boxes: BoxSet) -> LabelledSizes:
    """The boxes with their 3-D boxes, as the fit of the priors wants them."""
    _, object_id = np.unique(np.stack([boxes.sequence, boxes.track_id]), axis=1, return_inverse=True)
    xyxy_px, border = boxes.xyxy_px, boxes.size_px[:, 0] - 2.5
    return LabelledSizes(
        size_class=boxes.class_name,
        object_id=object_id.reshape(-1),
        wh_over_f=boxes.wh_over_f,
        bearing=boxes.bearing,
        distance_m=boxes.distance_m,
        size_hwl_m=boxes.size_hwl_m,
        rotation_y_rad=boxes.rotation_y_rad,
        is_whole=(xyxy_px[:, 0] > 1.5) & (xyxy_px[:, 2] < border),
    )
