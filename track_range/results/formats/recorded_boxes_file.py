"""recorded_boxes.csv: the boxes of a run in pixels of the recorded video, which a wide lens or a rectification changes.

    frame,time_s,track_id,class,x1_px,y1_px,x2_px,y2_px

The boxes of all other files are in pixels of the undistorted, rectified images. A row per track and frame, as in
tracks.csv; each edge is moved like its midpoint.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from track_range.detection.classes import ROAD_CLASSES
from track_range.results.formats.row_file import RowFile
from track_range.results.writers import RunInfo
from track_range.run.frame_result import FrameResult

FILE = "recorded_boxes.csv"
_HEADER = "frame,time_s,track_id,class,x1_px,y1_px,x2_px,y2_px\n"


class RecordedBoxesWriter:
    """Writer of recorded_boxes.csv, frame by frame (see `RowFile`)."""

    files = (FILE,)

    def open(self, info: RunInfo, folder: Path) -> None:
        """Create the file with its header."""
        self._recorded_boxes = info.recorded_boxes
        self._file = RowFile(folder / FILE, _HEADER)

    def write(self, result: FrameResult) -> None:
        """Add the boxes of a frame."""
        tracks = result.tracks
        boxes = self._recorded_boxes(tracks.xyxy_px).tolist()
        rows = zip(tracks.track_id.tolist(), tracks.class_id.tolist(), boxes, strict=True)
        self._file.write(
            "".join(
                f"{result.index},{result.time_s:.6f},{track_id},{ROAD_CLASSES[class_id]},"
                + ",".join(f"{edge:.2f}" if edge == edge else "" for edge in box)
                + "\n"
                for track_id, class_id, box in rows
            )
        )

    def discard_last(self) -> None:
        """Remove the boxes of the last frame."""
        self._file.discard_last()

    def close(self, summary: Mapping[str, Any] | None) -> None:
        """Close the file."""
        self._file.close()
