"""A simulated drive as files: both eyes' videos, the rig, exact labels and the playback detector's boxes.

left.mp4, right.mp4     H.264, near lossless        rig.yaml         the cameras
truth.txt               KITTI tracking labels       detections.txt   KITTI detections, made from the truth
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from detection.detections import FloatArray
from detection.kitti_format import KittiLabels
from stereo.camera import PinholeCamera
from stereo.rig import StereoRig
from stereo.rig_files import save_rig
from track_range.simulation.playback import play_back
from track_range.simulation.render import Renderer, kitti_like_rig
from track_range.simulation.scene import make_scene
from track_range.simulation.truth import label_scene
from track_range.video import VideoWriter
from track_range.written import make_folder, write_text

NEAR_LOSSLESS_CRF = 10
"""x264's quality: a texture moves against its surface by far less than a tenth of a pixel."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Drive:
    """The files of a drive."""

    left: Path
    right: Path
    rig: Path
    truth: Path
    detections: Path


def write_drive(
    folder: Path,
    *,
    seed: int = 0,
    seconds: float = 6.0,
    fps: float = 10.0,
    rig: StereoRig | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Drive:
    """Write a drive to `folder`, which is made if need be; the same seed gives the same drive.

    Args:
        folder: where the files go; files of the same names are replaced.
        seed: of the scene, its textures, the sensor noise and the playback detector.
        seconds: length.
        fps: frames per second.
        rig: a rectified pair with even image sizes (H.264); None = KITTI's angle of view, 1240 x 376, 0.54 m apart.
        progress: called after each frame with the frames done and the frames in all.

    Raises:
        ValueError: no frame fits into the given length.
        OutputError, VideoError: the folder or a file in it cannot be written.
    """
    rig = rig or kitti_like_rig()
    n_frames = round(seconds * fps)
    if n_frames < 1:
        raise ValueError(f"a drive of at least one frame wanted, {seconds:g} s at {fps:g} frames/s got")
    make_folder(folder)
    drive = Drive(
        left=folder / "left.mp4",
        right=folder / "right.mp4",
        rig=folder / "rig.yaml",
        truth=folder / "truth.txt",
        detections=folder / "detections.txt",
    )
    scene = make_scene(seed, seconds=seconds)
    times_s = np.arange(n_frames) / fps
    truth = label_scene(scene, times_s.tolist(), camera=rig.left)
    image_size_px = (rig.left.width_px, rig.left.height_px)
    save_rig(rig, drive.rig)
    write_text(drive.truth, kitti_text(truth))
    detections = play_back(truth, seed=seed, image_size_px=image_size_px)
    write_text(drive.detections, kitti_text(detections))
    _write_videos(drive, Renderer(scene, rig), times_s, fps=fps, progress=progress)
    return drive


def _write_videos(
    drive: Drive, renderer: Renderer, times_s: FloatArray, *, fps: float, progress: Callable[[int, int], None] | None
) -> None:
    """Render and encode, each eye in a thread of its own."""
    camera = renderer.rig.left
    with (
        _writer(drive.left, camera, fps) as left,
        _writer(drive.right, camera, fps) as right,
        ThreadPoolExecutor(1) as other_eye,
    ):
        for index, time_s in enumerate(times_s.tolist()):
            right_done = other_eye.submit(lambda at_s: right.write(renderer.render(at_s, eye="right"), at_s), time_s)
            left.write(renderer.render(time_s, eye="left"), time_s)
            right_done.result()
            if progress is not None:
                progress(index + 1, len(times_s))


def _writer(path: Path, camera: PinholeCamera, fps: float) -> VideoWriter:
    return VideoWriter(path, width_px=camera.width_px, height_px=camera.height_px, fps=fps, crf=NEAR_LOSSLESS_CRF)


def kitti_text(labels: KittiLabels) -> str:
    """Rows of KITTI's tracking format, with a score where there is one; alpha is the heading less the bearing."""
    bearing_rad = np.arctan2(labels.location_m[:, 0], labels.location_m[:, 2])
    alpha_rad = np.where(labels.has_3d_box, _wrapped(labels.rotation_y_rad - bearing_rad), -10.0)
    lines = []
    for row in range(len(labels)):
        numbers = [alpha_rad[row], *labels.xyxy_px[row], *labels.size_hwl_m[row], *labels.location_m[row]]
        numbers.append(labels.rotation_y_rad[row])
        words = [
            f"{labels.frame[row]} {labels.track_id[row]} {labels.kitti_type[row]}",
            f"{labels.truncated[row]:.0f} {labels.occluded[row]}",
            *(f"{number:.6f}".rstrip("0").rstrip(".") for number in numbers),
        ]
        if np.isfinite(labels.score[row]):
            words.append(f"{labels.score[row]:.6f}")
        lines.append(" ".join(words) + "\n")
    return "".join(lines)


def _wrapped(angle_rad: FloatArray) -> FloatArray:
    """Angles brought into -pi .. pi."""
    return np.asarray((angle_rad + np.pi) % (2 * np.pi) - np.pi)
