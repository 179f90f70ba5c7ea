"""fit_reference: the disparity error of a rig from objects with known disparities.

    d_true = d + offset (+ curvature u^2)         minimise  sum |d_true - d - offset - curvature u^2| / d

To first order dZ / Z = -dd / d, so this is the mean relative error of the distances; for the offset
alone it is the weighted median. Errors due to the depth of an object are proportional to d^2; both
the weight and the absolute value limit their influence. The curvature is fitted only if
cross-validation supports it. The errors in one frame are correlated (same scene, same pose), so
groups are resampled instead of objects.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.robust_statistics import weighted_median
from track_range.stereo.geometry.alignment import Alignment, column_from_axis
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError

MIN_OBJECTS = 5  # minimum number of objects for a fit
_N_RESAMPLES = 200  # number of bootstrap samples
_N_FOLDS = 8  # number of folds of the cross-validation
_MIN_OBJECTS_FOR_CURVATURE = 60  # minimum number of objects for a fit of the curvature
# minimum standard deviation of u^2 over the objects for the curvature; uniform: 0.3
_MIN_LEVERAGE = 0.08
# largest relative disparity error due to alignment; larger ones are wrong matches or labels
_MAX_MISMATCH = 0.3
_MAX_OFFSET_PX = 3.0  # disparity error that is never a mismatch, however small the disparity
_MEDIAN_OF_NORMAL = 0.6745  # median of |x| for a standard normal x
_N_REWEIGHTINGS = 30  # iterations of the reweighted least squares
_N_HALVINGS = 30  # iterations of the bisection
_MIN_ERROR_PX = 0.02  # error below which weights no longer increase in the reweighted least squares


class _Known(NamedTuple):
    """N objects: d_true - d, 1 / d, u^2, group from 0, the matcher's sigma."""

    error_px: FloatArray
    weight: FloatArray
    u2: FloatArray
    group: IntArray
    sigma_px: FloatArray

    @property
    def n_groups(self) -> int:
        return int(self.group.max()) + 1

    def select(self, rows: BoolArray | IntArray) -> _Known:
        return _Known._make(column[rows] for column in self)


def fit_reference(
    measured_px: FloatArray,
    true_px: FloatArray,
    *,
    x_px: FloatArray,
    camera: PinholeCamera,
    groups: npt.NDArray[np.generic],
    sigma_px: FloatArray | None = None,
    seed: int = 0,
) -> Alignment:
    """The alignment from known disparities; NaN rows and mismatches are ignored.

    Arrays are (N,): disparities of a matcher, true disparities, columns in the image of the
    rectified left camera, and groups (frame, pair or object) within which errors may be correlated.
    `sigma_px` (N,) are standard deviations of the matcher, excluded from the residual, None =
    zeros; `seed` is for the resampling. Raises RigError if fewer than five objects are usable.
    """
    with np.errstate(invalid="ignore"):  # NaN compares as False: not usable
        is_match = np.abs(true_px - measured_px) <= np.maximum(
            _MAX_OFFSET_PX, _MAX_MISMATCH * true_px
        )
        rows = (measured_px > 0) & (true_px > 0) & is_match
    if rows.sum() < MIN_OBJECTS:
        raise RigError(
            f"expected at least {MIN_OBJECTS} matched objects with known distances for the "
            f"alignment, found {int(rows.sum())}; give more frames or pairs."
        )
    known = _Known(
        (true_px - measured_px)[rows],
        1.0 / measured_px[rows],
        column_from_axis(x_px[rows], camera) ** 2,
        np.unique(groups[rows], return_inverse=True)[1],
        np.zeros(int(rows.sum())) if sigma_px is None else sigma_px[rows],
    )
    has_curvature = _is_curvature_supported(known)
    offset_px, curvature_px = _fit(known, has_curvature=has_curvature)
    samples = _resampled(known, has_curvature=has_curvature, rng=np.random.default_rng(seed))
    abs_residual_px = np.abs(known.error_px - offset_px - curvature_px * known.u2)
    scatter_px = weighted_median(abs_residual_px, known.weight) / _MEDIAN_OF_NORMAL
    min_sigma_px = scatter_px / known.n_groups**0.5  # samples of few groups hardly differ
    at_objects_px = samples[:, 0] + samples[:, 1] * float(
        np.average(known.u2, weights=known.weight)
    )
    sigma_at_objects_px = max(float(at_objects_px.std()), min_sigma_px)
    return Alignment(
        offset_px=offset_px,
        curvature_px=curvature_px,
        residual_px=float(np.hypot(_excess_sigma_px(abs_residual_px, known), sigma_at_objects_px)),
        offset_sigma_px=max(float(samples[:, 0].std()), min_sigma_px),
        curvature_sigma_px=float(samples[:, 1].std()),
        source=f"{int(rows.sum())} known distances of {known.n_groups} scenes or objects",
    )


