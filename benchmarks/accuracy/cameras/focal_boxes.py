"""Focal lengths and distances of cameras without a calibration from boxes alone, with no, one and
three known distances: drives without images.
"""

from __future__ import annotations

import math
from argparse import Namespace
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.boxes.box_drive import BoxDrive
from benchmarks.harness import Figures, option
from benchmarks.inputs.drives import REAL_DATA
from benchmarks.inputs.road_sets import SETS, RoadSet, road_set
from track_range.foundation.arrays import FloatArray
from track_range.ranging.cameras.camera_fit import fit_camera
from track_range.ranging.cameras.focal_evidence import vehicle_shapes
from track_range.ranging.cameras.measurements import (
    CameraMeasurements,
    KnownObject,
    SceneBoxes,
    unhidden,
)
from track_range.ranging.cameras.unknowns import camera_priors
from track_range.ranging.size_models.cuboid_sizes import CuboidSizes
from track_range.ranging.size_models.curve import load_curves
from track_range.ranging.size_models.size_model import SIZE_CLASSES, BoxNoise, measured_boxes
from track_range.recording.cameras.camera_estimate import (
    CameraEstimate,
    source_of_curve,
    source_of_guess,
)
from track_range.simulation.world.scenarios import make_scenario
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.focal_guess import FocalGuess, default_guess, focal_of_field
from track_range.stereo.geometry.rig import StereoRig

SCENARIOS = ("city", "town", "highway", "queue")
SIZE_PX = (1280, 720)
SECONDS, STEP_S = 20.0, 0.4  # length of a simulated drive and time between its frames, s
# relative error of a known distance, and error of the edges of its box in px
TAPE_SIGMA, EDGE_PX = 0.01, 1.5
# distances that are compared, and the largest known distance, m
NEAREST_M, FARTHEST_M, KNOWN_M = 5.0, 60.0, 30.0
CHOICES = 5  # number of choices of known objects per real drive
# rows of the tables
NAMES = ("no measurement", "one distance", "three distances", "75 degrees assumed")


@dataclass(frozen=True, slots=True)
class RoadDrive:
    """Boxes that are not hidden, with their true distances (N,), of a drive with a camera of
    unknown focal length.

    `size_px` is (width, height) of the images, `focal_px` the true focal length; `known` are
    choices of known objects.
    """

    name: str
    size_px: tuple[int, int]
    focal_px: float
    scene: SceneBoxes
    true_m: FloatArray
    known: tuple[tuple[KnownObject, ...], ...]


BOX_OPTIONS = (
    option("--first-seed", "--seed", default=100, help="first seed; 0-9 were used for the design"),
    option("--seeds", default=20, help="number of seeds of drives without images"),
    option("--sets", default=(), nargs="*", choices=SETS, help="data sets of real drives"),
    option("--data", default=REAL_DATA, help="folder of the data sets"),
)


def box_figures(options: Namespace) -> Figures:
    """Errors of focal lengths and distances by scenario and data set, and by what is known."""
    sizes = load_curves(region="europe")  # as runs and `calibrate` do
    if not isinstance(sizes, CuboidSizes):
        raise TypeError("the packaged curves have no priors")
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    groups = {name: [simulated_drive(name, seed) for seed in seeds] for name in SCENARIOS}
    groups["all simulated"] = [drive for name in SCENARIOS for drive in groups[name]]
    groups |= {
        name: list(labelled_drives(name, road_set(name, options.data))) for name in options.sets
    }
    groups["all real"] = [drive for name in options.sets for drive in groups[name]]
    return {name: _figures(drives, sizes) for name, drives in groups.items()}


