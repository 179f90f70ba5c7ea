"""Which of a box's surfaces is the object, if any: a softmax over the surfaces of a linear score.

    P(s) = (1 - Q) exp(theta . phi(s)) / sum over the surfaces t of exp(theta . phi(t))
    Q    = 1 / (1 + exp(-eta . phi(best)))

Q is the probability that none of the surfaces is the object: a box may show too little of an object
behind a post, a fence or a nearer vehicle, and only its occluder matches. It depends on the best
surface: whether it has the disparity of another box of the frame and is too near for the size of
its own, is small, or matches badly.

The features phi are where a surface lies in the box, how well it matches, whether other surfaces
are in front of or behind it, and how its disparity agrees with what is known about the object: its
size, its track and the other boxes. An occluder is in front, narrow, and too near for the size of
the box; the background is behind, at the box's corners; the object surrounds its occluder, so that
it is seen on both sides.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.stereo.matching.patch_matches import ExpectedDisparity
from track_range.stereo.matching.surfaces import BoxWindows, Surfaces
from track_range.stereo.matching.tiles import BoxTiles

_SIDE_U, _SIDE_V = 0.15, 0.15  # limits of the middle third of a box, in box sizes from its centre
_CENTRE_SIGMA = 0.175  # standard deviation of the weight of the box's centre, in box sizes
_MIN_FRACTION = 0.05  # added to fractions before their logarithm
# smallest sigma of the log disparity by size: visible parts are smaller than objects
_MIN_LOG_SIGMA = 0.1
# standard deviations from the expected disparity; larger deviations are as improbable
_MAX_DEVIATION = 4.0
# standard deviation of the log disparity in one frame about that of the track's last match
_TRACK_LOG_SIGMA = 0.05
# ratio of disparities from which a surface is in front of or behind another one
_NEARER, _FARTHER = 1.03, 0.97
# ratio of the expected disparities from which another box is nearer or farther than the box
_OTHER_BOX_RATIO = 1.15
# largest relative difference of a surface from the disparity of another box it belongs to
_OTHER_BOX_FRACTION = 0.12

# standard deviations from the size that objects of a class have
_TOO_NEAR_SIGMA = 3.0
# fraction of a box inside a nearer one from which it may show the nearer object
_COVERED_FRACTION = 0.02

THETA = {
    "area": 0.27,
    "centre": 0.28,
    "both_sides": 0.42,
    "one_side": 0.19,
    "middle_columns": 0.09,
    "top": 0.29,
    "bottom": 0.12,
    "middle_rows": 0.28,
    "width": -0.03,
    "height": -0.14,
    "cost": -0.31,
    "in_front": 2.73,
    "behind": -2.74,
    "nearer_than_size": -1.10,
    "nearer_than_size_squared": -0.16,
    "farther_than_size": -0.47,
    "farther_than_size_squared": -0.14,
    "off_track": -0.20,
    "of_other_box": -1.24,
}
"""theta: multinomial logistic regression of the correct surface on the features, with an L2 penalty
of 2, on the scenario `occlusion` of the simulation, seeds 0-19, with and without sizes and priors
(`python -m benchmarks surface_choice`, before its sizes had the errors of wrong classes)."""


ETA = {
    "constant": -4.31,
    "of_other_box": 2.83,
    "of_other_box_and_nearer_than_size": 0.56,
    "too_near_for_size": 3.73,
    "cost": 0.24,
    "area": -1.06,
}
"""eta: logistic regression of "none of the surfaces is within 10 % of the object" on the features
of the best surface, on the same drives with all objects that are hidden by less than 85 %
(`python -m benchmarks surface_choice`). Deviations from the size count from
3 standard deviations on, and smaller ones only in the box of another object: a child is nearer than
the size of people lets expect."""


@dataclass(frozen=True, slots=True)
class ChoiceModel:
    """Coefficients of the choice; those of features that are not named are 0."""

    theta: Mapping[str, float]  # of the score of a surface, by the names in `THETA`
    eta: Mapping[str, float]  # of the probability of none, by the names in `ETA`

    def score(self, phi: FloatArray) -> FloatArray:
        """(S, N) scores of surfaces from features (F, S, N)."""
        theta = np.array([self.theta.get(name, 0.0) for name in THETA])
        return np.asarray((theta @ phi.reshape(len(phi), -1)).reshape(phi.shape[1:]))

    def none_probability(self, best: FloatArray) -> FloatArray:
        """(N,) Q, from the features (F, N) of the best surfaces."""
        features = none_features(dict(zip(THETA, best, strict=True)))
        eta = np.array([self.eta.get(name, 0.0) for name in ETA])
        score = eta @ np.array([features[name] for name in ETA])
        return np.asarray(1.0 / (1.0 + np.exp(-score)))


OF_MATCHES = ChoiceModel(THETA, ETA)
"""Windows that were matched, by the patch matcher or by semi-global matching: near the edge of an
object, both give the background the object's disparity."""

