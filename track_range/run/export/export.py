"""export: a finished run or a label file in another format."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, cast

import cv2
import numpy as np

from track_range.detection.classes import map_to_road_classes
from track_range.detection.formats.label_formats import LABEL_FORMATS, label_format_of
from track_range.detection.formats.tables.box_table import (
    BoxTable,
    Written,
    frames_listed,
    image_name,
)
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.tables.label_format import LabelFormat
from track_range.detection.formats.titles import READ_TITLES
from track_range.detection.formats.video_labels.yolo_tracks import DATA_YAML, WRITTEN_MARK
from track_range.foundation.errors import UsageError
from track_range.foundation.files.atomic_files import atomic_path, writable, write_bytes
from track_range.foundation.files.folder_lock import is_locked
from track_range.foundation.files.input_files import counted
from track_range.foundation.files.output_files import OutputError, make_folder
from track_range.foundation.schemas.options import Options, option
from track_range.results.event_scenarios import write_event_scenarios
from track_range.results.events.event import Event, is_clip_name
from track_range.results.events.files import event_values
from track_range.results.folder import DEFAULT_FPS, DetectedCamera, RunFolder, every_of
from track_range.results.formats.adas.opendrive_file import ROAD_FILE, write_road
from track_range.results.formats.adas.openscenario_file import OpenScenarioWriter, write_scenario
from track_range.results.formats.adas.trajectories import Trajectories
from track_range.results.formats.poses_file import Poses, read_poses
from track_range.results.formats.run_info import RunInfo
from track_range.results.replay import frames_of_rows
from track_range.results.rows.rows import Rows
from track_range.results.writers import WRITERS, create_writer
from track_range.run.export.source import (
    boxes_of_labels,
    boxes_of_run,
    frames_of_run,
    frames_of_video,
    is_run,
    open_run,
    run_files,
)
from track_range.run.options.detection import NumberNamesField
from track_range.run.options.opened import class_names
from track_range.stereo.geometry.camera import PinholeCamera

MARKS: Mapping[str, bytes] = {
    "parquet": b"PAR1",
    "mcap": b"\x89MCAP",
    "rrd": b"RRF",
    "openscenario": b"<?xml",
    "opendrive": b"<?xml",
    "mf4": b"MDF     ",
    "openlabel": b'{"openlabel"',
    "osi": b"\n\6\b\3",
    "osi-gt": b"\n\6\b\3",
    "osi-mcap": b"\x89MCAP",
}
"""First bytes of the files that only result writers write, from the rows of a run; of OSI traces those
after the first length, which are the start of the version 3."""
_MARK_AT: Mapping[str, int] = {"osi": 4, "osi-gt": 4}

_Write = Callable[[BoxTable, Path], Written]

_JPEG_QUALITY = 95  # differences to the video are not visible
_WRITTEN_ENTRIES = frozenset({"labels", "images", DATA_YAML})  # of a folder that an export writes


def export_formats() -> tuple[str, ...]:
    """Names of the formats that are written: label formats, then formats of the rows of a run."""
    return (
        *(
            name
            for name, label_format in LABEL_FORMATS.usable.items()
            if label_format.write is not None
        ),
        *MARKS,
    )


class ExportSettings(Options):
    """Input, format and output of `track-range export`."""

    source: Annotated[
        Path,
        option(
            f"Result folder of a run, or labels: {READ_TITLES}.",
            metavar="RUN|LABELS",
            is_argument=True,
        ),
    ]
    to: Annotated[str, option("Format of the output.", metavar="FORMAT", choices=export_formats)]
    out: Annotated[Path, option("File to write; a folder for yolo.", metavar="PATH")]
    per_event: Annotated[
        bool,
        option(
            "With openscenario, a folder with a scenario of each event, NN-KIND-TRACK.xosc, whose "
            "parameters are the gap, the lateral offset and the speeds at its most critical moment."
        ),
    ] = False
    observed_only: Annotated[bool, option("Only detected boxes, no predicted ones.")] = False
    images: Annotated[
        bool,
        option(
            "With yolo, additional output of the video's frames as JPEG images, for training; "
            "images of a run are rectified like its boxes."
        ),
    ] = False
    video: Annotated[
        Path | None,
        option(
            "Video or image folder of a label file, for the image size and for --images.",
            metavar="VIDEO|DIR",
        ),
    ] = None
    first_frame: Annotated[
        int,
        option(
            "Number of the video's first frame in a label file.", metavar="N", ge=0, le=1_000_000
        ),
    ] = 0
    names: NumberNamesField = None


@dataclass(frozen=True, slots=True)
class Exported:
    """Result of an export: numbers of written boxes, images and scenarios, and notes for the
    user.
    """

    n_boxes: int | None  # None = of a road, or of scenarios
    n_images: int
    notes: tuple[str, ...]
    n_scenarios: int | None = None  # None = of other formats


def export(settings: ExportSettings) -> Exported:
    """Write a finished run or a label file in another format.

    A file or folder is replaced only if it has the format that is written. OutputError,
    LabelFileError, VideoError: an input cannot be used, or the output cannot be written;
    UsageError: options that contradict each other.
    """
    run, camera = None, None
    if is_run(settings.source):
        has_events = settings.per_event or settings.to == "openlabel"
        run, camera = open_run(settings.source, has_events=has_events)
    _check(settings, run)
    label_format = LABEL_FORMATS.usable.get(settings.to)
    if label_format is not None and label_format.write is not None:
        return _export_labels(settings, label_format, label_format.write, run, camera)
    if run is None:
        raise UsageError(
            f"--to {settings.to}: expected the result folder of a run, found a label file."
        )
    return _export_rows(settings, run, camera)


def _writer_of(name: str) -> str:
    """The writer of a format: the road is one of the files of a scenario."""
    return "openscenario" if name == "opendrive" else name


def _check(settings: ExportSettings, run: RunFolder | None) -> None:
    """Check the options, and that the output is neither an input nor in the folder of a run in
    progress.
    """
    if settings.to not in LABEL_FORMATS.usable and _writer_of(settings.to) not in WRITERS.names:
        raise UsageError(f"--to {settings.to}: this format is not available in this installation.")
    if settings.per_event and settings.to != "openscenario":
        raise UsageError(
            "--per-event: expected --to openscenario; other formats have no scenarios."
        )
    if settings.images and settings.to != "yolo":
        raise UsageError("--images: expected --to yolo; other formats have no folder for images.")
    if run is not None and (settings.video is not None or settings.first_frame):
        raise UsageError(
            "--video and --first-frame: expected labels, found a run, which states "
            "its video and frames."
        )
    if settings.images and run is not None and run.settings.get("anonymize"):
        raise UsageError(
            "--images: this run was anonymized, but these images would not be anonymized."
        )
    if (
        settings.images
        and run is not None
        and run.summary.get("frames_dropped", run.settings.get("realtime"))
    ):
        raise UsageError(
            "--images: expected a run of all frames, found one that dropped frames, "
            "which lack labels."
        )
    if settings.images and run is None and settings.video is None:
        raise UsageError("--images requires --video, the video that the labels belong to.")
    out = settings.out
    inputs = [settings.source, *run_files(settings.source), *filter(None, [settings.video])]
    if os.path.realpath(out) in {os.path.realpath(path) for path in inputs}:
        raise OutputError(f"{out}: this input would be overwritten; choose another --out.")
    if is_locked(out.parent):
        raise OutputError(
            f"{out}: a run is writing to this folder; wait for its end, or choose another folder."
        )


def _export_labels(
    settings: ExportSettings,
    label_format: LabelFormat,
    write: _Write,
    run: RunFolder | None,
    camera: PinholeCamera | None,
) -> Exported:
    if run is None:
        table = boxes_of_labels(
            settings.source,
            video=settings.video,
            first_frame=settings.first_frame,
            names=class_names(settings.names) or (),
        )
        notes: tuple[str, ...] = table.notes
    else:
        table, notes = boxes_of_run(run, camera), run.missing
    if settings.observed_only:
        table = table.select(table.observed)
    if label_format.has_classes and (n_unnamed := int(np.count_nonzero(table.class_name == ""))):
        table = table.with_class(0)  # person, as in MOTChallenge
        notes = (*notes, f"Boxes without a class in the input are written as person: {n_unnamed}.")
    if not label_format.is_folder:
        check_replaceable(settings.out, settings.to)
        with _output(settings.out), atomic_path(settings.out) as partial:
            written = write(table, partial)
            return Exported(written.n_boxes, 0, (*notes, *written.notes))
    with _replaced_folder(settings.out) as folder:
        written = write(table, folder)
        n_images = _write_images(settings, table, folder) if settings.images else 0
    return Exported(written.n_boxes, n_images, (*notes, *written.notes))


def _write_images(settings: ExportSettings, table: BoxTable, folder: Path) -> int:
    """Write the frames of the video, and remove the labels of frames that it does not have."""
    images, numbers = folder / "images", []
    images.mkdir()
    for index, image in (
        frames_of_run(settings.source)
        if settings.video is None
        else frames_of_video(settings.video)
    ):
        _, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        (images / image_name(table.video, index)).write_bytes(encoded.tobytes())
        numbers.append(index)
    if len(table) and not np.isin(table.frame, numbers).all():
        last = max(numbers, default=-1)
        raise OutputError(
            f"{settings.source}: expected boxes in the {len(numbers)} frames of the video, 0 to "
            f"{last}, found a box in frame {table.frame[~np.isin(table.frame, numbers)][0]}."
        )
    for file in (folder / "labels").iterdir():
        if not (images / file.with_suffix(".jpg").name).exists():
            file.unlink()
    return len(numbers)


def _export_rows(
    settings: ExportSettings, run: RunFolder, camera: PinholeCamera | None
) -> Exported:
    if camera is None:
        raise OutputError(
            f"{run.folder}: expected settings.yaml with the camera of the run, found none."
        )
    is_written = map_to_road_classes([str(name) for name in run.rows["class"]]) >= 0
    notes = run.missing
    if n_unknown := int(np.count_nonzero(~is_written)):
        notes = (*notes, f"{n_unknown} rows have no road class, and are not written.")
    if settings.observed_only:
        is_written &= run.rows["observed"]
    rows = run.rows.select(is_written)
    frames = frames_listed(boxes_of_run(run, camera))
    writer = create_writer(_writer_of(settings.to))
    if getattr(writer, "needs_images", False):
        raise UsageError(
            f"--to {settings.to}: expected a format of rows; this one needs the images: give "
            f"--write {settings.to} to a run."
        )
    is_scenario = isinstance(writer, OpenScenarioWriter)
    if not settings.per_event:
        check_replaceable(settings.out, settings.to)
    fps, poses = run.fps or DEFAULT_FPS, read_poses(run.folder)
    rate_hz = fps * every_of(run.settings)  # of the video
    if is_scenario or settings.to == "osi-gt":
        notes = (*notes, *_unplaced(rows, poses, "scenario" if is_scenario else "trace"))
    info = RunInfo(
        camera=camera,
        rig=None,
        fps=fps,
        methods=rows.methods_measured,
        settings=run.settings,
        start_utc_s=_start_utc_s(rows),
        provenance=run.provenance,
        events=lambda: [event_values(event) for event in run.events],
        mounting=DetectedCamera.model_validate(run.detected).mounting(),
        overlay=overlay if (overlay := run.folder / "overlay.mp4").is_file() else None,
    )
    with (
        _output(settings.out),
        tempfile.TemporaryDirectory(prefix=".export-", dir=settings.out.parent) as temporary,
    ):
        folder = Path(temporary)
        writer.open(info, folder)
        try:
            for result in frames_of_rows(
                rows, frames, rows.methods_measured, rate_hz, poses, info.mounting
            ):
                writer.write(result)
        finally:
            writer.close(run.summary)
        if not is_scenario:
            _move(folder / writer.files[0], settings.out)
            return Exported(len(rows), 0, notes)
        drive = cast(OpenScenarioWriter, writer).drive()
        if not settings.per_event:
            return Exported(
                None if settings.to == "opendrive" else len(rows),
                0,
                (*notes, *_write_drive(drive, settings)),
            )
        n_scenarios = _write_scenarios(drive, run.events, settings.out)
    if n_missing := len(run.events) - n_scenarios:
        lacks = "whose road user or camera has no known position"
        notes = (*notes, f"{counted(n_missing, 'event')}, {lacks}, without a scenario.")
    return Exported(None, 0, notes, n_scenarios)


def _unplaced(rows: Rows, poses: Poses | None, kind: str) -> Iterator[str]:
    """Notes for the user on what a file of a run in the frame `map` lacks; `kind` is its name."""
    if poses is None:
        yield (
            f"The {kind} is empty: the run has no positions of the camera (poses.csv), since its "
            "speed is unknown or --write leaves them out; run it again with --ego-speed, or with "
            "--write poses among the others."
        )
    elif len(rows) and not np.isfinite(rows["centre_world_x_m"]).any():
        yield (
            f"The {kind} has no road users: the rows of the run have no cuboids, as those of "
            "earlier versions; run it again."
        )


def _write_drive(drive: Trajectories, settings: ExportSettings) -> Iterator[str]:
    """Write a road, or a scenario with its road beside it, NAME.xodr; yields notes for the user."""
    out = settings.out
    if settings.to == "opendrive":
        if not write_road(out, drive):
            raise OutputError(
                f"{out}: the run shows no road, since no position of the camera is known."
            )
        return
    road = out.with_name(f"{out.stem}-road.xodr" if out.suffix == ".xodr" else f"{out.stem}.xodr")
    has_road = False
    if not out.exists() or out.is_file():  # no road beside a device
        check_replaceable(road, "opendrive")
        has_road = write_road(road, drive)
    write_scenario(out, drive, road=road.name if has_road else "")
    if has_road:
        yield f"The road of the scenario is {road}."


def _write_scenarios(drive: Trajectories, events: Sequence[Event], out: Path) -> int:
    """Write a scenario of each event to a folder, in place of those of an earlier export, and
    return their number.
    """
    make_folder(out)
    earlier = [file for file in out.glob("*.xosc") if is_clip_name(file.with_suffix(".mp4").name)]
    for file in (*earlier, out / ROAD_FILE):
        check_replaceable(file, "openscenario")
    for file in earlier:
        file.unlink()
    return len(write_event_scenarios(drive, events, out))


def _move(file: Path, out: Path) -> None:
    """Move a finished file to `out`; devices and symbolic links are written to, not replaced (see
    `atomic_path`).
    """
    with atomic_path(out) as partial:
        if partial == out:
            write_bytes(out, file.read_bytes())
        else:
            shutil.move(file, partial)


def _start_utc_s(rows: Rows) -> float | None:
    """UTC of time_s = 0 in seconds since 1970; None = unknown."""
    starts_s = rows["utc"] - rows["time_s"]
    known = starts_s[np.isfinite(starts_s)]
    return float(known[0]) if len(known) else None


@contextmanager
def _output(out: Path) -> Iterator[None]:
    """Context in which `out` is written, in a folder that is created; OutputError if it cannot be
    written.
    """
    make_folder(out.parent)
    with writable(out, OutputError):
        yield


@contextmanager
def _replaced_folder(out: Path) -> Iterator[Path]:
    """A new path next to `out`, which replaces `out`, a new folder or the folder of an export, at
    the end.
    """
    check_replaceable(out, "yolo")
    with (
        _output(out),
        tempfile.TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as temporary,
    ):
        folder = Path(temporary) / "new"
        yield folder
        if out.is_dir():
            out.rename(Path(temporary) / "old")
        folder.rename(out)


def check_replaceable(out: Path, name: str) -> None:
    """Check that an output does not exist, or has the format that replaces it; else OutputError."""
    if os.path.lexists(out) and not (
        _is_written_folder(out) if name == "yolo" else _has_format(out, name)
    ):
        expected = f"a new file, or a file in the format {name} to replace, found another format"
        if name == "yolo":
            expected = (
                "a new or empty folder, or a folder that contains only an earlier export, found "
                "something else"
            )
        raise OutputError(f"{out}: expected {expected}; choose another --out.")


def _is_written_folder(path: Path) -> bool:
    """Whether a path is an empty folder, or a folder that an export wrote."""
    try:
        entries = {entry.name for entry in path.iterdir()}
        if not entries:
            return True
        with (path / DATA_YAML).open(encoding="utf-8", errors="replace") as file:
            return entries <= _WRITTEN_ENTRIES and file.readline().strip() == WRITTEN_MARK
    except OSError:
        return False


def _has_format(path: Path, name: str) -> bool:
    """Whether a path is an empty file or has a format, or is a device such as /dev/null."""
    if path.exists() and not path.is_file() and not path.is_dir():
        return True
    try:
        with path.open("rb") as file:
            mark_at = _MARK_AT.get(name, 0)
            start = file.read(mark_at + len(max(MARKS.values(), key=len)))
        if name in MARKS:
            return not start or start.startswith(MARKS[name], mark_at)
        return not start or label_format_of(path).name == name
    except (OSError, LabelFileError):
        return False
