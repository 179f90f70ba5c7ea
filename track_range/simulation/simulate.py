"""Simulation of a stereo drive with exact ground truth, or of labelled images for training a detector."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from track_range.foundation.errors import UsageError
from track_range.foundation.files.output_files import locked_output
from track_range.foundation.progress import StepProgress, no_progress
from track_range.simulation.camera.drive_files import with_even_size
from track_range.simulation.camera.faults import Faults, WrongRig
from track_range.simulation.drive import Drive, DriveOptions, write_drive
from track_range.simulation.images import write_image_set
from track_range.simulation.render.renderer import NOISE_GREY
from track_range.simulation.settings import SimulationSettings
from track_range.simulation.world.scenarios import SCENARIOS
from track_range.simulation.world.scene import make_scene
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.rig_formats.reading import load_calibration

DEFAULT_SCENARIO, DEFAULT_SECONDS, DEFAULT_FPS, FIRST_IMAGE_SCENE = "city", 10.0, 10.0, 1000
LONGEST_S = 600.0
KITTI_SIZE_PX = (1242, 375)


@dataclass(frozen=True, slots=True)
class Simulated:
    """Result of `simulate`.

    Attributes:
        drive: files of the drive; None for a set of images.
        data_yaml: data.yaml of a set of images; None for a drive.
        n_images: number of images of a set; 0 for a drive.
        notes: messages for the user.
    """

    drive: Drive | None = None
    data_yaml: Path | None = None
    n_images: int = 0
    notes: tuple[str, ...] = ()


def simulate(settings: SimulationSettings, progress: StepProgress = no_progress) -> Simulated:
    """Write a drive with exact ground truth, or labelled images, to `settings.out`.

    Raises:
        UsageError: settings that contradict each other or are out of range.
        RigError: the rig cannot be used.
        OutputError, VideoError: the folder cannot be written.
        FolderLockError: another run is writing to the folder.
    """
    if settings.scenario is not None and settings.scenario not in SCENARIOS:
        raise UsageError(f"--scenario {settings.scenario}: expected one of {', '.join(SCENARIOS)}.")
    if settings.images is None:
        return _drive(settings, progress)
    if settings.has_drive_options:
        raise UsageError("--images: options of a drive do not apply to training images; remove them.")
    return _images(settings, settings.images, progress)


def _images(settings: SimulationSettings, n_images: int, progress: StepProgress) -> Simulated:
    n_frames = min(settings.frames, n_images)
    seed = FIRST_IMAGE_SCENE if settings.seed is None else settings.seed
    n_scenes = -(-n_images // n_frames)
    seeds = range(seed, seed + n_scenes)
    make = make_scene if settings.scenario is None else SCENARIOS[settings.scenario]
    with locked_output(settings.out), progress("rendering") as advance:
        path = write_image_set(settings.out, seeds, n_frames=n_frames, make=make, progress=advance)
    return Simulated(data_yaml=path, n_images=n_scenes * n_frames)


def _drive(settings: SimulationSettings, progress: StepProgress) -> Simulated:
    scenario = settings.scenario or DEFAULT_SCENARIO
    seconds = DEFAULT_SECONDS if settings.seconds is None else settings.seconds
    fps = settings.fps or DEFAULT_FPS
    if not 1 / fps <= seconds <= LONGEST_S:
        raise UsageError(f"--seconds {seconds:g}: expected {1 / fps:g} s (one frame) to {LONGEST_S:g} s.")
    options = DriveOptions(
        scenario=scenario,
        noise_grey=NOISE_GREY if settings.noise_grey is None else settings.noise_grey,
        faults=_faults(settings.faults),
        is_lossless=settings.lossless,
        has_disparity=settings.disparity,
        has_masks=settings.masks,
        car_size=settings.car_size or 1.0,
        camera_pitch_deg=settings.camera_pitch_deg or 0.0,
    )
    rig, notes = (None, ()) if settings.rig is None else _rig(settings.rig)
    if rig is not None and rig.left.is_wide and (settings.disparity or settings.masks):
        raise UsageError("--disparity, --masks: expected a rig of pinholes, found a wide lens; omit these options.")
    with locked_output(settings.out), progress("rendering") as advance:
        drive = write_drive(
            settings.out,
            seed=settings.seed or 0,
            seconds=seconds,
            fps=fps,
            rig=rig,
            options=options,
            progress=advance,
        )
    return Simulated(drive=drive, notes=notes)


def _faults(values: Mapping[str, Any]) -> Faults:
    wrong_rig = values.get("wrong_rig")
    if wrong_rig is not None and wrong_rig not in get_args(WrongRig):
        raise UsageError(f"--wrong-rig {wrong_rig}: expected one of {', '.join(get_args(WrongRig))}.")
    return Faults(**values)


def _rig(path: Path) -> tuple[StereoRig, tuple[str, ...]]:
    """The rectified rig of a file, with an even image size, and notes for the user."""
    notes = []
    calibration, _ = load_calibration(path)
    if not isinstance(calibration, StereoRig):
        raise RigError(f"{path}: expected two cameras, got one.")
    if calibration.left.width_px == 0:
        width_px, height_px = KITTI_SIZE_PX
        notes.append(f"Note: {path} contains no image size; KITTI's {width_px} x {height_px} px is used.")
        calibration = _resized(calibration, KITTI_SIZE_PX)
    if calibration.left.is_wide:
        return _wide_rig(calibration, path), tuple(notes)
    if not _is_nearly_rectified(calibration):
        raise RigError(
            f"{path}: expected a rectified pair (KITTI's calib.txt, or equal, parallel cameras without distortion); "
            "give the rig of the rectified images."
        )
    rig = StereoRig.rectified(calibration.left.without_distortion(), calibration.baseline_m)
    even = with_even_size(rig)
    if even.left != rig.left:
        old, new = (f"{camera.width_px} x {camera.height_px}" for camera in (rig.left, even.left))
        notes.append(f"Note: images of {new} px are rendered; videos need even sizes, and {path.name} has {old} px.")
    return even, tuple(notes)


def _wide_rig(rig: StereoRig, path: Path) -> StereoRig:
    """The pair with wide lenses, with an even image size.

    Raises:
        RigError: the cameras are not equal and parallel.
    """
    parallel = StereoRig.rectified(rig.left, rig.baseline_m)
    is_parallel = np.allclose(rig.right_from_left, parallel.right_from_left, atol=1e-5)
    if rig.left != rig.right or not is_parallel:
        raise RigError(
            f"{path}: expected equal, parallel cameras side by side for the simulation of wide lenses, found others; "
            "copy 'left' to 'right' and use the identity as rotation."
        )
    return with_even_size(parallel)


def _resized(rig: StereoRig, size_px: tuple[int, int]) -> StereoRig:
    width_px, height_px = size_px
    left, right = (replace(camera, width_px=width_px, height_px=height_px) for camera in (rig.left, rig.right))
    return StereoRig(left, right, rig.right_from_left)


def _is_nearly_rectified(rig: StereoRig) -> bool:
    """Whether a rig differs from a rectified one by less than 0.1 px and 1 cm, as KITTI's rigs do."""
    if rig.left.is_distorted or rig.right.is_distorted or rig.baseline_m <= 0:
        return False
    same_cameras = np.allclose(rig.left.matrix, rig.right.matrix, atol=0.1)
    is_parallel = np.allclose(rig.right_from_left[:3, :3], np.eye(3), atol=1e-5)
    return bool(same_cameras and is_parallel and np.abs(rig.right_from_left[1:3, 3]).max() < 0.01)
