"""Errors of the sizes of road users, and so of distances by size, that a drive has in common."""

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.ranging.size_models.region import Region

# of the logarithm of the sizes of all classes, if the region is known, and if it is not
KNOWN_REGION_SIGMA, _UNKNOWN_REGION_SIGMA = 0.026, 0.055
CLASS_SIGMA = 0.065  # of those of a class, in addition
DRIVE_VARIANCE = KNOWN_REGION_SIGMA**2 + CLASS_SIGMA**2  # of a class in a drive
_MAX_SHARED = 0.4  # largest fraction of the variance of a distance by size that a drive causes


def common_sigma(region: Region) -> float:
    """Standard deviation of the logarithm of the sizes of all classes in a drive."""
    return _UNKNOWN_REGION_SIGMA if region == "unknown" else KNOWN_REGION_SIGMA


def shared_variance(variance: FloatArray) -> FloatArray:
    """(N,) parts of the relative variances (N,) of distances by size that a drive causes."""
    return np.minimum(DRIVE_VARIANCE, _MAX_SHARED * variance)
