"""Tracked points of drives with a known rig, in pixels of the videos, and rig files with errors.

The points of a drive are tracked once; for a rig file with an error, only their rectification changes. Points of
simulated drives are stored in a folder, so that a second benchmark does not render them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from benchmarks.inputs.simulated_drives import SimulatedDrive
from track_range.foundation.arrays import FloatArray
from track_range.simulation.render.renderer import kitti_like_rig
from track_range.stereo.alignment.feature_tracks import FeatureTracks, PairPoints, TrackedFrame
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame, whole_image
from track_range.stereo.geometry.rectification import Rectifier
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.rig_formats.reading import load_rig

Fault = Literal["true", "yaw", "pitch", "roll", "focal_right", "focal_both", "baseline"]
"""Error of a rig file: rotation of the right camera about its centre, or a factor of focal lengths or baseline."""


@dataclass(frozen=True, slots=True)
class TrackedDrive:
    """Points of a drive in pixels of rectified videos.

    Attributes:
        name: name for the table.
        rig: the true rig, rectified.
        frames: tracked points.
    """

    name: str
    rig: StereoRig
    frames: tuple[TrackedFrame, ...]

    def windows(self, n_frames: int, step: int | None = None) -> Iterator[TrackedDrive]:
        """Parts of `n_frames` frames that start every `step` frames; None = one after the other.

        A shorter rest of at least half as many frames is a part too, unless parts overlap.
        """
        min_frames = n_frames / 2 if step is None or step >= n_frames else n_frames
        for start in range(0, len(self.frames), step or n_frames):
            part = self.frames[start : start + n_frames]
            if len(part) >= min_frames:
                yield replace(self, name=f"{self.name}/{start}", frames=part)


def rig_with_error(rig: StereoRig, fault: Fault, size: float) -> StereoRig:
    """The rig file: angles in degrees, other errors as relative ones."""
    if fault in ("yaw", "pitch", "roll"):
        axis = ("pitch", "yaw", "roll").index(fault)
        rotation = np.eye(4)
        rotation[:3, :3] = cv2.Rodrigues(np.radians(size) * np.eye(3)[axis])[0]
        return replace(rig, right_from_left=rotation @ rig.right_from_left)
    if fault == "baseline":
        right_from_left = rig.right_from_left.copy()
        right_from_left[:3, 3] *= 1 + size
        return replace(rig, right_from_left=right_from_left)
    left, right = rig.left, rig.right
    if fault == "focal_both":
        left = _zoomed(left, 1 + size)
    if fault in ("focal_both", "focal_right"):
        right = _zoomed(right, 1 + size)
    return StereoRig(left, right, rig.right_from_left)


def _zoomed(camera: PinholeCamera, factor: float) -> PinholeCamera:
    return replace(camera, fx_px=camera.fx_px * factor, fy_px=camera.fy_px * factor)


def rectified_points(frames: Iterable[TrackedFrame], rectifier: Rectifier) -> Iterator[TrackedFrame]:
    """The frames with their points in pixels of the rectified images; points outside of them are omitted."""
    camera = rectifier.rig.left
    size = np.array([camera.width_px, camera.height_px])
    for frame in frames:
        left_px, right_px = rectifier.points(frame.points.left_px, frame.points.right_px)
        is_inside = ((left_px > 0) & (left_px < size) & (right_px > 0) & (right_px < size)).all(axis=1)
        points = PairPoints(frame.points.number[is_inside], left_px[is_inside], right_px[is_inside])
        yield frame._replace(points=points)


def tracked(frames: Iterable[Frame]) -> Iterator[TrackedFrame]:
    """The points of frames with right images."""
    tracks = FeatureTracks()
    for frame in frames:
        if frame.right is not None:
            yield tracks.add(frame.left, whole_image(frame.right), frame.time_s)


def simulated_drive(scenario: str, *, seed: int, seconds: float, cache: Path | None) -> TrackedDrive:
    """A simulated drive, from the folder `cache` if it is there."""
    path = None if cache is None else cache / f"{scenario}-{seed}-{seconds:g}.npz"
    if path is not None and path.exists():
        frames = _load(path)
    else:
        frames = tuple(tracked(SimulatedDrive.of(scenario, seed=seed, seconds=seconds).iter_frames()))
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            _save(frames, path)
    return TrackedDrive(f"{scenario}/{seed}", kitti_like_rig(), frames)


def recorded_drive(folder: Path, *, fps: float) -> TrackedDrive:
    """A drive of KITTI: left.mp4, right.mp4 and calib.txt of rectified cameras."""
    videos = [cv2.VideoCapture(str(folder / f"{side}.mp4")) for side in ("left", "right")]
    width, height = (int(videos[0].get(key)) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    rig, _ = load_rig(folder / "calib.txt", size_px=(width, height), is_grey="odometry" in str(folder))
    frames = list[Frame]()
    while True:
        images = [video.read() for video in videos]
        if not all(is_read for is_read, _ in images):
            return TrackedDrive(folder.name, rig, tuple(tracked(frames)))
        (_, left), (_, right) = images
        frames.append(Frame(len(frames), len(frames) / fps, np.asarray(left, np.uint8), np.asarray(right, np.uint8)))


def shifted(drive: TrackedDrive, error_px: FloatArray) -> TrackedDrive:
    """The drive with the disparity errors offset, curvature and slope (3,) removed from its right points."""
    camera = drive.rig.left
    frames = []
    for frame in drive.frames:
        points = frame.points
        u = (points.left_px[:, 0] - camera.cx_px) / (camera.width_px / 2)
        moved = points.right_px.copy()
        moved[:, 0] -= error_px[0] + error_px[1] * u**2 + error_px[2] * u
        frames.append(frame._replace(points=points._replace(right_px=moved)))
    return replace(drive, frames=tuple(frames))


def _save(frames: Sequence[TrackedFrame], path: Path) -> None:
    counts = [len(frame.points.number) for frame in frames]
    np.savez_compressed(
        path,
        count=np.array(counts),
        frame=np.array([[frame.time_s, frame.flow_px, frame.fraction_tracked] for frame in frames]),
        number=np.concatenate([frame.points.number for frame in frames]).astype(np.int32),
        left_px=np.concatenate([frame.points.left_px for frame in frames]).astype(np.float32),
        right_px=np.concatenate([frame.points.right_px for frame in frames]).astype(np.float32),
    )


def _load(path: Path) -> tuple[TrackedFrame, ...]:
    with np.load(path) as file:
        ends = np.cumsum(file["count"])[:-1]
        number = np.split(file["number"].astype(np.int64), ends)
        left_px, right_px = (np.split(file[name].astype(np.float64), ends) for name in ("left_px", "right_px"))
        rows = file["frame"].tolist()
    return tuple(
        TrackedFrame(time_s, PairPoints(*points), flow_px, fraction_tracked)
        for (time_s, flow_px, fraction_tracked), *points in zip(rows, number, left_px, right_px, strict=True)
    )
