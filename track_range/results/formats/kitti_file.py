"""kitti.txt: the tracks of a run as KITTI tracking results, frames and pixels counted from 0.

    frame id TYPE -1 -1 -10 x1 y1 x2 y2 -1 -1 -1 X Y Z -10 score

TYPE is Car, Truck, Pedestrian or Cyclist, or the name of a class that KITTI's evaluation skips (Bus, Traffic_light).
Truncation, occlusion, angles and sizes are unknown. X Y Z is described in `track_range.results.formats.run_boxes`,
-1000 = unknown. Predicted boxes are written like observed ones: the format cannot distinguish them.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from track_range.detection.formats.video_labels.text_tables import kitti_lines
from track_range.pipeline.frame_result import FrameResult
from track_range.results.formats.row_file import RowFile
from track_range.results.formats.run_boxes import table_of_frame
from track_range.results.writers import RunInfo


class KittiWriter:
    """Writer of kitti.txt, frame by frame (see `RowFile`)."""

    files = ("kitti.txt",)

    def open(self, info: RunInfo, folder: Path) -> None:
        """Create the file."""
        self._camera = info.camera
        self._file = RowFile(folder / "kitti.txt")

    def write(self, result: FrameResult) -> None:
        """Add the tracks of a frame."""
        self._file.write("".join(kitti_lines(table_of_frame(result, self._camera), result.index)))

    def discard_last(self) -> None:
        """Remove the tracks of the last frame."""
        self._file.discard_last()

    def close(self, summary: Mapping[str, Any] | None) -> None:
        """Close the file."""
        self._file.close()
