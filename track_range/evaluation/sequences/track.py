"""Tracking of recorded detections; no video or rig is needed, and no distances are measured.

MOTChallenge's files of results count frames and pixels from 1, KITTI's, which have fewer classes,
from 0.
"""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from track_range.detection.classes import ROAD_CLASSES, road_class_ids
from track_range.detection.detections import Detections
from track_range.detection.formats.detection_files import RecordedDetections, read_detections
from track_range.detection.formats.tables.box_table import NO_FACTS
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.video_labels.kitti import KITTI_TYPE_OF, kitti_line
from track_range.detection.formats.video_labels.mot import mot_lines
from track_range.evaluation.sequences import find
from track_range.evaluation.sequences.settings import TrackSettings
from track_range.foundation.arrays import BoolArray, FloatArray, Image
from track_range.foundation.errors import UsageError
from track_range.foundation.files.input_files import readable, real_path
from track_range.foundation.files.output_files import (
    OutputError,
    locked_output,
    make_folder,
    write_text,
)
from track_range.foundation.progress import FrameProgress, no_frame_progress
from track_range.recording.sources.open_video import open_video
from track_range.recording.video.frame import VideoError
from track_range.recording.video.recorded_video import RecordedVideo
from track_range.run.export.source import facts_of_video
from track_range.run.options.detection import check_tracker
from track_range.run.options.opened import class_names, open_tracker_options
from track_range.tracking.offline_refinement import OfflineRefinement
from track_range.tracking.registry import (
    ObjectTracker,
    RefinableTracker,
    checked_tracks,
    create_tracker,
)
from track_range.tracking.tracks import Tracks

DEFAULT_FPS = 10.0  # frame rate of sequences without seqinfo.ini: KITTI's
# RRC's files have no classes
_CLASS_OF_FOLDER = {"car": "car", "pedestrian": "person", "cyclist": "bicycle"}


@dataclass(frozen=True, slots=True)
class TrackedFile:
    """One tracked sequence."""

    name: str
    n_frames: int
    n_boxes: int
    n_tracks: int
    us_per_frame: float  # mean time of the tracker, microseconds


@dataclass(frozen=True, slots=True)
class TrackedFiles:
    """Result of `track`."""

    done: tuple[TrackedFile, ...]
    failed: Mapping[str, str]  # reason by name of the sequences that could not be read


def track(
    settings: TrackSettings,
    progress: FrameProgress = no_frame_progress,
    note: Callable[[str], object] = lambda _note: None,
) -> TrackedFiles:
    """Track every sequence and write `mot/NAME.txt`, with frames counted from 1 as MOTChallenge
    defines.

    If one of several sequences cannot be read, the other sequences are tracked; a single unreadable
    sequence raises LabelFileError or VideoError, invalid settings raise TrackerError, ModelError,
    ClassNameError or UsageError, `out` OutputError or FolderLockError.
    """
    check_tracker(settings.tracker, settings.reid)
    sequences = find.find_sequences(settings.detections, "det")
    class_id = _class_of(settings)
    is_single = len(sequences) == 1
    all_images = [
        images_of(sequence, settings.images, is_single=is_single) for sequence in sequences
    ]
    if settings.reid is not None and None in all_images:
        raise UsageError("--reid needs the images of every sequence; give --images.")
    _check_overwritten(sequences, settings.out)
    tracker_options = replace(
        open_tracker_options(settings.reid, min_score=settings.tracker_min_score), is_smoothed=True
    )
    reid_notes = () if tracker_options.reid is None else tracker_options.reid.notes
    for sentence in (*find.ignored_files_note(settings.detections, sequences), *reid_notes):
        note(sentence)
    done, failed = [], {}
    with locked_output(settings.out):
        make_folder(settings.out / find.MOT_FOLDER)
        if settings.kitti:
            make_folder(settings.out / find.KITTI_FOLDER)
        for sequence, images in zip(sequences, all_images, strict=True):
            try:
                recorded = _read(sequence.path, class_id, settings, images)
                tracker = create_tracker(settings.tracker, tracker_options)
                tracked, notes = _track_one(sequence, recorded, images, tracker, settings, progress)
            except (LabelFileError, VideoError) as error:
                if is_single:
                    raise
                failed[sequence.name] = str(error)
                note(f"{sequence.name}: {error}")
            else:
                done.append(tracked)
                for sentence in notes:
                    note(f"{sequence.name}: {sentence}")
    return TrackedFiles(tuple(done), failed)


