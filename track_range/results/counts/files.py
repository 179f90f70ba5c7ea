"""crossings.csv and crossings.parquet, and the section `counts` of summary.json."""

from __future__ import annotations

from collections import Counter as Tally
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from track_range.foundation.files.atomic_files import atomic_path, writable
from track_range.foundation.files.output_files import OutputError, write_text
from track_range.results.counts.counter import Crossing
from track_range.results.counts.places import Place
from track_range.results.formats.row_file import csv_text

CROSSINGS_FILE, CROSSINGS_PARQUET = "crossings.csv", "crossings.parquet"
_TEXTS = ("class_name", "kind", "place", "direction")
_DECIMALS = {"time_s": 3, "track_id": 0, "dwell_s": 2, "x_px": 1, "y_px": 1, "heading_deg": 1}
_NAMES = {"class_name": "class"}
_FIELDS = tuple(Crossing.__dataclass_fields__)
CROSSING_COLUMNS = tuple(_NAMES.get(name, name) for name in _FIELDS)


def write_crossings(
    folder: Path, crossings: Sequence[Crossing], metadata: Mapping[str, str]
) -> None:
    """Write both files; OutputError if one cannot be written."""
    import pyarrow as pa
    from pyarrow import parquet

    rows = [[_text(name, getattr(one, name)) for name in _FIELDS] for one in crossings]
    write_text(folder / CROSSINGS_FILE, csv_text([CROSSING_COLUMNS, *rows]))
    columns = {}
    for name, shown in zip(_FIELDS, CROSSING_COLUMNS, strict=True):
        kind = pa.string() if name in _TEXTS else pa.int64() if name == "track_id" else pa.float64()
        columns[shown] = pa.array([getattr(one, name) for one in crossings], kind, from_pandas=True)
    table = pa.table(columns).replace_schema_metadata(dict(metadata))
    path = folder / CROSSINGS_PARQUET
    with writable(path, OutputError), atomic_path(path, is_flushed=False) as partial:
        parquet.write_table(table, partial, compression="zstd")


def _text(name: str, value: Any) -> str:
    if name in _TEXTS:
        return str(value)
    return "" if np.isnan(value) else f"{value:.{_DECIMALS.get(name, 2)}f}"


def counts_section(
    places: Sequence[Place], crossings: Sequence[Crossing], n_unsure: Mapping[str, int]
) -> dict[str, Any]:
    """Section `counts`: numbers by class and direction, and speeds, of each line; entries, exits
    and dwell times of each zone. None = unknown.
    """
    by_place = {
        place.name: [one for one in crossings if one.place == place.name] for place in places
    }
    return {
        "lines": {
            place.name: _line_figures(by_place[place.name], n_unsure.get(place.name, 0))
            for place in places
            if not place.is_zone
        },
        "zones": {
            place.name: _zone_figures(by_place[place.name]) for place in places if place.is_zone
        },
    }


def _line_figures(own: Sequence[Crossing], n_unsure: int) -> dict[str, Any]:
    speeds = [one.speed_kmh for one in own]
    by_class: dict[str, list[str]] = {}
    for one in own:
        by_class.setdefault(one.class_name, []).append(one.direction)
    return {
        "n": len(own),
        "by_direction": dict(sorted(Tally(one.direction for one in own).items())),
        "by_class": {
            name: dict(sorted(Tally(by_class[name]).items())) for name in sorted(by_class)
        },
        "n_unsure": n_unsure,
        "n_speeds": int(np.isfinite(speeds).sum()),
        "median_speed_kmh": _quantile(speeds, 0.5),
        "p85_speed_kmh": _quantile(speeds, 0.85),
    }


def _zone_figures(own: Sequence[Crossing]) -> dict[str, Any]:
    exits = [one for one in own if one.kind == "exit"]
    return {
        "n_enter": sum(one.kind == "enter" for one in own),
        "n_exit": len(exits),
        "median_dwell_s": _quantile([one.dwell_s for one in exits], 0.5),
        "mean_speed_kmh": _quantile([one.mean_speed_kmh for one in exits], 0.5),
    }


def _quantile(values: Sequence[float], share: float) -> float | None:
    known = [value for value in values if np.isfinite(value)]
    return round(float(np.quantile(known, share)), 2) if known else None
