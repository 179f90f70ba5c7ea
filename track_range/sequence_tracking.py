"""Tracking recorded boxes, frame by frame, with the images they were found in where those are at hand."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from detection.detection_files import RecordedDetections
from detection.detections import Image
from track_range.sequences import SequenceFile
from track_range.video import VideoError, VideoReader
from tracking.deepsort import DeepSortTracker
from tracking.lookahead import Recording
from tracking.tracks import Tracks

_VIDEO_SUFFIXES = (".mp4", ".mkv", ".avi", ".mov", ".webm")


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
        is_alone: there is no other sequence, so that `place` may be its folder of images.

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
    named = [place / sequence.name / "img1", place / sequence.name]
    named += [place / f"{sequence.name}{suffix}" for suffix in _VIDEO_SUFFIXES]
    if found := next((each for each in named if each.exists()), None):
        return found
    if is_alone:
        return place
    raise VideoError(f"{place}: no {sequence.name}.mp4 and no folder {sequence.name} in it.")


def track_sequence(
    recorded: RecordedDetections,
    tracker: DeepSortTracker,
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
        is_online: say of each frame what was known then; else what the whole sequence tells (`tracking.lookahead`).
        advance: told after each frame.

    Raises:
        VideoError: the images cannot be read.
    """
    video = None if images is None else VideoReader(images, folder_fps=fps)
    recording, online, spent_s, n_seen = Recording(), [], 0.0, 0
    for frame, time_s, image in _frames(video, n_frames, fps):
        n_seen += image is not None
        found = recorded.at(frame)
        began_s = time.perf_counter()
        tracks = tracker.update(found, time_s, image)
        if is_online:
            online.append(tracks)
        else:
            recording.add(time_s, tracks, tracker.tentative)
        spent_s += time.perf_counter() - began_s
        advance()
    began_s = time.perf_counter()
    frames = online if is_online else recording.completed(tracker.strong_score)
    spent_s += time.perf_counter() - began_s
    notes = () if video is None else video.notes
    if video is not None and n_seen < n_frames:
        notes = (*notes, f"{images}: images of {n_seen} of {n_frames} frames; the others are tracked without.")
    return TrackedSequence(frames, 1e6 * spent_s / max(n_frames, 1), notes)


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
