"""Surrogate measures of safety of the road users of a run or a fleet: one row each, with the moment
of each extreme.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.files.atomic_files import atomic_path, writable
from track_range.foundation.files.output_files import OutputError
from track_range.ranging.warning.safety import HALF_WIDTH_M, MAX_GAP_S, post_encroachment_s
from track_range.results.approaches import reference_distance, row_of_smallest
from track_range.results.folder import read_run_folder
from track_range.results.formats.parquet_file import PARQUET_FILE, read_tracks_parquet
from track_range.results.formats.poses_file import Poses, read_poses
from track_range.results.rows.rows import Rows, most_frequent
from track_range.results.rows.supported import supported_values

_SMALLEST, _LARGEST = ("gap_m", "headway_s", "ttc_front_s"), ("drac_mps2", "mdrac_mps2")
_CLIP = "clip="  # start of the folder of a clip's rows in those of a fleet
# as `min_gap_m` and `min_gap_m_at_s`
EXTREMES = {**dict.fromkeys(_SMALLEST, "min"), **dict.fromkeys(_LARGEST, "max")}


COLUMNS = (  # keys of a row, in order
    *("clip", "track_id", "class", "state", "from_s", "to_s", "lead_s"),
    *(f"{kind}_{key}{end}" for key, kind in EXTREMES.items() for end in ("", "_at_s")),
    *("tet_s", "tit_s2", "pet_s"),
    "min_ttc_s",  # the name of this figure everywhere; `min_ttc_front_s` is that of earlier versions
)


def surrogate_rows(source: Path) -> list[dict[str, Any]]:
    """Measures of each road user of a run's folder, or of the clips of a fleet's local folder, in
    the order of tracks.

    Values: `clip` ("" for a run), `track_id`, `class`, `state` (the most frequent), `from_s`,
    `to_s`, `lead_s`, the `EXTREMES` with their moments, `tet_s`, `tit_s2` and, with poses.csv,
    `pet_s`; None = unknown. OutputError: the folder is not the result of a run or a fleet, or its
    rows have no measures.
    """
    clips = sorted((source / "tracks").glob(f"{_CLIP}*/{PARQUET_FILE}"))
    if not clips:
        run = read_run_folder(source, is_rounded=False, has_events=False)
        return list(_road_users("", run.rows, read_poses(source), source))
    rows: list[dict[str, Any]] = []
    for path in clips:
        clip = path.parent.name.removeprefix(_CLIP)
        poses = read_poses(source / "runs" / path.parent.name)
        rows += _road_users(clip, Rows(read_tracks_parquet(path)), poses, path)
    return rows


def _road_users(
    clip: str, rows: Rows, poses: Poses | None, source: Path
) -> Iterator[dict[str, Any]]:
    if len(rows) and not np.isfinite(rows["gap_m"]).any():
        raise OutputError(
            f"{source}: expected rows with measures of safety (gap_m), found none; earlier "
            "versions did not write these measures; repeat the run."
        )
    ego = None if poses is None else np.stack([poses.time_s, poses.x_m, poses.y_m], axis=1)
    supported = supported_values(rows, *reference_distance(rows))
    rows = rows.with_columns({name: supported[name] for name in EXTREMES})
    for track in map(rows.select, rows.by_track()):
        name = most_frequent(track["class"])
        if name in ROAD_CLASSES and HALF_WIDTH_M[ROAD_CLASSES.index(name)] > 0:
            yield {"clip": clip, **_measures(name, track, ego)}


def _measures(name: str, track: Rows, ego: Any) -> dict[str, Any]:
    """Measures of a road user from the rows of its track."""
    time_s, indices = track["time_s"], np.arange(len(track))
    steps_s, is_lead = np.diff(time_s), track["is_lead"][:-1]
    lead_s = float(steps_s[is_lead & (steps_s <= MAX_GAP_S)].sum())
    row: dict[str, Any] = {"track_id": int(track["track_id"][0]), "class": name}
    row |= {"state": most_frequent(track["state"])}
    row |= {"from_s": float(time_s[0]), "to_s": float(time_s[-1]), "lead_s": lead_s}
    for key, kind in EXTREMES.items():
        values = track[key]
        at = row_of_smallest(-values if kind == "max" else values, indices)
        row[f"{kind}_{key}"] = None if at is None else float(values[at])
        row[f"{kind}_{key}_at_s"] = None if at is None else float(time_s[at])
    row |= {key: float(np.nan_to_num(track[key][-1])) for key in ("tet_s", "tit_s2")}
    path = np.stack([time_s, track["world_x_m"], track["world_y_m"]], axis=1)
    path = path[np.isfinite(path).all(axis=1)]
    half_width_m = float(HALF_WIDTH_M[ROAD_CLASSES.index(name)])
    pet_s = np.nan if ego is None else post_encroachment_s(ego, path, half_width_m=half_width_m)
    pet = None if np.isnan(pet_s) else float(pet_s)
    return {**row, "pet_s": pet, "min_ttc_s": row["min_ttc_front_s"]}


def by_class(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Extremes and sums over the road users of each class: `n`, `n_exposed` (with a TET), and keys
    without moments.
    """
    by_name = {name: [row for row in rows if row["class"] == name] for name in ROAD_CLASSES}
    return [{"class": name, **_figures(own)} for name, own in by_name.items() if own]


def _figures(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The figures of road users of one class."""
    n_exposed = sum(row["tet_s"] > 0 for row in rows)
    figures: dict[str, Any] = {"n": len(rows), "n_exposed": n_exposed}
    for key in (*(f"{kind}_{key}" for key, kind in EXTREMES.items()), "pet_s"):
        figures[key] = _extreme(key, [row[key] for row in rows if row[key] is not None])
    for key in ("tet_s", "tit_s2", "lead_s"):
        figures[key] = sum(row[key] for row in rows)
    return figures


def _extreme(key: str, values: Sequence[float]) -> float | None:
    """The most critical value: the largest where the key says so; None = there are none."""
    if not values:
        return None
    return max(values) if key.startswith("max") else min(values)


def write_rows(path: Path, rows: Sequence[dict[str, Any]], *, is_parquet: bool) -> None:
    """Write the rows as Parquet or CSV, null or empty = unknown; OutputError if the file cannot be
    written.
    """
    import pyarrow as pa
    from pyarrow import csv, parquet

    kinds = {"track_id": pa.int64(), **dict.fromkeys(("clip", "class", "state"), pa.string())}
    schema = pa.schema([(key, kinds.get(key, pa.float64())) for key in COLUMNS])
    table = pa.Table.from_pylist(list(rows), schema)
    with writable(path, OutputError), atomic_path(path) as partial:
        if is_parquet:
            parquet.write_table(table, partial, compression="zstd")
        else:
            csv.write_csv(table, partial, csv.WriteOptions(quoting_style="needed"))
