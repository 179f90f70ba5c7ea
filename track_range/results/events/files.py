"""events.csv and events.parquet: one row per event, with the columns `EVENT_COLUMNS`.

events.csv grows during the run: a row is added when an event has ended. At the end of the run both
files are written with all events in the order of their starts. Times are in seconds from the first
frame of the video; an empty cell, in Parquet null, = unknown or none.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from track_range.foundation.errors import UserError
from track_range.foundation.files.atomic_files import atomic_path, describe, writable
from track_range.foundation.files.csv_tables import read_csv_table
from track_range.foundation.files.input_files import (
    MAX_TABLE_BYTES,
    check_regular,
    first_line,
    quoted,
    shortened,
)
from track_range.foundation.files.numeric_text import number
from track_range.foundation.files.output_files import OutputError, write_text
from track_range.foundation.schemas.schema_version import check_schema_version
from track_range.results.events.event import (
    EVENT_COLUMNS,
    EVENT_KINDS,
    EVENT_NUMBERS,
    Event,
    EventKind,
)
from track_range.results.formats.row_file import RowFile, csv_text

if TYPE_CHECKING:
    import pyarrow as pa

EVENTS_FILE, EVENTS_PARQUET = "events.csv", "events.parquet"
NEEDED_COLUMNS = ("kind", "start_s", "end_s")  # those of other programs may lack the others
_MAX_TEXT = 2000
_MAX_ROWS = 1_000_000  # one event per second for 11 days


class EventFileError(UserError):
    """A file of events or contacts cannot be used; the message names the file and the row."""


class EventFiles:
    """events.csv and events.parquet of a run in progress; a context manager that closes files not
    closed by `finish`.

    `metadata` is the metadata of events.parquet (`Provenance.metadata`). OutputError: events.csv
    cannot be created; also raised by `add` and `finish` if a file cannot be written.
    """

    files = (EVENTS_FILE, EVENTS_PARQUET)

    def __init__(self, folder: Path, metadata: Mapping[str, str]) -> None:
        self._folder, self._metadata = folder, metadata
        with writable(folder / EVENTS_FILE, OutputError):
            self._rows = RowFile(folder / EVENTS_FILE, events_text(()))

    def __enter__(self) -> EventFiles:
        return self

    def __exit__(self, *_error: object) -> None:
        self._rows.close()

    def add(self, events: Sequence[Event]) -> None:
        """Add events that have ended to events.csv; if that fails, the file does not change."""
        if not events:
            return
        try:
            self._rows.write(_rows_text(events))
        except OSError as error:
            raise OutputError(
                f"{self._folder / EVENTS_FILE}: writing failed ({describe(error)})."
            ) from error

    def finish(self, events: Sequence[Event]) -> None:
        """Write both files with all events of the run."""
        self._rows.close()
        write_event_files(self._folder, events, self._metadata)


def write_event_files(folder: Path, events: Sequence[Event], metadata: Mapping[str, str]) -> None:
    """Write events.csv and events.parquet into a folder; OutputError if a file cannot be
    written.
    """
    write_text(folder / EVENTS_FILE, events_text(events))
    write_events_parquet(folder / EVENTS_PARQUET, events, metadata)


def write_events_parquet(path: Path, events: Sequence[Event], metadata: Mapping[str, str]) -> None:
    """Write events as Parquet, atomically; equal events give equal bytes. OutputError if the file
    cannot be written.
    """
    from pyarrow import parquet

    with writable(path, OutputError), atomic_path(path, is_flushed=False) as partial:
        parquet.write_table(events_table(events, metadata), partial, compression="zstd")


def events_text(events: Iterable[Event]) -> str:
    """Content of an events.csv."""
    return csv_text([EVENT_COLUMNS]) + _rows_text(events)


def _rows_text(events: Iterable[Event]) -> str:
    def text(name: str, value: Any) -> str:
        column = EVENT_NUMBERS.get(name)
        if value is None:
            return ""
        if column is None:
            return " ".join(str(value).split())  # one line per event
        return str(value) if column.is_integer else f"{value:.{column.decimals}f}"

    return csv_text(
        [text(name, value) for name, value in event_values(event).items()] for event in events
    )


def events_table(events: Sequence[Event], metadata: Mapping[str, str] | None = None) -> pa.Table:
    """Events as a table in full precision; null = unknown or none; the metadata of a field contains
    its unit.
    """
    import pyarrow as pa

    fields = []
    for name in EVENT_COLUMNS:
        column = EVENT_NUMBERS.get(name)
        kind = pa.string() if column is None else pa.int64() if column.is_integer else pa.float64()
        fields.append(
            pa.field(name, kind, metadata={"unit": column.unit} if column and column.unit else None)
        )
    schema = pa.schema(fields, metadata=dict(metadata or {}))
    return pa.Table.from_pylist([event_values(event) for event in events], schema=schema)


def event_values(event: Event) -> dict[str, Any]:
    """Values of an event by column, in full precision; None = unknown or none."""
    values = {
        name: getattr(event, "class_name" if name == "class" else name) for name in EVENT_COLUMNS
    }
    return {
        name: None if isinstance(value, float) and math.isnan(value) else value
        for name, value in values.items()
    }


def rounded_values(event: Event) -> dict[str, Any]:
    """Values of an event by column, with numbers as in events.csv; None = unknown or none."""
    return {
        name: round(value, EVENT_NUMBERS[name].decimals) if isinstance(value, float) else value
        for name, value in event_values(event).items()
    }


# -- reading
# ----------------------------------------------------------------------------------------------------------


def read_events(path: str | Path, *, needed: Sequence[str] = NEEDED_COLUMNS) -> tuple[Event, ...]:
    """Events of an events.csv or events.parquet, in the order of the file.

    Columns that the file lacks are unknown: NaN, 0 for `frame` and `track_id`, "" for texts,
    `start_s` for `peak_s`. Unknown columns are ignored. `path`: the file; Parquet if its name ends
    in .parquet. `needed`: columns that the file must have. Raises EventFileError: the file cannot
    be read, lacks a column, has an unknown kind, a time or number that is not finite or not
    plausible, or an event that ends before its start.
    """
    path = Path(path)
    if path.suffix.lower() == ".parquet":
        check_regular(
            path, EventFileError, "the events.parquet of a run", max_bytes=MAX_TABLE_BYTES
        )
        return events_in_parquet(path, path, needed=needed)
    expected = f"events with the columns {','.join(NEEDED_COLUMNS)}"
    if not first_line(path, EventFileError, expected):
        raise EventFileError(f"{path}: expected {expected}, found an empty file.")
    table = read_csv_table(path, EventFileError, "events")
    if len(table) > _MAX_ROWS:
        raise EventFileError(f"{path}: expected at most {_MAX_ROWS} events, found {len(table)}.")
    table.refuse_duplicates(EVENT_COLUMNS)
    cells = {name: cast(list[Any], table.texts(name)) for name in EVENT_COLUMNS if name in table}
    return _events(path, cells, lambda row: f"{path}, line {table.lines[row]}", needed)


def events_in_parquet(
    source: Any, name: object, *, needed: Sequence[str] = NEEDED_COLUMNS
) -> tuple[Event, ...]:
    """Events of an events.parquet (a path or an open file of pyarrow); see `read_events`; `name` is
    for messages.
    """
    from pyarrow import ArrowException, parquet

    try:
        with parquet.ParquetFile(source) as file:
            check_schema_version(name, file.schema_arrow.metadata, EventFileError)
            if file.metadata.num_rows > _MAX_ROWS:
                raise ValueError(f"{file.metadata.num_rows} events, more than {_MAX_ROWS}")
            names = file.schema_arrow.names
            if len(set(names)) < len(names):
                raise ValueError("two columns of the same name")
            table = file.read(
                columns=[column for column in EVENT_COLUMNS if column in names], use_threads=False
            )
        table.validate(full=True)
        cells = {column: table.column(column).to_pylist() for column in table.column_names}
    except (ArrowException, OSError, ValueError, LookupError, MemoryError) as error:
        raise EventFileError(
            f"{name}: expected the events.parquet of a run, found a damaged file "
            f"({shortened(str(error))}); repeat the run or restore the file."
        ) from error
    return _events(name, cells, lambda row: f"{name}, row {row + 1}", needed)


def _events(
    path: object,
    cells: Mapping[str, list[Any]],
    row_name: Callable[[int], str],
    needed: Sequence[str],
) -> tuple[Event, ...]:
    """Events in the cells of a file by column; `row_name` returns file and row of a row's number,
    for messages.
    """
    if missing := [name for name in needed if name not in cells]:
        raise EventFileError(
            f"{path}: expected events with columns {','.join(needed)}, found no "
            f"column {missing[0]}."
        )
    rows = range(len(cells["kind"]))
    return tuple(
        _event({name: values[row] for name, values in cells.items()}, row_name(row)) for row in rows
    )


def _event(cells: Mapping[str, Any], row_name: str) -> Event:
    """The event in the cells of a row by column; cells of CSV are texts."""
    values = {name: _value(name, cells.get(name), row_name) for name in EVENT_COLUMNS}
    kind = values["kind"].lower()
    problem = ""
    if kind not in EVENT_KINDS:
        problem = f"one of the kinds {', '.join(EVENT_KINDS)}, got {quoted(values['kind'])}"
    elif math.isnan(values["start_s"]) or math.isnan(values["end_s"]):
        problem = (
            f"a time in seconds for {'start_s' if math.isnan(values['start_s']) else 'end_s'}, got "
            "none"
        )
    elif values["end_s"] < values["start_s"]:
        problem = (
            f"an end after the start at {values['start_s']:g} s, got end_s {values['end_s']:g}"
        )
    if problem:
        raise EventFileError(f"{row_name}: expected {problem}.")
    if math.isnan(values["peak_s"]):
        values["peak_s"] = values["start_s"]
    class_name = values.pop("class")
    return Event(**{**values, "kind": cast(EventKind, kind)}, class_name=class_name)


def _value(name: str, cell: Any, row_name: str) -> Any:
    """Value of a cell; NaN = unknown, for integers 0. EventFileError if it is not plausible."""
    column = EVENT_NUMBERS.get(name)
    if column is None:
        text = "" if cell is None else cell
        if not isinstance(text, str) or len(text) > _MAX_TEXT:
            raise EventFileError(
                f"{row_name}: expected a text of at most {_MAX_TEXT} characters for {name}."
            )
        return text
    if cell is None or cell == "":
        return 0 if column.is_integer else math.nan
    is_number = isinstance(cell, int | float) and not isinstance(cell, bool)
    value = float(cell) if is_number else number(cell) if isinstance(cell, str) else math.nan
    if not column.low <= value <= column.high or (column.is_integer and value != round(value)):
        kind = "an integer" if column.is_integer else "a number"
        raise EventFileError(
            f"{row_name}: expected {kind} from {column.low:g} to {column.high:g} for {name}, got "
            f"{quoted(cell)}."
        )
    return int(value) if column.is_integer else value
