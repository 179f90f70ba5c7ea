"""Results of a fleet, in a local folder or an object store.

    OUT/fleet.json                          state of the run (`output.state`)
    OUT/clips.parquet                       one row per clip, compiled from the journal now and then
    OUT/journal/NAME.json                   row of a clip that is newer than clips.parquet
    OUT/tracks/clip=NAME/tracks.parquet     rows of a clip
    OUT/events/clip=NAME/events.parquet     events of a clip
    OUT/detections/clip=NAME/...            boxes of the detector, for a later run (`output.stored`)
    OUT/poses/clip=NAME/poses.parquet       path of the camera, for a later search of events
    OUT/runs/clip=NAME/...                  other files of a clip
    OUT/unfinished/...                      files that are being written

NAME is percent-encoded, as in other partitioned data sets. A clip is complete when its row is in
the journal or in clips.parquet; all else is written before. Every file is replaced as a whole, so
that nothing exists twice or in part, and the file of a repeated clip has the name of the first.
"""

from __future__ import annotations

import io
import json
import os
import platform
import shutil
import time
from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote, unquote

from track_range.fleet.errors import FleetError
from track_range.fleet.output.record import (
    SCHEMA_VERSION,
    Row,
    merged_table,
    records_table,
    with_all_columns,
)
from track_range.fleet.storage.errors import StorageError, storage_errors
from track_range.fleet.storage.location import Location
from track_range.foundation.files.input_files import shortened
from track_range.foundation.files.structured_text import parse_json
from track_range.results.events.files import EVENTS_PARQUET

if TYPE_CHECKING:
    import pyarrow as pa

CLIPS_FILE, TRACKS_FILE = "clips.parquet", "tracks.parquet"
JOURNAL, RUNS, UNFINISHED = "journal", "runs", "unfinished"
# shortest time between two compilations, s, and relative to that of one
_COMPILE_S, _COMPILE_FRACTION = 10.0, 20.0
_ROWS_PER_GROUP = 10_000  # rows per row group of clips.parquet, about 7 MB in memory
_MAX_NEWER = 3000  # rows in memory that are not compiled, of about 5 kB each
_N_CONNECTIONS = 16  # requests to the storage at a time
_PAUSES_S = (1.0, 3.0, 10.0)  # pauses after failed uploads, s


def partition(name: str) -> str:
    """Name of the folder of a clip."""
    return f"clip={encoded(name)}"


def encoded(name: str) -> str:
    """Name of a clip in the names of files."""
    text = quote(name, safe="")
    # files that begin with a dot are hidden
    return f"%2E{text[1:]}" if text.startswith(".") else text


def tracks_location(out: Location, name: str) -> Location:
    """Location of the rows of a clip."""
    return out.child("tracks", partition(name), TRACKS_FILE)


def events_location(out: Location, name: str) -> Location:
    """Location of the events of a clip."""
    return out.child("events", partition(name), EVENTS_PARQUET)


def detections_location(out: Location, name: str) -> Location:
    """Location of the boxes that the detector found in a clip."""
    return out.child("detections", partition(name), "detections.parquet")


def poses_location(out: Location, name: str) -> Location:
    """Location of the path of the camera in a clip."""
    return out.child("poses", partition(name), "poses.parquet")


def runs_location(out: Location, name: str) -> Location:
    """Folder of the other files of a clip."""
    return out.child(RUNS, partition(name))


def publish(out: Location, location: Location, content: Path | bytes) -> None:
    """Write a file, or copy a local file, to its location in the output `out`; it appears as a
    whole.

    In a local folder it is written to OUT/unfinished first: a worker that is killed leaves nothing
    beside the results, where readers of the data set would find it. Uploads to an object store are
    atomic, and repeated after errors of the network. Files of a clip count once its record is
    published. Raises StorageError if it cannot be written.
    """
    if not out.is_local:
        for pause_s in (*_PAUSES_S, None):
            try:
                return (
                    location.write_bytes(content)
                    if isinstance(content, bytes)
                    else location.upload(content)
                )
            except StorageError as error:
                if not error.is_transient or pause_s is None:
                    raise
                time.sleep(pause_s)
    partial = out.path / UNFINISHED / f"{platform.node()}-{os.getpid()}"
    with storage_errors(location, "written"):
        try:
            partial.parent.mkdir(parents=True, exist_ok=True)
            location.path.parent.mkdir(parents=True, exist_ok=True)
            if isinstance(content, bytes):
                partial.write_bytes(content)
            else:
                shutil.copyfile(content, partial)
            with partial.open("r+b") as file:
                os.fsync(file.fileno())
            partial.replace(location.path)
        except BaseException:
            with suppress(OSError):
                partial.unlink(missing_ok=True)
            raise


