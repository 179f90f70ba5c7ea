"""A simulated drive as files: both eyes' videos, the rig, exact truth, the ego speed, the playback detector's boxes.

left.mp4, right.mp4     H.264, near lossless; or, lossless, folders left/ and right/ of PNGs
rig.yaml                the cameras                 truth.txt        KITTI tracking labels
ego_speed.csv           of the left eye's frames    truth.csv        exact distances and more (`truth_table.py`)
detections.txt          KITTI detections, made from the truth
image_2/, image_3/, disp_occ_0/, obj_map/           on demand: pairs, disparities, objects as KITTI 2015 has

Frames are numbered as the left eye's file has them: lost ones have no number and no truth.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from detection.detections import FloatArray
from detection.kitti_format import KittiLabels
from stereo.rig import StereoRig
from stereo.rig_files import save_rig
from track_range.simulation.drive_files import (
    EyeWriter,
    disparity_map,
    eye_writer,
    object_map,
    with_even_size,
    write_png,
)
from track_range.simulation.faults import NO_FAULTS, Faults
from track_range.simulation.kitti_rows import kitti_text
from track_range.simulation.playback import play_back
from track_range.simulation.render import NOISE_GREY, Renderer, kitti_like_rig
from track_range.simulation.scenarios import make_scenario
from track_range.simulation.truth import joined, seen_at
from track_range.simulation.truth_table import HEADER, ego_speed_text, truth_rows
from track_range.written import make_folder, write_text

__all__ = ["Drive", "DriveOptions", "kitti_text", "write_drive"]

DEFAULT_SCENARIO = "town"


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
        closing(eye_writer(drive.left, camera, fps)) as left,
        closing(eye_writer(drive.right, camera, fps)) as right,
        ThreadPoolExecutor(1) as other_eye,
    ):
        writing.both(left, right, other_eye, progress)
    truth = joined(writing.labels)
    detections = play_back(truth, seed=seed, image_size_px=(camera.width_px, camera.height_px))
    write_text(drive.truth, kitti_text(truth))
    write_text(drive.table, HEADER + "".join(writing.rows))
    write_text(drive.ego_speed, ego_speed_text(scene, [times_s[k] for k in writing.kept_left]))
    write_text(drive.detections, kitti_text(detections))
    return drive


@dataclass(slots=True)
class _Writing:
    """A drive being drawn: the left eye here, the right one in a thread of its own."""

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
        left: EyeWriter,
        right: EyeWriter,
        other_eye: ThreadPoolExecutor,
        progress: Callable[[int, int], None] | None,
    ) -> None:
        """Draw and write every frame that is not lost."""
        faults, seed = self.renderer.faults, self.renderer.scene.seed
        kept_left = set(self.kept_left)
        kept_right = set(faults.kept_frames(len(self.times_s), seed, is_right=True))
        for number, time_s in enumerate(self.times_s.tolist()):
            right_done: Future[None] | None = None
            if number in kept_right:
                right_done = other_eye.submit(self._right, right, time_s, number)
            if number in kept_left:
                self._left(left, time_s, number)
            if right_done is not None:
                right_done.result()
            if progress is not None:
                progress(number + 1, len(self.times_s))

    def _left(self, writer: EyeWriter, time_s: float, number: int) -> None:
        image, inverse_depth = self.renderer.render_with_depth(time_s)
        writer.write(image, time_s)
        scene, camera = self.renderer.scene, self.renderer.rig.left
        seen = seen_at(scene, time_s, frame=len(self.labels), camera=camera, inverse_depth=inverse_depth)
        self.labels.append(seen.labels)
        self.rows.append(truth_rows(self.renderer, time_s, seen))
        if self.disparity_folder is not None:
            write_png(_in_kitti(self.disparity_folder, "image_2", number), image)
            truth = disparity_map(inverse_depth, self.renderer.rig)
            write_png(_in_kitti(self.disparity_folder, "disp_occ_0", number), truth)
            objects = object_map(inverse_depth, self.renderer.rig, seen, scene.turns(time_s))
            write_png(_in_kitti(self.disparity_folder, "obj_map", number), objects)

    def _right(self, writer: EyeWriter, time_s: float, number: int) -> None:
        image = self.renderer.render(time_s + self.renderer.faults.late_s, eye="right")
        writer.write(image, time_s)
        if self.disparity_folder is not None:
            write_png(_in_kitti(self.disparity_folder, "image_3", number), image)


def _in_kitti(folder: Path, name: str, number: int) -> Path:
    """A file of KITTI 2015's layout."""
    make_folder(folder / name)
    return folder / name / f"{number:06}_10.png"
