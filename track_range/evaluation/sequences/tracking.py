"""Tracking of recorded detections frame by frame, with images if there are any."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from track_range.detection.formats.detection_files import RecordedDetections
from track_range.evaluation.sequences.find import SequenceFile
from track_range.foundation.arrays import BoolArray, FloatArray, Image
from track_range.foundation.files.atomic_files import describe
from track_range.recording.frame import VideoError
from track_range.recording.open_video import open_video
from track_range.recording.recorded_video import RecordedVideo
from track_range.tracking.offline_refinement import OfflineRefinement
from track_range.tracking.registry import checked_tracks
from track_range.tracking.tracker import ObjectTracker, RefinableTracker
from track_range.tracking.tracks import Tracks

_VIDEO_SUFFIXES = (".mp4", ".mkv", ".avi", ".mov", ".webm")  # suffixes of videos, in the order of preference
_MAX_OUTSIDE = 0.05  # fraction of boxes with centres outside the images above which the user is warned


@dataclass(frozen=True, slots=True)
class TrackedSequence:
    """The tracks of every frame of one sequence, and notes for the user."""

    frames: list[Tracks]
    us_per_frame: float  # mean time of tracking in microseconds, without reading images
    notes: tuple[str, ...]


def images_of(sequence: SequenceFile, path: Path | None, *, is_single: bool) -> Path | None:
    """The video or folder of images of a sequence; None = no images.

    `path` is the user's video, or a folder with NAME.mp4, NAME/ or NAME/img1/; without it, only MOTChallenge's img1
    next to the boxes is used. If there is no other sequence (`is_single`), `path` or `path`/img1 may be the images.

    Raises:
        VideoError: `path` does not exist, or contains no images of this sequence.
    """
    if path is None:
        neighbour = sequence.path.parent.parent / "img1"
        return neighbour if sequence.path.parent.name == "det" and neighbour.is_dir() else None
    if path.is_file() and is_single:
        return path
    if not path.exists():
        raise VideoError(f"{path}: no such file or folder; check the name.")
    candidates = [path / sequence.name / "img1", path / sequence.name, *_videos(path, sequence.name)]
    candidates += [path / "img1", path] if is_single else []
    if images := next((candidate for candidate in candidates if candidate.exists()), None):
        return images
    raise VideoError(f"{path}: expected {sequence.name}.mp4 or a folder {sequence.name}, found neither.")


def _videos(folder: Path, name: str) -> list[Path]:
    """Videos with this stem in a folder, by preference of the suffix, which may be in upper case."""
    try:
        files = [file for file in folder.iterdir() if file.stem == name] if folder.is_dir() else []
    except OSError as error:
        raise VideoError(f"{folder}: the folder cannot be read ({describe(error)}); check its permissions.") from error
    return [file for suffix in _VIDEO_SUFFIXES for file in sorted(files) if file.suffix.lower() == suffix]


def track_sequence(
    recorded: RecordedDetections,
    tracker: ObjectTracker,
    *,
    n_frames: int,
    fps: float,
    images: Path | None = None,
    is_online: bool = False,
    advance: Callable[[], None] = lambda: None,
) -> TrackedSequence:
    """Run a tracker without tracks on a sequence; with images by number, from a video or folder, if there are any.

    Args:
        recorded: boxes by frame.
        tracker: the tracker.
        n_frames: number of frames, including frames without boxes.
        fps: frame rate, if there is no video that states one.
        images: the video or folder.
        is_online: output as in a live run; otherwise refined with later frames (`tracking.offline_refinement`).
        advance: called after each frame.

    Raises:
        VideoError: the images cannot be read.
    """
    video = None if images is None else open_video(images, folder_fps=fps)
    refinable = tracker if isinstance(tracker, RefinableTracker) else None
    refinement, online, spent_s, with_image = OfflineRefinement(), [], 0.0, []
    for frame, time_s, image in _frames(video, n_frames, fps):
        detections = recorded.at(frame)
        if image is not None:
            with_image.append(_size_and_outside(detections.xyxy_px, image))
        began_s = time.perf_counter()
        tracks = checked_tracks(tracker, tracker.update(detections, time_s, image))
        if is_online:
            online.append(tracks)
        else:
            refinement.add(time_s, tracks, refinable.tentative if refinable else Tracks.empty())
        spent_s += time.perf_counter() - began_s
        advance()
    began_s = time.perf_counter()
    frames = online if is_online else refinement.refine(refinable.track_activation_threshold if refinable else None)
    spent_s += time.perf_counter() - began_s
    notes = () if video is None else (*video.notes, *_image_notes(with_image, images, n_frames))
    return TrackedSequence(frames, 1e6 * spent_s / max(n_frames, 1), notes)


def _size_and_outside(xyxy_px: FloatArray, image: Image) -> tuple[str, BoolArray]:
    """The size of the image of a frame in words, and which (N,) of its boxes have centres outside of it."""
    height, width = image.shape[:2]
    centre = (xyxy_px[:, :2] + xyxy_px[:, 2:]) / 2
    outside = (centre < -0.5) | (centre > [width - 0.5, height - 0.5])
    return f"{width} x {height}", outside.any(axis=1)


def _image_notes(with_image: Sequence[tuple[str, BoolArray]], images: Path | None, n_frames: int) -> Iterator[str]:
    """Messages for the user about missing images and boxes outside the images."""
    if len(with_image) < n_frames:
        yield f"{images}: images for {len(with_image)} of {n_frames} frames; the others use boxes only."
    n_boxes = sum(len(is_outside) for _, is_outside in with_image)
    n_outside = sum(int(is_outside.sum()) for _, is_outside in with_image)
    if n_outside > _MAX_OUTSIDE * n_boxes:
        yield (
            f"{n_outside} of {n_boxes} boxes are outside the images of {with_image[-1][0]} px; check that boxes and "
            "images belong together."
        )


def _frames(video: RecordedVideo | None, n_frames: int, fps: float) -> Iterator[tuple[int, float, Image | None]]:
    """Number, time and image of each frame; frames that the video lacks get interpolated times, or times at `fps`."""
    next_frame, time_s = 0, -1 / fps
    if video is not None:
        fps, start_s = video.fps, None
        for read in video:
            frame = read.index
            # frames before this one may be undecodable, and have no known time
            start_s = read.time_s - frame / fps if start_s is None else start_s
            read_s = read.time_s - start_s
            if frame >= n_frames:
                break
            n_between = frame - next_frame + 1
            for i in range(1, n_between):
                yield next_frame + i - 1, time_s + i * (read_s - time_s) / n_between, None
            yield frame, read_s, read.image
            next_frame, time_s = frame + 1, read_s
    for frame in range(next_frame, n_frames):
        yield frame, time_s + (frame - next_frame + 1) / fps, None
