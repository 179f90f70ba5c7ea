"""ClipRecord: the row of a clip in clips.parquet."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pyarrow as pa

Row = dict[str, Any]  # values of a record by column
SCHEMA_VERSION = 1  # of clips.parquet; increased when a column changes its meaning or is removed

ERROR_FIGURES = (
    "median_relative_error_pct",
    "mean_relative_error_pct",
    "bias_pct",
    "within_25_percent",
    "delta_1_25",
    "within_1_sigma",
    "within_2_sigma",
)
"""Figures of a method where there is ground truth."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClipRecord:
    """Result of a clip; the fields up to `finished_utc` are the first columns of clips.parquet, in
    this order.
    """

    clip: str
    status: str  # "done" or "failed"
    error: str = ""  # reason of the failure, one sentence; "" = none
    error_kind: str = ""  # `ErrorKind`; "" = none
    attempts: int = 1
    left: str = ""  # path or address of the video
    right: str = ""  # "" = one camera
    inputs: str = ""  # files of the clip with size and time of change, and its settings, as JSON
    # hash of the content of the files and of the clip's settings; "" = not read
    content_hash: str = ""
    settings_hash: str = ""  # of the options of tracks and events that all clips have in common
    # of these options by stage (`StageKeys`); "" = a result of an earlier version
    detections_key: str = ""
    tracks_key: str = ""
    events_key: str = ""
    outputs: Sequence[str] = ()  # files in runs/clip=NAME, by name and variant
    version: str = ""
    frames: int | None = None
    rows: int | None = None
    tracks: int | None = None
    events: int | None = None  # None = a result of an earlier version, without a file of events
    seconds: float | None = None  # duration of the processed video
    wall_s: float | None = None  # time for the clip in the worker
    # part of `wall_s` that is not the run: fetching, hashing, publishing
    overhead_s: float | None = None
    calibration: str = ""
    focal_px: float | None = None  # of the rectified left images
    focal_sigma: float | None = None  # relative standard deviation of `focal_px`; 0 = calibrated
    start_utc: str = ""  # UTC of the first frame, ISO 8601; "" = unknown
    warnings: Sequence[str] = ()
    node: str = ""
    # largest resident memory of the worker's process during the clip
    peak_memory_mb: float | None = None
    finished_utc: str = ""  # UTC of the end of the attempt, ISO 8601
    # time per frame; columns `STAGE_ms`
    stages_ms: Mapping[str, float] = field(default_factory=dict)
    # of the boxes; columns `METHOD_coverage`
    coverage: Mapping[str, float | None] = field(default_factory=dict)
    # with truth; `METHOD_FIGURE`
    errors: Mapping[str, Mapping[str, float | None]] = field(default_factory=dict)
    # of a pair, px; `alignment_FIGURE`
    alignment: Mapping[str, float | None] = field(default_factory=dict)
    # placeholders of the pattern, columns of the manifest
    labels: Mapping[str, str] = field(default_factory=dict)

    def row(self) -> Row:
        """Values by column; labels with the name of another column have the prefix `label_`."""
        row: Row = {name: getattr(self, name) for name in _FIXED}
        row |= {"warnings": list(self.warnings), "outputs": list(self.outputs)}
        row.update({f"{stage}_ms": value for stage, value in self.stages_ms.items()})
        row.update({f"{method}_coverage": value for method, value in self.coverage.items()})
        for method, figures in self.errors.items():
            row.update({f"{method}_{name}": value for name, value in figures.items()})
        row.update({f"alignment_{name}": value for name, value in self.alignment.items()})
        for name, text in self.labels.items():
            row[name if name not in row else f"label_{name}"] = text
        return row


_GROUPS = ("stages_ms", "coverage", "errors", "alignment", "labels")
_FIXED: Mapping[str, str] = {  # annotations of the columns that every clips.parquet has
    column.name: str(column.type) for column in fields(ClipRecord) if column.name not in _GROUPS
}


def utc_now() -> str:
    """This moment in ISO 8601, to the second."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def records_table(rows: Iterable[Mapping[str, Any]]) -> pa.Table:
    """Table of rows with the fixed columns first, then the figures and labels by name; null = not
    known.
    """
    import pyarrow as pa

    rows = list(rows)
    others = sorted({name for row in rows for name in row} - set(_FIXED))
    types = {name: _arrow_type(name, rows) for name in (*_FIXED, *others)}
    texts = {name for name, kind in types.items() if pa.types.is_string(kind)}
    plain = [
        {
            name: str(value) if name in texts and value is not None else value
            for name, value in row.items()
        }
        for row in rows
    ]
    metadata = {"track_range.fleet_schema_version": str(SCHEMA_VERSION)}
    return pa.Table.from_pylist(plain, schema=pa.schema(list(types.items()), metadata=metadata))


def label_columns(table: pa.Table) -> list[str]:
    """The columns with labels of the clips: texts that every clip may have, and no figure."""
    import pyarrow as pa

    return [
        field.name
        for field in table.schema
        if field.name not in _FIXED and pa.types.is_string(field.type)
    ]


def with_all_columns(table: pa.Table) -> pa.Table:
    """The table with the fixed columns that earlier versions did not have, null."""
    import pyarrow as pa

    for name in set(_FIXED) - set(table.column_names):
        table = table.append_column(name, pa.nulls(table.num_rows, _arrow_type(name, ())))
    return table


def _arrow_type(name: str, rows: Sequence[Mapping[str, Any]]) -> pa.DataType:
    import pyarrow as pa

    annotation = _FIXED.get(name, "")
    if annotation.startswith("Sequence"):
        return pa.list_(pa.string())
    if annotation:
        return (
            pa.int64()
            if "int" in annotation
            else pa.float64()
            if "float" in annotation
            else pa.string()
        )
    # a label with the name of a figure
    is_text = any(isinstance(row.get(name), str) for row in rows)
    is_figure = name.startswith("alignment_") or name.endswith(("_ms", "_coverage", *ERROR_FIGURES))
    return pa.float64() if is_figure and not is_text else pa.string()


def merged_table(base: pa.Table, rows: Mapping[str, Mapping[str, Any]]) -> pa.Table:
    """The table, not copied, with rows added, or replaced by name; columns of two types become
    text.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    added = records_table(rows.values())
    is_replaced = pc.is_in(base["clip"], value_set=pa.array(list(rows), pa.string()))
    if pc.any(is_replaced).as_py():
        base = base.filter(pc.invert(is_replaced))
    for name in set(base.column_names) & set(added.column_names):
        kind = added.schema.field(name).type
        if base.schema.field(name).type != kind:
            try:  # figures of earlier versions may be text
                base = base.set_column(base.column_names.index(name), name, base[name].cast(kind))
            except pa.ArrowInvalid:
                added = added.set_column(
                    added.column_names.index(name), name, added[name].cast(pa.string())
                )
    table = pa.concat_tables([base, added], promote_options="default")
    others = sorted(set(table.column_names) - set(_FIXED))
    return table.select([*_FIXED, *others]).replace_schema_metadata(added.schema.metadata)
