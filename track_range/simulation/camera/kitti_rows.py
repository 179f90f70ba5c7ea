"""Formatting of labels as rows of KITTI's tracking format."""

from __future__ import annotations

import numpy as np

from track_range.detection.formats.video_labels.kitti import KittiLabels
from track_range.foundation.arrays import FloatArray


def kitti_text(labels: KittiLabels) -> str:
    """Rows of KITTI's tracking format, with a score if there is one; alpha = rotation_y - bearing."""
    bearing_rad = np.arctan2(labels.location_m[:, 0], labels.location_m[:, 2])
    alpha_rad = np.where(labels.has_3d_box, _wrapped(labels.rotation_y_rad - bearing_rad), -10.0)
    lines = []
    for row in range(len(labels)):
        numbers = [alpha_rad[row], *labels.xyxy_px[row], *labels.size_hwl_m[row], *labels.location_m[row]]
        numbers.append(labels.rotation_y_rad[row])
        words = [
            f"{labels.frame[row]} {labels.track_id[row]} {labels.kitti_type[row]}",
            f"{labels.truncated[row]:.0f} {labels.occluded[row]}",
            *(f"{number:.6f}".rstrip("0").rstrip(".") for number in numbers),
        ]
        if np.isfinite(labels.score[row]):
            words.append(f"{labels.score[row]:.6f}")
        lines.append(" ".join(words) + "\n")
    return "".join(lines)


def _wrapped(angle_rad: FloatArray) -> FloatArray:
    """Angles wrapped to [-pi, pi)."""
    return np.asarray((angle_rad + np.pi) % (2 * np.pi) - np.pi)
