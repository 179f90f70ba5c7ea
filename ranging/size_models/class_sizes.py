"""ClassSizes: sizes and usual directions of the road classes, by the size model of a run."""

from dataclasses import dataclass

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import FloatArray
from track_range.ranging.size_models.cuboid_sizes import CuboidSizes
from track_range.ranging.size_models.prior import YAW_DEG


@dataclass(frozen=True, slots=True)
class ClassSizes:
    """Sizes of each of the C `ROAD_CLASSES`; NaN = the size model has no such class."""

    log_hwl: FloatArray  # (C, 3) mean log height, width and length, in m
    covariance: FloatArray  # (C, 3, 3) of these
    # (C, 2) of the log height and width of boxes minus those of the cuboid: mean, and sigma
    offset: FloatArray
    scatter: FloatArray
    turn_weights: FloatArray  # (C, Y) probabilities of the angles `YAW_DEG` to the camera's axis

    @classmethod
    def of(cls, model: object) -> "ClassSizes":
        """The sizes in the priors of a size model; a model without cuboids has none."""
        n = len(ROAD_CLASSES)
        shapes = (n, 3), (n, 3, 3), (n, 2), (n, 2), (n, len(YAW_DEG))
        sizes = cls(*(np.full(shape, np.nan) for shape in shapes))
        if isinstance(model, CuboidSizes):
            for row, name in enumerate(ROAD_CLASSES):
                if name in model.priors:
                    prior = model.priors[name]
                    sizes.log_hwl[row] = np.log(prior.hwl_m)
                    sizes.covariance[row] = prior.covariance
                    sizes.offset[row], sizes.scatter[row] = prior.offset, prior.scatter
                    sizes.turn_weights[row] = np.array(prior.turn_weights) / sum(prior.turn_weights)
        return sizes