def simulated_drive(scenario: str, seed: int) -> RoadDrive:
    rng = np.random.default_rng([seed, 77, len(scenario), ord(scenario[0])])
    focal_px = focal_of_field(rng.uniform(50, 100), SIZE_PX[0])
    pitch_rad, height_m = math.radians(rng.normal(0, 2)), rng.uniform(1.2, 1.8)
    camera = PinholeCamera.of_focal_length(focal_px, SIZE_PX)
    # a pitched camera, nearly
    camera = replace(camera, cy_px=camera.cy_px - focal_px * math.tan(pitch_rad))
    scene = replace(make_scenario(scenario, seed=seed, seconds=SECONDS), camera_height_m=height_m)
    times_s = np.arange(0, SECONDS - STEP_S / 2, STEP_S / 2)
    drive = BoxDrive(scene, times_s, StereoRig.rectified(camera, 0.5), seed=seed)
    parts, distances = [], []
    for frame in list(drive)[::2]:
        boxes = frame.detections
        rows = np.flatnonzero((frame.user >= 0) & unhidden(boxes.xyxy_px))
        parts.append(SceneBoxes(boxes.xyxy_px[rows], boxes.class_id[rows], frame.user[rows]))
        distances.append(frame.true_m[rows])
    true = drive.true
    is_car = np.array([scene.road_users[user].kitti_type == "Car" for user in true.user])
    rows = np.flatnonzero(is_car & (true.hidden_fraction < 0.05) & (true.outside_fraction <= 0))
    known = _chosen(true.xyxy_px[rows], true.distance_m[rows], true.user[rows], SIZE_PX, rng)
    return RoadDrive(
        scenario, SIZE_PX, focal_px, SceneBoxes.joined(parts), np.concatenate(distances), (known,)
    )


def labelled_drives(name: str, road: RoadSet) -> Iterator[RoadDrive]:
    """The drives of a data set, one for each sequence and camera; of KITTI's drives, every fifth
    frame.
    """
    step = 1 if road.train is None else 5
    _, drive = np.unique(
        np.column_stack([road.boxes.sequence, road.boxes.fxycxy_px]), axis=0, return_inverse=True
    )
    for k in range(int(drive.max()) + 1):
        chosen = np.flatnonzero(drive.reshape(-1) == k)
        rows, identity = road.boxes.select(chosen), road.object_id[chosen]
        if len(rows) < 5:
            continue
        shown = np.zeros(len(rows), np.bool_)
        for frame in np.unique(rows.frame[rows.frame % step == 0]):
            frame_rows = np.flatnonzero(rows.frame == frame)
            shown[frame_rows] = unhidden(rows.xyxy_px[frame_rows])
        scene = SceneBoxes(rows.xyxy_px[shown], rows.class_id[shown], identity[shown])
        is_car = (rows.class_name == "car") & (rows.occluded == 0)
        cars, size_px = rows.select(is_car), (int(rows.size_px[0, 0]), int(rows.size_px[0, 1]))
        choices = tuple(
            _chosen(
                cars.xyxy_px,
                cars.distance_m,
                identity[is_car],
                size_px,
                np.random.default_rng([k, n]),
            )
            for n in range(CHOICES)
        )
        yield RoadDrive(
            name, size_px, float(rows.fxycxy_px[0, 0]), scene, rows.distance_m[shown], choices
        )


def _chosen(
    xyxy_px: FloatArray,
    distance_m: FloatArray,
    identity: Any,
    size_px: tuple[int, int],
    rng: np.random.Generator,
) -> tuple[KnownObject, ...]:
    """Up to three different objects in random order, as a person would measure them."""
    offset_px = (xyxy_px[:, 0] + xyxy_px[:, 2] - size_px[0]) / 2
    usable = (np.abs(offset_px) < size_px[0] / 4) & (xyxy_px[:, 3] < size_px[1] - 4)
    usable &= (distance_m > NEAREST_M) & (distance_m < KNOWN_M)
    chosen: dict[int, KnownObject] = {}
    for row in rng.permutation(np.flatnonzero(usable)).tolist():
        box = xyxy_px[row] + rng.normal(0, EDGE_PX, 4)
        chosen.setdefault(
            int(identity[row]),
            KnownObject(
                name=str(row),
                xyxy_px=(float(box[0]), float(box[1]), float(box[2]), float(box[3])),
                size_class=SIZE_CLASSES.index("car"),
                distance_m=float(distance_m[row] * (1 + rng.normal(0, TAPE_SIGMA))),
            ),
        )
    return tuple(chosen.values())[:3]


