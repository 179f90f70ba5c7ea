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
from track_range.stereo.matching.surfaces import Surfaces
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
        size_px, centre_px = xyxy_px[:, 2:] - xyxy_px[:, :2], (xyxy_px[:, :2] + xyxy_px[:, 2:]) / 2
        x_px = centre_px[:, :1] + tiles.u * size_px[:, :1]
        y_px = centre_px[:, 1:] + tiles.v * size_px[:, 1:]
        left, top, right, bottom = self.xyxy_px.T[:, :, None, None]
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = np.abs(np.log(self.expected_px[:, None] / expected_px[None, :]))
            is_itself = (self.xyxy_px[:, None] == xyxy_px).all(axis=2)
            # (other, box); False where unknown
            is_other = (ratio > np.log(_OTHER_BOX_RATIO)) & ~is_itself
            is_same = (
                np.abs(disparity_px / self.expected_px[:, None, None] - 1.0) < _OTHER_BOX_FRACTION
            )
        is_inside = (x_px > left) & (x_px < right) & (y_px > top) & (y_px < bottom)  # (other, N, G)
        return np.asarray((is_inside & is_same & is_other[:, :, None]).any(axis=0), np.float64)


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
    tiles: BoxTiles,
    cost: FloatArray,
    *,
    by_size: ExpectedDisparity,
    track_px: FloatArray,
    others_fraction: FloatArray,
) -> dict[str, FloatArray]:
    """The features phi by name, (S, N) each.

    `cost` (N, G) are the costs of the windows' minima, bits per pixel; `track_px` (N,) the last
    matches of the tracks, NaN = none; `others_fraction` (N, G) comes from `OtherBoxes.windows`.
    """
    u, v, used = tiles.u, tiles.v, tiles.is_used
    n_boxes, n_windows = u.shape
    masks = np.empty((n_boxes, n_windows, 8))
    masks[:] = used[..., None]
    masks[..., 1] *= np.exp(-(u**2 + v**2) / (2 * _CENTRE_SIGMA**2))
    masks[..., 2] *= u < -_SIDE_U
    masks[..., 3] *= u > _SIDE_U
    masks[..., 4] *= np.abs(u) <= _SIDE_U
    masks[..., 5] *= v < -_SIDE_V
    masks[..., 6] *= v > _SIDE_V
    masks[..., 7] *= np.abs(v) <= _SIDE_V
    is_surface = np.isfinite(surfaces.centre)
    member = surfaces.is_member.astype(np.float64)
    n = np.maximum(member.sum(axis=2), 1.0)
    # (N, S, 8)
    fraction = member.swapaxes(0, 1) @ masks / np.maximum(masks.sum(axis=1), 1e-6)[:, None]
    log_fraction = np.log(fraction + _MIN_FRACTION).transpose(2, 1, 0)
    area, disparity = fraction[..., 0].T, np.where(is_surface, surfaces.disparity, 0.0)
    single, parts = disparity[:, None], area[:, None]
    in_front = (single > disparity[None] * _NEARER) * parts  # surface t in front of s, (t, s, N)
    behind = (single < disparity[None] * _FARTHER) * parts
    centre = np.where(is_surface, surfaces.centre, 0.0)
    disparity_px = np.maximum(tiles.first_px + tiles.scale[0] * centre, 0.1)
    by_size_z = _deviation(
        disparity_px, by_size.disparity_px, np.hypot(by_size.log_sigma, _MIN_LOG_SIGMA)
    )
    track_z = _deviation(disparity_px, track_px, np.full(len(track_px), _TRACK_LOG_SIGMA))
    nearer, farther = np.maximum(by_size_z, 0.0), np.maximum(-by_size_z, 0.0)
    return {
        "area": log_fraction[0],
        "centre": log_fraction[1],
        "both_sides": np.minimum(log_fraction[2], log_fraction[3]),
        "one_side": np.maximum(log_fraction[2], log_fraction[3]),
        "middle_columns": log_fraction[4],
        "top": log_fraction[5],
        "bottom": log_fraction[6],
        "middle_rows": log_fraction[7],
        "width": _extent(u, surfaces.is_member),
        "height": _extent(v, surfaces.is_member),
        "cost": (member * cost).sum(axis=2) / n,
        "in_front": in_front.sum(axis=0),
        "behind": behind.sum(axis=0),
        "nearer_than_size": nearer,
        "nearer_than_size_squared": nearer**2,
        "farther_than_size": farther,
        "farther_than_size_squared": farther**2,
        "off_track": track_z**2,
        "of_other_box": (member * others_fraction).sum(axis=2) / n,
    }


def choose_surface(phi: dict[str, FloatArray], surfaces: Surfaces) -> SurfaceChoice:
    """The most probable surface of each box, from the features of `features`."""
    score = np.zeros_like(surfaces.centre)
    for name, theta in THETA.items():
        score += theta * phi[name]
    score = np.where(np.isfinite(surfaces.centre) & (surfaces.disparity > 0), score, -np.inf)
    best = score.max(axis=0)
    with np.errstate(invalid="ignore"):
        likelihood = np.where(np.isfinite(score), np.exp(score - best), 0.0)
    probability = likelihood / np.maximum(likelihood.sum(axis=0), 1e-12)
    chosen = score.argmax(axis=0)
    none = np.where(np.isfinite(best), _none_probability(phi, chosen), 1.0)
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


def _none_probability(phi: Mapping[str, FloatArray], chosen: IntArray) -> FloatArray:
    """(N,) Q, from the features (S, N) of the best surfaces (N,)."""
    rows = np.arange(len(chosen))
    features = none_features({name: values[chosen, rows] for name, values in phi.items()})
    score = sum(eta * features[name] for name, eta in ETA.items())
    return np.asarray(1.0 / (1.0 + np.exp(-np.asarray(score))))


def _deviation(
    disparity_px: FloatArray, expected_px: FloatArray, log_sigma: FloatArray
) -> FloatArray:
    """(S, N) deviations of log disparity in standard deviations; 0 where nothing is expected."""
    # the logarithm of expected disparities of infinity
    with np.errstate(invalid="ignore", divide="ignore"):
        z = np.log(disparity_px / expected_px) / log_sigma
    return np.asarray(
        np.where(np.isnan(z), 0.0, np.minimum(np.maximum(z, -_MAX_DEVIATION), _MAX_DEVIATION))
    )


def _extent(position: FloatArray, is_member: BoolArray) -> FloatArray:
    """(S, N) range of the positions (N, G) of the members."""
    last = np.where(is_member, position, -1.0).max(axis=2)
    first = np.where(is_member, position, 1.0).min(axis=2)
    return np.asarray(np.maximum(last - first, 0.0))
