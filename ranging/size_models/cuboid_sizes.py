"""CuboidSizes: distances of a frame's boxes from size priors and the common ground plane.

A box detected as a car may show a van: the prior of such a class is a mixture (`CLASS_CONFUSION`), and the bottom edge
of the box on the road distinguishes the two. Only classes of objects on the road contribute to the ground plane.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.ranging.size_models.posterior import (
    IMPOSSIBLE,
    ground_likelihood,
    log_evidence,
    mixture_by_size,
    on_grid,
)
from track_range.ranging.size_models.prior import ShapeTables, SizePrior
from track_range.ranging.size_models.shared_ground import GroundContacts, GroundPrior
from track_range.ranging.size_models.size_model import SIZE_CLASSES, BoxExtents, SizeClass, SizeRanges

KIND = "cuboids"
"""Value of "kind" in curve files of this model."""

CLASS_CONFUSION: Mapping[str, Mapping[str, float]] = {
    "car": {"car": 0.96, "van": 0.04},
    "van": {"van": 0.95, "truck": 0.05},
}
"""Probabilities of the true classes of a detected class: detectors report some vans as cars, and KITTI labels
lorries that are 3 m high as vans."""

_QUANTILES_68 = np.array([[0.158655], [0.5], [0.841345]])
"""Levels of the median and of the central 68 %: one standard deviation to either side of a Gaussian."""

_IS_RELATIVE = np.array([[False], [True], [False]])
"""Levels of `_QUANTILES_68` under p(log d) / d: the median, which then has the smallest expected relative error."""

_MIN_SIGMA = 0.01
"""Smallest relative standard deviation of a distance."""


class CuboidFile(BaseModel):
    """Content of a curve file with priors over cuboids, by size class."""

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)
    ground: GroundPrior
    classes: dict[SizeClass, SizePrior]


class CuboidSizes:
    """Size model with priors over the cuboids of all classes, and a prior of the ground plane."""

    def __init__(self, priors: Mapping[str, SizePrior], ground: GroundPrior | None = None) -> None:
        """Create a model from priors by size class; boxes of other classes are not ranged (NaN)."""
        self.priors = dict(priors)
        self.ground = ground or GroundPrior()
        self._tables = ShapeTables(priors)
        self._is_on_ground = np.array([name in priors and priors[name].stands for name in SIZE_CLASSES])
        self._has_prior = np.array([name in priors for name in SIZE_CLASSES])
        self._true_class, self._log_share = _class_mixture(priors)

    def measure(self, boxes: BoxExtents) -> SizeRanges:
        """Distances of the boxes of one frame, which share a ground plane."""
        has_prior = self._has_prior[boxes.size_class]
        if has_prior.all() and len(boxes):
            return SizeRanges(*self._measured(boxes))
        columns = np.full((3, len(boxes)), np.nan)
        if has_prior.any():
            columns[:, has_prior] = self._measured(boxes.select(has_prior))
        return SizeRanges(*columns)

    def _measured(self, boxes: BoxExtents) -> tuple[FloatArray, FloatArray, FloatArray]:
        detected_class = boxes.size_class
        true_class = self._true_class.take(detected_class, axis=1)
        log_share = self._log_share.take(detected_class, axis=1)
        by_size = mixture_by_size(self._tables, boxes, true_class, log_share)
        grid = on_grid(by_size)
        low, median, high = grid.quantiles(_QUANTILES_68)  # unlike moments not affected by unlikely classes
        size_sigma = (high - low) / 2
        is_on_ground = self._is_on_ground[detected_class] & boxes.uses_bottom
        if is_on_ground.any():
            contacts = GroundContacts(
                bottom=boxes.bottom,
                nearness=np.exp(by_size.log_contact_ratio - median),
                sigma=size_sigma,
                edge_sigma=boxes.edge_sigma[:, 1],
                is_on_ground=is_on_ground,
            )
            grid = grid.times(
                ground_likelihood(grid.log_m, by_size.log_contact_ratio, contacts=contacts, prior=self.ground)
            )
        low, best, high = grid.quantiles(_QUANTILES_68, is_relative=_IS_RELATIVE)
        sigma = np.maximum((high - low) / 2, _MIN_SIGMA)
        # The ground reduces the systematic and the independent part alike, so their ratio is that by size alone.
        systematic = sigma * np.sqrt(np.maximum(1.0 - by_size.frame_variance / size_sigma**2, 0.0))
        distance_m = np.exp(best)
        return distance_m, distance_m * sigma, distance_m * systematic

    def log_evidence(self, boxes: BoxExtents) -> FloatArray:
        """(N,) log likelihood of the sizes of boxes over distances, sizes and yaws, up to a constant per box.

        It depends on the focal length through the bearings. All boxes need a class with a prior.
        """
        true_class = self._true_class.take(boxes.size_class, axis=1)
        return log_evidence(self._tables, boxes, true_class, self._log_share.take(boxes.size_class, axis=1))

    def with_flat_distance(self, log_sigma: float) -> CuboidSizes:
        """The same sizes with the standard deviation `log_sigma` of the log distance of every class."""
        priors = {
            name: replace(prior, log_distance=(prior.log_distance[0], log_sigma)) for name, prior in self.priors.items()
        }
        return CuboidSizes(priors, self.ground)

    def document(self) -> dict[str, Any]:
        """Content of a curve file with this model."""
        classes = {name: asdict(prior) for name, prior in self.priors.items()}
        return {"kind": KIND, "ground": asdict(self.ground), "classes": classes}


def cuboids_in(content: CuboidFile) -> CuboidSizes:
    """The model in the content of a curve file.

    Raises:
        ValueError: a prior has an impossible value.
    """
    if invalid := [f"{name}: {faults}" for name, prior in content.classes.items() if (faults := prior.faults())]:
        raise ValueError(invalid[0])
    return CuboidSizes(content.classes, content.ground)


def _class_mixture(priors: Mapping[str, SizePrior]) -> tuple[IntArray, FloatArray]:
    """(M, classes) true size classes of each detected class, and the logarithms of their probabilities."""
    mixtures = [
        {true: share for true, share in CLASS_CONFUSION.get(name, {name: 1.0}).items() if true in priors}
        for name in SIZE_CLASSES
    ]
    m = max(len(mixture) for mixture in mixtures)
    true_class = np.tile(np.arange(len(SIZE_CLASSES)), (m, 1))
    log_share = np.full(true_class.shape, IMPOSSIBLE)
    for column, mixture in enumerate(mixtures):
        for row, (name, share) in enumerate(mixture.items()):
            true_class[row, column], log_share[row, column] = SIZE_CLASSES.index(name), np.log(share)
    return true_class, log_share
