"""Writing of a simulated drive: videos of both cameras, rig, ground truth, ego speed and simulated
detections.

left.mp4, right.mp4     H.264, near lossless; or lossless PNGs in the folders left/ and right/; or both.mp4 or both/
rig.yaml                the cameras
truth.txt, truth.csv, contacts.csv, ego_speed.csv   ground truth and speed (`tables.py`)
detections.txt          simulated detections in KITTI's format (`camera/playback.py`)
image_2/, image_3/, disp_occ_0/, obj_map/           optional: pairs, disparities and objects in KITTI 2015's layout
ground_points.txt, lines.txt, speeds.csv, crossings_truth.csv   of the scenario `fixed` (`camera/fixed_files.py`)
masks/, mask_ids/                                   optional: visible heads and number plates (`write_masks`)

With wide lenses, boxes of the ground truth are in pixels of the undistorted images of a run without
--fov-deg.

Frame numbers count the frames of the left file: dropped frames have no number and no ground truth.
"""

from __future__ import annotations

import math
import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from track_range.detection.formats.video_labels.kitti import KittiLabels
from track_range.foundation.arrays import FloatArray, Image
from track_range.foundation.files.output_files import make_folder, write_text
from track_range.simulation.camera import drive_files
from track_range.simulation.camera.faults import kept_frames, rig_in_file
from track_range.simulation.camera.fixed_files import write_fixed_files
from track_range.simulation.camera.playback import play_back
from track_range.simulation.camera.wide_lens import WideLens
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.settings import DriveOptions, mounting_of
from track_range.simulation.tables import (
    TRUTH_HEADER,
    contacts_text,
    ego_speed_text,
    kitti_text,
    truth_rows,
)
from track_range.simulation.world.contacts import find_contacts
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.scene import Scene
from track_range.simulation.world.truth import joined, visible_objects
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.rig_formats.rig_yaml import save_rig

# for rendering, and frames rendered ahead; images do not depend on it
N_THREADS = min(4, os.cpu_count() or 1)

