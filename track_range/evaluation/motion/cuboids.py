"""Evaluation of measured cuboids on labelled drives: labelled boxes are measured as in a run, with
the motion of the camera from its poses.
"""

from collections import defaultdict
from dataclasses import fields
from typing import Any

import numpy as np

from track_range.evaluation.motion.cells import CLASSES, MOVING_MPS
from track_range.evaluation.motion.cuboid_errors import (
    cuboid_errors,
    cuboid_figures,
    distance_cells,
    labelled_cuboids,
    view_cells,
)
from track_range.evaluation.motion.evaluate import labelled_drives, method_options
from track_range.evaluation.motion.labelled_motion import LabelledMotion
from track_range.evaluation.motion.measured_motion import filtered_frames, method_columns
from track_range.evaluation.motion.scores import resampled_drives
from track_range.evaluation.motion.settings import CuboidEvaluationSettings
from track_range.evaluation.motion.states import RESTING_MPS
from track_range.foundation.arrays import BoolArray, IntArray
from track_range.pipeline.filtering import reported
from track_range.pipeline.ranging import FrameRanges
from track_range.pipeline.world import WorldStage
from track_range.ranging.cameras.doubt import Doubt
from track_range.ranging.evaluation.box_frames import ranges_in_frame
from track_range.ranging.evaluation.box_methods import MethodOptions
from track_range.ranging.fitting.cross_validation import folds
from track_range.ranging.fitting.prior_fit import fit_size_priors
from track_range.ranging.size_models.class_sizes import ClassSizes
from track_range.ranging.size_models.curve import load_curves
from track_range.ranging.size_models.regions import in_region
from track_range.ranging.size_models.size_model import BoxTraits
from track_range.ranging.truth.labelled_boxes import BoxSet
from track_range.ranging.world.cuboids import Cuboids


def evaluate_cuboids(settings: CuboidEvaluationSettings) -> dict[str, Any]:
    """Errors of sizes, headings, centres and nearest sides by cell, with the settings, as JSON
    values.

    Raises LabelFileError, RigError: labels, poses or calibration cannot be used; UsageError: an
    unknown method, or folders that are missing.
    """
    truth = labelled_drives(settings)
    measured = measured_cuboids(
        truth, settings.methods, method_options(settings), is_ego_known=settings.ego == "poses"
    )
    boxes = truth.boxes
    true = labelled_cuboids(boxes.location_m, boxes.size_hwl_m, boxes.rotation_y_rad)
    errors = cuboid_errors(
        measured,
        true,
        is_moving=truth.speed_mps > MOVING_MPS,
        axis_rad=truth.axis_rad[boxes.sequence],
    )
    resamples = resampled_drives(truth, settings.seed)
    names = ("boxes", "noise_px", "seed", "region", "ego", "data")
    return {
        "labels": str(settings.labels),
        **{name: getattr(settings, name) for name in names},
        "method": settings.methods,
        "cross_validated": settings.cross_validate,
        "n_boxes": len(boxes),
        "cuboids": cuboid_figures(errors, _cells(truth, true), measured, true, resamples),
        "notes": [
            f"Truth: 3-D boxes of the labels; {truth.protocol}. Ego speed: {settings.ego}.",
            *boxes.notes,
        ],
    }


def _cells(truth: LabelledMotion, true: Cuboids) -> dict[str, BoolArray]:
    """Masks (N,) of the boxes, by the name of the cell."""
    by_class = {name: np.isin(truth.boxes.class_name, listed) for name, listed in CLASSES.items()}
    vehicles = by_class["vehicles"]
    states = {
        "moving": vehicles & (truth.speed_mps > MOVING_MPS),
        "parked": vehicles & (truth.speed_mps < RESTING_MPS),
    }
    sides = view_cells(true, {"vehicles": vehicles, **states})
    cars = {
        f"cars, {name}": rows & (truth.boxes.class_name == "car") for name, rows in states.items()
    }
    return {**by_class, **states, **sides, **cars, **distance_cells(true, vehicles)}


def measured_cuboids(
    truth: LabelledMotion, method: str, options: MethodOptions, *, is_ego_known: bool = True
) -> Cuboids:
    """Cuboids of the N boxes by the stages of a run, with the distances of a method."""
    boxes = truth.boxes
    columns = method_columns(boxes, method, options)
    sizes = _class_sizes(boxes, options)
    doubt = Doubt(shared_sigma=defaultdict(float))
    stages: dict[int, WorldStage] = {}
    parts = list[tuple[IntArray, Cuboids]]()
    for rows, tracks, ego, fused, filtered in filtered_frames(truth, columns, is_ego_known):
        number = int(boxes.sequence[rows[0]])
        if number not in stages:
            camera = boxes.camera_at(rows[0])
            stages[number] = WorldStage(
                camera,
                mounting=truth.mounting(number),
                sizes=sizes[number],
                traits=BoxTraits.of(camera.width_px, box_sigma_px=options.box_sigma_px),
            )
        in_frame = {name: ranges_in_frame(column, tracks, rows) for name, column in columns.items()}
        ranges = reported(FrameRanges(in_frame), fused, filtered, doubt)
        time_s = float(boxes.time_s[rows[0]])
        world = stages[number].update(tracks, filtered, ranges, ego, time_s)
        parts.append((rows, world.cuboids))
    order = np.argsort(np.concatenate([rows for rows, _ in parts]))
    values = {
        field.name: np.concatenate([getattr(one, field.name) for _, one in parts])[order]
        for field in fields(Cuboids)
    }
    return Cuboids(**values)


def _class_sizes(boxes: BoxSet, options: MethodOptions) -> dict[int, ClassSizes]:
    """Sizes of the classes for each sequence: of the curve file, or of the other sequences."""
    packaged = ClassSizes.of(load_curves(options.curves, options.region))
    sizes = dict.fromkeys(range(len(boxes.sequence_names)), packaged)
    for test in folds(boxes) if options.is_cross_validated else ():
        others = boxes.select(~np.isin(boxes.sequence, boxes.sequence[test]))
        if len(others):
            model = in_region(fit_size_priors(others, source="cross-validation"), options.region)
            sizes |= dict.fromkeys(np.unique(boxes.sequence[test]).tolist(), ClassSizes.of(model))
    return sizes
