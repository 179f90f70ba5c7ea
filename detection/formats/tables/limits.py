"""Limits of the numbers in label and detection files; larger numbers are in another unit or
damaged.
"""

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray

MAX_FRAME = 1_000_000  # largest frame number, from 0: nine hours at 30 Hz
MAX_ID = 2**53 - 1  # float64 represents all integers up to it exactly
# largest absolute pixel coordinate of a box; images have at most 65,535 pixels a side
MAX_COORDINATE_PX = 1e5
MAX_SIDE_PX = 65_535  # of an image
MAX_DISTANCE_M = 1e5  # largest absolute position, distance or size of an object


def are_plausible_boxes(xyxy_px: FloatArray) -> BoolArray:
    """(N,) mask of the boxes (N, 4) with finite edges of at most `MAX_COORDINATE_PX`."""
    return np.asarray((np.abs(xyxy_px) <= MAX_COORDINATE_PX).all(axis=1))  # NaN fails, too