def _check_overwritten(sequences: Iterable[find.SequenceFile], out: Path) -> None:
    """OutputError if the result of a sequence would overwrite its detections."""
    for sequence in sequences:
        folders = (find.MOT_FOLDER, find.KITTI_FOLDER)
        results = [real_path(out / folder / f"{sequence.name}.txt") for folder in folders]
        if real_path(sequence.path) in results:
            raise OutputError(
                f"{sequence.path}: the result would overwrite this input; choose another --out."
            )


def _read(
    path: Path, class_id: int, settings: TrackSettings, images: Path | None
) -> RecordedDetections:
    """The boxes of a sequence, with notes for the user; an empty file is a sequence without
    boxes.
    """
    video = NO_FACTS if images is None else facts_of_video(images)
    video = replace(video, names=class_names(settings.names) or ())
    recorded = read_detections(path, default_class_id=class_id, form=settings.form, video=video)
    # the first note is on the detected format
    detections, notes = recorded.detections, recorded.notes[1:]
    if settings.reid is not None:  # its embeddings replace those of the file
        detections = Detections.of(detections.xyxy_px, detections.score, detections.class_id)
    if recorded.has_classes and settings.road_class is not None:
        notes = (
            *notes,
            f"--classes {settings.road_class} is ignored: the rows of {path.name} contain classes.",
        )
    return replace(recorded, detections=detections, notes=notes)


def _class_of(settings: TrackSettings) -> int:
    if settings.road_class is None:
        path = real_path(settings.detections)  # `.` has no name
        words = [part.lower() for part in (path.name, path.parent.name)]
        name = next(
            (_CLASS_OF_FOLDER[word] for word in words if word in _CLASS_OF_FOLDER), "person"
        )
        return ROAD_CLASSES.index(name)
    ids = road_class_ids(settings.road_class.split(","))
    if len(ids) != 1:
        raise UsageError(
            f"--classes {settings.road_class}: expected one class for rows without a "
            "class, such as car."
        )
    return int(ids[0])


def _track_one(
    sequence: find.SequenceFile,
    recorded: RecordedDetections,
    images: Path | None,
    tracker: ObjectTracker,
    settings: TrackSettings,
    progress: FrameProgress,
) -> tuple[TrackedFile, tuple[str, ...]]:
    """Track a sequence and write its files; returns its results and the notes for the user."""
    last = int(recorded.frame[-1]) + 1 if len(recorded.frame) else 0
    n_frames = max(sequence.info.n_frames or 0, last)
    with progress(n_frames) as advance:
        tracked = track_sequence(
            recorded,
            tracker,
            n_frames=n_frames,
            fps=settings.fps or sequence.info.fps or DEFAULT_FPS,
            images=images,
            is_online=settings.online,
            advance=advance,
        )
    frames, notes = tracked.frames, (*recorded.notes, *tracked.notes)
    lines = (
        line
        for index, tracks in enumerate(frames)
        for line in mot_lines(index, tracks.track_id, tracks.xyxy_px, tracks.score)
    )
    write_text(settings.out / find.MOT_FOLDER / f"{sequence.name}.txt", "".join(lines))
    if settings.kitti:
        notes = (*notes, *_write_kitti(frames, settings.out, sequence.name))
    track_ids = np.unique(np.concatenate([tracks.track_id for tracks in frames])) if frames else ()
    n_boxes = sum(len(tracks) for tracks in frames)
    return TrackedFile(
        sequence.name, n_frames, n_boxes, len(track_ids), tracked.us_per_frame
    ), notes


def _write_kitti(frames: Sequence[Tracks], out: Path, name: str) -> tuple[str, ...]:
    """Write kitti/NAME.txt, frames from 0; returns a note about boxes omitted because KITTI has no
    such class.
    """
    file = Path(find.KITTI_FOLDER) / f"{name}.txt"
    unknown_m = (math.nan, math.nan, math.nan)
    rows = [
        kitti_line(frame, track_id, KITTI_TYPE_OF[ROAD_CLASSES[i]], box, unknown_m, score)
        for frame, tracks in enumerate(frames)
        for track_id, i, box, score in zip(
            *(
                column.tolist()
                for column in (tracks.track_id, tracks.class_id, tracks.xyxy_px, tracks.score)
            ),
            strict=True,
        )
        if ROAD_CLASSES[i] in KITTI_TYPE_OF
    ]
    write_text(out / file, "".join(rows))
    class_id = np.concatenate([np.zeros(0, np.int64), *(tracks.class_id for tracks in frames)])
    omitted = [i for i in np.unique(class_id) if ROAD_CLASSES[i] not in KITTI_TYPE_OF]
    if not omitted:
        return ()
    n, names = int(np.isin(class_id, omitted).sum()), ", ".join(ROAD_CLASSES[i] for i in omitted)
    return (
        f"{n} of {len(class_id)} boxes are omitted from {file.as_posix()}: KITTI has no class "
        f"for {names}.",
    )


