"""Odometry: errors of the camera's speed and yaw rate measured from the images."""

from __future__ import annotations

import time
from argparse import Namespace
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from pathlib import Path

import cv2
import numpy as np

from benchmarks.harness import (
    Figures,
    median_ms,
    median_or_none,
    option,
    quantile_or_none,
    workload,
)
from benchmarks.inputs.drives import FPS, REAL_DATA, SimulatedDrive, decoded
from benchmarks.inputs.edited_images import EDITS, edited
from track_range.foundation.arrays import FloatArray, Image
from track_range.foundation.processes import one_opencv_thread
from track_range.foundation.sparse_flow import BackgroundFlow
from track_range.recording.telemetry.speed_files import open_ego_speed
from track_range.simulation.settings import SCENARIO_NAMES
from track_range.simulation.world.truth import label_scene
from track_range.stereo.alignment.file import load_alignment
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.odometry.ego_motion import EgoMotion, Odometry
from track_range.stereo.odometry.ground_odometry import GroundOdometry
from track_range.stereo.odometry.image_motion import ImageMotionEstimator
from track_range.stereo.odometry.stereo_odometry import StereoOdometry
from track_range.stereo.rig_formats.reading import load_rig
from track_range.tracking.camera_motion import CameraMotion

MIN_SPEED_MPS = 3.0  # smallest true speed of a relative error
# true speeds of a camera that moves and of one at rest, and the reported one that says the other
MOVING_MPS, REST_MPS, WRONG_MPS = 2.0, 0.05, 0.5
GRAVITY_MPS2 = 9.81  # no car changes its speed faster
_OXTS_YAW_RATE = 22  # column of the angular rate about the upward axis in oxts
_N_INTERPOLATED = 13  # frames of KITTI odometry without a measured yaw rate
KITTI_HEIGHT_M = 1.65  # of the cameras above the road (Geiger et al., 2013)


@dataclass(frozen=True, slots=True)
class OdometryDrive:
    """F frames of a rectified pair with (N, 4) boxes of road users, true speeds (F,) and yaw rates
    (F,).

    A yaw rate is the mean since the previous frame; NaN = unknown. `height_m`: of the left camera
    above the road.
    """

    name: str
    rig: StereoRig
    height_m: float
    frames: Sequence[Frame]
    boxes: Sequence[FloatArray]
    true_mps: FloatArray
    true_yaw_rad_s: FloatArray
    alignment: Alignment | None = None


class _ImageOdometry:
    """The yaw rate of `ImageMotionEstimator`, without a speed."""

    source = "the images"

    def __init__(self, camera: PinholeCamera, flow: BackgroundFlow) -> None:
        self._estimator = ImageMotionEstimator(camera, flow=flow)

    def update(self, frame: Frame, xyxy_px: FloatArray) -> EgoMotion:
        return EgoMotion(
            yaw_rad_s=self._estimator.update(frame.left, frame.time_s, xyxy_px).yaw_rad_s
        )


@workload(
    option(
        "--scenarios",
        default=("town", "city", "highway", "night"),
        choices=SCENARIO_NAMES,
        help="simulated drives",
    ),
    option("--seeds", default=(100, 101), help="seeds of the simulated drives"),
    option("--seconds", default=4.0, help="length of the simulated drives"),
    option("--edits", default=("none",), choices=EDITS, help="changes of the images"),
    option("--align", type=Path, help="alignment file of KITTI 0003, from `track-range align`"),
    option("--data", default=REAL_DATA, help="folder with kitti_stereo and kitti_odometry"),
)
def odometry(options: Namespace) -> Figures:
    figures: Figures = {}
    with one_opencv_thread():
        for scenario, seed in product(options.scenarios, options.seeds):
            figures |= _edited_figures(_simulated(scenario, seed, options.seconds), options.edits)
        for drive in _real(options.data, options.align):
            figures |= _edited_figures(drive, options.edits)
    return figures


def _edited_figures(drive: OdometryDrive, edits: Sequence[str]) -> Figures:
    figures: Figures = {}
    for edit in edits:
        name = drive.name if edit == "none" else f"{drive.name} {edit}"
        figures |= _figures(replace(drive, name=name, frames=edited(drive.frames, edit)))
    return figures


