"""Box-only methods run over labelled boxes: the size ranger as the product has it, and the plain curves beside it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from track_range.foundation.arrays import IntArray
from track_range.ranging.evaluation.box_evaluation import Fitter, Predictor, cross_validated, frame_rows, within_drives
from track_range.ranging.evaluation.errors import MethodColumn
from track_range.ranging.fitting.labelled_boxes import BoxSet
from track_range.ranging.fitting.prior_fit import LabelledSizes, fit_size_priors
from track_range.ranging.fusion.fusion import Fusion
from track_range.ranging.methods.ground_plane import GroundPlane, GroundSettings
from track_range.ranging.methods.size_regression import SizeRegressionRanger
from track_range.ranging.ranges import Ranges
from track_range.ranging.size_models.curve import CurveError, SizeModel, load_curves
from track_range.ranging.size_models.plain_curves import PLAIN_CURVES, PlainCurve
from track_range.ranging.size_models.size_model import SIZE_CLASSES
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

METHODS = (*PLAIN_CURVES, "mono", "ground", "mono+ground")
"""Names of what can be measured, in the order of the tables."""

MIN_PLAIN_SAMPLES = 20

_DETECTOR_SIGMA_PX = 1.5


@dataclass(frozen=True, slots=True, kw_only=True)
class MethodOptions:
    """How methods are fitted, and what they are told.

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
    methods: Sequence[str], boxes: BoxSet, train: BoxSet, options: MethodOptions | None = None
) -> dict[str, MethodColumn]:
    """(N,) distances and sigmas of `boxes` by every one of `methods` (of `METHODS`).

    `train` are boxes of the same sequences, perhaps exact ones, that curves are fitted on.
    """
    options = options or MethodOptions()
    tested = within_drives if options.is_same_drive else cross_validated
    found = {name: tested(boxes, train, plain_fitter(PLAIN_CURVES[name])) for name in methods if name in PLAIN_CURVES}
    if not set(methods) <= found.keys():
        sigma_px = options.box_sigma_px
        found["mono"] = (
            tested(boxes, train, mono_fitter(sigma_px))
            if options.is_cross_validated or options.is_same_drive
            else mono_measured(boxes, load_curves(options.curves), box_sigma_px=sigma_px)
        )
        settings = _ground_settings(options.camera_height_m, _DETECTOR_SIGMA_PX if sigma_px is None else sigma_px)
        found |= ground_measured(boxes, found["mono"], settings)
    return {name: found[name] for name in methods}


def ground_measured(boxes: BoxSet, mono: MethodColumn, settings: GroundSettings) -> dict[str, MethodColumn]:
    """What the ground plane says, its horizon tracked by the sizes in `mono`, and the fusion of the two."""
    columns = {name: MethodColumn(*np.full((2, len(boxes)), np.nan)) for name in ("ground", "mono+ground")}
    sequence, plane, fusion = -1, GroundPlane(boxes.camera_at(0), settings), Fusion()
    for rows, tracks, frame in as_frames(boxes):
        if boxes.sequence[rows[0]] != sequence:
            sequence = boxes.sequence[rows[0]]
            plane, fusion = GroundPlane(boxes.camera_at(rows[0]), settings), Fusion()
        by_size = Ranges(tracks.track_id, mono.distance_m[rows], mono.sigma_m[rows])
        ground = plane.measure(tracks, by_size, frame)
        both = fusion.fuse({"mono": by_size, "ground": ground}, tracks.track_id, frame.time_s).ranges
        for name, found in (("ground", ground), ("mono+ground", both)):
            columns[name].distance_m[rows], columns[name].sigma_m[rows] = found.distance_m, found.sigma_m
    return columns


def _ground_settings(height_m: float | None, box_sigma_px: float) -> GroundSettings:
    settings = GroundSettings() if height_m is None else GroundSettings.of_known_height(height_m)
    return replace(settings, box_sigma_px=box_sigma_px)


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


def mono_fitter(box_sigma_px: float | None) -> Fitter:
    """The product's priors over sizes."""

    def fit(train: BoxSet) -> Predictor:
        try:
            model = fit_size_priors(labelled_sizes(train), source="left-out sequences not fitted on")
        except CurveError:
            return lambda boxes: MethodColumn(*np.full((2, len(boxes)), np.nan))
        return lambda boxes: mono_measured(boxes, model, box_sigma_px=box_sigma_px)

    return fit


def mono_measured(boxes: BoxSet, curves: SizeModel, *, box_sigma_px: float | None) -> MethodColumn:
    """What the size ranger says of the boxes, frame by frame as in a run; None = a detector's noise."""
    distance_m, sigma_m, kept_m = np.full((3, len(boxes)), np.nan)
    size_class = np.array([SIZE_CLASSES.index(str(name)) for name in boxes.class_name], np.int64)
    ranger: SizeRegressionRanger | None = None
    sequence = -1
    for rows, tracks, frame in as_frames(boxes):
        if boxes.sequence[rows[0]] != sequence or ranger is None:
            sequence = boxes.sequence[rows[0]]
            ranger = SizeRegressionRanger(boxes.camera_at(rows[0]), curves, box_sigma_px=box_sigma_px)
        found = ranger.measure(replace(tracks, class_id=size_class[rows]), frame)
        distance_m[rows], sigma_m[rows], kept_m[rows] = found.distance_m, found.sigma_m, found.sigma_kept_m
    return MethodColumn(distance_m, sigma_m, kept_m)


def as_frames(boxes: BoxSet) -> Iterator[tuple[IntArray, Tracks, Frame]]:
    """Rows, tracks and frame (blank, as wide as the image) of one frame after the other."""
    class_id = boxes.class_id
    for rows in frame_rows(boxes):
        n = len(rows)
        named = boxes.track_id[rows]
        track_id = named + 1 if (named >= 0).all() else np.arange(1, n + 1)
        tracks = Tracks(track_id, boxes.xyxy_px[rows], class_id[rows], np.ones(n), np.ones(n, np.bool_))
        width_px, height_px = boxes.size_px[rows[0]].tolist()
        blank = np.broadcast_to(np.zeros(1, np.uint8), (height_px, width_px, 3))
        yield rows, tracks, Frame(int(boxes.frame[rows[0]]), float(boxes.time_s[rows[0]]), blank, None)


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
