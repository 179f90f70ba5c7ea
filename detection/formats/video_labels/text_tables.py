"""MOTChallenge, KITTI, label CSV, tracks.csv and tracks.parquet as `BoxTable`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from track_range.detection.boxes import are_valid_boxes
from track_range.detection.formats.tables.box_table import BoxTable, VideoFacts, Written
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.tables.label_format import (
    PARQUET_MARK,
    LabelFormat,
    LabelStart,
)
from track_range.detection.formats.tables.limits import MAX_FRAME, MAX_ID, are_plausible_boxes
from track_range.detection.formats.tables.table_checks import (
    check_identities,
    ignored_note,
    omitted_regions_note,
)
from track_range.detection.formats.video_labels.csv_labels import (
    has_label_columns,
    read_csv_labels,
)
from track_range.detection.formats.video_labels.kitti import (
    UNKNOWN_M,
    kitti_line,
    kitti_type_of,
    read_kitti,
)
from track_range.detection.formats.video_labels.mot import mot_lines, read_mot
from track_range.detection.formats.video_labels.number_rows import is_number_row
from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.foundation.files.csv_tables import read_csv_table
from track_range.foundation.files.input_files import MAX_TABLE_BYTES, check_regular, quoted
from track_range.foundation.schemas.schema_version import check_schema_version

_COLUMNS = ("frame", "track_id", "score", "observed", "x1_px", "y1_px", "x2_px", "y2_px")
_DISTANCES = ("fused_m", "fused_sigma_m")


def read_mot_table(path: Path, video: VideoFacts) -> BoxTable:
    """The rows of a file of numbers; only some layouts have classes, such as ground truth since
    MOT16.

    Labels that are flagged as not evaluated (score 0) are regions. Errors: see `read_mot`.
    """
    rows = read_mot(path, video.n_frames, names=video.names)
    names, is_region = rows.class_name, rows.is_region
    is_truth = (
        np.array([name != "" for name in names], np.bool_) & np.isin(rows.score, (0, 1)).all()
    )
    return BoxTable.of(
        rows.frame,
        np.maximum(rows.track_id, -1),
        names,
        rows.xyxy_px,
        is_region=is_region,
        score=np.where(is_truth | (rows.score == -1), np.nan, rows.score),
        video=video,
        notes=rows.notes,
    )


def read_kitti_table(path: Path, video: VideoFacts) -> BoxTable:
    """The rows of KITTI tracking labels, of a result file, or of a folder of object files.

    The distance is the z of the location where there is no 3-D box, as in result files of
    track-range; the surface of a 3-D box has another distance (`ranging.truth.truth`). Errors:
    see `read_kitti`.
    """
    labels = read_kitti(path)
    is_region = labels.kitti_type == "DontCare"
    # what other programs write for an unknown box, 0 or -1, is no place in front of the camera
    is_surface = (labels.location_m[:, 2] > 0) & ~labels.has_3d_box & ~is_region
    is_known = (labels.has_3d_box | is_surface) & (labels.location_m > UNKNOWN_M).all(axis=1)
    location_m = np.where(is_known[:, None], labels.location_m, np.nan)
    return BoxTable.of(
        labels.frame,
        np.maximum(labels.track_id, -1),
        [str(name) for name in labels.kitti_type],
        labels.xyxy_px,
        score=labels.score,
        distance_m=np.where(is_surface, labels.location_m[:, 2], np.nan),
        location_m=location_m,
        video=video,
    )


def read_csv_table_of_labels(path: Path, video: VideoFacts) -> BoxTable:
    """The rows of a CSV of labels with distances; errors: see `read_csv_labels`."""
    labels = read_csv_labels(path)
    return BoxTable.of(
        labels.frame,
        labels.track_id,
        [str(name) for name in labels.class_name],
        labels.xyxy_px,
        distance_m=labels.distance_m,
        video=replace(video, is_rectified=True),
    )


def read_tracks_table(path: Path, video: VideoFacts) -> BoxTable:
    """The rows of a run's tracks.csv; the distance is the fused distance. LabelFileError if the
    file is invalid.
    """
    table = read_csv_table(path, LabelFileError, f"columns {', '.join(_COLUMNS)}, class")
    # boxes of another detector in these columns have no identities
    known = [name for name in _COLUMNS if name != "track_id" or name in table.header]
    table.require((*known, "class"))
    columns = {"track_id": np.full(len(table.rows), -1.0)}
    columns |= {name: table.finite(name) for name in known}
    columns |= {name: table.numbers(name) for name in _DISTANCES}
    return _table_of_rows(path, columns, table.texts("class"), video)


def read_parquet_table(path: Path, video: VideoFacts) -> BoxTable:
    """The rows of a run's tracks.parquet; the distance is the fused distance. LabelFileError if the
    file is invalid.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    check_regular(path, LabelFileError, "the tracks.parquet of a run", max_bytes=MAX_TABLE_BYTES)
    try:
        file = pq.ParquetFile(path)
        check_schema_version(path, file.schema_arrow.metadata, LabelFileError)
        names = file.schema_arrow.names
        if missing := [name for name in (*_COLUMNS, "class") if name not in names]:
            raise LabelFileError(
                f"{path}: expected the tracks.parquet of a run, but columns are missing: "
                f"{', '.join(missing)}."
            )
        known = [name for name in (*_COLUMNS, *_DISTANCES) if name in names]
        table = file.read([*known, "class"])
        cells = [
            np.asarray(table.column(name).cast(pa.float64()).to_numpy(), np.float64)
            for name in known
        ]
        classes = [str(name) for name in table.column("class").to_pylist()]
    except (pa.ArrowException, OSError, ValueError) as error:
        raise LabelFileError(
            f"{path}: expected the tracks.parquet of a run, found a damaged file."
        ) from error
    missing_m = dict.fromkeys(_DISTANCES, np.full(len(classes), np.nan))
    return _table_of_rows(path, missing_m | dict(zip(known, cells, strict=True)), classes, video)


