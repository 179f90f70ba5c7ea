"""Rows and summaries of runs for the tests of the report."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from track_range.results.rows.columns import column_names


def track_rows(*tracks: tuple[int, float], n: int = 40) -> dict[str, Any]:
    """Rows of tracks with identity and left edge in px, each with n frames."""
    columns: dict[str, Any] = {
        "frame": np.tile(np.arange(float(n)), len(tracks)),
        "time_s": np.tile(np.arange(n) / 10, len(tracks)),
        "track_id": np.repeat([float(track_id) for track_id, _ in tracks], n),
        "class": np.full(n * len(tracks), "car"),
        "x1_px": np.repeat([left for _, left in tracks], n),
        "y1_px": np.full(n * len(tracks), 100.0),
        "y2_px": np.full(n * len(tracks), 200.0),
    }
    return columns | {"x2_px": columns["x1_px"] + 100.0}


def columns(
    *lengths: int, class_name: str = "car", truth: bool = True
) -> dict[str, npt.NDArray[Any]]:
    """tracks.csv's columns with one track of each length, ids from 1; mono, stereo and fused
    measured."""
    n = sum(lengths)
    changed: dict[str, npt.NDArray[Any]] = {name: np.full(n, np.nan) for name in column_names()}
    time_s = (
        np.concatenate([np.arange(length) * 0.1 for length in lengths]) if lengths else np.zeros(0)
    )
    distance_m = 40.0 - time_s
    changed |= {
        "time_s": time_s,
        "track_id": np.repeat(np.arange(1.0, len(lengths) + 1), lengths),
        "class": np.full(n, class_name),
        "observed": np.ones(n),
        "mono_m": distance_m * 1.1,
        "stereo_m": distance_m * 0.99,
        "fused_m": distance_m,
        "fused_sigma_m": np.full(n, 0.4),
        "ttc_s": np.where(time_s > 0.35, 9.5, np.nan),
    }
    return changed | ({"truth_m": distance_m} if truth else {})


def method_summary(median_pct: float | None, **more: Any) -> dict[str, Any]:
    return {"coverage": 0.93, "n": 41, "median_relative_error_pct": median_pct, "bands": [], **more}


def summary(**more: Any) -> dict[str, Any]:
    return {
        "frames": 16,
        "wall_s": 2.0,
        "frames_per_s": 8.25,
        "stages_ms": {"read": 2.0, "detect": 61.7, "lane": None},
        "methods": {"mono": method_summary(7.9), "stereo": method_summary(3.4)},
        "common": {},
        "tracks": {"n": 3, "mota": 88.1, "idf1": 91.4, "idsw": 0},
        "notes": ["The rig was taken from calib.txt."],
        "truth": "the visible surface",
        "inputs": {
            "left": "drive/left.mp4",
            "right": "drive/right.mp4",
            "rig": {"file": "calib.txt", "note": None},
        },
        "versions": {"numpy": "2.4.6"},
        "files": {"overlay": "overlay.mp4"},
        **more,
    }
