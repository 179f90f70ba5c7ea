"""`track-range track`: identities for boxes that a detector found, without a video, a rig or distances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console

from detection.classes import ROAD_CLASSES, road_class_ids
from detection.detection_files import DetectionForm, RecordedDetections, read_detections
from detection.detections import Detections
from track_range.commands.progress import frame_progress, say
from track_range.config import TrackerName, UsageError
from track_range.sequence_tracking import images_of, track_sequence
from track_range.sequences import KITTI_FOLDER, MOT_FOLDER, SequenceFile, find_sequences
from track_range.tables import Column, Grid, grid_of, rich_table
from track_range.tracker_options import new_tracker, open_descriptor
from track_range.written import OutputError, make_folder, write_text
from tracking.appearance import Descriptor
from tracking.mot_format import mot_lines
from tracking.tracks import Tracks

DEFAULT_FPS = 10.0
"""KITTI's frame rate; what a sequence without seqinfo.ini is taken to have."""

_BLANK_BYTES = 1024
"""A file of blanks that is longer is none that a detector left for an empty sequence."""

_KITTI_TYPE = {"person": "Pedestrian", "bicycle": "Cyclist", "car": "Car", "truck": "Truck"}
_CLASS_OF_FOLDER = {"car": "car", "pedestrian": "person", "cyclist": "bicycle"}
"""RRC's folders name the class that their rows do not."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackOptions:
    """What `track` is told.

    Attributes:
        detections: a file, or a folder of sequences (`track_range.sequences`).
        out: folder of the results.
        images: the video of the boxes, or a folder of videos or images (`sequence_tracking.images_of`); None = none.
        form: of the boxes; None = told from the files.
        road_class: of rows that name none; None = from the folder's name, else person.
        fps: None = seqinfo.ini's, else `DEFAULT_FPS`.
        tracker: with looks, or without.
        reid: network that describes boxes; None = descriptors of the file, else the built-in ones.
        is_online: each frame says what was known then, as a live run would.
        is_kitti_written: KITTI files are written beside the MOT ones.
    """

    detections: Path
    out: Path
    images: Path | None
    form: DetectionForm | None
    road_class: str | None
    fps: float | None
    tracker: TrackerName
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
    """Track every sequence and write `mot/NAME.txt`, frames counted as in the input.

    Raises:
        LabelFileError: boxes cannot be read.
        VideoError: images cannot.
        ModelError: `reid` is no re-identification network.
        ClassNameError, UsageError: the class is unknown, or none is meant.
        OutputError: `out` cannot be written to.
    """
    sequences = find_sequences(options.detections, "det")
    class_id = _class_of(options)
    places = [images_of(each, options.images, is_alone=len(sequences) == 1) for each in sequences]
    if options.reid is not None and None in places:
        raise UsageError("--reid describes pictures: give --images with the frames of every sequence.")
    _check_inputs_stay(sequences, options)
    descriptor = open_descriptor(options.tracker, options.reid)
    for note in () if descriptor is None else descriptor.notes:
        say(console, f"- {note}")
    make_folder(options.out / MOT_FOLDER)
    if options.is_kitti_written:
        make_folder(options.out / KITTI_FOLDER)
    done = []
    for sequence, images in zip(sequences, places, strict=True):
        recorded = _read(sequence.path, class_id, options.form)
        if options.reid is not None:  # what it says of looks wins over what the file says
            recorded = replace(recorded, detections=_without_looks(recorded.detections))
        done.append(_track_one(sequence, recorded, images, descriptor, options, console))
    console.print(rich_table(_grid(done)))
    say(console, f"Written: {options.out / MOT_FOLDER}")


def _check_inputs_stay(sequences: Sequence[SequenceFile], options: TrackOptions) -> None:
    """No result may take the place of what it is made from.

    Raises:
        OutputError: one would.
    """
    for each in sequences:
        for folder in (MOT_FOLDER, KITTI_FOLDER):
            if (options.out / folder / f"{each.name}.txt").resolve() == each.path.resolve():
                raise OutputError(f"{each.path} would be overwritten with its own tracks: choose another --out.")


def _read(path: Path, class_id: int, form: DetectionForm | None) -> RecordedDetections:
    """The boxes of a sequence; an empty file means that nothing was found in it."""
    if path.is_file() and path.stat().st_size < _BLANK_BYTES and not path.read_bytes().strip():
        nothing = np.zeros(0, np.int64)
        return RecordedDetections(nothing, Detections.empty(), first_frame=0, is_rectified=False, notes=("",))
    return read_detections(path, unnamed_class_id=class_id, form=form)


def _without_looks(found: Detections) -> Detections:
    return Detections.of(found.xyxy_px, found.score, found.class_id)


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
    descriptor: Descriptor | None,
    options: TrackOptions,
    console: Console,
) -> _Done:
    last = int(recorded.frame[-1]) + 1 if len(recorded.frame) else 0
    n_frames = max(sequence.info.n_frames or 0, last)
    with frame_progress(console, n_frames) as advance:
        tracked = track_sequence(
            recorded,
            new_tracker(options.tracker, descriptor),
            n_frames=n_frames,
            fps=options.fps or sequence.info.fps or DEFAULT_FPS,
            images=images,
            is_online=options.is_online,
            advance=advance,
        )
    for note in (*recorded.notes[1:], *tracked.notes):
        say(console, f"- {sequence.name}: {note}")
    frames, name = tracked.frames, f"{sequence.name}.txt"
    write_text(options.out / MOT_FOLDER / name, _mot_text(frames, first_frame=recorded.first_frame))
    if options.is_kitti_written:
        write_text(options.out / KITTI_FOLDER / name, _kitti_text(frames))
    identities = np.unique(np.concatenate([tracks.track_id for tracks in frames])) if frames else ()
    n_boxes = sum(len(tracks) for tracks in frames)
    return _Done(sequence.name, n_frames, n_boxes, len(identities), tracked.us_per_frame)


def _mot_text(frames: Sequence[Tracks], *, first_frame: int) -> str:
    return "".join(
        line for index, tracks in enumerate(frames) for line in mot_lines(tracks, index, first_frame=first_frame)
    )


def _kitti_text(frames: Sequence[Tracks]) -> str:
    """KITTI's result rows, frames from 0; classes that KITTI has no name for are left out."""
    rows = []
    for frame, tracks in enumerate(frames):
        kinds = [_KITTI_TYPE.get(ROAD_CLASSES[i]) for i in tracks.class_id]
        for kind, track_id, box, score in zip(kinds, tracks.track_id, tracks.xyxy_px, tracks.score, strict=True):
            if kind is not None:
                edges = " ".join(f"{edge:.2f}" for edge in box)
                rows.append(f"{frame} {track_id} {kind} -1 -1 -10 {edges} -1 -1 -1 -1000 -1000 -1000 -10 {score:.4f}\n")
    return "".join(rows)


def _grid(done: Sequence[_Done]) -> Grid:
    columns = [
        Column("frames", [float(each.n_frames) for each in done], "{:.0f}"),
        Column("boxes", [float(each.n_boxes) for each in done], "{:.0f}"),
        Column("tracks", [float(each.n_tracks) for each in done], "{:.0f}"),
        Column("us per frame", [each.us_per_frame for each in done], "{:.0f}"),
    ]
    return grid_of("Tracks", "sequence", [each.name for each in done], columns)
