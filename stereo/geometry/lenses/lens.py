"""Lens: a central projection from directions to the normalised image plane, which a camera matrix maps to pixels.

X = (x, y, z)  --distort-->  m = (m_x, m_y),    u = f_x m_x + c_x,    v = f_y m_y + c_y
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from track_range.foundation.arrays import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Lens:
    """One lens model."""

    name: str  # its name in rig.yaml
    coefficients: tuple[str, ...]  # names of its coefficients, in the order in which they are given to the functions
    # (N, 2) points of the normalised image plane of directions (N, 3) of any length, in the camera's frame; NaN for
    # directions that the lens does not image
    distort: Callable[[FloatArray, Sequence[float]], FloatArray]
    # (N, 3) unit directions of points (N, 2) of the normalised image plane; NaN outside the image circle
    undistort: Callable[[FloatArray, Sequence[float]], FloatArray]
    is_wide: bool = True  # whether the lens can image directions behind z = 0