def remove_unfinished(out: Location) -> None:
    """Remove files that killed workers have left, as far as possible."""
    if out.is_local:
        shutil.rmtree(out.path / UNFINISHED, ignore_errors=True)


def publish_files(out: Location, folder: Location, files: Collection[Path]) -> None:
    """Publish files in a folder of the output, and remove files of an earlier result from it;
    errors as from `publish`.
    """
    for file in files:
        publish(out, folder.child(file.name), file)
    names = {file.name for file in files}
    for entry in list(folder.list()) if folder.exists() else ():
        if entry.name not in names and not entry.stat.is_folder:
            folder.child(entry.name).remove()


def publish_record(out: Location, row: Row) -> None:
    """Publish the record of a clip, after which the clip is complete; raises the errors of
    `publish`.
    """
    text = json.dumps(row, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    publish(out, _journal_location(out, row["clip"]), text.encode())


def read_clips(out: Location) -> pa.Table:
    """The rows of all clips, with the journal; FleetError: clips.parquet is damaged or too new;
    StorageError.
    """
    rows = journal_rows(out, _journal_names(out))
    table = _compiled(out)  # read last: a row leaves the journal when it is in the table
    return (merged_table(table, rows) if rows else table).sort_by("clip")


def read_journal(out: Location) -> pa.Table:
    """The rows of the clips in the journal alone."""
    return records_table(journal_rows(out, _journal_names(out)).values())


class ClipTable:
    """The rows of a fleet in the driver, with the journal as the source of rows that are not
    compiled.

    `table` has the compiled rows, `newer` the rows that are newer, by name of the clip.
    """

    def __init__(self, out: Location) -> None:
        """Read the rows of earlier runs; raises the errors of `read_clips`."""
        self._out = out
        self.table = _compiled(out)
        names = _journal_names(out)
        self.newer: dict[str, Row] = journal_rows(out, names)
        self._in_journal: set[str] = set(names)
        self._next_s = 0.0
        self._is_sorted = True

    def add(self, row: Row, *, is_in_journal: bool) -> None:
        """Add or replace the row of a clip; a row that is not in the journal is stored by the next
        compilation.
        """
        self.newer[row["clip"]] = row
        if is_in_journal:
            self._in_journal.add(row["clip"])

    def touch(self, name: str, changes: Mapping[str, Any]) -> None:
        """Change columns of a clip whose result remains, such as the fingerprint of its inputs."""
        import pyarrow.compute as pc

        row = self.newer.get(name)
        if row is None and (index := pc.index(self.table["clip"], name).as_py()) >= 0:
            row = self.table.slice(index, 1).to_pylist()[0]
        if row is not None:
            self.add({**row, **changes}, is_in_journal=False)

    def collect_journal(self) -> int:
        """Add rows of workers that an interrupted driver does not know; returns how many of the
        clips are done.
        """
        names = [name for name in _journal_names(self._out) if name not in self._in_journal]
        rows = journal_rows(self._out, names).values()
        for row in rows:
            self.add(row, is_in_journal=True)
        return sum(row["status"] == "done" for row in rows)

    def compile_if_due(self) -> None:
        """Write clips.parquet if enough time has passed or many rows are new; see `compile`."""
        if len(self.newer) >= _MAX_NEWER or (self.newer and time.monotonic() >= self._next_s):
            self.compile()

    def compile(self, *, is_sorted: bool = False) -> None:
        """Write clips.parquet, then remove the rows in it from the journal; raises the errors of
        `write_clips`.
        """
        from pyarrow import default_memory_pool

        start_s = time.monotonic()
        if self.newer or (is_sorted and not self._is_sorted):
            merged = merged_table(self.table, self.newer)
            write_clips(self._out, merged, is_sorted=is_sorted)
            self.table = merged
            self.newer, self._is_sorted = {}, is_sorted
            default_memory_pool().release_unused()
        self._clear_journal()
        end_s = time.monotonic()
        self._next_s = end_s + max(_COMPILE_S, _COMPILE_FRACTION * (end_s - start_s))

    def _clear_journal(self) -> None:
        compiled = self._in_journal - self.newer.keys()

        def remove(name: str) -> None:
            # a row that stays in the journal is compiled again by the next run
            with suppress(StorageError):
                _journal_location(self._out, name).remove()

        with ThreadPoolExecutor(_N_CONNECTIONS) as threads:
            list(threads.map(remove, compiled))
        self._in_journal -= compiled

    def failed(self, names: Collection[str]) -> list[tuple[str, str]]:
        """Names and errors of the failed clips among `names`."""
        import pyarrow.compute as pc

        compiled = self.table.filter(pc.equal(self.table["status"], "failed")).select(
            ["clip", "error"]
        )
        errors = {
            row["clip"]: row["error"]
            for row in compiled.to_pylist()
            if row["clip"] not in self.newer
        }
        errors |= {
            name: row["error"] for name, row in self.newer.items() if row["status"] == "failed"
        }
        return sorted((name, error) for name, error in errors.items() if name in names)


def write_clips(out: Location, table: pa.Table, *, is_sorted: bool = False) -> None:
    """Write clips.parquet, in the order of the clips if `is_sorted`; raises the errors of
    `publish`.
    """
    import pyarrow as pa
    import pyarrow.compute as pc
    from pyarrow import parquet

    order = pc.sort_indices(table["clip"]) if is_sorted else None
    stream = pa.BufferOutputStream()
    with parquet.ParquetWriter(stream, table.schema, compression="zstd") as writer:
        # a sorted table would be a second one
        for start in range(0, max(1, table.num_rows), _ROWS_PER_GROUP):
            group = slice(start, start + _ROWS_PER_GROUP)
            writer.write_table(table[group] if order is None else table.take(order[group]))
    publish(out, out.child(CLIPS_FILE), stream.getvalue().to_pybytes())


def _compiled(out: Location) -> pa.Table:
    from pyarrow import ArrowException, parquet

    location = out.child(CLIPS_FILE)
    if not location.exists():
        return records_table([])
    try:
        # one thread and no data set, which would take three times the memory of the table
        table = parquet.ParquetFile(io.BytesIO(location.read_bytes())).read(use_threads=False)
        version = int((table.schema.metadata or {}).get(b"track_range.fleet_schema_version", b""))
        table.column("clip"), table.column("settings_hash")
    except (ArrowException, OSError, ValueError, LookupError) as error:
        raise FleetError(
            f"{location}: expected the table of a fleet, found a different or damaged file "
            f"({shortened(str(error))}); choose another --out, or remove the file to process all "
            "clips again."
        ) from error
    if version > SCHEMA_VERSION:
        raise FleetError(
            f"{location}: expected version {SCHEMA_VERSION} or earlier, found {version}, of a "
            "newer track-range; update with `pip install --upgrade track-range`."
        )
    return with_all_columns(table)


def _journal_location(out: Location, name: str) -> Location:
    return out.child(JOURNAL, f"{encoded(name)}.json")


def _journal_names(out: Location) -> list[str]:
    folder = out.child(JOURNAL)
    names = [entry.name for entry in folder.list()] if folder.exists() else []
    # hidden files belong to a killed write
    return [
        unquote(name.removesuffix(".json"))
        for name in names
        if name.endswith(".json") and name[0] != "."
    ]


def journal_rows(out: Location, names: Sequence[str]) -> dict[str, Row]:
    """Rows in the journal; damaged or removed rows are left out, so that their clips are
    repeated.
    """

    def row_of(name: str) -> Row | None:
        location = _journal_location(out, name)
        try:
            row: Any = parse_json(location.read_bytes().decode(), location, FleetError, "a record")
        except (FleetError, UnicodeDecodeError):
            return None
        except StorageError as error:
            if error.kind != "missing":
                raise
            return None
        is_row = (
            isinstance(row, dict)
            and isinstance(row.get("clip"), str)
            and row.get("status") in ("done", "failed")
        )
        return row if is_row else None

    with ThreadPoolExecutor(_N_CONNECTIONS) as threads:
        return {row["clip"]: row for row in threads.map(row_of, names) if row is not None}
