"""recorded_boxes.csv: the tracks of a run in the recorded video and in the camera's frame, for wide lenses.

    frame,time_s,track_id,class,x1_px,y1_px,x2_px,y2_px,azimuth_deg,x_m,y_m,z_m

All other files are about the undistorted, rectified images. Boxes are in pixels of the recorded video: each edge is
moved like its midpoint. The azimuth of the box centre and the ranged point, from the fused distance, are in the frame
of the camera (x right, y down, z along its axis), also in a run with --yaw-deg. An empty cell = unknown. A row per
track and frame, as in tracks.csv.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import FloatArray
from track_range.pipeline.frame_result import FrameResult
from track_range.results.formats.row_file import RowFile
from track_range.results.writers import RunInfo
from track_range.stereo.geometry.virtual_pinhole import view_from_camera

FILE = "recorded_boxes.csv"

COLUMNS = (
    *("frame", "time_s", "track_id", "class"),
    *("x1_px", "y1_px", "x2_px", "y2_px", "azimuth_deg", "x_m", "y_m", "z_m"),
)
"""Names of the columns."""


class RecordedBoxesWriter:
    """Writer of recorded_boxes.csv, frame by frame (see `RowFile`)."""

    files = (FILE,)

    def open(self, info: RunInfo, folder: Path) -> None:
        """Create the file with its header."""
        self._info = info
        self._camera_from_view = view_from_camera(float(info.settings.get("yaw_deg", 0.0))).T
        self._file = RowFile(folder / FILE, ",".join(COLUMNS) + "\n")

    def write(self, result: FrameResult) -> None:
        """Add the boxes of a frame."""
        tracks = result.tracks
        values = np.concatenate(
            [
                self._info.recorded_boxes(tracks.xyxy_px),
                self._azimuth_deg(tracks.xyxy_px)[:, None],
                result.xyz_m @ self._camera_from_view.T,
            ],
            axis=1,
        )
        rows = zip(tracks.track_id.tolist(), tracks.class_id.tolist(), values.tolist(), strict=True)
        start = f"{result.index},{result.time_s:.6f}"
        self._file.write("".join(f"{start},{i},{ROAD_CLASSES[c]},{_cells(numbers)}\n" for i, c, numbers in rows))

    def _azimuth_deg(self, xyxy_px: FloatArray) -> FloatArray:
        """(N,) angle of the box centres from the camera's axis, positive = to the right."""
        rays = self._info.camera.rays((xyxy_px[:, :2] + xyxy_px[:, 2:]) / 2) @ self._camera_from_view.T
        return np.asarray(np.degrees(np.arctan2(rays[:, 0], rays[:, 2])))

    def discard_last(self) -> None:
        """Remove the boxes of the last frame."""
        self._file.discard_last()

    def close(self, summary: Mapping[str, Any] | None) -> None:
        """Close the file."""
        self._file.close()


def _cells(numbers: list[float]) -> str:
    return ",".join(f"{number:.3f}" if math.isfinite(number) else "" for number in numbers)
