"""Simulation of a stereo drive with exact ground truth, or of labelled images for training a
detector.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from track_range.detection.classes import ROAD_CLASSES, road_class_of
from track_range.detection.formats.video_labels.kitti import KittiLabels
from track_range.foundation.arrays import Image
from track_range.foundation.errors import UsageError
from track_range.foundation.files.output_files import (
    OutputError,
    locked_output,
    make_folder,
    write_bytes,
    write_text,
)
from track_range.foundation.files.structured_text import yaml_text
from track_range.foundation.progress import StepProgress, no_progress
from track_range.simulation.camera.drive_files import with_even_size
from track_range.simulation.drive import Drive, write_drive
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.settings import SimulationSettings
from track_range.simulation.world.scenarios import SCENARIOS
from track_range.simulation.world.scene import Scene, make_scene
from track_range.simulation.world.truth import label_scene
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.rig_formats.reading import load_calibration

DEFAULT_SECONDS, DEFAULT_FPS, FIRST_IMAGE_SCENE = 10.0, 10.0, 1000
LONGEST_S = 600.0
KITTI_SIZE_PX = (1242, 375)

WIDTH_PX = 640  # width of labelled images
SECONDS = 6.0  # length of a scene of labelled images, s; its images have equal intervals
MIN_SIDE_PX = 3.0  # smallest side of a box in the image, px; smaller objects are ignored
_HIDDEN = 2  # KITTI's `occluded` of objects that are less than half visible
_IGNORED_SCORE = 0.3  # of a pseudo-label that training ignores


@dataclass(frozen=True, slots=True)
class Simulated:
    """Result of `simulate`."""

    drive: Drive | None = None  # files of the drive; None for a set of images
    data_yaml: Path | None = None  # data.yaml of a set of images; None for a drive
    n_images: int = 0  # number of images of a set; 0 for a drive
    notes: tuple[str, ...] = ()  # messages for the user


def simulate(settings: SimulationSettings, progress: StepProgress = no_progress) -> Simulated:
    """Write a drive with exact ground truth, or labelled images, to `settings.out`.

    Raises UsageError for settings that contradict each other or are out of range, RigError for an
    unusable rig, OutputError, VideoError or FolderLockError for a folder that cannot be written, or
    that another run is writing to.
    """
    if settings.images is None:
        return _drive(settings, progress)
    if settings.has_drive_options:
        raise UsageError(
            "--images: options of a drive do not apply to training images; remove them."
        )
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
        raise UsageError(
            f"--seconds {seconds:g}: expected {1 / fps:g} s (one frame) to {LONGEST_S:g} s."
        )
    rig, notes = (None, ()) if settings.rig is None else _rig(settings.rig)
    if rig is not None and rig.left.is_wide and (settings.disparity or settings.masks):
        raise UsageError(
            "--disparity, --masks: expected a rig of pinholes, found a wide lens; "
            "omit these options."
        )
    if settings.stereo_layout is not None and settings.drop_fraction:
        raise UsageError(
            "--drop-frames: two cameras drop different frames; omit --drop-frames or "
            "--stereo-layout."
        )
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
        notes.append(
            f"Note: {path} contains no image size; KITTI's {width_px} x {height_px} px is used."
        )
        left, right = (
            replace(camera, width_px=width_px, height_px=height_px)
            for camera in (rig.left, rig.right)
        )
        rig = StereoRig(left, right, rig.right_from_left)
    if rig.left.is_wide:
        parallel = StereoRig.rectified(rig.left, rig.baseline_m)
        if rig.left != rig.right or not np.allclose(
            rig.right_from_left, parallel.right_from_left, atol=1e-5
        ):
            raise RigError(
                f"{path}: simulating wide lenses requires two identical, parallel cameras side by "
                "side, found other cameras; copy 'left' to 'right' and use the identity as "
                "rotation."
            )
        return with_even_size(parallel), tuple(notes)
    if not _is_nearly_rectified(rig):
        raise RigError(
            f"{path}: expected a rectified pair (KITTI's calib.txt, or identical, parallel cameras "
            "without distortion); give the rig of the rectified images."
        )
    rig = StereoRig.rectified(rig.left.without_distortion(), rig.baseline_m)
    even = with_even_size(rig)
    if even.left != rig.left:
        old, new = (f"{camera.width_px} x {camera.height_px}" for camera in (rig.left, even.left))
        notes.append(
            f"Note: images of {new} px are rendered; videos need even sizes, and "
            f"{path.name} has {old} px."
        )
    return even, tuple(notes)


def _is_nearly_rectified(rig: StereoRig) -> bool:
    """Whether a rig differs from a rectified rig by less than 0.1 px and 1 cm, as KITTI's rigs
    do.
    """
    if rig.left.is_distorted or rig.right.is_distorted or rig.baseline_m <= 0:
        return False
    same_cameras = np.allclose(rig.left.matrix, rig.right.matrix, atol=0.1)
    is_parallel = np.allclose(rig.right_from_left[:3, :3], np.eye(3), atol=1e-5)
    return bool(same_cameras and is_parallel and np.abs(rig.right_from_left[1:3, 3]).max() < 0.01)


def write_image_set(
    folder: Path,
    seeds: Sequence[int],
    *,
    n_frames: int,
    make: Callable[[int, float], Scene] = make_scene,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Write `n_frames` images of each scene into `folder`; returns data.yaml, which lists all
    images for training.

    Objects that are less than half visible are written to `ignored` (see `labels_pseudo` in
    detection/training/data_yaml.py): whether a detector finds them has no effect on its loss.

    `folder` gets images/, labels/, ignored/ and data.yaml. The same `seeds` give the same images;
    `make` creates a scene from its seed and length in seconds. `progress` is called after each
    image with the number of finished images and the total. OutputError if the folder cannot be
    written, or contains images or a data.yaml.
    """
    for name in ("images", "labels", "ignored"):
        make_folder(folder / name)
    if (folder / "data.yaml").exists() or any((folder / "images").iterdir()):
        raise OutputError(
            f"{folder}: the folder already contains a data set; choose another folder."
        )
    rig = kitti_like_rig()
    times_s = (np.arange(n_frames) * SECONDS / n_frames).tolist()
    n_written = 0
    for seed in seeds:
        scene = make(seed, SECONDS)
        renderer, truth = Renderer(scene, rig), label_scene(scene, times_s, camera=rig.left)
        for frame, time_s in enumerate(times_s):
            _write(
                folder,
                f"{seed:06}_{frame:02}",
                renderer.render(time_s),
                truth.select(truth.frame == frame),
            )
            n_written += 1
            if progress is not None:
                progress(n_written, len(seeds) * n_frames)
    document = {"train": "images", "val": "images", "names": list(ROAD_CLASSES)}
    path = folder / "data.yaml"
    write_text(path, yaml_text(document | {"labels": "labels", "labels_pseudo": "ignored"}))
    return path


