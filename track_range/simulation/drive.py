"""Writing of a simulated drive: videos of both cameras, rig, ground truth, ego speed and simulated detections.

left.mp4, right.mp4     H.264, near lossless; or lossless PNGs in the folders left/ and right/
rig.yaml                the cameras                 truth.txt        KITTI tracking labels
ego_speed.csv           speed at the left frames    truth.csv        exact distances and more (`truth_table.py`)
detections.txt          simulated detections in KITTI's format (`playback.py`)
contacts.csv            contacts of the ego vehicle, real and without braking (`contact_table.py`)
image_2/, image_3/, disp_occ_0/, obj_map/           optional: pairs, disparities and objects in KITTI 2015's layout
masks/, mask_ids/                                   optional: visible heads and number plates (`masks.py`)

With wide lenses, boxes of the ground truth are in pixels of the undistorted images of a run without --fov-deg.

Frame numbers are those of the left file: dropped frames have no number and no ground truth.
"""

from __future__ import annotations

import math
import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path

import numpy as np
import numpy.typing as npt

from track_range.detection.formats.video_labels.kitti import KittiLabels
from track_range.foundation.arrays import FloatArray, Image
from track_range.foundation.files.output_files import make_folder, write_text
from track_range.simulation.camera.contact_table import contacts_text
from track_range.simulation.camera.drive_files import (
    ImageWriter,
    disparity_map,
    image_writer,
    object_map,
    with_even_size,
    write_png,
)
from track_range.simulation.camera.faults import NO_FAULTS, Faults
from track_range.simulation.camera.kitti_rows import kitti_text
from track_range.simulation.camera.masks import MaskFolder
from track_range.simulation.camera.playback import play_back
from track_range.simulation.camera.truth_table import HEADER, ego_speed_text, truth_rows
from track_range.simulation.camera.wide_lens import WideLens
from track_range.simulation.render.renderer import NOISE_GREY, Renderer, kitti_like_rig
from track_range.simulation.world.contacts import find_contacts
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.truth import joined, visible_objects
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.rig_formats.rig_yaml import save_rig

__all__ = ["Drive", "DriveOptions", "kitti_text", "write_drive"]

DEFAULT_SCENARIO = "town"
"""Scenario of the demo."""

N_THREADS = min(4, os.cpu_count() or 1)
"""Number of rendering threads; the images do not depend on it."""

