"""Speed of one camera in whole runs: drives with drawn cameras and sizes of cars, and recordings.

The pipeline gets the images and the calibration of the camera, and its height or not. Errors are
correlated within a drive, so that the coverage of sigma is that of all drives together.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import track_range as tr
from benchmarks.accuracy.cameras.odometry import speed_faults
from benchmarks.harness import Figures, median_or_none, option, workload
from benchmarks.inputs.camera_drives import FPS, CameraDrive
from benchmarks.inputs.drives import CACHE_OPTION, REAL_DATA, StoredDetector, decoded
from track_range.detection.formats.detection_files import RecordedDetections, read_detections
from track_range.foundation.arrays import FloatArray
from track_range.recording.telemetry.speed_files import open_ego_speed
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.odometry.ego_motion import EgoMotion
from track_range.stereo.rig_formats.reading import load_camera

# nothing was chosen on these seeds
DRIVES = (
    *("town 720", "town 722", "highway 721", "highway 723"),
    *("winding 720", "winding 721", "winding 722", "winding 723"),
)
SLOW_MPS = 2.0  # below which errors are in m/s
HEIGHT_M = 1.65  # of the cameras of simulated drives and of KITTI above the road
PANDASET_HEIGHT_M = 2.18  # over the plane through the bottoms of the cuboids within 40 m


@dataclass(frozen=True, slots=True)
class SpeedDrive:
    """F images of one camera with true speeds (F,); without recorded boxes, the packaged detector
    finds them.
    """

    name: str
    video: Path
    camera: PinholeCamera
    height_m: float
    true_mps: FloatArray
    recorded: RecordedDetections | None = None


@workload(
    option("--drives", default=DRIVES, metavar="NAME", help="rendered drives, as 'town 720'"),
    CACHE_OPTION,
    option("--data", default=REAL_DATA, help="folder with kitti_odometry and pandaset"),
)
def mono_speed(options: Namespace) -> Figures:
    """Speed of one camera with and without its height."""
    figures: Figures = {}
    true_mps: dict[str, list[FloatArray]] = {}
    motions: dict[str, list[EgoMotion]] = {}
    for drive in (*_simulated(options), *_real(options.data)):
        for known, height_m in {"height unknown": None, "height given": drive.height_m}.items():
            measured = _motions(drive, height_m)
            known_mps = drive.true_mps[1 : len(measured) + 1]
            true_mps.setdefault(known, []).append(known_mps)
            motions.setdefault(known, []).extend(measured)
            figures[f"{drive.name}, {known}"] = _figures(known_mps, measured)
    for known, of_drives in motions.items():
        figures[f"all, {known}"] = _figures(np.concatenate(true_mps[known]), of_drives)
    return figures


def _simulated(options: Namespace) -> Iterator[SpeedDrive]:
    for name in options.drives:
        scenario, seed = name.split()
        drawn = CameraDrive.drawn(scenario, int(seed))
        files = drawn.files(options.cache)
        speed = open_ego_speed(str(files.ego_speed))
        yield SpeedDrive(
            drawn.name,
            files.left,
            drawn.rig.left,
            HEIGHT_M,
            speed.speed_mps,
            read_detections(files.detections),
        )


def _real(data: Path) -> Iterator[SpeedDrive]:
    folder = data / "kitti_odometry" / "gray51"
    if folder.is_dir():
        poses = np.loadtxt(folder / "poses.txt").reshape(-1, 3, 4)
        forward_mps = (np.diff(poses[:, :, 3], axis=0) * poses[:-1, :, 2]).sum(axis=1) * FPS
        true_mps = np.interp(np.arange(len(poses)) - 0.5, np.arange(len(poses) - 1), forward_mps)
        video = folder / "left.mp4"
        camera = _camera(folder / "calib.txt", video, is_grey=True)
        yield SpeedDrive("KITTI grey", video, camera, HEIGHT_M, true_mps)
    folder = data / "pandaset"
    if folder.is_dir():
        true_mps = open_ego_speed(str(folder / "ego" / "front.csv")).speed_mps
        video = folder / "front.mp4"
        camera = _camera(folder / "calib" / "front.txt", video)
        yield SpeedDrive("PandaSet front", video, camera, PANDASET_HEIGHT_M, true_mps)


def _camera(calibration: Path, video: Path, *, is_grey: bool = False) -> PinholeCamera:
    height_px, width_px = decoded(video, 1)[0].shape[:2]
    return load_camera(calibration, size_px=(width_px, height_px), is_grey=is_grey)[0]


def _motions(drive: SpeedDrive, height_m: float | None) -> list[EgoMotion]:
    """The motion of the camera in each image after the first one, at 10 Hz, by a pipeline that gets
    no speed.
    """
    images = decoded(drive.video)
    detector: str | StoredDetector = "road"
    if drive.recorded is not None:
        detector = StoredDetector([drive.recorded.at(frame) for frame in range(len(images))])
    with tr.Pipeline.mono(
        rig=drive.camera, camera_height_m=height_m, detector=detector
    ) as pipeline:
        results = [pipeline.step(image, frame / FPS) for frame, image in enumerate(images)]
    return [result.ego for result in results[1:]]


def _figures(true_mps: FloatArray, motions: Sequence[EgoMotion]) -> Figures:
    """Errors of the speed in F frames."""
    speed_mps = np.array([motion.speed_mps for motion in motions])
    sigma_mps = np.array([motion.speed_sigma_mps for motion in motions])
    is_known, is_slow = np.isfinite(speed_mps), true_mps < SLOW_MPS
    error_mps = speed_mps - true_mps
    relative = (error_mps / np.maximum(true_mps, SLOW_MPS))[is_known & ~is_slow]
    in_sigmas = np.abs(error_mps / sigma_mps)[is_known]
    return {
        "n": len(true_mps),
        "known": float(is_known.mean()),
        **speed_faults(true_mps, speed_mps, sigma_mps),
        "median_pct": median_or_none(np.abs(relative), 100),
        "bias_pct": median_or_none(relative, 100),
        "slow_median_mps": median_or_none(np.abs(error_mps)[is_known & is_slow]),
        "within_1_sigma": float((in_sigmas <= 1).mean()),
        "within_2_sigma": float((in_sigmas <= 2).mean()),
    }