OF_MAPS = ChoiceModel(
    {
        "area": -0.04,
        "centre": 0.55,
        "both_sides": 0.15,
        "one_side": 0.42,
        "middle_columns": 0.59,
        "top": -0.31,
        "bottom": 0.04,
        "middle_rows": 0.52,
        "width": 0.57,
        "height": 1.31,
        "in_front": -0.55,
        "behind": -3.57,
    },
    {"constant": -3.65, "area": -1.68},
)
"""Windows of dense maps with edges as sharp as their resolution, or blurred: networks and depth
cameras. The same regression, on exact disparities of the simulation (`occlusion`, seeds 0-9, and
`town`, seeds 0-7), blurred by 1.5 and 3 px, at a quarter of the resolution, with noise, with holes,
and of cars with the background in their windows. Sizes are not used."""


@dataclass(frozen=True, slots=True)
class SurfaceChoice:
    """The object's surface in each of N boxes."""

    chosen: IntArray  # (N,) number of the surface
    # (S, N) probability of each surface; they sum to 1 - `none`, or are 0 in boxes without any
    probability: FloatArray
    none: FloatArray  # (N,) probability that none of the surfaces is the object
    n_surfaces: IntArray  # (N,) number of surfaces with at least two windows


@dataclass(frozen=True, slots=True)
class OtherBoxes:
    """All boxes of a frame with their expected disparities: nearer boxes occlude, farther boxes are
    background.
    """

    xyxy_px: FloatArray  # (M, 4) boxes
    expected_px: FloatArray  # (M,) expected disparities, from the track or the size; NaN = unknown

    def windows(
        self,
        xyxy_px: FloatArray,
        expected_px: FloatArray,
        tiles: BoxTiles,
        disparity_px: FloatArray,
    ) -> FloatArray:
        """(N, G) 1 = the window belongs to another box, which is expected to be nearer or farther;
        0 = it does not.

        `expected_px` (N,) are the expected disparities of the boxes, NaN = unknown; `disparity_px`
        (N, G) the disparities of the windows, px of the image.
        """
        of_others = np.zeros(tiles.u.shape)
        first_px, last_px = self.xyxy_px[:, None, :2], self.xyxy_px[:, None, 2:]
        is_near = ((first_px < xyxy_px[:, 2:]) & (last_px > xyxy_px[:, :2])).all(axis=2)
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = np.abs(np.log(self.expected_px[:, None] / expected_px))
            # (other, box); False where unknown, and for the box itself
            is_other = is_near & (ratio > np.log(_OTHER_BOX_RATIO))
            is_other &= (self.xyxy_px[:, None] != xyxy_px).any(axis=2)
            if not is_other.any():
                return of_others
            is_same = (
                np.abs(disparity_px / self.expected_px[:, None, None] - 1.0) < _OTHER_BOX_FRACTION
            )
        size_px, centre_px = xyxy_px[:, 2:] - xyxy_px[:, :2], (xyxy_px[:, :2] + xyxy_px[:, 2:]) / 2
        x_px = centre_px[:, :1] + tiles.u * size_px[:, :1]
        y_px = centre_px[:, 1:] + tiles.v * size_px[:, 1:]
        left, top, right, bottom = self.xyxy_px.T[:, :, None, None]
        is_inside = (x_px > left) & (x_px < right) & (y_px > top) & (y_px < bottom)  # (other, N, G)
        of_others[:] = (is_inside & is_same & is_other[:, :, None]).any(axis=0)
        return of_others


def are_behind(xyxy_px: FloatArray) -> BoolArray:
    """(N,) boxes (N, 4) of which another box, which ends lower and so is nearer, covers a part."""
    is_lower = xyxy_px[:, 3] > xyxy_px[:, 3, None]  # (box, other)
    first_px = np.maximum(xyxy_px[:, None, :2], xyxy_px[:, :2])
    last_px = np.minimum(xyxy_px[:, None, 2:], xyxy_px[:, 2:])
    covered_px2 = is_lower * np.maximum(last_px - first_px, 0.0).prod(axis=2)
    area_px2 = (xyxy_px[:, 2:] - xyxy_px[:, :2]).prod(axis=1)
    return np.asarray(covered_px2.max(axis=1, initial=0.0) > _COVERED_FRACTION * area_px2)


