"""`track-range track`: identities for boxes that a detector found, without a video, a rig or distances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console

from track_range.detection.classes import ROAD_CLASSES, road_class_ids
from track_range.detection.detections import Detections
from track_range.detection.formats.detection_files import DetectionForm, RecordedDetections, read_detections
from track_range.detection.formats.kitti import LabelFileError
from track_range.foundation.errors import UsageError
from track_range.report.tables import Column, Grid, grid_of
from track_range.results.output_files import OutputError, make_folder
from track_range.run.progress import frame_progress, say
from track_range.run.settings import check_tracker
from track_range.run.tracker_options import open_tracker_options
from track_range.sequences.files import write_kitti, write_mot
from track_range.sequences.find import (
    KITTI_FOLDER,
    MOT_FOLDER,
    SequenceFile,
    find_sequences,
    first_line,
    listed,
    passed_over,
)
from track_range.sequences.tracking import images_of, track_sequence
from track_range.terminal_tables import tell_grid
from track_range.tracking.registry import create_tracker
from track_range.tracking.tracker import TrackerOptions
from track_range.video.reader import VideoError

DEFAULT_FPS = 10.0
"""KITTI's frame rate; what a sequence without seqinfo.ini is taken to have."""

_CLASS_OF_FOLDER = {"car": "car", "pedestrian": "person", "cyclist": "bicycle"}
"""RRC's folders name the class that their rows do not."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackOptions:
    """What `track` is told.

    Attributes:
        detections: a file, or a folder of sequences (`track_range.sequences.find`).
        out: folder of the results.
        images: the video of the boxes, or a folder of videos or images (`sequence_tracking.images_of`); None = none.
        form: of the boxes; None = told from the files.
        road_class: of rows that name none; None = from the folder's name, else person.
        fps: None = seqinfo.ini's, else `DEFAULT_FPS`.
        tracker: a name of `tracking.registry`, or package.module:Class.
        reid: re-identification network; None = embeddings of the file, else the tracker's own.
        is_online: each frame says what was known then, as a live run would.
        is_kitti_written: KITTI files are written beside the MOT ones.
    """

    detections: Path
    out: Path
    images: Path | None
    form: DetectionForm | None
    road_class: str | None
    fps: float | None
    tracker: str
    reid: Path | None
    is_online: bool
    is_kitti_written: bool


@dataclass(frozen=True, slots=True)
class _Done:
    """One tracked sequence, for the table."""

    name: str
    n_frames: int
    n_boxes: int
    n_tracks: int
    us_per_frame: float


def track(options: TrackOptions, console: Console) -> None:
    """Track every sequence and write `mot/NAME.txt`, frames counted from 1 as MOTChallenge defines.

    A sequence of several that cannot be read does not keep the others from being tracked.

    Raises:
        LabelFileError: boxes cannot be read; of several sequences, after all have been tried.
        VideoError: images cannot.
        TrackerError: the tracker cannot be made.
        ModelError: `reid` is no re-identification network.
        ClassNameError, UsageError: the class is unknown, or none is meant.
        OutputError: `out` cannot be written to.
    """
    check_tracker(options.tracker, options.reid)
    sequences = find_sequences(options.detections, "det")
    class_id = _class_of(options)
    places = [images_of(each, options.images, is_alone=len(sequences) == 1) for each in sequences]
    if options.reid is not None and None in places:
        raise UsageError("--reid needs images: give --images with the frames of every sequence.")
    _check_inputs_stay(sequences, options)
    tracker_options = open_tracker_options(options.reid)
    reid_notes = () if tracker_options.reid is None else tracker_options.reid.notes
    for note in (*passed_over(options.detections, sequences), *reid_notes):
        say(console, f"- {note}")
    _make_folders(options)
    done, failed = [], []
    for sequence, images in zip(sequences, places, strict=True):
        try:
            recorded = _read(sequence.path, class_id, options)
            done.append(_track_one(sequence, recorded, images, tracker_options, options, console))
        except (LabelFileError, VideoError) as error:
            if len(sequences) == 1:
                raise
            say(console, f"- {sequence.name}: {error}")
            failed.append(sequence.name)
    if done:
        tell_grid(console, _grid(done))
        say(console, f"Written: {options.out / MOT_FOLDER}")
    if failed:
        told = f"{len(failed)} of {len(sequences)} sequences could not be tracked, see above: {listed(failed)}."
        raise LabelFileError(f"{options.detections}: {told}")


def _make_folders(options: TrackOptions) -> None:
    make_folder(options.out / MOT_FOLDER)
    if options.is_kitti_written:
        make_folder(options.out / KITTI_FOLDER)


def _check_inputs_stay(sequences: Sequence[SequenceFile], options: TrackOptions) -> None:
    """No result may take the place of what it is made from.

    Raises:
        OutputError: one would.
    """
    for each in sequences:
        for folder in (MOT_FOLDER, KITTI_FOLDER):
            if (options.out / folder / f"{each.name}.txt").resolve() == each.path.resolve():
                raise OutputError(f"{each.path} would be overwritten with its own tracks: choose another --out.")


def _read(path: Path, class_id: int, options: TrackOptions) -> RecordedDetections:
    """The boxes of a sequence, with notes for the user; an empty file means that nothing was found in it."""
    if not first_line(path):
        return RecordedDetections(np.zeros(0, np.int64), Detections.empty(), options.form or "rrc", notes=())
    recorded = read_detections(path, unnamed_class_id=class_id, form=options.form)
    found, notes = recorded.detections, recorded.notes[1:]  # the first says what the file was read as
    if options.reid is not None:  # what it says of looks wins over what the file says
        found = Detections.of(found.xyxy_px, found.score, found.class_id)
    if recorded.names_classes and options.road_class is not None:
        notes = (*notes, f"--classes {options.road_class} does not count: the rows of {path.name} name their classes.")
    return replace(recorded, detections=found, notes=notes)


def _class_of(options: TrackOptions) -> int:
    """Class of rows that name none."""
    if options.road_class is None:
        place = options.detections.resolve()  # `.` has a name too
        words = [part.lower() for part in (place.name, place.parent.name)]
        name = next((_CLASS_OF_FOLDER[word] for word in words if word in _CLASS_OF_FOLDER), "person")
        return ROAD_CLASSES.index(name)
    ids = road_class_ids(options.road_class.split(","))
    if len(ids) != 1:
        raise UsageError(f"--classes {options.road_class}: rows that name no class want one, such as car.")
    return int(ids[0])


def _track_one(
    sequence: SequenceFile,
    recorded: RecordedDetections,
    images: Path | None,
    tracker_options: TrackerOptions,
    options: TrackOptions,
    console: Console,
) -> _Done:
    last = int(recorded.frame[-1]) + 1 if len(recorded.frame) else 0
    n_frames = max(sequence.info.n_frames or 0, last)
    with frame_progress(console, n_frames) as advance:
        tracked = track_sequence(
            recorded,
            create_tracker(options.tracker, tracker_options),
            n_frames=n_frames,
            fps=options.fps or sequence.info.fps or DEFAULT_FPS,
            images=images,
            is_online=options.is_online,
            advance=advance,
        )
    frames, notes = tracked.frames, (*recorded.notes, *tracked.notes)
    write_mot(frames, options.out, sequence.name)
    if options.is_kitti_written:
        notes = (*notes, *write_kitti(frames, options.out, sequence.name))
    for note in notes:
        say(console, f"- {sequence.name}: {note}")
    identities = np.unique(np.concatenate([tracks.track_id for tracks in frames])) if frames else ()
    n_boxes = sum(len(tracks) for tracks in frames)
    return _Done(sequence.name, n_frames, n_boxes, len(identities), tracked.us_per_frame)


def _grid(done: Sequence[_Done]) -> Grid:
    columns = [
        Column("frames", [float(each.n_frames) for each in done], "{:.0f}"),
        Column("boxes", [float(each.n_boxes) for each in done], "{:.0f}"),
        Column("tracks", [float(each.n_tracks) for each in done], "{:.0f}"),
        Column("us per frame", [each.us_per_frame for each in done], "{:.0f}"),
    ]
    return grid_of("Tracks", "sequence", [each.name for each in done], columns)
