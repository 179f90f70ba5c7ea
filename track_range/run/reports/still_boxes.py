"""Boxes that do not move in the image, such as the bonnet."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from track_range.recording.cameras.calibration import RecordingCalibration
from track_range.results.rows.rows import Rows
from track_range.run.reports.report import Reports

_STILL_SPEED_MPS, _STILL_S, _STILL_FRAMES = 3.0, 10.0, 50  # of a drive with boxes that do not move
# standard deviation of the edges of such a box in image widths; its zone in image heights
_STILL, _EDGE = 0.001, 0.15


@dataclass(frozen=True, slots=True)
class StillBoxes(Reports):
    """Tracks that do not move in the image while the car drives.

    They are at the upper or lower edge of the image, where no vehicle ahead stays; the camera's
    pitch moves such a vehicle in the image, too. `FixedParts` leaves out boxes of a detector whose
    pixels never change; what remains are bonnets, whose reflections move, and recorded boxes.
    """

    rows: Rows
    calibration: RecordingCalibration

    def notes(self) -> Sequence[str]:
        """A note that proposes `--ignore` for such tracks."""
        width, height = self.calibration.sizes_px[0]
        rows = self.rows
        rows = rows.select((rows["ego_mps"] >= _STILL_SPEED_MPS) & rows["observed"])
        box, time_s = self.calibration.rectifier.recorded_boxes(rows.boxes_px), rows["time_s"]
        track, first, group, n = np.unique(rows["track_id"], True, True, True)
        last = np.zeros(len(track), np.int64)
        last[group] = np.arange(len(rows))
        mean, square = (
            np.stack([np.bincount(group, edge) / n for edge in values.T], axis=1)
            for values in (box, box**2)
        )
        deviation = np.sqrt(np.maximum(square - mean**2, 0)).max(axis=1)
        at_edge = (mean[:, 3] > (1 - _EDGE) * height) | (mean[:, 1] < _EDGE * height)
        is_long = (time_s[last] - time_s[first] >= _STILL_S) & (n >= _STILL_FRAMES)
        still = np.flatnonzero((deviation < _STILL * width) & at_edge & is_long)[:3]
        if not len(still):
            return ()
        corners = np.rint(mean[still]).astype(int)
        polygons = " / ".join(
            f"{x1},{y1} {x2},{y1} {x2},{y2} {x1},{y2}" for x1, y1, x2, y2 in corners
        )
        names = f"Track{'s' * (len(still) > 1)} {', '.join(f'{name:g}' for name in track[still])}"
        return (
            f"{names} did not move in the image while the car drove. If this is the bonnet, or text in "
            f"the image, drop the boxes with --ignore '{polygons}' (Python ignore).",
        )
