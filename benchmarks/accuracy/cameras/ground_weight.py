"""What `ground` adds to `mono`: their errors on KITTI's labels by drive, and those of their fusion.

Boxes have no images, so that the horizon comes from the poses of the camera as image motion would
measure it: `RoadHorizon` gets the turns of the poses and the direction of the last metres travelled,
with the errors of simulated drives. `mono` has sizes of the other sequences.
"""

from __future__ import annotations

import math
from argparse import Namespace
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import Figures, option, workload
from benchmarks.inputs.drives import REAL_DATA
from benchmarks.inputs.road_sets import KITTI, KITTI_HEIGHT_M, RoadSet, road_set
from track_range.foundation.arrays import FloatArray
from track_range.ranging.evaluation.box_evaluation import figures
from track_range.ranging.evaluation.box_frames import as_frames, ranges_in_frame
from track_range.ranging.evaluation.box_methods import (
    MethodOptions,
    measured_by,
)
from track_range.ranging.fusion.fusion import Fusion
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.ground_plane import GroundRanger, GroundSettings
from track_range.ranging.truth.errors import MethodColumn
from track_range.stereo.odometry.road_horizon import RoadHorizon, RoadView

KNOWN = ("nothing", "height")
FUSED = ("as in a run", "always")  # whether `ground` is only a fallback where its height is unknown
STEP_S = 0.1036  # between two frames of KITTI
TRAVELLED_M, SLOWEST_MPS = 4.0, 1.0  # of the direction of travel
ROTATION_RAD = 0.0002  # error of the turn between two frames
# error of the direction of travel, its correlation from frame to frame, and the stated sigma
TRAVEL_RAD, TRAVEL_MEMORY, TRAVEL_SIGMA_RAD = 0.0015, 0.8, 0.002
OUTLIER_SIGMA = 4.0


@workload(
    option("--sets", default=tuple(KITTI), choices=tuple(KITTI), help="boxes"),
    option("--known", default=KNOWN, choices=KNOWN, help="what is known of the camera's height"),
    option("--data", default=REAL_DATA, help="folder of the real data"),
    option("--seed", default=0, help="seed of the errors of the horizon"),
)
def ground_weight(options: Namespace) -> Figures:
    """Errors of `mono`, `ground` and their fusion by drive, and the correlation of the first two."""
    data = Path(options.data)
    return {
        name: {
            known: _measured(road_set(name, data), data / "kitti_poses", known, options.seed)
            for known in options.known
        }
        for name in options.sets
    }


def _measured(one: RoadSet, poses: Path, known: str, seed: int) -> Figures:
    boxes, train = one.boxes, one.boxes if one.train is None else one.train
    of_mono = MethodOptions(is_cross_validated=True, box_sigma_px=one.box_sigma_px, region="europe")
    mono = measured_by(["mono"], boxes, train, of_mono)["mono"]
    ground = _ground(one, mono, poses, known=known, seed=seed)
    columns = {"mono": mono, "ground": ground}
    fused = {form: _fused(one, columns, known, is_always=form == "always") for form in FUSED}
    by_method = {name: figures(boxes, column) for name, column in {**columns, **fused}.items()}
    return {"correlation of cars": _correlation(one, mono, ground), **by_method}


def _ground(
    one: RoadSet, mono: MethodColumn, poses: Path, *, known: str, seed: int
) -> MethodColumn:
    settings, boxes = GroundSettings(), one.boxes
    if known == "height":
        settings = GroundSettings.of_known_height(KITTI_HEIGHT_M)
    if one.box_sigma_px is not None:
        settings = replace(settings, box_sigma_px=max(one.box_sigma_px, 1e-3))
    column = MethodColumn(*np.full((2, len(boxes)), np.nan))
    ranger, views = GroundRanger(boxes.camera_at(0)), list[RoadView]()
    for rows, tracks, frame, is_first in as_frames(boxes, boxes.class_id):
        if is_first:
            name = boxes.sequence_names[boxes.sequence[rows[0]]]
            views = list(_road_views(poses / f"{name}.txt", np.random.default_rng([seed, 40])))
            camera = boxes.camera_at(rows[0])
            ranger = GroundRanger(camera, settings, is_reference=known == "height")
        ranger.update_road(views[min(frame.index, len(views) - 1)])
        by_size = ranges_in_frame(mono, tracks, rows)
        ranges = ranger.measure_with(tracks, frame, {"mono": by_size})
        column.distance_m[rows], column.sigma_m[rows] = ranges.distance_m, ranges.sigma_m
    return column


