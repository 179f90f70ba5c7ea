"""Identities for recorded detections, without a video, a rig or distances."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from track_range.detection.classes import ROAD_CLASSES, road_class_ids
from track_range.detection.detections import Detections
from track_range.detection.formats.detection_files import RecordedDetections, read_detections
from track_range.detection.formats.kitti import LabelFileError
from track_range.foundation.errors import UsageError
from track_range.foundation.progress import FrameProgress, no_frame_progress
from track_range.results.output_files import OutputError, make_folder
from track_range.run.settings import check_tracker
from track_range.run.tracker_options import open_tracker_options
from track_range.sequences.files import write_kitti, write_mot
from track_range.sequences.find import (
    KITTI_FOLDER,
    MOT_FOLDER,
    SequenceFile,
    find_sequences,
    first_line,
    ignored_files_note,
)
from track_range.sequences.settings import TrackSettings
from track_range.sequences.tracking import images_of, track_sequence
from track_range.tracking.registry import create_tracker
from track_range.tracking.tracker import Tracker
from track_range.video.frame import VideoError

DEFAULT_FPS = 10.0
"""KITTI's frame rate; what a sequence without seqinfo.ini is taken to have."""

_CLASS_OF_FOLDER = {"car": "car", "pedestrian": "person", "cyclist": "bicycle"}
"""RRC's folders name the class that their rows do not."""


@dataclass(frozen=True, slots=True)
class TrackedFile:
    """One tracked sequence.

    Attributes:
        name: of the sequence.
        n_frames, n_boxes, n_tracks: counts over the sequence.
        us_per_frame: time of the tracker.
    """

    name: str
    n_frames: int
    n_boxes: int
    n_tracks: int
    us_per_frame: float


@dataclass(frozen=True, slots=True)
class TrackedFiles:
    """What `track` did.

    Attributes:
        done: sequences that were tracked.
        failed: sequences that could not be read, of several, each with the reason.
    """

    done: tuple[TrackedFile, ...]
    failed: Mapping[str, str]


def track(
    settings: TrackSettings,
    progress: FrameProgress = no_frame_progress,
    note: Callable[[str], object] = lambda _note: None,
) -> TrackedFiles:
    """Track every sequence and write `mot/NAME.txt`, frames counted from 1 as MOTChallenge defines.

    A sequence of several that cannot be read does not keep the others from being tracked.

    Args:
        settings: what is tracked, and how.
        progress: opened for each sequence.
        note: called with each note for the user.

    Raises:
        LabelFileError, VideoError: boxes or images of the only sequence cannot be read.
        TrackerError: the tracker cannot be made.
        ModelError: `reid` is no re-identification network.
        ClassNameError, UsageError: the class is unknown, or none is meant.
        OutputError: `out` cannot be written to.
    """
    check_tracker(settings.tracker, settings.reid)
    sequences = find_sequences(settings.detections, "det")
    class_id = _class_of(settings)
    places = [images_of(each, settings.images, is_alone=len(sequences) == 1) for each in sequences]
    if settings.reid is not None and None in places:
        raise UsageError("--reid needs images: give --images with the frames of every sequence.")
    _check_inputs_stay(sequences, settings)
    tracker_options = open_tracker_options(settings.reid)
    reid_notes = () if tracker_options.reid is None else tracker_options.reid.notes
    for sentence in (*ignored_files_note(settings.detections, sequences), *reid_notes):
        note(sentence)
    _make_folders(settings)
    done, failed = [], {}
    for sequence, images in zip(sequences, places, strict=True):
        try:
            recorded = _read(sequence.path, class_id, settings)
            tracker = create_tracker(settings.tracker, tracker_options)
            tracked, notes = _track_one(sequence, recorded, images, tracker, settings, progress)
        except (LabelFileError, VideoError) as error:
            if len(sequences) == 1:
                raise
            failed[sequence.name] = str(error)
            note(f"{sequence.name}: {error}")
        else:
            done.append(tracked)
            for sentence in notes:
                note(f"{sequence.name}: {sentence}")
    return TrackedFiles(tuple(done), failed)


def _make_folders(settings: TrackSettings) -> None:
    make_folder(settings.out / MOT_FOLDER)
    if settings.kitti:
        make_folder(settings.out / KITTI_FOLDER)


def _check_inputs_stay(sequences: Sequence[SequenceFile], settings: TrackSettings) -> None:
    """No result may take the place of what it is made from.

    Raises:
        OutputError: one would.
    """
    for each in sequences:
        for folder in (MOT_FOLDER, KITTI_FOLDER):
            if (settings.out / folder / f"{each.name}.txt").resolve() == each.path.resolve():
                raise OutputError(f"{each.path} would be overwritten with its own tracks: choose another --out.")


def _read(path: Path, class_id: int, settings: TrackSettings) -> RecordedDetections:
    """The boxes of a sequence, with notes for the user; an empty file means that nothing was found in it."""
    if not first_line(path):
        return RecordedDetections(np.zeros(0, np.int64), Detections.empty(), settings.form or "rrc", notes=())
    recorded = read_detections(path, unnamed_class_id=class_id, form=settings.form)
    found, notes = recorded.detections, recorded.notes[1:]  # the first says what the file was read as
    if settings.reid is not None:  # its embeddings replace those of the file
        found = Detections.of(found.xyxy_px, found.score, found.class_id)
    if recorded.names_classes and settings.road_class is not None:
        notes = (*notes, f"--classes {settings.road_class} does not count: the rows of {path.name} name their classes.")
    return replace(recorded, detections=found, notes=notes)


def _class_of(settings: TrackSettings) -> int:
    """Class of rows that name none."""
    if settings.road_class is None:
        place = settings.detections.resolve()  # `.` has a name too
        words = [part.lower() for part in (place.name, place.parent.name)]
        name = next((_CLASS_OF_FOLDER[word] for word in words if word in _CLASS_OF_FOLDER), "person")
        return ROAD_CLASSES.index(name)
    ids = road_class_ids(settings.road_class.split(","))
    if len(ids) != 1:
        raise UsageError(f"--classes {settings.road_class}: expected one class for rows that name none, such as car.")
    return int(ids[0])


def _track_one(
    sequence: SequenceFile,
    recorded: RecordedDetections,
    images: Path | None,
    tracker: Tracker,
    settings: TrackSettings,
    progress: FrameProgress,
) -> tuple[TrackedFile, tuple[str, ...]]:
    """Track a sequence and write its files; figures and notes."""
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
    write_mot(frames, settings.out, sequence.name)
    if settings.kitti:
        notes = (*notes, *write_kitti(frames, settings.out, sequence.name))
    identities = np.unique(np.concatenate([tracks.track_id for tracks in frames])) if frames else ()
    n_boxes = sum(len(tracks) for tracks in frames)
    return TrackedFile(sequence.name, n_frames, n_boxes, len(identities), tracked.us_per_frame), notes
