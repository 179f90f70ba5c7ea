"""fit_reference: the disparity error of a rig from objects whose true disparity is known.

    true = measured + offset (+ bow u^2)          minimised: sum |true - measured - offset - bow u^2| / measured

To first order dZ / Z = -dd / d, so this is the mean relative error of the distances: the weighted median for the offset
alone. An object's own depth errs in proportion to d^2, which the weight and the absolute value both keep small. The bow
is fitted only where objects that were left out say that it helps. Errors of one frame go together (same scene, same
pose), so groups, not objects, are resampled.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.robust_statistics import weighted_median
from track_range.stereo.alignment.model import Alignment, column_from_axis
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError

MIN_OBJECTS = 5

_N_RESAMPLES = 200
_N_FOLDS = 8
_MIN_OBJECTS_FOR_BOW = 60
_MIN_BOW_LEVERAGE = 0.08
"""Least standard deviation of u^2 over the objects; evenly spread over the image it is 0.3."""

_MAX_MISMATCH = 0.3
"""Relative disparity errors beyond it are wrong matches or wrong labels, not alignment: they are left out."""

_GROSS_PX = 3.0
"""An error within it is no mismatch, however small the disparity."""

_MEDIAN_OF_NORMAL = 0.6745
_N_REWEIGHTINGS = 30
_N_HALVINGS = 30
_LEAST_ERROR_PX = 0.02
"""Smaller errors get no more weight when absolute errors are minimised by reweighting."""


class _Known(NamedTuple):
    """Objects, N each: true - measured, 1 / measured, u^2, group from 0, the matcher's own sigma."""

    error_px: FloatArray
    weight: FloatArray
    u2: FloatArray
    group: IntArray
    sigma_px: FloatArray

    @property
    def n_groups(self) -> int:
        return int(self.group.max()) + 1

    def rows(self, keep: BoolArray | IntArray) -> _Known:
        return _Known(self.error_px[keep], self.weight[keep], self.u2[keep], self.group[keep], self.sigma_px[keep])


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
    """The alignment that known disparities call for; NaN rows and mismatches are left out.

    Args:
        measured_px: (N,) disparities as a matcher reads them.
        true_px: (N,) true ones.
        x_px: (N,) columns of the left image they belong to.
        camera: the rectified left one.
        groups: (N,) frame, pair or object of each: errors within a group may go together.
        sigma_px: (N,) what the matcher thinks of its own errors; what scatters beyond them is the residual. None = all
            that scatters is.
        seed: of the resampling.

    Raises:
        RigError: fewer than five objects that can be used.
    """
    keep = _usable(measured_px, true_px)
    if keep.sum() < MIN_OBJECTS:
        raise RigError(
            f"the alignment needs at least {MIN_OBJECTS} objects of known distance that can be matched, and there are "
            f"{int(keep.sum())}; give more frames or pairs."
        )
    known = _Known(
        (true_px - measured_px)[keep],
        1.0 / measured_px[keep],
        column_from_axis(x_px[keep], camera) ** 2,
        np.unique(groups[keep], return_inverse=True)[1],
        np.zeros(int(keep.sum())) if sigma_px is None else sigma_px[keep],
    )
    has_bow = _is_bow_supported(known)
    offset_px, bow_px = _fit(known, has_bow=has_bow)
    drawn = _resampled(known, has_bow=has_bow, rng=np.random.default_rng(seed))
    left_px = np.abs(known.error_px - offset_px - bow_px * known.u2)
    scatter_px = weighted_median(left_px, known.weight) / _MEDIAN_OF_NORMAL
    least_px = scatter_px / known.n_groups**0.5  # few groups, drawn again and again, hardly differ
    at_objects = drawn[:, 0] + drawn[:, 1] * float(np.average(known.u2, weights=known.weight))
    own_px = max(float(at_objects.std()), least_px)
    return Alignment(
        offset_px=offset_px,
        bow_px=bow_px,
        residual_px=float(np.hypot(_beyond(left_px, known), own_px)),
        offset_sigma_px=max(float(drawn[:, 0].std()), least_px),
        bow_sigma_px=float(drawn[:, 1].std()),
        source=f"{int(keep.sum())} known distances of {known.n_groups} scenes or objects",
    )


def _usable(measured_px: FloatArray, true_px: FloatArray) -> BoolArray:
    with np.errstate(invalid="ignore"):  # NaN compares as False: not usable
        error_px = np.abs(true_px - measured_px)
        good = (measured_px > 0) & (true_px > 0) & (error_px <= np.maximum(_GROSS_PX, _MAX_MISMATCH * true_px))
    return np.asarray(good)


def _fit(known: _Known, *, has_bow: bool) -> tuple[float, float]:
    return _offset_and_bow(known) if has_bow else (weighted_median(known.error_px, known.weight), 0.0)


def _offset_and_bow(known: _Known) -> tuple[float, float]:
    """Least weighted absolute error, by reweighted least squares."""
    design = np.stack([np.ones_like(known.u2), known.u2], axis=1)
    reweighted, solution = known.weight, np.zeros(2)
    for _ in range(_N_REWEIGHTINGS):
        root = np.sqrt(reweighted)
        solution = np.linalg.lstsq(design * root[:, None], known.error_px * root, rcond=None)[0]
        reweighted = known.weight / np.maximum(np.abs(known.error_px - design @ solution), _LEAST_ERROR_PX)
    return float(solution[0]), float(solution[1])


def _is_bow_supported(known: _Known) -> bool:
    """Whether objects left out are told better with the bow than without, by more than twice the gain's own error."""
    n_groups = known.n_groups
    if len(known.u2) < _MIN_OBJECTS_FOR_BOW or n_groups < _N_FOLDS or float(np.std(known.u2)) < _MIN_BOW_LEVERAGE:
        return False
    gain = np.zeros(n_groups)
    for fold in range(_N_FOLDS):
        is_out = known.group % _N_FOLDS == fold
        rest, out = known.rows(~is_out), known.rows(is_out)
        plain, _ = _fit(rest, has_bow=False)
        offset_px, bow_px = _fit(rest, has_bow=True)
        better_px = np.abs(out.error_px - plain) - np.abs(out.error_px - offset_px - bow_px * out.u2)
        np.add.at(gain, out.group, out.weight * better_px)
    return bool(gain.mean() > 2 * gain.std(ddof=1) / np.sqrt(n_groups))


def _resampled(known: _Known, *, has_bow: bool, rng: np.random.Generator) -> FloatArray:
    """(R, 2) offset and bow of as many groups, drawn with replacement."""
    members = [np.flatnonzero(known.group == number) for number in range(known.n_groups)]
    drawn = []
    for _ in range(_N_RESAMPLES):
        chosen = rng.integers(len(members), size=len(members)).tolist()
        drawn.append(_fit(known.rows(np.concatenate([members[number] for number in chosen])), has_bow=has_bow))
    return np.array(drawn)


def _beyond(left_px: FloatArray, known: _Known) -> float:
    """The standard deviation that explains, with the matcher's own, the middle one of the (N,) errors left."""
    low_px, high_px = 0.0, float(left_px.max()) / _MEDIAN_OF_NORMAL
    for _ in range(_N_HALVINGS):
        tried_px = (low_px + high_px) / 2
        with np.errstate(divide="ignore", invalid="ignore"):  # 0 / 0 of an exact object without a sigma
            ratio = np.nan_to_num(left_px / np.hypot(known.sigma_px, tried_px), nan=0.0)
        if weighted_median(ratio, known.weight) > _MEDIAN_OF_NORMAL:
            low_px = tried_px
        else:
            high_px = tried_px
    return low_px
