"""initial_bundle: poses and points to begin a bundle from, by the perspective-n-point problem from frame to frame.

Points are triangulated from their first observation, with the measured disparity; the next frame's pose is the one that
most of the known points agree on (RANSAC), so moving objects have no influence unless they are the majority.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray
from track_range.stereo.alignment.bundle_adjustment import Bundle, Observations
from track_range.stereo.geometry.rig import StereoRig

MIN_OBSERVATIONS = 4
"""A point seen less often says little, and is left out."""

MIN_POINTS = 60

_MIN_AGREEING = 12
_AGREE_PX = 2.0
_N_TRIALS = 200
_LEAST_DISPARITY_PX = 0.5
"""Points further away start here; the bundle moves them on."""

_FAR_M = 200.0
"""Points further away say nothing about the shift and are kept out of the first pose."""

_LEAST_DEPTH_SHARE = 0.3
"""A point must keep this share of its depth in frame 0, where its ray is taken; in sharp turns some do not."""


def initial_bundle(seen: Observations, rig: StereoRig) -> tuple[Observations, Bundle] | None:
    """The observations that can be used, renumbered, and where to start from; None with too few points or no pose."""
    seen = _often_seen(seen)
    if not len(seen.point) or seen.point.max() + 1 < MIN_POINTS:
        return None
    places_m = _triangulated(seen, rig)
    n_frames, n_points = int(seen.frame.max()) + 1, int(seen.point.max()) + 1
    world_m, depth_m = np.full((n_points, 3), np.nan), np.full(n_points, np.nan)
    rotation, translation_m = np.eye(3), np.zeros(3)
    rotations, translations = [], []
    for frame in range(n_frames):
        rows = np.flatnonzero(seen.frame == frame)
        if frame > 0:
            pose = _pose(world_m[seen.point[rows]], seen.xyx_px[rows, :2], rig, (rotation, translation_m))
            if pose is None:
                return None
            rotation, translation_m = pose
        new = rows[np.isnan(depth_m[seen.point[rows]])]
        world_m[seen.point[new]] = (places_m[new] - translation_m) @ rotation
        depth_m[seen.point[new]] = places_m[new, 2]
        rotations.append(rotation)
        translations.append(translation_m)
    ahead = world_m[:, 2] > _LEAST_DEPTH_SHARE * depth_m
    if ahead.sum() < MIN_POINTS:
        return None
    rays = np.column_stack([world_m[ahead, :2], np.ones(int(ahead.sum()))]) / world_m[ahead, 2:]
    return only_points(seen, ahead), Bundle(np.stack(rotations), np.stack(translations), rays, np.zeros(2))


def _often_seen(seen: Observations) -> Observations:
    points, index, count = np.unique(seen.point, return_inverse=True, return_counts=True)
    if not len(points):
        return seen
    return only_points(Observations(seen.frame, index, seen.xyx_px), count >= MIN_OBSERVATIONS)


def only_points(seen: Observations, wanted: npt.NDArray[np.bool_]) -> Observations:
    """The observations of the wanted points (P,), numbered anew."""
    keep, number = wanted[seen.point], np.cumsum(wanted) - 1
    return Observations(seen.frame[keep], number[seen.point[keep]], seen.xyx_px[keep])


def _triangulated(seen: Observations, rig: StereoRig) -> FloatArray:
    disparity_px = np.maximum(seen.xyx_px[:, 0] - seen.xyx_px[:, 2], _LEAST_DISPARITY_PX)
    return rig.left.rays(seen.xyx_px[:, :2]) * rig.distance_m(disparity_px)[:, None]


def _pose(
    world_m: FloatArray, xy_px: FloatArray, rig: StereoRig, before: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray] | None:
    """Frame from frame 0, from points (N, 3), NaN = not known yet, at pixels (N, 2); None where too few agree."""
    rotation, translation_m = before
    with np.errstate(invalid="ignore"):
        near = (world_m @ rotation.T + translation_m)[:, 2] < _FAR_M
    if near.sum() < _MIN_AGREEING:
        return None
    found, turn, shift, agreeing = cv2.solvePnPRansac(
        world_m[near],
        xy_px[near],
        rig.left.matrix,
        np.zeros(5),
        rvec=cv2.Rodrigues(rotation)[0],
        tvec=translation_m.reshape(3, 1).copy(),
        useExtrinsicGuess=True,
        iterationsCount=_N_TRIALS,
        reprojectionError=_AGREE_PX,
    )
    if not found or agreeing is None or len(agreeing) < _MIN_AGREEING:
        return None
    return np.asarray(cv2.Rodrigues(turn)[0], np.float64), np.asarray(shift, np.float64).reshape(3)