def _table_of_rows(
    path: Path, columns: Mapping[str, FloatArray], classes: Sequence[str], video: VideoFacts
) -> BoxTable:
    boxes = np.stack([columns[name] for name in ("x1_px", "y1_px", "x2_px", "y2_px")], axis=1)
    is_valid: BoolArray = are_valid_boxes(boxes) & are_plausible_boxes(boxes)
    for name, lowest, highest in (("frame", 0, MAX_FRAME), ("track_id", -1, MAX_ID)):
        values = columns[name]
        is_integer = (values >= lowest) & (values <= highest) & (np.rint(values) == values)
        for row in np.flatnonzero(~is_integer)[:1].tolist():
            raise LabelFileError(
                f"{path}: expected an integer from {lowest} for {name}, got {quoted(values[row])}."
            )
    columns = {name: values[is_valid] for name, values in columns.items()}
    table = BoxTable.of(
        columns["frame"].astype(np.int64),
        columns["track_id"].astype(np.int64),
        [classes[row] for row in np.flatnonzero(is_valid).tolist()],
        boxes[is_valid],
        score=columns["score"],
        observed=columns["observed"] > 0,
        distance_m=columns["fused_m"],
        sigma_m=columns["fused_sigma_m"],
        video=replace(video, is_rectified=True),
        notes=ignored_note(path, int((~is_valid).sum()), "without width or height"),
    )
    check_identities(table, path)
    return table


def write_mot_table(table: BoxTable, path: Path) -> Written:
    """Write a table as MOTChallenge rows, with the score 1 where it is unknown, and without
    regions.
    """

    def lines(rows: BoxTable, frame: int) -> list[str]:
        return mot_lines(
            frame, rows.track_id, rows.xyxy_px, np.where(np.isnan(rows.score), 1.0, rows.score)
        )

    rows = table.select(~table.is_region)
    _write_frames(rows, path, lines)
    return Written(len(rows), omitted_regions_note(table))


def write_kitti_table(table: BoxTable, path: Path) -> Written:
    """Write a table as rows of KITTI tracking results; regions become DontCare.

    The location is written where it is known. Where only the distance is known, the location has
    that z and unknown x and y.
    """
    _write_frames(table, path, kitti_lines)
    return Written(len(table))


def kitti_lines(rows: BoxTable, frame: int) -> list[str]:
    """One line of KITTI tracking results per box of one frame, with its newline."""
    location_m = rows.location_m.copy()
    location_m[:, 2] = np.where(np.isnan(location_m[:, 2]), rows.distance_m, location_m[:, 2])
    columns = (rows.track_id.tolist(), rows.class_name.tolist(), rows.is_region.tolist())
    numbers = (rows.xyxy_px.tolist(), location_m.tolist(), rows.score.tolist())
    return [
        kitti_line(
            frame, track_id, "DontCare" if region else kitti_type_of(name), box, location, score
        )
        for track_id, name, region, box, location, score in zip(*columns, *numbers, strict=True)
    ]


def _write_frames(
    table: BoxTable, path: Path, lines_of: Callable[[BoxTable, int], list[str]]
) -> None:
    frames, starts = np.unique(table.frame, return_index=True)
    with path.open("w", encoding="utf-8", newline="\n") as file:
        for frame, rows in zip(
            frames.tolist(), np.split(np.arange(len(table)), starts[1:]), strict=False
        ):
            file.writelines(lines_of(table.select(rows), frame))


def _is_kitti(start: LabelStart) -> bool:
    is_number = start.first != "" and is_number_row(start.first)
    return "," not in start.first and not is_number


MOT = LabelFormat(
    name="mot",
    title="MOTChallenge",
    recognises=lambda start: True,
    priority=-40,
    read=read_mot_table,
    write=write_mot_table,
    has_classes=False,
    is_general=False,
    precision_px=0.01,
)
KITTI = LabelFormat(
    name="kitti",
    title="KITTI",
    recognises=_is_kitti,
    priority=-30,
    read=read_kitti_table,
    write=write_kitti_table,
    is_general=False,
    precision_px=0.005,
)
TRACKS = LabelFormat(
    name="tracks",
    title="a tracks.csv",
    recognises=lambda start: start.first.startswith("frame,"),
    priority=-20,
    read=read_tracks_table,
    is_general=False,
    is_of_run=True,
)
CSV = LabelFormat(
    name="csv",
    title="a CSV of labels",
    recognises=lambda start: "," in start.first and has_label_columns(start.path),
    priority=-10,
    read=read_csv_table_of_labels,
    is_general=False,
)
PARQUET = LabelFormat(
    name="parquet",
    title="a tracks.parquet",
    recognises=lambda start: start.first.startswith(PARQUET_MARK),
    read=read_parquet_table,
    is_of_run=True,
)
