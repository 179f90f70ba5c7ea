"""Results of a fleet of three clips, one of them failed, with known figures; written without
Ray."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from track_range.detection.classes import ROAD_CLASSES
from track_range.fleet.engine.clip_run import write_tracks
from track_range.fleet.output.data_set import (
    ClipTable,
    events_location,
    publish,
    publish_record,
    runs_location,
    tracks_location,
)
from track_range.fleet.output.record import ClipRecord
from track_range.fleet.output.state import FleetState
from track_range.fleet.storage.location import Location
from track_range.results.events.event import Event
from track_range.results.events.files import write_events_parquet

DAWN, NOON = "van 1/2026 ä%", "noon"
"""Names of the complete clips; the first has characters with a meaning in paths and addresses."""

BROKEN = "broken"

DAWN_S = 1777881000.0
"""2026-05-04 07:50:00 UTC."""

STEP_S, N_ROWS = 0.1, 20


def track_rows(
    track_id: int, name: str, *, near_m: float, x_m: float, utc_s: float | None, ttc: bool = True
) -> Any:
    """Rows of a track that approaches by 1 m per frame at 10 m/s, to `near_m`; stereo measures
    every other frame."""
    n = np.arange(N_ROWS)
    distance_m = near_m + (N_ROWS - 1 - n) * 1.0
    stereo_m = np.where(n % 2 == 0, distance_m, np.nan)
    nothing = np.full(N_ROWS, np.nan)
    return {
        "frame": n,
        "time_s": n * STEP_S,
        "track_id": np.full(N_ROWS, track_id),
        "class": np.full(N_ROWS, name),
        "observed": np.ones(N_ROWS, bool),
        "stereo_m": stereo_m,
        "stereo_sigma_m": stereo_m / 10,
        "fused_m": distance_m,
        "fused_sigma_m": distance_m / 20,
        "fused_kf_m": distance_m,
        "fused_kf_sigma_m": distance_m / 50,
        "mono_m": nothing,
        "mono_sigma_m": nothing,
        "truth_m": distance_m,
        "x_m": np.full(N_ROWS, x_m),
        "ttc_front_s": distance_m / 10 if ttc and abs(x_m) < 2 else nothing,
        "ttc_sigma_s": distance_m / 100 if ttc else nothing,
        "closing_mps": np.full(N_ROWS, 10.0),
        "utc": nothing if utc_s is None else utc_s + n * STEP_S,
    }


def rows_table(*tracks: dict[str, Any]) -> pa.Table:
    """Rows of tracks in the order of frames, as in tracks.parquet."""
    columns = {name: np.concatenate([track[name] for track in tracks]) for name in tracks[0]}
    order = np.argsort(columns["frame"], kind="stable")
    arrays = {}
    for name, values in columns.items():
        if name == "class":
            codes = [ROAD_CLASSES.index(text) for text in values[order]]
            arrays[name] = pa.DictionaryArray.from_arrays(
                pa.array(codes, pa.int8()), pa.array(ROAD_CLASSES)
            )
        else:
            arrays[name] = pa.array(values[order], from_pandas=True)
    return pa.table(arrays)


def done_record(name: str, **more: Any) -> ClipRecord:
    """Record of a complete clip of 1200 s."""
    values: dict[str, Any] = {
        "left": f"/recordings/{name}.mp4",
        "settings_hash": "sha256:1",
        "frames": 12000,
        "rows": 40,
        "tracks": 2,
        "focal_px": 1000.0,
        "focal_sigma": 0.0,
        "seconds": 1200.0,
        "wall_s": 600.0,
        "overhead_s": 0.5,
        "node": "a",
        "peak_memory_mb": 500.0,
        "stages_ms": {"detect": 40.0, "read": 10.0},
        "coverage": {"fused": 1.0, "mono": 0.0},
        "warnings": [f"Focal length {len(name)} px."],
        "labels": {"vehicle": "van"},
        **more,
    }
    return ClipRecord(clip=name, status="done", **values)


def write_clip(
    out: Location,
    record: ClipRecord,
    table: pa.Table,
    scratch: Path,
    events: Sequence[Event] | None = None,
) -> None:
    """Publish a complete clip, as a worker does; None = as an earlier version, without events."""
    file = scratch / "tracks.parquet"
    write_tracks(file, table, {"track_range.clip": record.clip})
    publish(out, tracks_location(out, record.clip), file)
    if events is not None:
        write_events_parquet(scratch / "events.parquet", events, {})
        publish(out, events_location(out, record.clip), scratch / "events.parquet")
        record = replace(record, events=len(events))
    publish_record(out, record.row())


def write_fleet(out: Location, scratch: Path, *, is_compiled: bool = True) -> None:
    """Write the results of a fleet with the clips DAWN, NOON and BROKEN.

    Args:
        out: where.
        scratch: an existing folder for temporary files.
        is_compiled: whether there is a clips.parquet; else all records are in the journal.
    """
    dawn = rows_table(
        track_rows(1, "car", near_m=4.0, x_m=-3.5, utc_s=DAWN_S),  # passes on the left
        track_rows(2, "person", near_m=12.0, x_m=0.5, utc_s=DAWN_S),
        track_rows(3, "traffic sign", near_m=1.0, x_m=0.0, utc_s=DAWN_S, ttc=False),
    )
    errors = {"fused": {"median_relative_error_pct": 2.0, "bias_pct": -1.0}}
    alignment = {"row_offset_px": 0.1, "offset_px": 0.0}
    record = done_record(DAWN, start_utc="2026-05-04T07:50:00Z", errors=errors, alignment=alignment)
    write_clip(out, record, dawn, scratch)
    for name in ("report.html", "overlay.mp4"):
        publish(out, runs_location(out, DAWN).child(name), b"content")

    noon = rows_table(track_rows(1, "car", near_m=30.0, x_m=0.0, utc_s=None))
    errors = {"fused": {"median_relative_error_pct": 4.0, "bias_pct": 3.0}}
    later = {
        "start_utc": "2026-05-06T12:00:00Z",
        "alignment": {"row_offset_px": 0.5, "offset_px": -0.2},
    }
    write_clip(out, done_record(NOON, errors=errors, **later), noon, scratch)

    left = f"/recordings/{BROKEN}.mp4"
    failed = ClipRecord(
        clip=BROKEN, status="failed", error=f"{left}: not a video.", error_kind="input", left=left
    )
    publish_record(out, failed.row())
    if is_compiled:
        ClipTable(out).compile()
    FleetState(
        state="finished",
        total=3,
        done=2,
        failed=1,
        started_s=DAWN_S,
        heartbeat_s=DAWN_S + 3600,
        options={"run": {}},
    ).write(out)