def _road_views(file: Path, rng: np.random.Generator) -> Iterator[RoadView]:
    """The road in each frame of a sequence, as the motion of its images shows it."""
    poses = np.loadtxt(file).reshape(-1, 3, 4)
    rotation, place_m = poses[:, :, :3], poses[:, :, 3]
    step_m = np.linalg.norm(np.diff(place_m, axis=0, prepend=place_m[:1]), axis=1)
    way_m = np.cumsum(step_m)
    horizon, error = RoadHorizon(), 0.0
    for frame in range(len(poses)):
        if frame > 0:
            turned = rotation[frame - 1].T @ rotation[frame]
            pitch_rad = math.asin(-turned[1, 2]) + rng.normal(0, ROTATION_RAD)
            horizon.predict(
                STEP_S, pitch_rad=pitch_rad, roll_rad=math.nan, travelled_m=step_m[frame]
            )
        white = rng.normal(0, math.sqrt(1 - TRAVEL_MEMORY**2) * TRAVEL_RAD)
        error = TRAVEL_MEMORY * error + white
        start = int(np.searchsorted(way_m, way_m[frame] - TRAVELLED_M))
        travelled_m = rotation[frame].T @ (place_m[frame] - place_m[start])
        if step_m[frame] > SLOWEST_MPS * STEP_S and travelled_m[2] > TRAVELLED_M / 4:
            row = travelled_m[1] / travelled_m[2] + error
            horizon.measure(row, TRAVEL_SIGMA_RAD**2, max_sigma=OUTLIER_SIGMA)
        yield horizon.view


def _fused(
    one: RoadSet, columns: Mapping[str, MethodColumn], known: str, *, is_always: bool
) -> MethodColumn:
    boxes, fusion = one.boxes, Fusion()
    column = MethodColumn(*np.full((2, len(boxes)), np.nan))
    for rows, tracks, frame, is_first in as_frames(boxes, boxes.class_id):
        fusion = Fusion() if is_first else fusion
        ranges: dict[str, Ranges] = {
            name: ranges_in_frame(part, tracks, rows) for name, part in columns.items()
        }
        is_fallback = known == "nothing" and not is_always
        ranges["ground"] = replace(ranges["ground"], is_fallback=is_fallback)
        result = fusion.fuse(ranges, tracks.track_id, frame.time_s).ranges
        column.distance_m[rows], column.sigma_m[rows] = result.distance_m, result.sigma_m
    return column


def _correlation(one: RoadSet, mono: MethodColumn, ground: MethodColumn) -> dict[str, Any]:
    """Correlations of the errors of cars, in sigmas: of the means of tracks, and of their views."""
    boxes = one.boxes
    rows = (boxes.class_name == "car") & np.isfinite(mono.distance_m + ground.distance_m)
    track = np.stack([boxes.sequence, boxes.track_id])[:, rows]
    number = np.unique(track, axis=1, return_inverse=True)[1]
    errors = [_in_sigmas(column, boxes.distance_m)[rows] for column in (mono, ground)]
    means = [np.bincount(number, error)[number] / np.bincount(number)[number] for error in errors]
    views = [error - mean for error, mean in zip(errors, means, strict=True)]
    return {
        "n": int(rows.sum()),
        "of tracks": _about_zero(*means),
        "of views": _about_zero(*views),
    }


def _in_sigmas(column: MethodColumn, true_m: FloatArray) -> FloatArray:
    return np.asarray(np.log(column.distance_m / true_m) * column.distance_m / column.sigma_m)


def _about_zero(a: FloatArray, b: FloatArray) -> float:
    return float((a * b).mean() / math.sqrt((a * a).mean() * (b * b).mean()))