# suffixes of videos, in the order of preference
_VIDEO_SUFFIXES = (".mp4", ".mkv", ".avi", ".mov", ".webm")
# fraction of boxes with centres outside the images above which the user is warned
_MAX_OUTSIDE = 0.05


@dataclass(frozen=True, slots=True)
class TrackedSequence:
    """The tracks of every frame of one sequence, and notes for the user."""

    frames: list[Tracks]
    us_per_frame: float  # mean time of tracking in microseconds, without reading images
    notes: tuple[str, ...]


def images_of(sequence: find.SequenceFile, path: Path | None, *, is_single: bool) -> Path | None:
    """The video or folder of images of a sequence; None = no images.

    `path` is the user's video, or a folder with NAME.mp4, NAME/ or NAME/img1/; without it, only
    MOTChallenge's img1 next to the boxes is used. If there is no other sequence (`is_single`),
    `path` or `path`/img1 may be the images. VideoError if `path` does not exist, or contains no
    images of this sequence.
    """
    if path is None:
        neighbour = sequence.path.parent.parent / "img1"
        return neighbour if sequence.path.parent.name == "det" and neighbour.is_dir() else None
    if path.is_file() and is_single:
        return path
    if not path.exists():
        raise VideoError(f"{path}: no such file or folder; check the name.")
    candidates = [
        path / sequence.name / "img1",
        path / sequence.name,
        *_videos(path, sequence.name),
    ]
    candidates += [path / "img1", path] if is_single else []
    if images := next((candidate for candidate in candidates if candidate.exists()), None):
        return images
    raise VideoError(
        f"{path}: expected {sequence.name}.mp4 or a folder {sequence.name}, found neither."
    )


def _videos(folder: Path, name: str) -> list[Path]:
    """Videos with this stem in a folder, by preference of the suffix, which may be in upper
    case.
    """
    with readable(folder, VideoError):
        files = [file for file in folder.iterdir() if file.stem == name] if folder.is_dir() else []
    return [
        file
        for suffix in _VIDEO_SUFFIXES
        for file in sorted(files)
        if file.suffix.lower() == suffix
    ]


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
    """Run a new tracker on `n_frames` frames, with the images of a video or folder if `images` is
    given.

    `fps` applies if no video states a frame rate. The output is as in a live run (`is_online`), or
    refined with later frames (`tracking.offline_refinement`). `advance` is called after each frame.
    VideoError if the images cannot be read.
    """
    video = None
    if images is not None:
        video = open_video(images, fps=fps if images.is_dir() else None)
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
    frames = (
        online
        if is_online
        else refinement.refine(refinable.track_activation_threshold if refinable else None)
    )
    spent_s += time.perf_counter() - began_s
    notes = () if video is None else (*video.notes, *_image_notes(with_image, images, n_frames))
    return TrackedSequence(frames, 1e6 * spent_s / max(n_frames, 1), notes)


def _size_and_outside(xyxy_px: FloatArray, image: Image) -> tuple[str, BoolArray]:
    """The size of the image of a frame in words, and (N,) whether the centres of its boxes are
    outside the image.
    """
    height, width = image.shape[:2]
    centre = (xyxy_px[:, :2] + xyxy_px[:, 2:]) / 2
    outside = (centre < -0.5) | (centre > [width - 0.5, height - 0.5])
    return f"{width} x {height}", np.asarray(outside.any(axis=1))


def _image_notes(
    with_image: Sequence[tuple[str, BoolArray]], images: Path | None, n_frames: int
) -> Iterator[str]:
    if len(with_image) < n_frames:
        yield (
            f"{images}: found images for {len(with_image)} of {n_frames} frames; the other frames "
            "use boxes only."
        )
    n_boxes = sum(len(is_outside) for _, is_outside in with_image)
    n_outside = sum(int(is_outside.sum()) for _, is_outside in with_image)
    if n_outside > _MAX_OUTSIDE * n_boxes:
        yield (
            f"{n_outside} of {n_boxes} boxes are outside the images of {with_image[-1][0]} px; "
            "check that boxes and images belong together."
        )


def _frames(
    video: RecordedVideo | None, n_frames: int, fps: float
) -> Iterator[tuple[int, float, Image | None]]:
    """Number, time and image of each frame; frames that the video lacks get interpolated times, or
    times at `fps`.
    """
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
