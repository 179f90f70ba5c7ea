"""Evaluation of closing speed, speed over ground, time to collision and warnings on labelled
drives.
"""

from typing import Any

from track_range.evaluation.motion.cells import cell_figures
from track_range.evaluation.motion.labelled_motion import LabelledMotion, kitti_motion
from track_range.evaluation.motion.measured_motion import measured_motion
from track_range.evaluation.motion.nuscenes import nuscenes_motion
from track_range.evaluation.motion.scores import motion_figures
from track_range.evaluation.motion.settings import (
    CuboidEvaluationSettings,
    LabelledDriveSettings,
    MotionEvaluationSettings,
)
from track_range.evaluation.motion.tusimple import tusimple_motion
from track_range.foundation.errors import UsageError
from track_range.ranging.evaluation.box_evaluation import metrics
from track_range.ranging.evaluation.box_methods import MethodOptions
from track_range.ranging.truth.frame_times import TimeSource


def evaluate_motion(settings: MotionEvaluationSettings) -> dict[str, Any]:
    """Errors of the motion by distance band, class and time to collision, with the settings, as
    JSON values.

    Raises LabelFileError, RigError: labels, poses or calibration cannot be used; UsageError: an
    unknown method, or folders that are missing.
    """
    shown = {"labels": str(settings.labels), "data": settings.data}
    if settings.data == "tusimple":
        truth, measured, score = tusimple_motion(settings.labels)
        figures: dict[str, Any] = {"velocity_score": score}
        note = "Measured by runs with one camera."
    else:
        truth = labelled_drives(settings)
        known = {"is_ego_known": settings.ego == "poses", "look_ahead": settings.look_ahead}
        measured = measured_motion(truth, settings.methods, method_options(settings), **known)
        figures, note = {}, f"Ego speed: {settings.ego}."
        names = ("boxes", "noise_px", "seed", "region", "ego", "look_ahead")
        shown |= {name: getattr(settings, name) for name in names} | {
            "method": settings.methods,
            "cross_validated": settings.cross_validate,
        }
    return {
        **shown,
        "n_boxes": len(truth.boxes),
        "time_step_s": truth.boxes.time_step_s,
        "distance": metrics(measured.distance_m, truth.boxes.distance_m),
        **motion_figures(truth, measured, settings.seed),
        **cell_figures(truth, measured, settings.seed),
        **figures,
        "notes": [f"Truth: {truth.protocol}. {note}", *truth.boxes.notes],
    }


def method_options(settings: LabelledDriveSettings) -> MethodOptions:
    """Options of the ranging methods that measure labelled drives."""
    return MethodOptions(
        is_cross_validated=settings.cross_validate,
        box_sigma_px=settings.noise_px if settings.boxes == "labels" else None,
        region=settings.region,
    )


def labelled_drives(
    settings: MotionEvaluationSettings | CuboidEvaluationSettings,
) -> LabelledMotion:
    """Boxes of labelled drives with their true motion; UsageError: a folder is missing."""
    if settings.data == "nuscenes":
        return nuscenes_motion(settings.labels, noise_px=settings.noise_px, seed=settings.seed)
    if settings.calib is None or settings.poses is None:
        raise UsageError(
            "expected --calib and --poses, the folders of calibrations and poses; give both."
        )
    return kitti_motion(
        settings.labels,
        settings.calib,
        settings.poses,
        boxes=settings.boxes,
        noise_px=settings.noise_px,
        seed=settings.seed,
        times=TimeSource(settings.times, settings.frame_rate_hz),
    )