_Rendered = tuple[Future[tuple[Any, ...]] | None, Future[Image] | None]
"""Left image with depth and labels, and right image; None = dropped."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Drive:
    """The files of a drive."""

    left: Path
    right: Path
    rig: Path
    truth: Path
    detections: Path
    table: Path
    ego_speed: Path
    contacts: Path

    @classmethod
    def in_folder(
        cls, folder: Path, *, is_lossless: bool = False, is_packed: bool = False
    ) -> Drive:
        """The paths of the files in a folder; `is_packed`: left and right are one video of both
        cameras.
        """
        suffix = "" if is_lossless else ".mp4"
        return cls(
            left=folder / f"{'both' if is_packed else 'left'}{suffix}",
            right=folder / f"{'both' if is_packed else 'right'}{suffix}",
            rig=folder / "rig.yaml",
            truth=folder / "truth.txt",
            detections=folder / "detections.txt",
            table=folder / "truth.csv",
            ego_speed=folder / "ego_speed.csv",
            contacts=folder / "contacts.csv",
        )


def write_drive(
    folder: Path,
    *,
    scenario: str = "town",
    seed: int = 0,
    seconds: float = 6.0,
    fps: float = 10.0,
    rig: StereoRig | None = None,
    options: DriveOptions | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Drive:
    """Write a drive to `folder`, where files with the same names are replaced; the same seed gives
    the same drive.

    `scenario` is a name of `settings.SCENARIO_NAMES`, `seed` is for the scene, textures, sensor
    noise and simulated detections. `rig`: a rectified pair, or identical, parallel cameras with
    wide lenses; None = KITTI's angle of view, 1240 x 376 px and 0.54 m. Odd image sizes grow by
    one, also in the rig file. `progress` is called after each frame with the number of finished
    frames and the total. Raises ValueError: less than one frame, an unknown scenario, a rig that is
    not rectified, or disparities or masks of a wide lens. Raises OutputError, VideoError: the
    folder or a file in it cannot be written.
    """
    options = options or DriveOptions()
    rig = drive_files.with_even_size(rig or kitti_like_rig())
    n_frames = round(seconds * fps)
    if n_frames < 1:
        raise ValueError(
            f"seconds: expected at least one frame, got {seconds:g} s at {fps:g} frames/s"
        )
    scene = _scene_of(options, make_scenario(scenario, seed=seed, seconds=seconds))
    wide_lens = WideLens.of(rig) if rig.left.is_wide else None
    if wide_lens is not None and (options.disparity or options.masks):
        raise ValueError(
            "options: disparities and masks need a pinhole, but the rig has wide lenses"
        )
    pinholes = rig if wide_lens is None else wide_lens.pinholes
    renderer = Renderer(
        scene, pinholes, noise_grey=options.noise_grey, faults=options, wide_lens=wide_lens
    )
    make_folder(folder)
    drive = Drive.in_folder(
        folder, is_lossless=options.lossless, is_packed=options.stereo_layout is not None
    )
    save_rig(rig_in_file(rig, options), drive.rig, mounting=mounting_of(options.mount))
    times_s: list[float] = (np.arange(n_frames) / fps).tolist()
    truth = _DriveTruth(folder, renderer, pinholes, options)
    with (
        _open_videos(drive, rig, fps, options) as videos,
        ThreadPoolExecutor(N_THREADS) as pool,
    ):
        frames = _rendering(pool, renderer, times_s, options)
        for number, (left, right) in enumerate(frames):
            time_s = times_s[number]
            if left is not None:
                image, inverse_depth, *part_labels = left.result()
                videos[0].write(image, time_s)
                truth.add(number, time_s, image, inverse_depth, part_labels)
            if right is not None:
                image = right.result()
                videos[1].write(image, time_s)  # without a delay of the right camera
                truth.add_right(number, image)
            if progress is not None:
                progress(number + 1, n_frames)
    labels = joined(truth.labels)
    detections = play_back(labels, seed=seed, image_size_px=pinholes.left.size_px)
    if wide_lens is not None:
        detections = wide_lens.recorded_labels(detections)
    write_text(drive.truth, kitti_text(labels))
    write_text(drive.table, TRUTH_HEADER + "".join(truth.rows))
    write_text(drive.ego_speed, ego_speed_text(scene, truth.times_s))
    write_text(drive.contacts, contacts_text(find_contacts(scene, seconds)))
    write_text(drive.detections, kitti_text(detections))
    if scenario == "fixed":
        write_fixed_files(folder, scene, pinholes.left, truth.times_s)
    return drive


def _scene_of(options: DriveOptions, scene: Scene) -> Scene:
    if options.car_size != 1.0:
        scene = scene.with_car_sizes(options.car_size)
    mounting = mounting_of(options.mount) or scene.mounting
    return replace(
        scene,
        camera_pitch_rad=math.radians(options.camera_pitch_deg),
        camera_height_m=mounting.z_m or scene.camera_height_m,
        mounting=mounting,
    )


@contextmanager
def _open_videos(
    drive: Drive, rig: StereoRig, fps: float, options: DriveOptions
) -> Iterator[tuple[drive_files.FrameWriter, drive_files.FrameWriter]]:
    """The writers of the left and the right images, which are one for a packed video."""
    layout = options.stereo_layout
    if layout is not None:
        with closing(drive_files.PackedWriter(drive.left, rig.left, fps, layout)) as packed:
            yield packed, packed
        return
    with (
        closing(drive_files.image_writer(drive.left, rig.left, fps)) as left,
        closing(drive_files.image_writer(drive.right, rig.left, fps)) as right,
    ):
        yield left, right


class _DriveTruth:
    """The truth of the left images, some of which is written at once."""

    def __init__(
        self, folder: Path, renderer: Renderer, rig: StereoRig, options: DriveOptions
    ) -> None:
        self._folder, self._renderer, self._rig, self._options = folder, renderer, rig, options
        self.times_s: list[float] = []
        self.labels: list[KittiLabels] = []
        self.rows: list[str] = []

    def add(
        self,
        number: int,
        time_s: float,
        image: Image,
        inverse_depth: FloatArray,
        part_labels: Sequence[Any],
    ) -> None:
        """Add a frame of the drive; with masks, `part_labels` has the labels of its pixels."""
        scene, options, frame = self._renderer.scene, self._options, len(self.rows)
        visible = visible_objects(
            scene, time_s, frame=frame, camera=self._rig.left, inverse_depth=inverse_depth
        )
        self.times_s.append(time_s)
        self.labels.append(visible.labels)
        self.rows.append(truth_rows(self._renderer, time_s, visible))
        if options.masks:
            drive_files.write_masks(self._folder, frame, part_labels[0], scene)
        if options.disparity:
            rotations = scene.rotations(time_s)
            disparity = drive_files.disparity_map(inverse_depth, self._rig)
            objects = drive_files.object_map(inverse_depth, self._rig, visible, rotations)
            _write_kitti_2015(self._folder / "image_2", number, image)
            _write_kitti_2015(self._folder / "disp_occ_0", number, disparity)
            _write_kitti_2015(self._folder / "obj_map", number, objects)

    def add_right(self, number: int, image: Image) -> None:
        """Add the right image of a frame of the drive."""
        if self._options.disparity:
            _write_kitti_2015(self._folder / "image_3", number, image)


def _rendering(
    pool: ThreadPoolExecutor, renderer: Renderer, times_s: list[float], options: DriveOptions
) -> Iterator[_Rendered]:
    """The images of each frame, in order, some of which are rendered ahead."""
    seed = renderer.scene.seed
    kept_left, kept_right = (
        set(kept_frames(options, len(times_s), seed, is_right=is_right))
        for is_right in (False, True)
    )
    render_left = renderer.render_with_labels if options.masks else renderer.render_with_depth
    waiting: deque[_Rendered] = deque()
    for number, time_s in enumerate(times_s):
        left = pool.submit(render_left, time_s) if number in kept_left else None
        right_s = time_s + options.late_s
        right = (
            pool.submit(renderer.render, right_s, side="right") if number in kept_right else None
        )
        waiting.append((left, right))
        if len(waiting) > N_THREADS:
            yield waiting.popleft()
    yield from waiting


def _write_kitti_2015(folder: Path, number: int, image: Any) -> None:
    make_folder(folder)
    drive_files.write_png(folder / f"{number:06}_10.png", image)