def features(
    surfaces: Surfaces,
    tiles: BoxWindows,
    cost: FloatArray,
    *,
    by_size: ExpectedDisparity,
    track_px: FloatArray,
    others_fraction: FloatArray,
) -> FloatArray:
    """(F, S, N) features phi of the surfaces, in the order of `THETA`.

    `cost` (N, G) are the costs of the windows' minima, bits per pixel; `track_px` (N,) the last
    matches of the tracks, NaN = none; `others_fraction` (N, G) comes from `OtherBoxes.windows`.
    """
    u, v = tiles.u, tiles.v
    is_surface = np.isfinite(surfaces.centre)
    member = surfaces.is_member.astype(np.float64)
    n = np.maximum(member.sum(axis=2), 1.0)
    # (N, G, 10) whether windows are in parts of the box: all, the centre with its weight, left,
    # right, the middle columns, top, bottom, the middle rows; then two values of each window
    parts = np.empty((*u.shape, 10))
    parts[..., 0] = 1.0
    parts[..., 1] = np.exp((u * u + v * v) * (-0.5 / _CENTRE_SIGMA**2))
    for first, position, side in ((2, u, _SIDE_U), (5, v, _SIDE_V)):
        is_before, is_after = position < -side, position > side
        parts[..., first], parts[..., first + 1] = is_before, is_after
        parts[..., first + 2] = ~(is_before | is_after)
    parts[..., :8] *= tiles.is_used[..., None]
    parts[..., 8], parts[..., 9] = cost, others_fraction
    sums = (member.swapaxes(0, 1) @ parts).transpose(2, 1, 0)  # (10, S, N)
    fraction = sums[:8] / np.maximum(parts[..., :8].sum(axis=1), 1e-6).T[:, None]
    log_fraction = np.log(fraction + _MIN_FRACTION)
    area, disparity = fraction[0, :, None], np.where(is_surface, surfaces.disparity, 0.0)
    single = disparity[:, None]
    centre = np.where(is_surface, surfaces.centre, 0.0)
    by_size_z, track_z = _deviations(
        np.maximum(tiles.first_px + tiles.scale[0] * centre, 0.1),
        np.stack([by_size.disparity_px, track_px]),
        np.stack([np.hypot(by_size.log_sigma, _MIN_LOG_SIGMA), np.full(len(u), _TRACK_LOG_SIGMA)]),
    )
    nearer, farther = np.maximum(by_size_z, 0.0), np.maximum(-by_size_z, 0.0)
    in_front = ((single > disparity * _NEARER) * area).sum(axis=0)  # sum over t of (t, s, N)
    behind = ((single < disparity * _FARTHER) * area).sum(axis=0)
    left, right, middle_columns, top, bottom, middle_rows = log_fraction[2:]
    return np.array(
        [
            log_fraction[0],
            log_fraction[1],
            np.minimum(left, right),
            np.maximum(left, right),
            middle_columns,
            top,
            bottom,
            middle_rows,
            _extent(u, surfaces.is_member),
            _extent(v, surfaces.is_member),
            sums[8] / n,
            in_front,
            behind,
            nearer,
            np.square(nearer),
            farther,
            np.square(farther),
            np.square(track_z),
            sums[9] / n,
        ]
    )


def choose_surface(
    phi: FloatArray, surfaces: Surfaces, model: ChoiceModel = OF_MATCHES
) -> SurfaceChoice:
    """The most probable surface of each box, from the features (F, S, N) of `features`."""
    score = model.score(phi)
    score = np.where(np.isfinite(surfaces.centre) & (surfaces.disparity > 0), score, -np.inf)
    best = score.max(axis=0)
    has_any = best > -np.inf
    likelihood = np.exp(score - np.where(has_any, best, 0.0))
    probability = likelihood / np.maximum(likelihood.sum(axis=0), 1e-12)
    chosen = score.argmax(axis=0)
    best_phi = phi[:, chosen, np.arange(len(chosen))]
    none = np.where(has_any, model.none_probability(best_phi), 1.0)
    return SurfaceChoice(
        chosen,
        probability * (1.0 - none),
        none,
        (surfaces.is_member.sum(axis=2) >= 2).sum(axis=0),
    )


def none_features(best: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """The features of Q by name, (N,) each, from those of the best surfaces, phi, (N,) each."""
    of_other_box = best["of_other_box"]
    return {
        "constant": np.ones_like(of_other_box),
        "of_other_box": of_other_box,
        "of_other_box_and_nearer_than_size": of_other_box * best["nearer_than_size_squared"],
        "too_near_for_size": np.maximum(best["nearer_than_size"] - _TOO_NEAR_SIGMA, 0.0) ** 2,
        "cost": best["cost"],
        "area": best["area"],
    }


def _deviations(
    disparity_px: FloatArray, expected_px: FloatArray, log_sigma: FloatArray
) -> FloatArray:
    """(K, S, N) deviations of log disparity (S, N) from K expected ones (K, N), in standard
    deviations (K, N); 0 where nothing is expected.
    """
    # the logarithm of expected disparities of infinity
    with np.errstate(invalid="ignore", divide="ignore"):
        z = (np.log(disparity_px) - np.log(expected_px)[:, None]) / log_sigma[:, None]
    return np.asarray(
        np.where(np.isnan(z), 0.0, np.minimum(np.maximum(z, -_MAX_DEVIATION), _MAX_DEVIATION))
    )


def _extent(position: FloatArray, is_member: BoolArray) -> FloatArray:
    """(S, N) range of the positions (N, G) of the members."""
    last = np.where(is_member, position, -1.0).max(axis=2)
    first = np.where(is_member, position, 1.0).min(axis=2)
    return np.asarray(np.maximum(last - first, 0.0))
