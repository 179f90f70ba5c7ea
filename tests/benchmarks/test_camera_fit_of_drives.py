"""Fits of a camera to simulated drives with detector boxes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.boxes.box_drive import BoxDrive
from track_range.ranging.cameras.camera_fit import fit_camera
from track_range.ranging.cameras.focal_evidence import vehicle_shapes
from track_range.ranging.cameras.measurements import (
    CameraMeasurements,
    KnownObject,
    SceneBoxes,
    unhidden,
)
from track_range.ranging.cameras.unknowns import camera_priors
from track_range.ranging.size_models.curve import load_curves
from track_range.ranging.size_models.size_model import SIZE_CLASSES
from track_range.recording.cameras.camera_estimate import (
    CameraEstimate,
    source_of_curve,
    source_of_guess,
)
from track_range.simulation.world.scenarios import make_scenario
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.focal_guess import default_guess, focal_of_field
from track_range.stereo.geometry.rig import StereoRig

SIZE_PX = (1280, 720)
CENTRE_PX = (639.5, 359.5)
CAR = SIZE_CLASSES.index("car")
SIZES = load_curves()


def simulated(seed, scenario="city"):
    """Camera of random focal length, boxes of the simulated detector, and up to three known
    distances."""
    rng = np.random.default_rng([seed, 4])
    focal_px = focal_of_field(rng.uniform(50, 100), SIZE_PX[0])
    camera = PinholeCamera.of_focal_length(focal_px, SIZE_PX)
    camera = replace(
        camera, cy_px=camera.cy_px - focal_px * math.tan(math.radians(rng.normal(0, 2)))
    )
    scene = replace(
        make_scenario(scenario, seed=seed, seconds=12.0), camera_height_m=rng.uniform(1.2, 1.8)
    )
    drive = BoxDrive(scene, np.arange(0, 11.8, 0.4), StereoRig.rectified(camera, 0.5), seed=seed)
    parts = []
    for frame in drive:
        boxes = frame.detections
        rows = np.flatnonzero((frame.user >= 0) & unhidden(boxes.xyxy_px))
        parts.append(SceneBoxes(boxes.xyxy_px[rows], boxes.class_id[rows], frame.user[rows]))
    true = drive.true
    centre = (true.xyxy_px[:, 0] + true.xyxy_px[:, 2]) / 2
    is_car = np.array([scene.road_users[user].kitti_type == "Car" for user in true.user])
    usable = (
        is_car
        & (true.hidden_fraction < 0.05)
        & (true.outside_fraction <= 0)
        & (np.abs(centre - CENTRE_PX[0]) < 320)
    )
    usable &= (true.distance_m > 5) & (true.distance_m < 30)
    known = {}
    for row in rng.permutation(np.flatnonzero(usable)):
        box = true.xyxy_px[row] + rng.normal(0, 1.5, 4)
        distance_m = float(true.distance_m[row] * (1 + rng.normal(0, 0.01)))
        known.setdefault(
            int(true.user[row]),
            KnownObject(name="", xyxy_px=tuple(box), size_class=CAR, distance_m=distance_m),
        )
    return focal_px, SceneBoxes.joined(parts), list(known.values())[:3]


@pytest.mark.slow
def test_simulated_drives():
    errors, sigmas = [], []
    for seed in range(6):
        focal_px, scene, known = simulated(seed)
        shapes = vehicle_shapes(scene, SIZE_PX, SIZES)
        usual = source_of_guess(default_guess(SIZE_PX), "usual", SIZE_PX)
        by_shape = source_of_curve("shapes", "", shapes.curve, SIZE_PX)
        guess = CameraEstimate(size_px=SIZE_PX, sources=(usual, by_shape)).guess
        fits = [
            fit_camera(
                SIZE_PX,
                camera_priors(guess.focal_px, focal_sigma=guess.sigma),
                SIZES,
                CameraMeasurements(
                    objects=known[:n], scene=scene, scene_noise=shapes.relative_noise
                ),
            )
            for n in (1, 3)
        ]
        errors.append(
            [
                abs(math.log(f / focal_px))
                for f in (guess.focal_px, *(fit.camera.fx_px for fit in fits))
            ]
        )
        sigmas.append([guess.sigma, *(fit.focal_sigma for fit in fits)])
    none, one, three = np.median(errors, axis=0)
    assert 0.02 < none < 0.2
    assert 0.005 < one < 0.07
    assert 0.002 < three < 0.05
    assert (np.array(errors) < 3 * np.array(sigmas)).all()
