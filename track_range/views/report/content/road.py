r"""Positions of the tracks on the road and their collision courses, for the bird's-eye view of the
report.

The camera is recovered from the rows: the boxes give the image coordinate u of their centres, and
the distances z with the lateral positions x the slopes of their rays:

    x / z = (u - cx) / fx        hence a line through (u, x / z) has the slope 1 / fx and passes zero at cx

The course is a line x = x0 + v t through the lateral positions of the last `WINDOW_S`, by least
squares. At the time to collision T the object passes the camera at the lateral offset

    o = x0 + v T,    var o = s^2 (1 / n + (T - mean t)^2 / sum (t - mean t)^2) + (a T^2 / 2)^2

with t = 0 now, n positions with the standard deviation s, and the standard deviation a of the
lateral acceleration.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.results.rows.rows import Rows
from track_range.stereo.geometry.camera import PinholeCamera

# longest time to collision in s of the courses that the page contains; it draws the next 4 s
COURSE_S = 8.0
# duration in s of the positions from which a course is computed: at least eight frames at 10 Hz
WINDOW_S = 0.8
# the same for the offsets of the collision warning, whose slope is the lateral speed
FILTERED_WINDOW_S = 0.5
_MIN_POSITIONS = 4  # of a course
# sigma a of the lateral acceleration; a lane change reaches twice as much
_LATERAL_ACCELERATION_MPS2 = 0.25
# of a box centre: px, plus a fraction of the width (`ranging`)
_CENTRE_SIGMA_PX, _CENTRE_SIGMA_FRACTION = 1.0, 0.02
# distance in px from the left or right image border within which a box counts as truncated
_BORDER_PX = 2.0
_MIN_ROWS = 3  # minimum number of rows with a position from which a camera is recovered
# largest median residual of x / z, about 1 degree; of one camera below 1e-4, from rounding
_MAX_RESIDUAL = 0.02


def uncalibrated_video(summary: Mapping[str, Any]) -> str | None:
    """Name of the one video of a run without a calibration by a board; None = calibrated, a pair,
    or several files.
    """
    video = (summary.get("inputs") or {}).get("mono")
    is_known = summary.get("calibration") == "rig" and not summary.get("focal_sigma")
    return None if is_known or not isinstance(video, str) else video


def box_columns(rows: Rows, summary: Mapping[str, Any]) -> dict[str, FloatArray]:
    """(N,) `box_left`, `box_top`, `box_right` and `box_bottom` in px, for the calibration of one
    video's camera.
    """
    if uncalibrated_video(summary) is None or "x1_px" not in rows:
        return {}
    names = ("box_left", "box_top", "box_right", "box_bottom")
    return dict(zip(names, rows.boxes_px.T, strict=True))


def road_columns(rows: Rows) -> dict[str, FloatArray]:
    """Additional columns of rows with positions: (N,) each, NaN = unknown; none if the camera
    cannot be recovered.

    They are in m and s; their names do not end in `_m`, since columns NAME_m are the distances of
    methods.

    Keys: `road_x`, position to the right of the camera; `box_width`, width of the box; and where
    the time to collision `shown_ttc` is at most `COURSE_S`: `passing` and `passing_sigma`, lateral
    offset of the object at that time. It is relative to the ego path if the rows contain values of
    `path_offset_m`, else to the camera's axis.
    """
    camera = camera_of_rows(rows)
    if camera is None:
        return {}
    boxes = rows.boxes_px
    fused_m, filtered_m, ttc_s = rows["fused_m"], rows["fused_kf_m"], rows["ttc_s"]
    m_per_px = np.where(np.isfinite(fused_m), fused_m, filtered_m) / camera.fx_px
    x_m = ((boxes[:, 0] + boxes[:, 2]) / 2 - camera.cx_px) * m_per_px
    width_m = (boxes[:, 2] - boxes[:, 0]) * m_per_px
    is_whole = (boxes[:, 0] > _BORDER_PX) & (boxes[:, 2] < camera.width_px - 1 - _BORDER_PX)
    road = {
        "road_x": x_m,
        "box_width": width_m,
        "shown_ttc": np.where(ttc_s <= COURSE_S, ttc_s, np.nan),
        "passing": np.full(len(x_m), np.nan),
        "passing_sigma": np.full(len(x_m), np.nan),
    }
    sigma_m = _CENTRE_SIGMA_PX * m_per_px + _CENTRE_SIGMA_FRACTION * width_m
    is_measured = is_whole & np.isfinite(x_m) & rows["observed"]
    offset_m, window_s = x_m, WINDOW_S
    if np.isfinite(rows["path_offset_m"]).any():
        offset_m, window_s = rows["path_offset_m"], FILTERED_WINDOW_S
        is_measured = np.isfinite(offset_m)
    for own in rows.by_track():
        road["passing"][own], road["passing_sigma"][own] = _courses(
            rows["time_s"][own],
            offset_m[own],
            sigma_m[own],
            is_measured[own],
            road["shown_ttc"][own],
            window_s,
        )
    return road


def camera_of_rows(rows: Rows) -> PinholeCamera | None:
    """The camera on whose rays the positions of the rows lie; None without distances, or for
    several cameras.

    The image is as wide as the rightmost box edge requires, and its height is unknown (1).
    """
    boxes, z_m = rows.boxes_px, rows["fused_m"]
    u_px = (boxes[:, 0] + boxes[:, 2]) / 2
    slope = rows["x_m"] / np.where(z_m > 1.0, z_m, np.nan)
    known = np.isfinite(slope) & np.isfinite(u_px)
    if np.sum(known) < _MIN_ROWS or np.ptp(u_px[known]) < 1.0:
        return None
    per_px, offset = np.polyfit(u_px[known], slope[known], 1).tolist()
    residual = np.median(np.abs(per_px * u_px[known] + offset - slope[known]))
    if not (per_px > 0 and residual < _MAX_RESIDUAL):
        return None
    cx_px = -offset / per_px
    width_px = round(max(float(np.nanmax(boxes[:, 2])) + 1, 2 * cx_px))
    return PinholeCamera(1 / per_px, 1 / per_px, cx_px, 0.0, width_px=width_px, height_px=1)


def _courses(
    time_s: FloatArray,
    x_m: FloatArray,
    sigma_m: FloatArray,
    is_measured: BoolArray,
    ttc_s: FloatArray,
    window_s: float,
) -> tuple[FloatArray, FloatArray]:
    """(N,) lateral offsets of one track at its times to collision, and their standard deviations;
    NaN = unknown.
    """
    first: IntArray = np.searchsorted(time_s, time_s - window_s - 1e-6)

    def sum_of_window(values: FloatArray) -> FloatArray:
        """(N,) sums of the measured values from row `first` up to each row."""
        total = np.concatenate([[0.0], np.cumsum(np.where(is_measured, values, 0.0))])
        return np.asarray(total[1:] - total[first])

    t = time_s - time_s[0]
    x = np.where(is_measured, x_m, 0.0)
    n, sum_t, sum_x, sum_tt, sum_tx = map(sum_of_window, (np.ones_like(t), t, x, t * t, t * x))
    known = (n >= _MIN_POSITIONS) & np.isfinite(ttc_s)
    mean_t = sum_t / np.maximum(n, 1)
    spread = sum_tt - n * mean_t**2
    known &= spread > 1e-6
    spread = np.where(known, spread, np.nan)
    v = (sum_tx - mean_t * sum_x) / spread
    ahead_s = t + ttc_s - mean_t
    offset_m = sum_x / np.maximum(n, 1) + v * ahead_s
    variance = sigma_m**2 * (1 / np.maximum(n, 1) + ahead_s**2 / spread)
    return offset_m, np.sqrt(variance + (_LATERAL_ACCELERATION_MPS2 * ttc_s**2 / 2) ** 2)
