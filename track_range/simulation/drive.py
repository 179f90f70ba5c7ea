"""A simulated drive as files: both eyes' videos, the rig, exact truth, the ego speed, the playback detector's boxes.

left.mp4, right.mp4     H.264, near lossless; or, lossless, folders left/ and right/ of PNGs
rig.yaml                the cameras                 truth.txt        KITTI tracking labels
ego_speed.csv           of the left eye's frames    truth.csv        exact distances and more (`truth_table.py`)
detections.txt          KITTI detections, made from the truth
image_2/, image_3/, disp_occ_0/, obj_map/           on demand: pairs, disparities, objects as KITTI 2015 has

Frames are numbered as the left eye's file has them: lost ones have no number and no truth.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np

from track_range.detection.formats.kitti import KittiLabels
from track_range.foundation.arrays import FloatArray, Image
from track_range.results.output_files import make_folder, write_text
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
from track_range.simulation.camera.playback import play_back
from track_range.simulation.camera.truth_table import HEADER, ego_speed_text, truth_rows
from track_range.simulation.render.renderer import NOISE_GREY, Renderer, kitti_like_rig
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.truth import joined, seen_at
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.matching.box_matchers import one_thread
from track_range.stereo.rig_formats.rig_yaml import save_rig

__all__ = ["Drive", "DriveOptions", "kitti_text", "write_drive"]

DEFAULT_SCENARIO = "town"

N_DRAWING = min(4, os.cpu_count() or 1)
"""Threads that draw; what they draw does not depend on how many there are."""

N_AHEAD = N_DRAWING
"""Frames being drawn, or waiting to be written."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveOptions:
    """How a drive is drawn and written.

    Attributes:
        scenario: a name of `scenarios.SCENARIOS`.
        noise_grey: standard deviation of the sensor's noise, grey levels.
        faults: of the cameras.
        is_lossless: folders of PNGs in place of videos.
        has_disparity: pairs and true disparities too.
    """

    scenario: str = DEFAULT_SCENARIO
    noise_grey: float = NOISE_GREY
    faults: Faults = NO_FAULTS
    is_lossless: bool = False
    has_disparity: bool = False


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

    @classmethod
    def in_folder(cls, folder: Path, *, is_lossless: bool = False) -> Drive:
        """Where they lie."""
        ending = "" if is_lossless else ".mp4"
        return cls(
            left=folder / f"left{ending}",
            right=folder / f"right{ending}",
            rig=folder / "rig.yaml",
            truth=folder / "truth.txt",
            detections=folder / "detections.txt",
            table=folder / "truth.csv",
            ego_speed=folder / "ego_speed.csv",
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
    """Write a drive to `folder`, which is made if need be; the same seed gives the same drive.

    Args:
        folder: where the files go; files of the same names are replaced.
        seed: of the scene, its textures, the sensor noise and the playback detector.
        seconds: length.
        fps: frames per second.
        rig: a rectified pair; None = KITTI's angle of view, 1240 x 376, 0.54 m apart. Images of an odd size get one
            more column or row, and the rig file says so.
        options: scenario, faults and files; None = the defaults.
        progress: called after each frame with the frames done and the frames in all.

    Raises:
        ValueError: no frame fits into the given length, no scenario of that name, or a rig that is not rectified.
        OutputError, VideoError: the folder or a file in it cannot be written.
    """
    options = options or DriveOptions()
    rig = with_even_size(rig or kitti_like_rig())
    n_frames = round(seconds * fps)
    if n_frames < 1:
        raise ValueError(f"a drive of at least one frame wanted, {seconds:g} s at {fps:g} frames/s got")
    scene = make_scenario(options.scenario, seed=seed, seconds=seconds)
    renderer = Renderer(scene, rig, noise_grey=options.noise_grey, faults=options.faults)
    make_folder(folder)
    drive = Drive.in_folder(folder, is_lossless=options.is_lossless)
    save_rig(options.faults.told_rig(rig), drive.rig)
    times_s = np.arange(n_frames) / fps
    writing = _Writing(renderer, times_s, folder if options.has_disparity else None)
    camera = rig.left
    with (
        closing(image_writer(drive.left, camera, fps)) as left,
        closing(image_writer(drive.right, camera, fps)) as right,
        ThreadPoolExecutor(N_DRAWING) as drawing,
        one_thread(),  # OpenCV's own threads would only be in the way of these
    ):
        writing.both(left, right, drawing, progress)
    truth = joined(writing.labels)
    detections = play_back(truth, seed=seed, image_size_px=(camera.width_px, camera.height_px))
    write_text(drive.truth, kitti_text(truth))
    write_text(drive.table, HEADER + "".join(writing.rows))
    write_text(drive.ego_speed, ego_speed_text(scene, [times_s[k] for k in writing.kept_left]))
    write_text(drive.detections, kitti_text(detections))
    return drive


@dataclass(frozen=True, slots=True)
class _Frame:
    """A frame whose images are being drawn; None = lost."""

    number: int
    time_s: float
    left: Future[tuple[Image, FloatArray]] | None
    right: Future[Image] | None


@dataclass(slots=True)
class _Writing:
    """A drive being drawn: images by several threads, ahead of the one that writes them in order."""

    renderer: Renderer
    times_s: FloatArray
    disparity_folder: Path | None
    labels: list[KittiLabels] = field(default_factory=list)
    rows: list[str] = field(default_factory=list)

    @property
    def kept_left(self) -> list[int]:
        """Numbers of the frames that the left eye keeps."""
        return self.renderer.faults.kept_frames(len(self.times_s), self.renderer.scene.seed, is_right=False)

    def both(
        self,
        left: ImageWriter,
        right: ImageWriter,
        drawing: ThreadPoolExecutor,
        progress: Callable[[int, int], None] | None,
    ) -> None:
        """Draw and write every frame that is not lost."""
        frames = self._begun(drawing)
        waiting = deque(islice(frames, N_AHEAD))
        while waiting:
            frame = waiting.popleft()
            waiting.extend(islice(frames, 1))
            if frame.left is not None:
                self._left(left, frame, *frame.left.result())
            if frame.right is not None:
                self._right(right, frame, frame.right.result())
            if progress is not None:
                progress(frame.number + 1, len(self.times_s))

    def _begun(self, drawing: ThreadPoolExecutor) -> Iterator[_Frame]:
        """Frames in order, their drawing begun as they are asked for."""
        renderer, faults = self.renderer, self.renderer.faults
        kept_left = set(self.kept_left)
        kept_right = set(faults.kept_frames(len(self.times_s), renderer.scene.seed, is_right=True))
        for number, time_s in enumerate(self.times_s.tolist()):
            left = drawing.submit(renderer.render_with_depth, time_s) if number in kept_left else None
            right_s = time_s + faults.late_s
            right = drawing.submit(renderer.render, right_s, side="right") if number in kept_right else None
            yield _Frame(number, time_s, left, right)

    def _left(self, writer: ImageWriter, frame: _Frame, image: Image, inverse_depth: FloatArray) -> None:
        writer.write(image, frame.time_s)
        scene, camera = self.renderer.scene, self.renderer.rig.left
        seen = seen_at(scene, frame.time_s, frame=len(self.labels), camera=camera, inverse_depth=inverse_depth)
        self.labels.append(seen.labels)
        self.rows.append(truth_rows(self.renderer, frame.time_s, seen))
        if self.disparity_folder is not None:
            write_png(_in_kitti(self.disparity_folder, "image_2", frame.number), image)
            truth = disparity_map(inverse_depth, self.renderer.rig)
            write_png(_in_kitti(self.disparity_folder, "disp_occ_0", frame.number), truth)
            objects = object_map(inverse_depth, self.renderer.rig, seen, scene.turns(frame.time_s))
            write_png(_in_kitti(self.disparity_folder, "obj_map", frame.number), objects)

    def _right(self, writer: ImageWriter, frame: _Frame, image: Image) -> None:
        writer.write(image, frame.time_s)  # the time that the camera tells
        if self.disparity_folder is not None:
            write_png(_in_kitti(self.disparity_folder, "image_3", frame.number), image)


def _in_kitti(folder: Path, name: str, number: int) -> Path:
    """A file of KITTI 2015's layout."""
    make_folder(folder / name)
    return folder / name / f"{number:06}_10.png"
