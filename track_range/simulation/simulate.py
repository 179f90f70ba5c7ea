"""Simulation of a stereo drive with exact ground truth, or of labelled images for training a detector."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from track_range.foundation.errors import UsageError
from track_range.foundation.files.output_files import locked_output
from track_range.foundation.progress import StepProgress, no_progress
from track_range.simulation.camera.drive_files import with_even_size
from track_range.simulation.drive import Drive, write_drive
from track_range.simulation.images import write_image_set
from track_range.simulation.settings import SimulationSettings
from track_range.simulation.world.scenarios import SCENARIOS
from track_range.simulation.world.scene import make_scene
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.rig_formats.reading import load_calibration

DEFAULT_SECONDS, DEFAULT_FPS, FIRST_IMAGE_SCENE = 10.0, 10.0, 1000
LONGEST_S = 600.0
KITTI_SIZE_PX = (1242, 375)


@dataclass(frozen=True, slots=True)
class Simulated:
    """Result of `simulate`."""

    drive: Drive | None = None  # files of the drive; None for a set of images
    data_yaml: Path | None = None  # data.yaml of a set of images; None for a drive
    n_images: int = 0  # number of images of a set; 0 for a drive
    notes: tuple[str, ...] = ()  # messages for the user


def simulate(settings: SimulationSettings, progress: StepProgress = no_progress) -> Simulated:
    """Write a drive with exact ground truth, or labelled images, to `settings.out`.

    Raises:
        UsageError: settings that contradict each other or are out of range.
        RigError: the rig cannot be used.
        OutputError, VideoError: the folder cannot be written.
        FolderLockError: another run is writing to the folder.
    """
    if settings.images is None:
        return _drive(settings, progress)
    if settings.has_drive_options:
        raise UsageError("--images: options of a drive do not apply to training images; remove them.")
    n_frames = min(settings.frames, settings.images)
    n_scenes = -(-settings.images // n_frames)
    seed = FIRST_IMAGE_SCENE if settings.seed is None else settings.seed
    make = make_scene if settings.scenario is None else SCENARIOS[settings.scenario]
    with locked_output(settings.out), progress("rendering") as advance:
        seeds = range(seed, seed + n_scenes)
        path = write_image_set(settings.out, seeds, n_frames=n_frames, make=make, progress=advance)
    return Simulated(data_yaml=path, n_images=n_scenes * n_frames)


def _drive(settings: SimulationSettings, progress: StepProgress) -> Simulated:
    seconds = DEFAULT_SECONDS if settings.seconds is None else settings.seconds
    fps = settings.fps or DEFAULT_FPS
    if not 1 / fps <= seconds <= LONGEST_S:
        raise UsageError(f"--seconds {seconds:g}: expected {1 / fps:g} s (one frame) to {LONGEST_S:g} s.")
    rig, notes = (None, ()) if settings.rig is None else _rig(settings.rig)
    if rig is not None and rig.left.is_wide and (settings.disparity or settings.masks):
        raise UsageError("--disparity, --masks: expected a rig of pinholes, found a wide lens; omit these options.")
    with locked_output(settings.out), progress("rendering") as advance:
        drive = write_drive(
            settings.out,
            scenario=settings.scenario or "city",
            seed=settings.seed or 0,
            seconds=seconds,
            fps=fps,
            rig=rig,
            options=settings,
            progress=advance,
        )
    return Simulated(drive=drive, notes=notes)


def _rig(path: Path) -> tuple[StereoRig, tuple[str, ...]]:
    """The rectified or wide rig of a file, with an even image size, and notes for the user."""
    notes = []
    rig, _ = load_calibration(path)
    if not isinstance(rig, StereoRig):
        raise RigError(f"{path}: expected two cameras, got one.")
    if rig.left.width_px == 0:
        width_px, height_px = KITTI_SIZE_PX
        notes.append(f"Note: {path} contains no image size; KITTI's {width_px} x {height_px} px is used.")
        left, right = (replace(camera, width_px=width_px, height_px=height_px) for camera in (rig.left, rig.right))
        rig = StereoRig(left, right, rig.right_from_left)
    if rig.left.is_wide:
        parallel = StereoRig.rectified(rig.left, rig.baseline_m)
        if rig.left != rig.right or not np.allclose(rig.right_from_left, parallel.right_from_left, atol=1e-5):
            raise RigError(
                f"{path}: expected equal, parallel cameras side by side for the simulation of wide lenses, found "
                "others; copy 'left' to 'right' and use the identity as rotation."
            )
        return with_even_size(parallel), tuple(notes)
    if not _is_nearly_rectified(rig):
        raise RigError(
            f"{path}: expected a rectified pair (KITTI's calib.txt, or equal, parallel cameras without distortion); "
            "give the rig of the rectified images."
        )
    rig = StereoRig.rectified(rig.left.without_distortion(), rig.baseline_m)
    even = with_even_size(rig)
    if even.left != rig.left:
        old, new = (f"{camera.width_px} x {camera.height_px}" for camera in (rig.left, even.left))
        notes.append(f"Note: images of {new} px are rendered; videos need even sizes, and {path.name} has {old} px.")
    return even, tuple(notes)


def _is_nearly_rectified(rig: StereoRig) -> bool:
    """Whether a rig differs from a rectified one by less than 0.1 px and 1 cm, as KITTI's rigs do."""
    if rig.left.is_distorted or rig.right.is_distorted or rig.baseline_m <= 0:
        return False
    same_cameras = np.allclose(rig.left.matrix, rig.right.matrix, atol=0.1)
    is_parallel = np.allclose(rig.right_from_left[:3, :3], np.eye(3), atol=1e-5)
    return bool(same_cameras and is_parallel and np.abs(rig.right_from_left[1:3, 3]).max() < 0.01)