def _simulated(scenario: str, seed: int, seconds: float) -> OdometryDrive:
    drive = SimulatedDrive.of(scenario, seed=seed, seconds=seconds)
    scene, rig, times_s = drive.renderer.scene, drive.renderer.rig, drive.times_s.tolist()
    boxes = [label_scene(scene, [time_s], camera=rig.left).xyxy_px for time_s in times_s]
    true_mps = np.array([scene.speed_mps(time_s) for time_s in times_s])
    yaw_rad_s = _yaw_rad_s([scene.pose(time_s).camera_from_world for time_s in times_s], 1 / FPS)
    return OdometryDrive(
        f"{scenario} {seed}", rig, scene.camera_height_m, drive.frames(), boxes, true_mps, yaw_rad_s
    )


def _yaw_rad_s(camera_from_world: Sequence[FloatArray], dt_s: float) -> FloatArray:
    """(F,) mean yaw rates since the previous frame, positive = to the right, from rotations (3,
    3).
    """
    steps = [now @ before.T for before, now in pairwise(camera_from_world)]
    return np.array([np.nan, *(-float(cv2.Rodrigues(step)[0][1, 0]) / dt_s for step in steps)])


def _real(data: Path, align: Path | None = None) -> list[OdometryDrive]:
    drives = []
    folder = data / "kitti_stereo" / "0003"
    if folder.is_dir():
        ego = open_ego_speed(str(folder / "oxts"))
        frames = _frames(folder, ego.time_s)
        true_mps = ego.speed_mps[: len(frames)]
        packets = [np.loadtxt(path) for path in sorted((folder / "oxts").glob("0*.txt"))]
        yaw_rad_s = np.array([-packet[_OXTS_YAW_RATE] for packet in packets])[: len(frames)]
        alignment = None if align is None else load_alignment(align)
        rig = _rig(folder, frames[0].left)
        drives.append(
            OdometryDrive(
                "KITTI 0003", rig, KITTI_HEIGHT_M, frames, [], true_mps, yaw_rad_s, alignment
            )
        )
    folder = data / "kitti_odometry" / "gray51"
    if folder.is_dir():
        poses = np.loadtxt(folder / "poses.txt").reshape(-1, 3, 4)
        forward_mps = (np.diff(poses[:, :, 3], axis=0) * poses[:-1, :, 2]).sum(axis=1) * 10.0
        true_mps = np.concatenate(
            [[0.0], (forward_mps[1:] + forward_mps[:-1]) / 2, forward_mps[-1:]]
        )
        frames = _frames(folder, np.arange(len(poses)) / 10.0)
        rig = _rig(folder, frames[0].left, is_grey=True)
        yaw_rad_s = _yaw_rad_s(list(poses[:, :, :3].transpose(0, 2, 1)), 0.1)
        yaw_rad_s[:_N_INTERPOLATED] = np.nan
        drives.append(
            OdometryDrive("KITTI grey", rig, KITTI_HEIGHT_M, frames, [], true_mps, yaw_rad_s)
        )
    return drives


def _rig(folder: Path, image: Image, *, is_grey: bool = False) -> StereoRig:
    rig, _ = load_rig(
        folder / "calib.txt", size_px=(image.shape[1], image.shape[0]), is_grey=is_grey
    )
    return rig


def _frames(folder: Path, times_s: FloatArray) -> list[Frame]:
    pairs = zip(
        times_s.tolist(), decoded(folder / "left.mp4"), decoded(folder / "right.mp4"), strict=False
    )
    return [Frame(index, time_s, left, right) for index, (time_s, left, right) in enumerate(pairs)]


def _figures(drive: OdometryDrive) -> Figures:
    camera = drive.rig.left
    methods: dict[str, Callable[[BackgroundFlow], Odometry]] = {
        "stereo": lambda flow: StereoOdometry(drive.rig, drive.alignment, flow=flow),
        "ground": lambda flow: GroundOdometry(camera, drive.height_m, flow=flow),
        "image": lambda flow: _ImageOdometry(camera, flow),
    }
    return {
        f"{drive.name}, {name}": _method_figures(drive, create) for name, create in methods.items()
    }


