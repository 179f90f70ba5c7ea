"""Distance from the contact point of an object to its visible surface, from the aspect ratio of its box.

The ground-plane and lane-width methods use the bottom edge of a box, which belongs to the object's nearest point on the
ground; `distance_m` is where the ray through the box centre meets the object. Both are the same for an object seen from
behind. Seen from a corner or the side, the nearest point is the corner, and the surface is farther.
"""

from __future__ import annotations

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.ranging.size_models.size_model import SIZE_CLASSES


def _by_class(values: dict[str, float]) -> FloatArray:
    """(size classes,) the values, 0 for classes without one."""
    return np.array([values.get(name, 0.0) for name in SIZE_CLASSES])


_NARROW_M = _by_class(
    {"person": 0.05, "bicycle": 0.15, "motorcycle": 0.15, "car": 0.03, "van": 0.03, "truck": 0.03, "bus": 0.03}
)
"""Offsets in m for boxes with an aspect ratio up to 1.5 (rear view), medians over KITTI's labels."""

_WIDE_M = _by_class(
    {"person": 0.05, "bicycle": 0.3, "motorcycle": 0.3, "car": 0.45, "van": 0.55, "truck": 1.5, "bus": 1.5}
)
"""Offsets in m for boxes with an aspect ratio of 2.2 or more (side view), medians over KITTI's labels."""

_DIFFERENCE_M = _WIDE_M - _NARROW_M


_OVERHANG_M = _by_class({"car": 0.6, "van": 0.6})
"""Depth in m of the tyres' contact behind the bumper: overhangs of cars are 0.7 to 0.9 m, the tyre touches the road a
little before the axle."""


def surface_offset_m(xyxy_px: FloatArray, class_id: IntArray, *, has_visible_boxes: bool = False) -> FloatArray:
    """(N,) depth in m of the visible surface behind the contact point, for boxes (N, 4) of size classes (N,).

    Linear in the aspect ratio between rear and side views. The visible boxes of a detector end at the tyres of a car,
    in a rear view behind its bumper; labels that are projections of 3-D boxes end where the bumper is above the road.
    """
    size_px = xyxy_px[:, 2:] - xyxy_px[:, :2]
    aspect = size_px[:, 0] / np.maximum(size_px[:, 1], 1.0)
    wide = np.minimum(np.maximum((aspect - 1.5) / 0.7, 0.0), 1.0)  # 0 for rear views to 1 for side views
    offset_m = _NARROW_M[class_id] + wide * _DIFFERENCE_M[class_id]
    return np.asarray(offset_m - (1.0 - wide) * _OVERHANG_M[class_id] if has_visible_boxes else offset_m)
