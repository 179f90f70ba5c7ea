"""CuboidSizes: distances of a frame's boxes from size priors and the common ground plane.

A box detected as a car may show a van: the prior of such a class is a mixture (`CLASS_CONFUSION`),
and the bottom edge of the box on the road distinguishes the two. Only classes of objects on the
road contribute to the ground plane.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import cached_property
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.ranging.size_models.posterior import (
    IMPOSSIBLE,
    LogGrid,
    SizeMixture,
    ground_likelihood,
    log_evidence,
    mixture_by_size,
    on_grid,
)
from track_range.ranging.size_models.prior import ShapeTables, SizePrior, shape_tables
from track_range.ranging.size_models.shared_ground import (
    GroundContacts,
    GroundPrior,
    ground_from_others,
)
from track_range.ranging.size_models.size_model import (
    SIZE_CLASSES,
    BoxExtents,
    DriveState,
    SizeClass,
    SizeRanges,
)

KIND = "cuboids"  # value of "kind" in curve files of this model
# true classes of a detected one: vans are reported as cars, and so are some trucks, which are one
# in twenty vehicles
CLASS_CONFUSION: Mapping[str, Mapping[str, float]] = {
    "car": {"car": 0.95, "van": 0.04, "truck": 0.01},
    "van": {"van": 0.95, "truck": 0.05},
}
# median and one standard deviation to either side
_QUANTILES_68 = np.array([0.158655, 0.5, 0.841345])
# median, and one and two standard deviations to either side
_QUANTILES = np.array([0.02275, 0.158655, 0.5, 0.841345, 0.97725])

_CALIBRATION, _ONE_BODY_CALIBRATION = 0.92, 0.85
"""Factors of sigma for classes with several body types and with a single type, since the width of
the posterior is too large on average. Cross-validated on KITTI: 60-76 % of distances are within one
sigma, and at least 93 % within two."""

# of 95 % of boxes, from the usual sizes and yaws of their class; larger ones scale the variance
_USUAL_CHI2 = 6.0
# smallest systematic fraction of the variance: the size of an object is never known exactly
_MIN_SYSTEMATIC = 1e-4
# by which the log size of an object differs between its views, whose aspect ratios are explained by
# other yaws and sizes: 0.02 within KITTI's tracks, 0.03 to 0.06 for cameras that look aside
_VIEW_SIGMA = 0.03
_MIN_SIGMA = 0.01  # smallest relative standard deviation of a distance


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
        self._is_on_ground = np.array(
            [name in priors and priors[name].stands for name in SIZE_CLASSES]
        )
        self._has_prior = np.array([name in priors for name in SIZE_CLASSES])
        self._drive_sigma = np.array(
            [priors[name].drive_sigma if name in priors else np.nan for name in SIZE_CLASSES]
        )
        self._scatter = np.array(
            [priors[name].scatter[0] if name in priors else np.nan for name in SIZE_CLASSES]
        )
        self._calibration = np.array(
            [
                _CALIBRATION if name in priors and priors[name].bodies else _ONE_BODY_CALIBRATION
                for name in SIZE_CLASSES
            ]
        )

    @cached_property
    def _tables(self) -> ShapeTables:
        # when they are needed: priors of another region are often made from these
        return shape_tables(tuple(self.priors.items()))

    @cached_property
    def _n_bodies(self) -> IntArray:
        # (classes,) number of possible body types
        return np.asarray((self._mixture[1] > IMPOSSIBLE).sum(axis=1))

    @cached_property
    def _fraction(self) -> FloatArray:
        # (classes, B) probabilities of all body types, by the class of the detector
        confusion = [CLASS_CONFUSION.get(name, {name: 1.0}) for name in SIZE_CLASSES]
        names = self._tables.class_name
        true = np.array([[kinds.get(name, 0.0) for name in names] for kinds in confusion])
        return np.asarray(true * self._tables.fraction)

    @cached_property
    def _mixture(self) -> tuple[IntArray, FloatArray]:
        return _possible_bodies(self._fraction)

    def measure(self, boxes: BoxExtents, drive: DriveState | None = None) -> SizeRanges:
        """Distances of the boxes of one frame, which share a ground plane.

        `drive` has started this frame (`DriveState.start_frame`); None = only this frame is known.
        """
        rows = self._has_prior[boxes.size_class].nonzero()[0]
        if 0 < len(rows) == len(boxes):
            return SizeRanges(*self._measured(boxes, drive, rows))
        columns = np.full((3, len(boxes)), np.nan)
        if len(rows):
            columns[:, rows] = self._measured(boxes.select(rows), drive, rows)
        return SizeRanges(*columns)

    def _measured(
        self, boxes: BoxExtents, drive: DriveState | None, rows: IntArray
    ) -> tuple[FloatArray, ...]:
        n_bodies = len(self._tables.class_name)
        body, log_fraction = self._bodies_of(boxes)
        if drive is not None:
            log_fraction += drive.body_evidence(n_bodies)[body, rows[:, None]]
        by_size = mixture_by_size(self._tables, boxes, body, log_fraction)
        grid = on_grid(by_size)
        # unlike moments not affected by unlikely body types
        low, median, high = grid.quantiles(_QUANTILES_68)
        size_sigma = (high - low) / 2
        contacts = GroundContacts(
            bottom=boxes.bottom,
            bearing=boxes.bearing,
            inverse_depth=np.exp(by_size.log_contact_ratio - median),
            sigma=size_sigma,
            edge_sigma=boxes.edge_sigma[:, 1],
            is_on_ground=self._is_on_ground[boxes.size_class] & boxes.uses_bottom,
        )
        if contacts.is_on_ground.any():
            ground = ground_from_others(contacts, self.ground, drive)
            roughness, terms = 1.0 if drive is None else drive.roughness, ground.terms
            likelihood = ground_likelihood(
                grid.log_m,
                by_size.log_contact_ratio,
                contacts=contacts,
                ground=ground,
                prior=self.ground,
                roughness=roughness,
            )
        else:
            likelihood, terms = np.ones_like(grid.log_m), None
        grid = grid.times(likelihood)
        (lowest, low, _, high, highest), relative = grid.quantiles_and_relative(_QUANTILES)
        # the median under p(log d) / d has the smallest expected relative error
        best = relative[2]
        sigma = np.maximum(
            np.maximum((high - low) / 2, np.maximum(highest - best, best - lowest) / 2), _MIN_SIGMA
        )
        if drive is not None:
            of_bodies = self._body_likelihood(body, log_fraction, by_size, grid, likelihood)
            log_size = best - by_size.log_contact_ratio + np.log(boxes.wh_over_f[:, 1])
            variance = np.maximum((high - low) / 2, _MIN_SIGMA) ** 2
            mean = drive.add(rows, terms, of_bodies, log_size, variance)
            # A distance by the mean size has the noise and the shape of this box, but not the error
            # of its view.
            of_box = boxes.noise_variance[:, 1] + self._scatter[boxes.size_class] ** 2
            gain = _VIEW_SIGMA**2 / (_VIEW_SIGMA**2 + of_box)
            best = best + gain * (mean - log_size)
        # The ground plane comes from sizes that share the errors of drive and detector, so that it
        # cannot reduce them.
        sigma *= self._calibration[boxes.size_class]
        drive_sigma = np.hypot(self._drive_sigma[boxes.size_class], boxes.systematic_sigma[:, 1])
        drive_sigma = np.minimum(drive_sigma, size_sigma)
        reduction = np.minimum((sigma / size_sigma) ** 2, 1.0)
        sigma = np.sqrt(sigma**2 + (1.0 - reduction) * drive_sigma**2)
        sigma = sigma * np.sqrt(1.0 + np.maximum(by_size.chi2 - _USUAL_CHI2, 0.0) / _USUAL_CHI2)
        # The ground reduces the systematic and the independent part alike, so their ratio is that
        # by size alone.
        systematic_fraction = np.maximum(
            1.0 - by_size.frame_variance / size_sigma**2, _MIN_SYSTEMATIC
        )
        systematic = sigma * np.sqrt(systematic_fraction)
        distance_m = np.exp(best)
        return distance_m, distance_m * sigma, distance_m * systematic

    def _bodies_of(self, boxes: BoxExtents) -> tuple[IntArray, FloatArray]:
        """(N, M) body types that each box may show, and their log probabilities."""
        if boxes.doubt is not None and boxes.doubt[1].any():
            other, probability = boxes.doubt
            q = np.where(self._has_prior[other], probability, 0.0)[:, None]
            fraction = (1.0 - q) * self._fraction[boxes.size_class] + q * self._fraction[other]
            return _possible_bodies(fraction)
        # possible types come first
        n_possible = int(self._n_bodies[boxes.size_class].max())
        body, log_fraction = self._mixture
        body, log_fraction = body[:, :n_possible], log_fraction[:, :n_possible]
        return body.take(boxes.size_class, axis=0), log_fraction.take(boxes.size_class, axis=0)

    def _body_likelihood(
        self,
        body: IntArray,
        log_fraction: FloatArray,
        by_size: SizeMixture,
        grid: LogGrid,
        likelihood: FloatArray,
    ) -> FloatArray:
        """(B, N) log likelihoods of all body types by size and ground; 0 = the most likely type, or
        one that the class does not have: another class may have it later.
        """
        (n, m), n_bodies = body.shape, len(self._tables.class_name)
        by_term = np.vecdot(grid.by_term, likelihood.astype(np.float32))
        index = by_size.body + np.arange(0, n * m, m)[:, None]
        evidence = np.bincount(index.ravel(), weights=by_term.T.ravel(), minlength=n * m)
        log_likelihood = np.log(np.maximum(evidence, 1e-300)).reshape(n, m) - log_fraction
        log_likelihood[log_fraction < IMPOSSIBLE / 2] = -np.inf
        log_likelihood -= np.maximum.reduce(log_likelihood, axis=1, keepdims=True)
        result = np.zeros((n_bodies, n))
        is_possible = np.isfinite(log_likelihood)
        result[body, np.arange(n)[:, None]] = np.where(is_possible, log_likelihood, 0.0)
        return result

    def log_evidence(self, boxes: BoxExtents) -> FloatArray:
        """(N,) log likelihood of the sizes of boxes over distances, sizes and yaws, up to a
        constant per box.

        It depends on the focal length through the bearings. All boxes need a class with a prior.
        """
        return log_evidence(self._tables, boxes, *self._bodies_of(boxes))

    def with_flat_distance(self, log_sigma: float) -> CuboidSizes:
        """The same sizes with the standard deviation `log_sigma` of the log distance of every
        class.
        """
        priors = {
            name: replace(prior, log_distance=(prior.log_distance[0], log_sigma))
            for name, prior in self.priors.items()
        }
        return CuboidSizes(priors, self.ground)

    def document(self) -> dict[str, Any]:
        """Content of a curve file with this model."""
        classes = {name: asdict(prior) for name, prior in self.priors.items()}
        return {"kind": KIND, "ground": asdict(self.ground), "classes": classes}


def cuboids_in(content: CuboidFile) -> CuboidSizes:
    """The model in the content of a curve file; ValueError if a prior has an impossible value."""
    if invalid := [
        f"{name}: {faults}" for name, prior in content.classes.items() if (faults := prior.faults())
    ]:
        raise ValueError(invalid[0])
    return CuboidSizes(content.classes, content.ground)


def _possible_bodies(fraction: FloatArray) -> tuple[IntArray, FloatArray]:
    """(N, M) body types with a probability in (N, B), in their order and before others, and the
    logarithms of the probabilities.
    """
    n_possible = int(np.count_nonzero(fraction, axis=1).max())
    body = np.argsort(fraction == 0, axis=1, kind="stable")[:, :n_possible]
    with np.errstate(divide="ignore"):
        log_fraction = np.log(np.take_along_axis(fraction, body, axis=1))
    return body, np.maximum(log_fraction, IMPOSSIBLE)