def _figures(drives: Sequence[RoadDrive], sizes: CuboidSizes) -> dict[str, dict[str, float]]:
    errors: dict[str, list[tuple[float, ...]]] = {name: [] for name in NAMES}
    for drive in drives:
        for name, guess in _estimates(drive, sizes):
            log_error = math.log(guess.focal_px / drive.focal_px)
            errors[name].append(
                (log_error, guess.sigma, *_distance_errors(drive, guess.focal_px, sizes))
            )
    return {name: _summary(np.array(values)) for name, values in errors.items() if values}


def _estimates(drive: RoadDrive, sizes: CuboidSizes) -> Iterator[tuple[str, FocalGuess]]:
    default = default_guess(drive.size_px)
    yield NAMES[3], default
    shapes = vehicle_shapes(drive.scene, drive.size_px, sizes)
    usual = source_of_guess(default, "usual", drive.size_px)
    by_shape = source_of_curve("shapes", "shapes", shapes.curve, drive.size_px)
    prior = CameraEstimate(size_px=drive.size_px, sources=(usual, by_shape)).guess
    yield NAMES[0], prior
    for known in drive.known:
        for name, n in ((NAMES[1], 1), (NAMES[2], 3)):
            if len(known) < n:
                continue
            fit = fit_camera(
                drive.size_px,
                camera_priors(prior.focal_px, focal_sigma=prior.sigma),
                sizes,
                CameraMeasurements(
                    objects=known[:n], scene=drive.scene, scene_noise=shapes.relative_noise
                ),
            )
            yield name, FocalGuess(fit.camera.fx_px, fit.focal_sigma, "")


def _distance_errors(drive: RoadDrive, focal_px: float, sizes: CuboidSizes) -> tuple[float, float]:
    """Median error, and magnitude of the common scale error, of distances by size with this focal
    length.
    """
    rows = np.flatnonzero((drive.true_m >= NEAREST_M) & (drive.true_m <= FARTHEST_M))
    scene = drive.scene.select(rows)
    xyxy_px = scene.xyxy_px
    is_whole = (
        (xyxy_px[:, 0] > 2)
        & (xyxy_px[:, 2] < drive.size_px[0] - 3)
        & (xyxy_px[:, 3] > xyxy_px[:, 1])
    )
    scene, true_m = scene.select(is_whole), drive.true_m[rows][is_whole]
    camera = PinholeCamera.of_focal_length(focal_px, drive.size_px)
    no_bottom = np.ones(len(scene), np.bool_), np.zeros(len(scene), np.bool_)
    boxes = measured_boxes(
        scene.xyxy_px,
        scene.size_class,
        camera=camera,
        noise=BoxNoise(),
        uses_width_bottom=no_bottom,
    )
    log_ratio = np.log(sizes.measure(boxes).distance_m / true_m)
    return float(np.nanmedian(np.abs(log_ratio))), abs(float(np.nanmedian(log_ratio)))


def _summary(values: FloatArray) -> dict[str, float]:
    log_error, sigma, distance_error, scale_error = values.T
    size = np.abs(log_error)
    return {
        "n": len(values),
        "focal_median_pct": 100 * float(np.median(size)),
        "focal_p90_pct": 100 * float(np.quantile(size, 0.9)),
        "focal_bias_pct": 100 * float(np.median(log_error)),
        "sigma_pct": 100 * float(np.median(sigma)),
        "within_1_sigma": float(np.mean(size < sigma)),
        "within_2_sigma": float(np.mean(size < 2 * sigma)),
        "distance_median_pct": 100 * float(np.median(distance_error)),
        "scale_median_pct": 100 * float(np.median(scale_error)),
    }
