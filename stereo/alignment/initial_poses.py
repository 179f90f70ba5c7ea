"""initial_bundle: initial poses and points of a bundle adjustment, by PnP (perspective-n-point) from frame to frame.

Points are triangulated from their first observation with the measured disparity; the pose of the next frame has the
most inliers among the known points (RANSAC), so moving objects have no influence unless they are the majority.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray
from track_range.stereo.alignment.bundle_adjustment import N_ERRORS, Bundle, Observations
from track_range.stereo.geometry.rig import StereoRig

MIN_OBSERVATIONS = 4
"""Minimum number of observations of a point; points with fewer carry little information."""

MIN_POINTS = 60
"""Minimum number of points of a bundle."""

_MIN_INLIERS = 12
"""Minimum number of inliers of a pose."""

_MAX_ERROR_PX = 2.0
"""Largest reprojection error of an inlier."""

_N_TRIALS = 200
"""Iterations of RANSAC."""

_MIN_DISPARITY_PX = 0.5
"""Initial disparity of farther points; the bundle adjustment moves them."""

_FAR_M = 200.0
"""Largest distance of points used for PnP; farther ones carry no information on the translation."""

_MIN_DEPTH_SHARE = 0.3
"""Minimum ratio of a point's depth in frame 0, where its ray starts, to its first depth; smaller in sharp turns."""


def initial_bundle(observed: Observations, rig: StereoRig) -> tuple[Observations, Bundle] | None:
    """The usable observations, renumbered, and the initial bundle; None with too few points or without a pose."""
    observed = _often_observed(observed)
    if not len(observed.point) or observed.point.max() + 1 < MIN_POINTS:
        return None
    points_m = _triangulated(observed, rig)
    n_frames, n_points = int(observed.frame.max()) + 1, int(observed.point.max()) + 1
    world_m, depth_m = np.full((n_points, 3), np.nan), np.full(n_points, np.nan)
    rotation, translation_m = np.eye(3), np.zeros(3)
    rotations, translations = [], []
    for frame in range(n_frames):
        rows = np.flatnonzero(observed.frame == frame)
        if frame > 0:
            pose = _pose(world_m[observed.point[rows]], observed.xyx_px[rows, :2], rig, (rotation, translation_m))
            if pose is None:
                return None
            rotation, translation_m = pose
        new = rows[np.isnan(depth_m[observed.point[rows]])]
        world_m[observed.point[new]] = (points_m[new] - translation_m) @ rotation
        depth_m[observed.point[new]] = points_m[new, 2]
        rotations.append(rotation)
        translations.append(translation_m)
    is_ahead = world_m[:, 2] > _MIN_DEPTH_SHARE * depth_m
    if is_ahead.sum() < MIN_POINTS:
        return None
    rays = np.column_stack([world_m[is_ahead, :2], np.ones(int(is_ahead.sum()))]) / world_m[is_ahead, 2:]
    return only_points(observed, is_ahead), Bundle(
        np.stack(rotations), np.stack(translations), rays, np.zeros(N_ERRORS)
    )


def _often_observed(observed: Observations) -> Observations:
    points, index, count = np.unique(observed.point, return_inverse=True, return_counts=True)
    if not len(points):
        return observed
    return only_points(Observations(observed.frame, index, observed.xyx_px), count >= MIN_OBSERVATIONS)


def only_points(observed: Observations, is_used: npt.NDArray[np.bool_]) -> Observations:
    """The observations of the points in the mask (P,), with points renumbered."""
    rows, number = is_used[observed.point], np.cumsum(is_used) - 1
    return Observations(observed.frame[rows], number[observed.point[rows]], observed.xyx_px[rows])


def _triangulated(observed: Observations, rig: StereoRig) -> FloatArray:
    disparity_px = np.maximum(observed.xyx_px[:, 0] - observed.xyx_px[:, 2], _MIN_DISPARITY_PX)
    return rig.left.rays(observed.xyx_px[:, :2]) * rig.distance_m(disparity_px)[:, None]


def _pose(
    world_m: FloatArray, xy_px: FloatArray, rig: StereoRig, before: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray] | None:
    """Frame from frame 0, from points (N, 3), NaN = unknown, at pixels (N, 2); None with too few inliers."""
    rotation, translation_m = before
    with np.errstate(invalid="ignore"):
        is_near = (world_m @ rotation.T + translation_m)[:, 2] < _FAR_M
    if is_near.sum() < _MIN_INLIERS:
        return None
    is_solved, rvec, tvec, inliers = cv2.solvePnPRansac(
        world_m[is_near],
        xy_px[is_near],
        rig.left.matrix,
        np.zeros(5),
        rvec=cv2.Rodrigues(rotation)[0],
        tvec=translation_m.reshape(3, 1).copy(),
        useExtrinsicGuess=True,
        iterationsCount=_N_TRIALS,
        reprojectionError=_MAX_ERROR_PX,
    )
    if not is_solved or inliers is None or len(inliers) < _MIN_INLIERS:
        return None
    return np.asarray(cv2.Rodrigues(rvec)[0], np.float64), np.asarray(tvec, np.float64).reshape(3)
