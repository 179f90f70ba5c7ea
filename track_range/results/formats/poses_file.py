"""poses.csv: pose and speed of the camera in the frame `map` in each frame where they are known,
with sigmas.

x along the optical axis of the first frame with a known speed, y to the left, headings
counterclockwise.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.csv_tables import read_csv_table
from track_range.foundation.files.output_files import OutputError
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.world.ego_path import EgoPose
from track_range.results.formats.row_file import RowWriter, csv_text

POSES_FILE = "poses.csv"
POSE_COLUMNS = (
    *(
        "frame",
        "time_s",
        "x_m",
        "y_m",
        "heading_deg",
        "x_sigma_m",
        "y_sigma_m",
        "heading_sigma_deg",
    ),
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
        if math.isnan(result.ego_pose.x_m):
            return ""
        texts = ["" if math.isnan(value) else f"{value:.3f}" for value in pose_values(result)]
        return csv_text([[str(result.index), f"{result.time_s:.6f}", *texts]])


def pose_values(result: FrameResult) -> list[float]:
    """The columns of a frame after its time, NaN = unknown."""
    pose = result.ego_pose
    x, y, heading = pose.sigmas
    values = (pose.x_m, pose.y_m, math.degrees(pose.heading_rad), x, y, math.degrees(heading))
    return [*values, result.ego_mps, result.ego_sigma_mps]


@dataclass(frozen=True, slots=True)
class Poses:
    """Poses of the camera in N frames, in their order, (N,) each."""

    frame: FloatArray
    time_s: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    heading_deg: FloatArray
    sigmas: FloatArray  # (N, 3) standard deviations of x and y in m, and of the heading in degrees

    def at(self, frame: int) -> EgoPose | None:
        """The pose in a frame, with the correlations of its errors unknown; None = unknown."""
        row = int(np.searchsorted(self.frame, frame))
        if row == len(self.frame) or self.frame[row] != frame:
            return None
        variances = (self.sigmas[row] * [1.0, 1.0, math.pi / 180]) ** 2
        x_m, y_m, heading_deg = (
            float(values[row]) for values in (self.x_m, self.y_m, self.heading_deg)
        )
        return EgoPose(x_m, y_m, math.radians(heading_deg), np.diag(variances))


def read_poses(folder: Path) -> Poses | None:
    """The poses.csv of a run's folder; None if the file is missing, empty or unreadable."""
    path = folder / POSES_FILE
    if not path.is_file():
        return None
    with suppress(OutputError):
        table = read_csv_table(path, OutputError, "the poses.csv of a run")
        table.require(POSE_COLUMNS[:8])
        frame, time_s, x_m, y_m, heading_deg, *sigmas = (
            table.finite(name) for name in POSE_COLUMNS[:8]
        )
        if len(frame) and (np.diff(frame) > 0).all():
            return Poses(frame, time_s, x_m, y_m, heading_deg, np.stack(sigmas, axis=1))
    return None