def _write(folder: Path, name: str, image: Image, truth: KittiLabels) -> None:
    height, width = image.shape[:2]
    scale = WIDTH_PX / width
    small = cv2.resize(image, (WIDTH_PX, round(height * scale)), interpolation=cv2.INTER_AREA)
    _, encoded = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 92])
    write_bytes(folder / "images" / f"{name}.jpg", encoded.tobytes())
    boxes = np.clip(truth.xyxy_px + 0.5, 0, [width, height, width, height])
    sizes = boxes[:, 2:] - boxes[:, :2]
    ignored = (truth.occluded >= _HIDDEN) | (
        scale * sizes.min(axis=1, initial=np.inf) < MIN_SIDE_PX
    )
    names = [road_class_of(kitti_type) for kitti_type in truth.kitti_type]
    fractions = np.concatenate([(boxes[:, :2] + boxes[:, 2:]) / 2, sizes], axis=1) / [
        width,
        height,
        width,
        height,
    ]
    labels, pseudo_labels = [], []
    for road_class, row, is_ignored in zip(names, fractions, ignored, strict=True):
        if road_class is not None and row[2:].min() > 0:
            line = " ".join(
                [str(ROAD_CLASSES.index(road_class)), *(f"{fraction:.6f}" for fraction in row)]
            )
            if is_ignored:
                pseudo_labels.append(f"{line} {_IGNORED_SCORE}\n")
            else:
                labels.append(f"{line}\n")
    write_text(folder / "labels" / f"{name}.txt", "".join(labels))
    write_text(folder / "ignored" / f"{name}.txt", "".join(pseudo_labels))
