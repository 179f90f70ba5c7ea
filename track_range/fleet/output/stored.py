"""What a clip keeps for a later run with other options: the boxes of its detector, and the path of
its camera.

detections.parquet has a row per box, and one with class_id -1 for an image without boxes; `image`
is a checksum of the image. Boxes count for the same image alone: a lens that is undistorted in
another way gives other images, in which the detector finds the boxes again.
"""

import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from track_range.detection.detections import Detections
from track_range.fleet.storage.errors import StorageError
from track_range.fleet.storage.location import Location
from track_range.foundation.files.output_files import write_text
from track_range.pipeline.frame_result import FrameResult
from track_range.results.events.event import Event, EventSettings
from track_range.results.events.files import EVENTS_FILE, events_in_parquet, events_text
from track_range.results.events.finder import events_of
from track_range.results.folder import DEFAULT_FPS
from track_range.results.formats.parquet_file import read_tracks_parquet
from track_range.results.formats.poses_file import POSE_COLUMNS, Poses, pose_values
from track_range.results.formats.run_info import RunInfo
from track_range.results.replay import frames_of_rows
from track_range.results.rows.rows import Rows
from track_range.results.writers import OpenWriters
from track_range.run.box_source import BoxSource
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame

if TYPE_CHECKING:
    import pyarrow as pa

# formats of which a file has the rows of tracks alone, without images and camera
OF_ROWS = frozenset(("csv", "mot"))
_NO_CAMERA = PinholeCamera.of_focal_length(1.0, (1, 1))
_Image = tuple[int, int]  # number of a frame and checksum of its image
_KEY = b"track_range.detections_key"
_EDGES = ("x1_px", "y1_px", "x2_px", "y2_px")


class StoredDetections:
    """The boxes of the detector in the images of a clip, of an earlier and of the present run."""

    def __init__(self, key: str, known: Mapping[_Image, Detections]) -> None:
        self._key, self._known = key, known
        self._used: dict[_Image, Detections] = {}

    @classmethod
    def read(cls, location: Location, key: str) -> "StoredDetections":
        """The boxes of an earlier run in a file, none if it is missing, damaged, or of another
        detector: `key` is the hash of all that determines the boxes in an image.
        """
        table = _read(location)
        is_same = table is not None and (table.schema.metadata or {}).get(_KEY) == key.encode()
        with suppress(ValueError, LookupError):
            return cls(key, dict(_boxes_of(table)) if table is not None and is_same else {})
        return cls(key, {})

    @property
    def is_changed(self) -> bool:
        """Whether the present run has used other images than the file has."""
        return bool(self._used) and self._used.keys() != self._known.keys()

    def source(self, boxes: BoxSource) -> BoxSource:
        """The source of boxes that asks the detector for new images alone."""
        prepare = boxes.prepare
        if prepare is None:  # recorded boxes
            return boxes

        def prepared(frame: Frame) -> Callable[[], Detections]:
            image = frame.index, zlib.crc32(np.ascontiguousarray(frame.left).data)
            known = self._known.get(image)
            detect = prepare(frame) if known is None else lambda: known
            return partial(self._noted, image, detect)

        return replace(boxes, detect=lambda frame: prepared(frame)(), prepare=prepared)

    def _noted(self, image: _Image, detect: Callable[[], Detections]) -> Detections:
        detections = self._used[image] = detect()
        return detections

    def write(self, path: Path) -> None:
        """Write the boxes of the present run."""
        import pyarrow as pa
        from pyarrow import parquet

        parts = []
        for image, boxes in sorted(self._used.items(), key=lambda item: item[0]):
            table = np.full(
                (max(len(boxes), 1), 9), [*image, *[0] * 5, -1, boxes.is_complete], float
            )
            if len(boxes):
                table[:, 2:8] = np.column_stack([boxes.xyxy_px, boxes.score, boxes.class_id])
            parts.append(table)
        values = np.concatenate([np.zeros((0, 9)), *parts]).T
        names = ("frame", "image", *_EDGES, "score", "class_id", "is_complete")
        integers = {"frame", "image", "class_id", "is_complete"}
        columns = {
            name: column.astype(np.int64) if name in integers else column
            for name, column in zip(names, values, strict=True)
        }
        table = pa.table(columns).replace_schema_metadata({_KEY: self._key.encode()})
        parquet.write_table(table, path, compression="zstd")


