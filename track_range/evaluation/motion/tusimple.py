"""Clips of TuSimple's velocity challenge: images at 20 Hz, with labelled vehicles in the last image
(annotation.json).

A label has the drawn box, the nearest point and the velocity relative to the camera, (forward,
right) in m and m/s. The clip is measured as a run with one camera does, from the boxes of a
detector; a vehicle has the motion of the track in the last image that overlaps its box most. The
official score is the mean over near (below 20 m), medium (below 45 m) and far vehicles of the mean
squared error of the velocity, where vehicles without an answer count with a velocity of 0.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from track_range.detection.boxes import iou
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.evaluation.motion.labelled_motion import LabelledMotion
from track_range.evaluation.motion.measured_motion import MeasuredMotion
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.files.structured_text import read_json
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.truth.errors import MIN_IOU
from track_range.ranging.truth.labelled_boxes import BoxSet
from track_range.run.pipeline import Pipeline
from track_range.stereo.geometry.camera import PinholeCamera

# of all clips
CAMERA = PinholeCamera(714.1526, 710.3725, 675.5754, 376.2563, width_px=1280, height_px=720)
# m, of the official score
BANDS = {"near": (0.0, 20.0), "medium": (20.0, 45.0), "far": (45.0, np.inf)}
_STEP_S = 0.05
_LATERAL_FRAMES = 20  # last images whose positions give the lateral velocity

_EDGES = ("left", "top", "right", "bottom")


def tusimple_motion(folder: Path) -> tuple[LabelledMotion, MeasuredMotion, dict[str, Any]]:
    """True and measured motion of the vehicles of a clip, or of all clips in a folder, and the
    official score.

    Raises LabelFileError: there is no clip with images, or its labels cannot be read.
    """
    clips = sorted(
        {path.parent for pattern in ("", "*/") for path in folder.glob(pattern + "annotation.json")}
    )
    if not clips:
        raise LabelFileError(
            f"{folder}: expected clips of TuSimple with annotation.json and images, found none."
        )
    parts = [(labels, _measured(clip, labels)) for clip in clips if len(labels := _vehicles(clip))]
    clip = np.repeat(np.arange(len(parts)), [len(labels) for labels, _ in parts])
    labels, measured = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    position_m, velocity_mps, nan = labels[:, 4:6], labels[:, 6:], np.full(len(labels), np.nan)
    duration_s = np.array([_STEP_S * sum(len(_images(clip)) for clip in clips)])
    protocol = "velocities of the labels in the last image of each clip"
    truth = LabelledMotion(
        boxes=vehicle_boxes(labels, clip),
        closing_mps=-velocity_mps[:, 0],
        speed_mps=nan,
        heading_rad=nan,
        ego_mps=nan,
        right_mps=nan,
        yaw_rad_s=nan,
        duration_s=duration_s,
        protocol=protocol,
    )
    *motion, lateral_mps = measured.T
    closing_mps = motion[1]
    is_alarm = np.zeros(len(labels), np.bool_)
    answers = MeasuredMotion(is_alarm, *motion, *[nan] * 6)
    answer_mps = np.nan_to_num(np.stack([-closing_mps, lateral_mps], axis=1))
    return truth, answers, velocity_score(answer_mps, velocity_mps, position_m)


def velocity_score(
    velocity_mps: FloatArray, true_mps: FloatArray, position_m: FloatArray
) -> dict[str, float | None]:
    """Mean squared errors in (m/s)^2 of velocities (N, 2) by distance, and their mean; None = no
    vehicle.
    """
    squared, z = ((velocity_mps - true_mps) ** 2).sum(axis=1), np.linalg.norm(position_m, axis=1)
    by_band = {name: squared[(z >= low) & (z < high)] for name, (low, high) in BANDS.items()}
    score = {
        name: round(float(part.mean()), 4) if len(part) else None for name, part in by_band.items()
    }
    known = [value for value in score.values() if value is not None]
    return {**score, "mean": round(float(np.mean(known)), 4) if known else None}


def _vehicles(clip: Path) -> FloatArray:
    """(N, 8) boxes, positions and velocities of the labels of a clip."""
    path = clip / "annotation.json"
    try:
        return vehicle_columns(read_json(path, LabelFileError, "labels of TuSimple"))
    except (ValueError, KeyError, TypeError) as error:
        raise LabelFileError(
            f"{path}: expected vehicles with bbox, position and velocity, found other labels."
        ) from error


def vehicle_columns(vehicles: Any) -> FloatArray:
    """(N, 8) boxes, positions and velocities of labelled vehicles; ValueError, KeyError or
    TypeError if invalid.
    """
    rows = [
        [*(v["bbox"][edge] for edge in _EDGES), *v["position"], *v["velocity"]] for v in vehicles
    ]
    return np.array(rows, np.float64).reshape(len(rows), 8)


def vehicle_boxes(labels: FloatArray, clip: IntArray) -> BoxSet:
    """Boxes of the labels (N, 8) in the last images of the clips (N,), which are separate
    images.
    """
    n = len(labels)
    return BoxSet.without_3d_boxes(
        sequence_names=("tusimple",),
        sequence=np.zeros(n, np.int64),
        frame=clip,
        time_s=clip.astype(np.float64),
        track_id=np.full(n, -1),
        kitti_type=np.full(n, "Car"),
        class_name=np.full(n, "car"),
        xyxy_px=labels[:, :4],
        fxycxy_px=np.tile([CAMERA.fx_px, CAMERA.fy_px, CAMERA.cx_px, CAMERA.cy_px], (n, 1)),
        size_px=np.tile([CAMERA.width_px, CAMERA.height_px], (n, 1)),
        distance_m=labels[:, 4],
    )


def _images(clip: Path) -> list[Path]:
    images = sorted((clip / "imgs").glob("*.jpg")) or sorted(clip.glob("*.jpg"))
    if not images:
        raise LabelFileError(
            f"{clip}: expected the images 001.jpg, 002.jpg, ... of the clip, found none."
        )
    return images


def _measured(clip: Path, labels: FloatArray) -> FloatArray:
    """(N, 6) distance, closing speed and time to collision with their sigmas, lateral velocity of
    labels (N, 8); NaN = none.
    """
    results = list(_results(clip))
    last, measured = results[-1], np.full((len(labels), 6), np.nan)
    overlap = iou(labels[:, :4], last.tracks.xyxy_px)
    for row in np.flatnonzero(overlap.max(axis=1, initial=0.0) >= MIN_IOU):
        track = int(np.argmax(overlap[row]))
        columns = (
            last.ranges["fused_kf"].distance_m,
            last.closing_mps,
            last.closing_sigma_mps,
            last.ttc_s,
            last.ttc_sigma_s,
        )
        at = [
            (
                _STEP_S * number,
                result.xyz_m[result.tracks.track_id == last.tracks.track_id[track], 0],
            )
            for number, result in enumerate(results[-_LATERAL_FRAMES:])
        ]
        t, x = (
            np.array([(time_s, x_m[0]) for time_s, x_m in at if len(x_m) and np.isfinite(x_m[0])])
            .reshape(-1, 2)
            .T
        )
        lateral_mps = np.polyfit(t, x, 1)[0] if len(t) > 2 else np.nan
        measured[row] = *(column[track] for column in columns), lateral_mps
    return measured


def _results(clip: Path) -> Iterator[FrameResult]:
    with Pipeline.mono(rig=CAMERA) as pipeline:
        for number, path in enumerate(_images(clip)):
            image = cv2.imread(str(path))
            if image is None:
                raise LabelFileError(
                    f"{path}: expected an image, found a file that cannot be read."
                )
            yield pipeline.step(np.asarray(image, np.uint8), number * _STEP_S)
