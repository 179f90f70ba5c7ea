"""Data of the report's map of the drive: paths of the camera and of the tracks in the frame `map`,
seen from above.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from track_range.foundation.arrays import IntArray
from track_range.pipeline.colours import track_colour
from track_range.ranging.world.cuboid_corners import mean_axis_rad, mean_size_m
from track_range.results.formats.poses_file import Poses
from track_range.results.rows.rows import Rows, most_frequent
from track_range.views.report.content.series import (
    LINE_POINTS,
    TICKS_PER_M,
    TICKS_PER_S,
    packed,
    thinned,
)

_TRACK_POINTS = 200  # largest number of points of the path of a track
_MAX_TRACKS = 1000  # largest number of paths: those of the longest tracks
_MAX_SIGMA = 0.15  # largest relative standard deviation of the distance of a position that is drawn
_MIN_ROWS = 5  # smallest number of positions of a path


def drive_map(rows: Rows, poses: Poses | None) -> dict[str, Any] | None:
    """Paths for the page, None without a path of the camera.

    Keys: `ego` and `tracks`, with packed `t`, `x`, `y` each, tracks also with `id`, `name`,
    `colour`, `size` (length, width and height in m) where it is known, and `at` (x, y in m), the
    median position, and `heading` in degrees if most of their rows are parked.
    """
    if poses is None or len(poses.frame) < 2:
        return None
    shown = thinned(len(poses.frame), LINE_POINTS)
    x_m, y_m, is_parked = rows["world_x_m"], rows["world_y_m"], rows["state"] == "parked"
    distance_m, sigma_m = rows.distance("fused_kf")
    boxes = _Boxes(rows, poses)
    is_placed = np.isfinite(x_m) & ~(sigma_m > _MAX_SIGMA * distance_m)
    tracks = []
    for own in sorted(rows.by_track(), key=len, reverse=True)[:_MAX_TRACKS]:
        own = own[is_placed[own]]
        if len(own) < _MIN_ROWS:
            continue
        track_id = int(rows["track_id"][own[0]])
        track: dict[str, Any] = {
            "id": track_id,
            "name": most_frequent(rows["class"][own]),
            "colour": "#{2:02x}{1:02x}{0:02x}".format(*track_colour(track_id)),
        }
        track |= boxes.shape(own)
        if np.mean(is_parked[own]) > 0.5:
            places = boxes.places if "size" in track else (x_m, y_m)
            track["at"] = [round(float(np.nanmedian(values[own])), 2) for values in places]
        drawn = own[thinned(len(own), _TRACK_POINTS)]
        tracks.append({**track, **_path(rows["time_s"][drawn], x_m[drawn], y_m[drawn])})
    return {
        "ego": _path(*(values[shown] for values in (poses.time_s, poses.x_m, poses.y_m))),
        "tracks": tracks,
    }


class _Boxes:
    """Cuboids of the rows, with their directions in the frame `map`."""

    def __init__(self, rows: Rows, poses: Poses) -> None:
        sides = ("length", "width", "height")
        self._lwh_m = np.stack([rows[f"{side}_m"] for side in sides], axis=1)
        self._sigma_m = np.stack([rows[f"{side}_sigma_m"] for side in sides], axis=1)
        ego_deg = np.interp(rows["frame"], poses.frame, poses.heading_deg)
        self._yaw_rad = np.radians(rows["yaw_deg"] + ego_deg)
        self.places = rows["centre_world_x_m"], rows["centre_world_y_m"]

    def shape(self, own: IntArray) -> dict[str, Any]:
        """`size` and `heading` of the track with these rows; empty if they are unknown."""
        known = own[np.isfinite(self._lwh_m[own]).all(axis=1) & np.isfinite(self._yaw_rad[own])]
        if not len(known):
            return {}
        size_m = mean_size_m(self._lwh_m[known], self._sigma_m[known])
        heading_deg = math.degrees(mean_axis_rad(self._yaw_rad[known]))
        return {"size": [round(side_m, 1) for side_m in size_m], "heading": round(heading_deg)}


def _path(time_s: Any, x_m: Any, y_m: Any) -> dict[str, str]:
    return {
        "t": packed(time_s, TICKS_PER_S),
        "x": packed(x_m, TICKS_PER_M),
        "y": packed(y_m, TICKS_PER_M),
    }