def _boxes_of(table: "pa.Table") -> Iterator[tuple[_Image, Detections]]:
    frame, image, class_id, is_complete = (
        table[name].to_numpy() for name in ("frame", "image", "class_id", "is_complete")
    )
    xyxy_px = np.stack([table[name].to_numpy() for name in _EDGES], axis=1)
    starts = np.flatnonzero(np.diff(frame, prepend=-1) | np.diff(image, prepend=-1))
    for rows in np.split(np.arange(len(frame)), starts[1:]):
        first, with_box = int(rows[0]), rows[class_id[rows] >= 0]
        boxes = Detections.of(
            xyxy_px[with_box], table["score"].to_numpy()[with_box], class_id[with_box]
        )
        key = int(frame[first]), int(image[first])
        yield key, replace(boxes, is_complete=bool(is_complete[first]))


def _read(location: Location) -> "pa.Table | None":
    """A Parquet file; None if it is missing or damaged."""
    from pyarrow import ArrowException, parquet

    with suppress(ArrowException, OSError, StorageError):
        system, path = location.arrow()
        with system.open_input_file(path) as stream:
            return parquet.ParquetFile(stream).read()
    return None


def write_poses(path: Path, poses: Iterable[tuple[float, ...]]) -> None:
    """Write the path of the camera, `pose_row` of its frames, with the columns of poses.csv."""
    import pyarrow as pa
    from pyarrow import parquet

    values = np.array([*poses]).reshape(-1, len(POSE_COLUMNS)).T
    arrays = [pa.array(column, from_pandas=True) for column in values]  # null = unknown
    columns = dict(zip(POSE_COLUMNS, arrays, strict=True))
    parquet.write_table(pa.table(columns | {"frame": arrays[0].cast("int64")}), path)


def pose_row(result: FrameResult) -> tuple[float, ...]:
    """The pose of the camera in a frame, NaN = unknown."""
    return (result.index, result.time_s, *pose_values(result))


def write_of_rows(tracks: Path, events: Location, names: Iterable[str]) -> list[Path]:
    """The files of formats in `OF_ROWS`, with events.csv, written beside the rows of a clip."""
    rows = _rows(tracks)
    frames = np.unique(rows["frame"]).tolist()
    methods = rows.methods_measured
    info = RunInfo(camera=_NO_CAMERA, rig=None, fps=DEFAULT_FPS, settings={}, methods=methods)
    with OpenWriters(sorted(names), info, tracks.parent) as writers:
        for result in frames_of_rows(rows, frames, methods, DEFAULT_FPS):
            writers.write(result)
    system, path = events.arrow()
    with system.open_input_file(path) as stream:
        text = events_text(events_in_parquet(stream, events))
    write_text(tracks.parent / EVENTS_FILE, text)
    return [tracks.parent / name for name in (*writers.files, EVENTS_FILE)]


def metadata_of(path: Path) -> dict[str, str]:
    """Metadata of the rows of a clip, for its events."""
    from pyarrow import parquet

    metadata = parquet.read_schema(path).metadata or {}
    return {key.decode(): value.decode() for key, value in metadata.items()}


def _rows(path: Path) -> Rows:
    rows = Rows(read_tracks_parquet(path))
    return rows.select(np.argsort(rows["frame"], kind="stable"))


def stored_events(
    tracks: Path, poses: Location, settings: EventSettings
) -> tuple[Event, ...] | None:
    """The events in the rows of a clip; None if its path is missing. OutputError: the rows cannot
    be read.
    """
    table = _read(poses)
    if table is None:
        return None
    frame, time_s, x_m, y_m, heading_deg, *sigmas = (
        table[name].to_numpy() for name in POSE_COLUMNS[:8]
    )
    path = Poses(frame, time_s, x_m, y_m, heading_deg, np.stack(sigmas, axis=1))
    rows = _rows(tracks)
    frames = frame.astype(int).tolist()
    return events_of(
        frames_of_rows(rows, frames, rows.methods_measured, DEFAULT_FPS, path), settings
    )