def _method_figures(drive: OdometryDrive, create: Callable[[BackgroundFlow], Odometry]) -> Figures:
    motions, times_s = [], []
    flow = BackgroundFlow()
    tracker_motion, odometry = CameraMotion(flow=flow), create(flow)
    for frame in drive.frames:
        xyxy_px = drive.boxes[frame.index] if drive.boxes else np.zeros((0, 4))
        tracker_motion.update(frame.left, xyxy_px, frame.time_s)
        start_s = time.process_time()
        motions.append(odometry.update(frame, xyxy_px))
        times_s.append(time.process_time() - start_s)
    speed_mps, sigma_mps, yaw_rad_s = (
        np.array([getattr(motion, name) for motion in motions[1:]])
        for name in ("speed_mps", "speed_sigma_mps", "yaw_rad_s")
    )
    true_mps = drive.true_mps[1:]
    yaw_error = np.abs(yaw_rad_s - drive.true_yaw_rad_s[1:])
    yaw_error = yaw_error[np.isfinite(yaw_error)]
    is_known, is_driving = np.isfinite(speed_mps), true_mps > MIN_SPEED_MPS
    is_predicted = np.array([motion.is_predicted for motion in motions[1:]])[is_known]
    use = is_known & is_driving
    error = (speed_mps / np.where(is_driving, true_mps, np.nan) - 1.0)[use]
    in_sigmas = ((speed_mps - true_mps) / sigma_mps)[is_known]
    return {
        "median_pct": median_or_none(np.abs(error), 100),
        "p95_pct": quantile_or_none(np.abs(error), 0.95, 100),
        "bias_pct": median_or_none(error, 100),
        "coverage": float(use.sum() / max(is_driving.sum(), 1)),
        "within_1_sigma": float((np.abs(in_sigmas) <= 1).mean()) if use.any() else None,
        "within_2_sigma": float((np.abs(in_sigmas) <= 2).mean()) if use.any() else None,
        "rms_sigmas": float(np.sqrt((in_sigmas**2).mean())) if use.any() else None,
        **speed_faults(true_mps, speed_mps, sigma_mps),
        "n_jumps": _n_jumps(drive, speed_mps),
        "predicted": float(is_predicted.mean()) if len(is_predicted) else None,
        "yaw_median_mrad_s": median_or_none(yaw_error, 1e3),
        "yaw_p95_mrad_s": quantile_or_none(yaw_error, 0.95, 1e3),
        "ms": median_ms(times_s),
    }


def _n_jumps(drive: OdometryDrive, speed_mps: FloatArray) -> int:
    """Speeds (F - 1,) of frames that change by more than 1 g since the previous frame, beyond the
    true change.
    """
    dt_s = np.diff([frame.time_s for frame in drive.frames])[1:]
    change_mps = np.abs(np.diff(speed_mps) - np.diff(drive.true_mps[1:]))
    return int((change_mps > GRAVITY_MPS2 * dt_s).sum())


def speed_faults(
    true_mps: FloatArray, speed_mps: FloatArray, sigma_mps: FloatArray
) -> dict[str, float | None]:
    """Frames (F,) of a camera that moves with a speed of zero, those of one at rest with a speed,
    and the fractions of both in which the speed is unknown.

    Zero is a speed below `WRONG_MPS`, a speed is one above it and above two sigma.
    """
    is_moving, is_at_rest = true_mps > MOVING_MPS, true_mps < REST_MPS
    is_unknown = np.isnan(speed_mps)
    is_zero = speed_mps < WRONG_MPS
    is_motion = (speed_mps > WRONG_MPS) & (speed_mps > 2 * sigma_mps)
    return {
        "n_zero_while_moving": int((is_moving & is_zero).sum()),
        "n_moving_at_rest": int((is_at_rest & is_motion).sum()),
        "unknown_moving": float(is_unknown[is_moving].mean()) if is_moving.any() else None,
        "unknown_at_rest": float(is_unknown[is_at_rest].mean()) if is_at_rest.any() else None,
    }
