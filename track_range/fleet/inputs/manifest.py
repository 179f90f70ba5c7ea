"""Manifest: a table of clips, CSV or Parquet, local or remote.

    clip, left, right, rig, ego_speed, truth, ...

Columns: `left` is required; `clip` is the name, by default the path of the left video without
suffix; columns of `CLIP_SETTINGS` are settings of the run; all other columns are labels. Relative
paths start in the manifest's folder.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from track_range.fleet.inputs.clip import CLIP_SETTINGS, Clip, FleetInputError, is_file_setting
from track_range.fleet.inputs.tree import without_suffix
from track_range.fleet.storage.location import Location, has_scheme, shown
from track_range.foundation.errors import UserError
from track_range.foundation.files.csv_tables import read_csv_table
from track_range.foundation.files.input_files import (
    MAX_TABLE_BYTES,
    check_regular,
    quoted,
    shortened,
)
from track_range.foundation.files.numeric_text import number
from track_range.foundation.schemas.options import option_of, value_type
from track_range.recording.video.utc import parsed_utc
from track_range.run.options.settings import RunSettings

if TYPE_CHECKING:
    import pyarrow as pa

_EXPECTED = (
    "a manifest with the column left and optionally clip, right, rig, ego_speed, truth and other "
    "columns"
)
# equal for all clips: no labels
_FLEET_OPTIONS = RunSettings.fields_where(lambda field: option_of(field).is_shared)
# cells in a Parquet file, characters in a cell
_MAX_COLUMNS, _MAX_CELLS, _MAX_CELL = 1000, 50_000_000, 10_000


def manifest_clips(location: Location) -> list[Clip]:
    """The clips of a manifest, in its order. Raises FleetInputError, which names the line, and
    StorageError.
    """
    if location.is_local:
        return _Manifest(location, location.path).clips()
    with tempfile.TemporaryDirectory(prefix="track-range-manifest-") as folder:
        path = Path(folder) / f"manifest{Path(location.name).suffix.lower()}"
        location.download(path, MAX_TABLE_BYTES)
        try:
            return _Manifest(location, path).clips()
        except FleetInputError as error:
            raise FleetInputError(str(error).replace(str(path), str(location))) from error


class _Manifest:
    def __init__(self, location: Location, path: Path) -> None:
        self._path = path
        self._folder = location.parent or location
        self._local_folder = str(self._folder) if location.is_local else ""
        if path.suffix.lower() == ".csv":
            table = read_csv_table(path, FleetInputError, _EXPECTED)
            self._columns = tuple(name for name in table.header if name)
            _check_columns(path, self._columns)
            self._cells = [table.texts(name) for name in self._columns]
            self._unit = "line"
            self._numbers: Sequence[int] = table.lines
        else:
            self._columns, self._cells = _parquet_columns(path)
            self._unit = "row"
            self._numbers = range(1, len(self._cells[0]) + 1)
        # earlier names of options, such as folder_fps, become the current ones
        column_of = RunSettings.with_current_names({name: name for name in self._columns})
        name_of = {column: name for name, column in column_of.items()}
        self._columns = tuple(name_of.get(column, column) for column in self._columns)
        if not self._numbers:
            raise FleetInputError(f"{path}: expected a {self._unit} for each clip, found none.")
        self._names: dict[str, int] = {}
        self._values: dict[tuple[str, str], str] = {}

    def clips(self) -> list[Clip]:
        rows = zip(*self._cells, strict=True)
        return [
            self._clip(row, dict(zip(self._columns, texts, strict=True)))
            for row, texts in enumerate(rows)
        ]

    def _clip(self, row: int, cells: dict[str, str]) -> Clip:
        if long := next((name for name, text in cells.items() if len(text) > _MAX_CELL), None):
            raise self._fault(
                row,
                f"expected at most {_MAX_CELL} characters in the column {quoted(long)}, found more",
            )
        left, right = cells.pop("left"), cells.pop("right", "")
        if not left:
            raise self._fault(row, "expected the left video, found an empty cell")
        addresses = self._file(row, left), self._file(row, right) if right else None
        name = cells.pop("clip", "") or _default_name(left)
        if not name:
            raise self._fault(
                row, f"expected a name in the column clip, found none for {quoted(shown(left))}"
            )
        other = self._names.setdefault(name, row)
        if other != row:
            before = f"{self._unit} {self._numbers[other]}"
            raise self._fault(
                row, f"expected a different name for each clip, found {quoted(name)} as in {before}"
            )
        settings = {
            key: self._setting(row, key, text)
            for key, text in cells.items()
            if text and key in CLIP_SETTINGS
        }
        if "rig" in settings and "focal_px" in settings:
            raise self._fault(row, "expected rig or focal_px, found both")
        labels = {key: text for key, text in cells.items() if key not in CLIP_SETTINGS}
        return Clip(name, *addresses, settings, labels)

    def _setting(self, row: int, name: str, text: str) -> str:
        known = self._values.get((name, text))
        if known is not None:
            return known
        if value_type(RunSettings.model_fields[name]) is float and not math.isfinite(number(text)):
            raise self._fault(row, f"expected a number for {name}, found {quoted(text)}")
        if name == "start_utc":
            try:
                parsed_utc(text)
            except ValueError as error:
                raise self._fault(row, f"start_utc: {str(error).removesuffix('.')}") from error
            return text
        value = self._file(row, text) if is_file_setting(name, text) else text
        self._values[name, text] = value  # one object for equal values of many clips
        return value

    def _file(self, row: int, text: str) -> str:
        try:
            if (
                self._local_folder
                and text[0] not in "/~"
                and "://" not in text
                and "\0" not in text
            ):
                # the usual case, without a Location
                return os.path.normpath(f"{self._local_folder}/{text}")
            if has_scheme(text) or text.startswith(("/", "~")):
                return Location.of(text).address
            if "\\0" in text:
                raise FleetInputError("a null character")
            return self._folder.descendant(text).address
        except UserError as error:
            raise self._fault(
                row, f"expected a path or an address, found {quoted(shown(text))}"
            ) from error

    def _fault(self, row: int, message: str) -> FleetInputError:
        return FleetInputError(f"{self._path}, {self._unit} {self._numbers[row]}: {message}.")


def _default_name(left: str) -> str:
    if has_scheme(left):
        return without_suffix(Location.of(left).name)
    is_below = not left.startswith(("/", "~", ".."))
    return without_suffix(
        left.removeprefix("./") if is_below else left.rstrip("/").rpartition("/")[2]
    )


def _parquet_columns(path: Path) -> tuple[tuple[str, ...], list[list[str]]]:
    from pyarrow import ArrowException, parquet, types

    check_regular(path, FleetInputError, "a manifest", max_bytes=MAX_TABLE_BYTES)
    try:
        with parquet.ParquetFile(path) as file:
            schema, n_cells = file.schema_arrow, file.metadata.num_rows * len(file.schema_arrow)
        texts = [
            field.name
            for field in schema
            if types.is_string(field.type) or types.is_large_string(field.type)
        ]
        if n_cells > _MAX_CELLS:
            raise FleetInputError(f"{path}: expected at most {_MAX_CELLS} cells, found {n_cells}.")
        names = tuple(name.strip().lower() for name in schema.names)
        _check_columns(path, names)
        # as dictionaries, repeated texts need memory once
        with parquet.ParquetFile(path, read_dictionary=texts) as file:
            table = file.read(use_threads=False)
        table.validate(full=True)
        return names, [_cells(path, name, table.column(index)) for index, name in enumerate(names)]
    except (ArrowException, OSError, ValueError, LookupError, MemoryError) as error:
        raise FleetInputError(
            f"{path}: expected {_EXPECTED}, found a damaged Parquet file ({shortened(str(error))})."
        ) from error


def _cells(path: Path, name: str, column: pa.ChunkedArray) -> list[str]:
    """Cells of a column as text; equal texts are one object."""
    from pyarrow import types

    kind = column.type.value_type if types.is_dictionary(column.type) else column.type
    if types.is_nested(kind) or types.is_binary(kind) or types.is_large_binary(kind):
        raise FleetInputError(
            f"{path}: expected text, numbers or dates in the column {quoted(name)}, found {kind}."
        )
    cells: list[str] = []
    for chunk in column.chunks:
        if types.is_dictionary(chunk.type):
            texts = [*map(_text, chunk.dictionary.to_pylist())]
            cells += ["" if index is None else texts[index] for index in chunk.indices.to_pylist()]
        else:
            cells += map(_text, chunk.to_pylist())
    return cells


def _text(value: object) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    return value.isoformat() if isinstance(value, datetime) else str(value).strip()


def _check_columns(path: Path, names: tuple[str, ...]) -> None:
    """Raise an error for a missing column `left`, columns with equal names, and options of the
    fleet.
    """
    if "left" not in names:
        raise FleetInputError(f"{path}: found no column 'left'; expected {_EXPECTED}.")
    if len(names) > _MAX_COLUMNS:
        raise FleetInputError(
            f"{path}: expected at most {_MAX_COLUMNS} columns, found {len(names)}."
        )
    for name in names:
        if names.count(name) > 1:
            raise FleetInputError(
                f"{path}: expected one column {quoted(name)}, found several; rename or remove one."
            )
        if name in _FLEET_OPTIONS:
            raise FleetInputError(
                f"{path}: {quoted(name)} is an option of the whole fleet, not of a clip; give it "
                "on the command line, or rename the column."
            )