N_AHEAD = N_THREADS
"""Number of frames that are rendered ahead of the one that is written."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveOptions:
    """Options of rendering and writing a drive.

    Attributes:
        scenario: a name of `scenarios.SCENARIOS`.
        noise_grey: standard deviation of the sensor noise, grey levels.
        faults: faults of the cameras.
        is_lossless: whether to write folders of PNGs instead of videos.
        has_disparity: whether to write pairs, disparities and objects in KITTI 2015's layout too.
        has_masks: whether to write masks of heads and number plates too.
        car_size: size of all cars relative to the scenario's.
        camera_pitch_deg: pitch of the cameras relative to the ego car, positive = up.
    """

    scenario: str = DEFAULT_SCENARIO
    noise_grey: float = NOISE_GREY
    faults: Faults = NO_FAULTS
    is_lossless: bool = False
    has_disparity: bool = False
    has_masks: bool = False
    car_size: float = 1.0
    camera_pitch_deg: float = 0.0


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
    def in_folder(cls, folder: Path, *, is_lossless: bool = False) -> Drive:
        """The paths of the files in a folder."""
        suffix = "" if is_lossless else ".mp4"
        return cls(
            left=folder / f"left{suffix}",
            right=folder / f"right{suffix}",
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
    seed: int = 0,
    seconds: float = 6.0,
    fps: float = 10.0,
    rig: StereoRig | None = None,
    options: DriveOptions | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Drive:
    """Write a drive to `folder`, which is created if necessary; the same seed gives the same drive.

    Args:
        folder: the folder; files with the same names are replaced.
        seed: random seed of the scene, textures, sensor noise and simulated detections.
        seconds: length of the drive.
        fps: frame rate.
        rig: a rectified pair, or equal, parallel cameras with wide lenses; None = KITTI's angle of view, 1240 x 376 px
            and 0.54 m. Odd image sizes grow by one, also in the rig file.
        options: scenario, faults and files; None = the defaults.
        progress: called after each frame with the number of finished frames and the total.

    Raises:
        ValueError: less than one frame, an unknown scenario, a rig that is not rectified, or disparities or masks of a
            wide lens.
        OutputError, VideoError: the folder or a file in it cannot be written.
    """
    options = options or DriveOptions()
    rig = with_even_size(rig or kitti_like_rig())
    n_frames = round(seconds * fps)
    if n_frames < 1:
        raise ValueError(f"seconds: expected at least one frame, got {seconds:g} s at {fps:g} frames/s")
    scene = make_scenario(options.scenario, seed=seed, seconds=seconds)
    if options.car_size != 1.0:
        scene = scene.with_car_sizes(options.car_size)
    scene = replace(scene, camera_pitch_rad=math.radians(options.camera_pitch_deg))
    wide_lens = WideLens.of(rig) if rig.left.is_wide else None
    if wide_lens is not None and (options.has_disparity or options.has_masks):
        raise ValueError("options: disparities and masks are those of a pinhole, and the rig has wide lenses")
    rendered = rig if wide_lens is None else wide_lens.pinholes
    renderer = Renderer(scene, rendered, noise_grey=options.noise_grey, faults=options.faults, wide_lens=wide_lens)
    make_folder(folder)
    drive = Drive.in_folder(folder, is_lossless=options.is_lossless)
    save_rig(options.faults.rig_in_file(rig), drive.rig)
    times_s = np.arange(n_frames) / fps
    recorder = _Recorder(
        renderer,
        times_s,
        disparity_folder=folder if options.has_disparity else None,
        masks=MaskFolder(folder, scene) if options.has_masks else None,
    )
    camera = rig.left
    with (
        closing(image_writer(drive.left, camera, fps)) as left,
        closing(image_writer(drive.right, camera, fps)) as right,
        ThreadPoolExecutor(N_THREADS) as pool,
    ):
        recorder.write(left, right, pool, progress)
    truth = joined(recorder.labels)
    pinhole = rendered.left
    detections = play_back(truth, seed=seed, image_size_px=(pinhole.width_px, pinhole.height_px))
    if wide_lens is not None:
        detections = wide_lens.recorded_labels(detections)
    write_text(drive.truth, kitti_text(truth))
    write_text(drive.table, HEADER + "".join(recorder.rows))
    write_text(drive.ego_speed, ego_speed_text(scene, [times_s[k] for k in recorder.kept_left]))
    write_text(drive.contacts, contacts_text(find_contacts(scene, seconds)))
    write_text(drive.detections, kitti_text(detections))
    return drive


@dataclass(frozen=True, slots=True)
class _Frame:
    """A frame with the images being rendered; None = dropped."""

    number: int
    time_s: float
    left: Future[tuple[Image, FloatArray, npt.NDArray[np.uint16] | None]] | None
    right: Future[Image] | None


@dataclass(slots=True)
class _Recorder:
    """Renders the images of a drive in several threads and writes them in order."""

    renderer: Renderer
    times_s: FloatArray
    disparity_folder: Path | None
    masks: MaskFolder | None
    labels: list[KittiLabels] = field(default_factory=list)
    rows: list[str] = field(default_factory=list)

    @property
    def kept_left(self) -> list[int]:
        """Numbers of the frames that the left camera does not drop."""
        return self.renderer.faults.kept_frames(len(self.times_s), self.renderer.scene.seed, is_right=False)

    def write(
        self,
        left: ImageWriter,
        right: ImageWriter,
        pool: ThreadPoolExecutor,
        progress: Callable[[int, int], None] | None,
    ) -> None:
        """Render and write all frames that are not dropped."""
        frames = self._rendering(pool)
        waiting = deque(islice(frames, N_AHEAD))
        while waiting:
            frame = waiting.popleft()
            waiting.extend(islice(frames, 1))
            if frame.left is not None:
                self._write_left(left, frame, *frame.left.result())
            if frame.right is not None:
                self._write_right(right, frame, frame.right.result())
            if progress is not None:
                progress(frame.number + 1, len(self.times_s))

    def _rendering(self, pool: ThreadPoolExecutor) -> Iterator[_Frame]:
        """The frames in order; rendering of a frame starts when it is requested."""
        renderer, faults = self.renderer, self.renderer.faults
        kept_left = set(self.kept_left)
        kept_right = set(faults.kept_frames(len(self.times_s), renderer.scene.seed, is_right=True))
        for number, time_s in enumerate(self.times_s.tolist()):
            left = pool.submit(self._rendered_left, time_s) if number in kept_left else None
            right_s = time_s + faults.late_s
            right = pool.submit(renderer.render, right_s, side="right") if number in kept_right else None
            yield _Frame(number, time_s, left, right)

    def _rendered_left(self, time_s: float) -> tuple[Image, FloatArray, npt.NDArray[np.uint16] | None]:
        """Left image, inverse depth, and with masks the labels of the samples."""
        if self.masks is None:
            return *self.renderer.render_with_depth(time_s), None
        return self.renderer.render_with_labels(time_s)

    def _write_left(
        self,
        writer: ImageWriter,
        frame: _Frame,
        image: Image,
        inverse_depth: FloatArray,
        part_labels: npt.NDArray[np.uint16] | None,
    ) -> None:
        writer.write(image, frame.time_s)
        if self.masks is not None and part_labels is not None:
            self.masks.write(part_labels)
        scene, camera = self.renderer.scene, self.renderer.rig.left
        visible = visible_objects(
            scene, frame.time_s, frame=len(self.labels), camera=camera, inverse_depth=inverse_depth
        )
        self.labels.append(visible.labels)
        self.rows.append(truth_rows(self.renderer, frame.time_s, visible))
        if self.disparity_folder is not None:
            write_png(_kitti_2015_file(self.disparity_folder, "image_2", frame.number), image)
            truth = disparity_map(inverse_depth, self.renderer.rig)
            write_png(_kitti_2015_file(self.disparity_folder, "disp_occ_0", frame.number), truth)
            objects = object_map(inverse_depth, self.renderer.rig, visible, scene.rotations(frame.time_s))
            write_png(_kitti_2015_file(self.disparity_folder, "obj_map", frame.number), objects)

    def _write_right(self, writer: ImageWriter, frame: _Frame, image: Image) -> None:
        writer.write(image, frame.time_s)  # the timestamp, which ignores a delay of the right camera
        if self.disparity_folder is not None:
            write_png(_kitti_2015_file(self.disparity_folder, "image_3", frame.number), image)


def _kitti_2015_file(folder: Path, name: str, number: int) -> Path:
    """Path of a file in KITTI 2015's layout; its folder is created."""
    make_folder(folder / name)
    return folder / name / f"{number:06}_10.png"
