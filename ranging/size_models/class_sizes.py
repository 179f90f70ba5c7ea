"""ClassSizes: typical length, width and height of the road classes, by the size model of a run."""

from dataclasses import dataclass

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import FloatArray
from track_range.ranging.size_models.cuboid_sizes import CuboidSizes

_LWH_OF_HWL = [2, 1, 0]  # priors have height, width, length


@dataclass(frozen=True, slots=True)
class ClassSizes:
    """Length, width and height in m of each of `ROAD_CLASSES`, and their standard deviations, all
    (road classes, 3); NaN = the size model has no such class.
    """

    lwh_m: FloatArray
    sigma_m: FloatArray

    @classmethod
    def of(cls, model: object) -> "ClassSizes":
        """The sizes in the priors of a size model; a model without cuboids has none."""
        lwh_m, sigma_m = np.full((2, len(ROAD_CLASSES), 3), np.nan)
        if isinstance(model, CuboidSizes):
            for row, name in enumerate(ROAD_CLASSES):
                if name in model.priors:
                    prior = model.priors[name]
                    lwh_m[row] = np.array(prior.hwl_m)[_LWH_OF_HWL]
                    sigma_m[row] = lwh_m[row] * np.array(prior.log_sigma)[_LWH_OF_HWL]
        return cls(lwh_m, sigma_m)
