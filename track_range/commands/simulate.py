"""`track-range simulate`: a drive for two eyes with exact truth, or labelled images to train a detector with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from rich.console import Console

from track_range.foundation.errors import UsageError
from track_range.run.progress import say, step_progress
from track_range.simulation.camera.drive_files import with_even_size
from track_range.simulation.camera.faults import Faults, WrongRig
from track_range.simulation.drive import Drive, DriveOptions, write_drive
from track_range.simulation.images import write_image_set
from track_range.simulation.render.renderer import NOISE_GREY
from track_range.simulation.world.scenarios import SCENARIOS
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.rig_formats.reading import load_calibration

DEFAULT_SCENARIO, DEFAULT_SECONDS, DEFAULT_FPS, FIRST_IMAGE_SCENE = "city", 10.0, 10.0, 1000
LONGEST_S = 600.0
KITTI_SIZE_PX = (1242, 375)


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulateOptions:
    """What the command line asks for; None = not said.

    Attributes:
        out: folder of the results.
        scenario, seconds, fps, rig: of a drive.
        seed: of the drive, or of the first scene of images.
        is_lossless, has_disparity: what is written.
        n_images: how many labelled images, in place of a drive.
        n_frames: how many of them show one scene.
        noise_grey: the sensor's.
        faults: fields of `Faults` by name.
    """

    out: Path
    scenario: str | None = None
    seconds: float | None = None
    fps: float | None = None
    seed: int | None = None
    rig: Path | None = None
    is_lossless: bool = False
    has_disparity: bool = False
    n_images: int | None = None
    n_frames: int = 6
    noise_grey: float | None = None
    faults: Mapping[str, Any] = field(default_factory=dict)

    @property
    def is_drive_described(self) -> bool:
        """Whether something is said that only a drive has."""
        said = (self.scenario, self.seconds, self.fps, self.rig, self.noise_grey)
        return any(one is not None for one in said) or self.is_lossless or self.has_disparity or bool(self.faults)


def simulate(options: SimulateOptions, console: Console) -> None:
    """Write a drive, or images, into `options.out`.

    Raises:
        UsageError: options that make no sense.
        RigError: the rig cannot be used.
        OutputError, VideoError: the folder cannot be written.
    """
    if options.n_images is None:
        _drive(options, console)
    elif options.is_drive_described:
        raise UsageError("--images are of towns, without faults: leave the options of a drive away.")
    else:
        _images(options, options.n_images, console)


def _images(options: SimulateOptions, n_images: int, console: Console) -> None:
    n_frames = min(options.n_frames, n_images)
    seed = FIRST_IMAGE_SCENE if options.seed is None else options.seed
    n_scenes = -(-n_images // n_frames)
    with step_progress(console, "rendering") as progress:
        path = write_image_set(options.out, range(seed, seed + n_scenes), n_frames=n_frames, progress=progress)
    say(console, f"Written: {n_scenes * n_frames} images, and {path}")


def _drive(options: SimulateOptions, console: Console) -> None:
    scenario = options.scenario or DEFAULT_SCENARIO
    if scenario not in SCENARIOS:
        raise UsageError(f"--scenario {scenario}: no such scenario; there are {', '.join(SCENARIOS)}.")
    seconds = DEFAULT_SECONDS if options.seconds is None else options.seconds
    fps = options.fps or DEFAULT_FPS
    if not 1 / fps <= seconds <= LONGEST_S:
        raise UsageError(
            f"--seconds {seconds:g}: at least one frame, {1 / fps:g} s, and at most {LONGEST_S:g} s wanted."
        )
    drive_options = DriveOptions(
        scenario=scenario,
        noise_grey=NOISE_GREY if options.noise_grey is None else options.noise_grey,
        faults=_faults(options.faults),
        is_lossless=options.is_lossless,
        has_disparity=options.has_disparity,
    )
    rig = None if options.rig is None else _rig(options.rig, console)
    with step_progress(console, "rendering") as progress:
        drive = write_drive(
            options.out,
            seed=options.seed or 0,
            seconds=seconds,
            fps=fps,
            rig=rig,
            options=drive_options,
            progress=progress,
        )
    _tell(drive, options.out, fps, console)


def _faults(named: Mapping[str, Any]) -> Faults:
    wrong = named.get("wrong_rig")
    if wrong is not None and wrong not in get_args(WrongRig):
        raise UsageError(f"--wrong-rig {wrong}: one of {', '.join(get_args(WrongRig))} wanted.")
    return Faults(**named)


def _rig(path: Path, console: Console) -> StereoRig:
    """The rig that a drive is drawn for, its images of an even size."""
    found, _ = load_calibration(path)
    if not isinstance(found, StereoRig):
        raise RigError(f"{path}: holds one camera only; a drive is for two eyes.")
    if found.left.width_px == 0:
        say(console, f"Note: {path} gives no image size; KITTI's {KITTI_SIZE_PX[0]} x {KITTI_SIZE_PX[1]} is taken.")
        found = _resized(found, KITTI_SIZE_PX)
    if not _is_as_good_as_rectified(found):
        raise RigError(
            f"{path}: its cameras are not rectified, and the simulation draws rectified pairs only: give the rig of "
            "rectified images (KITTI's calib.txt, or equal cameras without distortion, side by side)."
        )
    rig = StereoRig.rectified(found.left.without_distortion(), found.baseline_m)
    even = with_even_size(rig)
    if even.left != rig.left:
        size, drawn = (f"{camera.width_px} x {camera.height_px}" for camera in (rig.left, even.left))
        say(console, f"Note: {drawn} is drawn, as videos want even sizes and {path.name} has {size}.")
    return even


def _resized(rig: StereoRig, size_px: tuple[int, int]) -> StereoRig:
    width_px, height_px = size_px
    left, right = (replace(camera, width_px=width_px, height_px=height_px) for camera in (rig.left, rig.right))
    return StereoRig(left, right, rig.right_from_left)


def _is_as_good_as_rectified(rig: StereoRig) -> bool:
    """Whether a rectified pair differs from it by less than a tenth of a pixel, and a centimetre across (KITTI's)."""
    if rig.left.is_distorted or rig.right.is_distorted or rig.baseline_m <= 0:
        return False
    same_cameras = np.allclose(rig.left.matrix, rig.right.matrix, atol=0.1)
    is_parallel = np.allclose(rig.right_from_left[:3, :3], np.eye(3), atol=1e-5)
    return bool(same_cameras and is_parallel and np.abs(rig.right_from_left[1:3, 3]).max() < 0.01)


def _tell(drive: Drive, out: Path, fps: float, console: Console) -> None:
    rate = f" --folder-fps {fps:g}" if drive.left.suffix != ".mp4" and fps != DEFAULT_FPS else ""
    say(console, f"Written: {out}. To run on it:")
    say(
        console,
        f"  track-range --stereo {drive.left} {drive.right} --rig {drive.rig} --truth {drive.table}{rate}",
    )
