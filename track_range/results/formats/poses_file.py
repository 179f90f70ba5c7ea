"""poses.csv: pose and speed of the camera in the frame `map` in each frame where they are known, with sigmas.

x along the optical axis of the first frame with a known speed, y to the left, headings counterclockwise.
"""

from __future__ import annotations

import math

from track_range.pipeline.frame_result import FrameResult
from track_range.results.formats.row_file import RowWriter, csv_text

POSES_FILE = "poses.csv"
POSE_COLUMNS = (
    *("frame", "time_s", "x_m", "y_m", "heading_deg", "x_sigma_m", "y_sigma_m", "heading_sigma_deg"),
    *("speed_mps", "speed_sigma_mps"),
)


class PosesWriter(RowWriter):
    """Writer of poses.csv, frame by frame; frames without a known pose have no row."""

    files = (POSES_FILE,)

    def header(self) -> str:
        """Names of the columns."""
        return csv_text([POSE_COLUMNS])

    def rows(self, result: FrameResult) -> str:
        """The row of a frame."""
        pose = result.ego_pose
        if pose is None or math.isnan(pose.x_m):
            return ""
        x, y, heading = pose.sigmas
        values = (pose.x_m, pose.y_m, math.degrees(pose.heading_rad), x, y, math.degrees(heading))
        numbers = [*values, result.ego_mps, result.ego_sigma_mps]
        texts = ["" if math.isnan(value) else f"{value:.3f}" for value in numbers]
        return csv_text([[str(result.index), f"{result.time_s:.6f}", *texts]])