def _fit(known: _Known, *, has_curvature: bool) -> tuple[float, float]:
    """Offset and curvature with the minimum weighted absolute error, by reweighted least
    squares.
    """
    if not has_curvature:
        return weighted_median(known.error_px, known.weight), 0.0
    design = np.stack([np.ones_like(known.u2), known.u2], axis=1)
    reweighted, solution = known.weight, np.zeros(2)
    for _ in range(_N_REWEIGHTINGS):
        root = np.sqrt(reweighted)
        solution = np.linalg.lstsq(design * root[:, None], known.error_px * root, rcond=None)[0]
        reweighted = known.weight / np.maximum(
            np.abs(known.error_px - design @ solution), _MIN_ERROR_PX
        )
    return float(solution[0]), float(solution[1])


def _is_curvature_supported(known: _Known) -> bool:
    """Whether the curvature reduces the error of held-out objects by more than two standard
    deviations of the gain.
    """
    n_groups, n_objects = known.n_groups, len(known.u2)
    if (
        n_objects < _MIN_OBJECTS_FOR_CURVATURE
        or n_groups < _N_FOLDS
        or float(np.std(known.u2)) < _MIN_LEVERAGE
    ):
        return False
    gain = np.zeros(n_groups)
    for fold in range(_N_FOLDS):
        is_held_out = known.group % _N_FOLDS == fold
        rest, held_out = known.select(~is_held_out), known.select(is_held_out)
        plain_px, _ = _fit(rest, has_curvature=False)
        offset_px, curvature_px = _fit(rest, has_curvature=True)
        residual_px = held_out.error_px - offset_px - curvature_px * held_out.u2
        gain_px = np.abs(held_out.error_px - plain_px) - np.abs(residual_px)
        np.add.at(gain, held_out.group, held_out.weight * gain_px)
    return bool(gain.mean() > 2 * gain.std(ddof=1) / np.sqrt(n_groups))


def _resampled(known: _Known, *, has_curvature: bool, rng: np.random.Generator) -> FloatArray:
    """(R, 2) offset and curvature of bootstrap samples of the groups."""
    members = [np.flatnonzero(known.group == number) for number in range(known.n_groups)]
    fits = []
    for _ in range(_N_RESAMPLES):
        drawn = rng.integers(len(members), size=len(members)).tolist()
        sample = known.select(np.concatenate([members[number] for number in drawn]))
        fits.append(_fit(sample, has_curvature=has_curvature))
    return np.array(fits)


def _excess_sigma_px(abs_residual_px: FloatArray, known: _Known) -> float:
    """Standard deviation that explains the median of the residuals (N,) together with the matcher's
    sigmas.
    """
    low_px, high_px = 0.0, float(abs_residual_px.max()) / _MEDIAN_OF_NORMAL
    for _ in range(_N_HALVINGS):
        middle_px = (low_px + high_px) / 2
        # 0 / 0 for an exact object without a sigma
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.nan_to_num(abs_residual_px / np.hypot(known.sigma_px, middle_px), nan=0.0)
        if weighted_median(ratio, known.weight) > _MEDIAN_OF_NORMAL:
            low_px = middle_px
        else:
            high_px = middle_px
    return low_px
