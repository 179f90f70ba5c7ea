"""Boxes of the tracks in pixels, for the command that calibrates the camera by known distances."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from track_range.foundation.arrays import FloatArray
from track_range.results.columns import Columns, boxes_px


def uncalibrated_video(summary: Mapping[str, Any]) -> str | None:
    """Name of the one video of a run without a calibration by a board; None = calibrated, a pair, or several files."""
    video = (summary.get("inputs") or {}).get("mono")
    is_known = summary.get("calibration") == "rig" and not summary.get("focal_sigma")
    return None if is_known or not isinstance(video, str) else video


def box_columns(columns: Columns, summary: Mapping[str, Any]) -> dict[str, FloatArray]:
    """Additional columns of such a run: (N,) each, `box_left`, `box_top`, `box_right`, `box_bottom` in px."""
    if uncalibrated_video(summary) is None or "x1_px" not in columns:
        return {}
    names = ("box_left", "box_top", "box_right", "box_bottom")
    return dict(zip(names, boxes_px(columns).T, strict=True))
