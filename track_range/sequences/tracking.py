"""Tracking recorded detections, frame by frame, with their images where there are any."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from track_range.detection.formats.detection_files import RecordedDetections
from track_range.foundation.arrays import FloatArray, Image
from track_range.sequences.find import SequenceFile
from track_range.tracking.offline_refinement import OfflineRefinement
from track_range.tracking.registry import checked_tracks
from track_range.tracking.tracker import RefinableTracker, Tracker
from track_range.tracking.tracks import Tracks
from track_range.video.frame import VideoError
from track_range.video.reader import VideoReader

_VIDEO_SUFFIXES = (".mp4", ".mkv", ".avi", ".mov", ".webm")

_MAX_OUTSIDE = 0.05
"""Share of boxes with their centres outside the images above which the user is told."""


@dataclass(frozen=True, slots=True)
class TrackedSequence:
    """The tracks of one sequence.

    Attributes:
        frames: of every frame.
        us_per_frame: time that tracking took, without reading images.
        notes: what the user should know.
    """

    frames: list[Tracks]
    us_per_frame: float
    notes: tuple[str, ...]


def images_of(sequence: SequenceFile, place: Path | None, *, is_alone: bool) -> Path | None:
    """The video, or folder of images, of a sequence; None = there is none.

    Args:
        sequence: whose.
        place: what the user named: the video itself, or a folder with NAME.mp4, NAME/ or NAME/img1/; None = only
            MOTChallenge's img1 beside the boxes counts.
        is_alone: there is no other sequence, so that `place`, or img1 in it, may be its folder of images.

    Raises:
        VideoError: `place` does not exist, or has nothing of that name.
    """
    if place is None:
        beside = sequence.path.parent.parent / "img1"
        return beside if sequence.path.parent.name == "det" and beside.is_dir() else None
    if place.is_file() and is_alone:
        return place
    if not place.exists():
        raise VideoError(f"{place}: there is no such file or folder: check the name.")
    named = [place / sequence.name / "img1", place / sequence.name, *_videos(place, sequence.name)]
    named += [place / "img1", place] if is_alone else []
    if found := next((each for each in named if each.exists()), None):
        return found
    raise VideoError(f"{place}: no {sequence.name}.mp4 and no folder {sequence.name} in it.")


def _videos(place: Path, name: str) -> list[Path]:
    """Videos of this name in a folder, the usual suffixes first; cameras write .MP4 too."""
    found = [each for each in place.iterdir() if each.stem == name] if place.is_dir() else []
    return [each for suffix in _VIDEO_SUFFIXES for each in sorted(found) if each.suffix.lower() == suffix]


def track_sequence(
    recorded: RecordedDetections,
    tracker: Tracker,
    *,
    n_frames: int,
    fps: float,
    images: Path | None = None,
    is_online: bool = False,
    advance: Callable[[], None] = lambda: None,
) -> TrackedSequence:
    """Run a fresh tracker through a sequence.

    Args:
        recorded: boxes by frame.
        tracker: gives them identities.
        n_frames: frames to go through; those without boxes too.
        fps: of frames whose time no video tells; a video's own rate wins.
        images: video or folder whose frame k is that of the boxes' frame k.
        is_online: output as of a live run; else refined by later frames (`tracking.offline_refinement`).
        advance: called after each frame.

    Raises:
        VideoError: the images cannot be read.
    """
    video = None if images is None else VideoReader(images, folder_fps=fps)
    refinable = tracker if isinstance(tracker, RefinableTracker) else None
    refinement, online, spent_s, image_counts = OfflineRefinement(), [], 0.0, _ImageCounts()
    for frame, time_s, image in _frames(video, n_frames, fps):
        detections = recorded.at(frame)
        image_counts.add(detections.xyxy_px, image)
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
    notes = () if video is None else (*video.notes, *image_counts.notes(images, n_frames))
    return TrackedSequence(frames, 1e6 * spent_s / max(n_frames, 1), notes)


class _ImageCounts:
    """Counts the frames that had images, and the boxes that are not in them."""

    def __init__(self) -> None:
        self._n_frames = self._n_boxes = self._n_outside = 0
        self._size_text = ""

    def add(self, xyxy_px: FloatArray, image: Image | None) -> None:
        """One frame's boxes (N, 4)."""
        if image is None:
            return
        height, width = image.shape[:2]
        centre = (xyxy_px[:, :2] + xyxy_px[:, 2:]) / 2
        outside = (centre < -0.5) | (centre > [width - 0.5, height - 0.5])
        self._n_frames += 1
        self._n_boxes += len(centre)
        self._n_outside += int(np.count_nonzero(outside.any(axis=1)))
        self._size_text = f"{width} x {height}"

    def notes(self, images: Path | None, n_frames: int) -> tuple[str, ...]:
        """What the user should know of the images of `n_frames` frames."""
        found = []
        if self._n_frames < n_frames:
            found.append(f"{images}: images of {self._n_frames} of {n_frames} frames; the others are tracked without.")
        if self._n_outside > _MAX_OUTSIDE * self._n_boxes:
            found.append(
                f"{self._n_outside} of {self._n_boxes} boxes lie outside the images of {self._size_text} pixels: "
                "are these the images that the boxes were found in?"
            )
        return tuple(found)


def _frames(video: VideoReader | None, n_frames: int, fps: float) -> Iterator[tuple[int, float, Image | None]]:
    """Number, time and image of each frame; times go on at `fps` where the video has no frame."""
    next_frame, time_s = 0, -1 / fps
    if video is not None:
        fps, start_s = video.fps, None
        for read in video:
            frame = read.index
            # frames that cannot be decoded come before the first time that is known
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
