"""CuboidSizes: distances of a frame's boxes from size priors and the common ground plane.

A detector's car may be a van: such a class is a mixture of priors (`CLASS_CONFUSION`), and the position of the box's
bottom edge on the road decides between the two. Only boxes of classes that stand on the road inform the ground plane.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.ranging.size_models.posterior import NO_CHANCE, ground_likelihood, mixture_by_size, on_grid
from track_range.ranging.size_models.prior import ShapeTables, SizePrior
from track_range.ranging.size_models.shared_ground import GroundPrior, Stand
from track_range.ranging.size_models.size_model import SIZE_CLASSES, BoxExtents, SizeRanges

KIND = "cuboids"

CLASS_CONFUSION: Mapping[str, Mapping[str, float]] = {
    "car": {"car": 0.96, "van": 0.04},
    "van": {"van": 0.95, "truck": 0.05},
}
"""True classes of a detected class, with probabilities: detectors take vans for cars, KITTI 3 m lorries for vans."""

_MIDDLE_68 = np.array([[0.158655], [0.5], [0.841345]])
_BEST_RELATIVE = np.array([[False], [True], [False]])  # the middle: of the smallest expected relative error
_MIN_SIGMA = 0.01


class CuboidSizes:
    """Priors of all classes, and of the ground."""

    def __init__(self, priors: Mapping[str, SizePrior], ground: GroundPrior | None = None) -> None:
        """Priors by size class; a class without one gives NaN."""
        self.priors = dict(priors)
        self.ground = ground or GroundPrior()
        self._tables = ShapeTables(priors)
        self._stands = np.array([name in priors and priors[name].stands for name in SIZE_CLASSES])
        self._known = np.array([name in priors for name in SIZE_CLASSES])
        self._kinds, self._log_shares = _class_mixture(priors)

    def measure(self, boxes: BoxExtents) -> SizeRanges:
        """Distances of the boxes of one frame, together."""
        known = self._known[boxes.size_class]
        if known.all() and len(boxes):
            return SizeRanges(*self._measured(boxes))
        columns = np.full((3, len(boxes)), np.nan)
        if known.any():
            columns[:, known] = self._measured(boxes.select(known))
        return SizeRanges(*columns)

    def _measured(self, boxes: BoxExtents) -> tuple[FloatArray, FloatArray, FloatArray]:
        sold_as = boxes.size_class
        kinds, log_shares = self._kinds.take(sold_as, axis=1), self._log_shares.take(sold_as, axis=1)
        by_size = mixture_by_size(self._tables, boxes, kinds, log_shares)
        grid = on_grid(by_size)
        low, middle, high = grid.quantiles(_MIDDLE_68)  # moments would mind the van that a car hardly ever is
        size_sigma = (high - low) / 2
        stands = self._stands[sold_as] & boxes.uses_bottom
        if stands.any():
            stand = Stand(boxes.bottom, np.exp(by_size.nearer - middle), size_sigma, boxes.edge_sigma[:, 1], stands)
            grid = grid.times(ground_likelihood(grid.log_m, by_size.nearer, stand=stand, prior=self.ground))
        low, best, high = grid.quantiles(_MIDDLE_68, is_relative=_BEST_RELATIVE)
        sigma = np.maximum((high - low) / 2, _MIN_SIGMA)
        # the ground shrinks the kept and the new part alike: by size alone they can be told apart
        kept = sigma * np.sqrt(np.maximum(1.0 - by_size.frame_variance / size_sigma**2, 0.0))
        distance_m = np.exp(best)
        return distance_m, distance_m * sigma, distance_m * kept

    def document(self) -> dict[str, Any]:
        """Content of a curve file of this kind."""
        classes = {name: asdict(prior) for name, prior in self.priors.items()}
        return {"kind": KIND, "ground": asdict(self.ground), "classes": classes}


def cuboids_in(document: Mapping[str, Any]) -> CuboidSizes:
    """The priors of a file's content.

    Raises:
        ValueError, KeyError, TypeError, AttributeError: an unknown class, a missing number, numbers that make no sense.
    """
    ground = GroundPrior(**{key: _tuples(value) for key, value in document["ground"].items()})
    priors = {}
    for name, numbers in document["classes"].items():
        if name not in SIZE_CLASSES:
            raise ValueError(f"unknown size class {name}")
        priors[name] = SizePrior(**{key: _tuples(value) for key, value in numbers.items()})
        if faults := priors[name].faults():
            raise ValueError(f"{name}: {faults}")
    if faults := ground.faults():
        raise ValueError(faults)
    return CuboidSizes(priors, ground)


def _tuples(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _class_mixture(priors: Mapping[str, SizePrior]) -> tuple[IntArray, FloatArray]:
    """(M, classes) true size classes of each detected class, and the logarithms of their probabilities."""
    meant = [
        {one: share for one, share in CLASS_CONFUSION.get(name, {name: 1.0}).items() if one in priors}
        for name in SIZE_CLASSES
    ]
    most = max(len(kinds) for kinds in meant)
    kinds = np.tile(np.arange(len(SIZE_CLASSES)), (most, 1))
    log_shares = np.full(kinds.shape, NO_CHANCE)
    for column, members in enumerate(meant):
        for row, (one, share) in enumerate(members.items()):
            kinds[row, column], log_shares[row, column] = SIZE_CLASSES.index(one), np.log(share)
    return kinds, log_shares
