"""Evaluation of closing speed, speed over ground, time to collision and warnings on labelled drives."""

from __future__ import annotations

from typing import Any

from track_range.evaluation.motion.labelled_motion import LabelledMotion, kitti_motion
from track_range.evaluation.motion.measured_motion import measured_motion
from track_range.evaluation.motion.nuscenes import nuscenes_motion
from track_range.evaluation.motion.scores import motion_figures
from track_range.evaluation.motion.settings import MotionEvaluationSettings
from track_range.evaluation.motion.tusimple import tusimple_motion
from track_range.foundation.errors import UsageError
from track_range.ranging.evaluation.box_methods import MethodOptions


def evaluate_motion(settings: MotionEvaluationSettings) -> dict[str, Any]:
    """Errors of the motion by distance band, class and time to collision, with the settings, as JSON values.

    Raises LabelFileError, RigError: labels, poses or calibration cannot be used; UsageError: an unknown method, or
    folders that are missing.
    """
    if settings.data == "tusimple":
        truth, measured, score = tusimple_motion(settings.labels)
        figures = {**motion_figures(truth, measured), "velocity_score": score}
        return {"labels": str(settings.labels), "data": settings.data, "n_boxes": len(truth.boxes), **figures} | {
            "notes": [f"Truth: {truth.protocol}. Measured by runs with one camera."]
        }
    truth = _truth(settings)
    options = MethodOptions(
        is_cross_validated=settings.cross_validate,
        box_sigma_px=settings.noise_px if settings.boxes == "labels" else None,
    )
    measured = measured_motion(
        truth, settings.method, options, is_ego_known=settings.ego == "poses", look_ahead=settings.look_ahead
    )
    return {
        "labels": str(settings.labels),
        "data": settings.data,
        "boxes": settings.boxes,
        "noise_px": settings.noise_px,
        "seed": settings.seed,
        "method": settings.method,
        "ego": settings.ego,
        "look_ahead": settings.look_ahead,
        "cross_validated": settings.cross_validate,
        "n_boxes": len(truth.boxes),
        **motion_figures(truth, measured),
        "notes": [f"Truth: {truth.protocol}. Ego speed: {settings.ego}."],
    }


def _truth(settings: MotionEvaluationSettings) -> LabelledMotion:
    if settings.data == "nuscenes":
        return nuscenes_motion(settings.labels, noise_px=settings.noise_px, seed=settings.seed)
    if settings.calib is None or settings.poses is None:
        raise UsageError("expected the folders --calib and --poses of the labels; give both.")
    return kitti_motion(
        settings.labels,
        settings.calib,
        settings.poses,
        boxes=settings.boxes,
        noise_px=settings.noise_px,
        seed=settings.seed,
    )
