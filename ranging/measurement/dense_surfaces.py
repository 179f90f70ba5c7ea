"""The object's surface at the centre of each box, from a dense map of any quantity."""

import numpy as np

from track_range.foundation.arrays import FloatArray, FloatArray32
from track_range.ranging.measurement.dense_map import DenseMap
from track_range.stereo.matching.dense_surfaces import (
    MIN_KNOWN,
    SCATTER_FRACTION,
    map_surfaces,
)

# Planes of the scene are planes of inverse depth as they are of disparity; its unit is chosen so
# that the near parts of a map have the disparities of a usual pair, for which the smallest
# tolerances of the surfaces are made.
_NEAR_PX, _NEAR_PERCENTILE = 100.0, 90.0


def box_surfaces(
    dense: DenseMap,
    xyxy_px: FloatArray,
    *,
    min_known: float = MIN_KNOWN,
    scatter_fraction: float = SCATTER_FRACTION,
) -> tuple[FloatArray, FloatArray]:
    """Values at the centres of boxes (N, 4), and their standard deviations, (N,) each, in the
    quantity and the unit of the map.

    The value is that of the surface that probably is the object: not an occluder in front of it, or
    what is seen beside or through it. Sigma is what the pixels of the box show: their scatter, the
    tilt of the surface, other surfaces, the resolution of the map; not an error that the pixels of
    an object share. NaN for boxes that are not finite, smaller than two pixels of the map, without
    enough known pixels, or without a probable surface. `min_known` is the smallest fraction of a
    box's windows with known pixels, `scatter_fraction` the fraction of the scatter that contributes
    to sigma.
    """
    unit = _unit(dense)
    if not np.isfinite(unit):
        return np.full(len(xyxy_px), np.nan), np.full(len(xyxy_px), np.nan)
    disparity = _as_disparity(dense, unit)
    d, sigma_d = map_surfaces(
        disparity,
        dense.in_map(xyxy_px),
        dense.confidence,
        min_known=min_known,
        scatter_fraction=scatter_fraction,
    )
    if dense.quantity == "depth":
        z = unit / d
        return z, z * sigma_d / d
    return d / unit, sigma_d / unit


def _unit(dense: DenseMap) -> float:
    """Pixels of the map per unit of disparity or inverse depth; NaN = nothing is known."""
    if dense.quantity == "disparity":
        return float(dense.values.shape[1] / dense.image_hw[1])
    values = dense.values[np.isfinite(dense.values) & (dense.values > 0)]
    if not len(values):
        return np.nan
    if dense.quantity == "depth":
        return _NEAR_PX * float(np.percentile(values, 100.0 - _NEAR_PERCENTILE))
    return _NEAR_PX / float(np.percentile(values, _NEAR_PERCENTILE))


def _as_disparity(dense: DenseMap, unit: float) -> FloatArray32:
    """(h, w) the map as disparities in its own pixels; what is not above 0 is unknown."""
    if dense.quantity != "depth":
        return np.asarray(dense.values * np.float32(unit), np.float32)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.float32(unit) / dense.values, np.float32)
