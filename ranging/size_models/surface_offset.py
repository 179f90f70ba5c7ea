"""How far an object's visible surface lies behind the point where it touches the ground, from the shape of its box.

A ground plane or a lane's width measures to the bottom edge of a box, which belongs to the object's nearest point on
the ground; `distance_m` is where the ray through the box's centre meets it. From behind they are the same; from a
corner or the side the nearest point is the corner, and the ray meets the side later.
"""

from __future__ import annotations

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.ranging.size_models.size_model import SIZE_CLASSES


def _by_class(values: dict[str, float]) -> FloatArray:
    return np.array([values.get(name, 0.0) for name in SIZE_CLASSES])


_NARROW_M = _by_class(
    {"person": 0.05, "bicycle": 0.15, "motorcycle": 0.15, "car": 0.03, "van": 0.03, "truck": 0.03, "bus": 0.03}
)
_WIDE_M = _by_class(
    {"person": 0.05, "bicycle": 0.3, "motorcycle": 0.3, "car": 0.45, "van": 0.55, "truck": 1.5, "bus": 1.5}
)
_MORE_M = _WIDE_M - _NARROW_M


def surface_offset_m(xyxy_px: FloatArray, class_id: IntArray) -> FloatArray:
    """(N,) how much further the ray through the box's centre meets an object than its nearest point on the ground.

    Medians over KITTI's labels: nothing for a car seen from behind; for a wide box, seen from a corner or the side, the
    nearest point is the corner.
    """
    size_px = xyxy_px[:, 2:] - xyxy_px[:, :2]
    aspect = size_px[:, 0] / np.maximum(size_px[:, 1], 1.0)
    wide = np.minimum(np.maximum((aspect - 1.5) / 0.7, 0.0), 1.0)
    return np.asarray(_NARROW_M[class_id] + wide * _MORE_M[class_id])
