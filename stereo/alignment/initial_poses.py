"""initial_bundle: initial poses and points of a bundle adjustment, by PnP (perspective-n-point) from frame to frame.

The points of a frame are triangulated with their measured disparities; the motion to the next frame has the most
inliers among them (RANSAC) and resembles those of the other frames, so moving objects have no influence unless they are
the majority in most frames. Rays and inverse depths start from the first observation of a point.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

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

_MAX_CHANGE, _MAX_CHANGE_M = 0.25, 0.1
"""Largest deviation of a step from the median step of a segment, relative and in m: a vehicle that brakes with 6 m/s^2
from 8 m/s changes its speed by half of that within 1.6 s."""

_CLEAR_SHARE = 0.75
"""Minimum fraction of inliers that are certainly the static scene."""

_REFINING_ERRORS_PX = (8.0, 3.0, 2.0)
"""Largest reprojection errors of the points that agree with a predicted motion, round by round."""

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
    rows_of = [np.flatnonzero(observed.frame == frame) for frame in range(n_frames)]
    steps = []
    for before, now in pairwise(rows_of):
        _, first, second = np.intersect1d(observed.point[before], observed.point[now], return_indices=True)
        near = points_m[before[first], 2] < _FAR_M
        steps.append(_Step(points_m[before[first[near]]], observed.xyx_px[now[second[near]], :2]))
    motions = _steady_motions(steps, rig)
    if motions is None:
        return None
    rotation, translation_m = np.eye(3), np.zeros(3)
    rotations, translations = [], []
    for rows, motion in zip(rows_of, [_Motion(np.eye(3), np.zeros(3)), *motions], strict=True):
        rotation, translation_m = motion.rotation @ rotation, motion.rotation @ translation_m + motion.translation_m
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


class _Step(NamedTuple):
    """Points of one frame in metres (N, 3), and their pixels in the next one (N, 2)."""

    points_m: FloatArray
    xy_px: FloatArray


class _Motion(NamedTuple):
    """Frame from the previous one: (3, 3) rotation and (3,) translation."""

    rotation: FloatArray
    translation_m: FloatArray


def _steady_motions(steps: Sequence[_Step], rig: StereoRig) -> list[_Motion] | None:
    """The motion of each step; None if there are too few inliers.

    The largest group of points may move with a vehicle ahead, or be badly tracked, in some steps. It is then not a
    clear majority, and its motion differs from the median: it is replaced by the motion of the points that move like
    the scene in the nearest other step.
    """
    measured = [_motion(step, rig) for step in steps]
    motions = [motion for motion, _ in filter(None, measured)]
    if len(motions) < len(steps):
        return None
    median_m = np.median([motion.translation_m for motion in motions], axis=0)
    tolerance_m = _MAX_CHANGE * float(np.linalg.norm(median_m)) + _MAX_CHANGE_M
    differences_m = np.linalg.norm([motion.translation_m - median_m for motion in motions], axis=1)
    shares = np.array([share for _, share in filter(None, measured)])
    steady = np.flatnonzero((differences_m <= tolerance_m) | (shares >= _CLEAR_SHARE))
    if not len(steady):
        return motions
    for number in np.setdiff1d(np.arange(len(motions)), steady).tolist():
        nearest = motions[steady[np.abs(steady - number).argmin()]]
        motions[number] = _refined(steps[number], rig, nearest) or nearest
    return motions


def _motion(step: _Step, rig: StereoRig) -> tuple[_Motion, float] | None:
    """The motion with the most inliers, and their fraction; None with too few."""
    if len(step.points_m) < _MIN_INLIERS:
        return None
    is_solved, rvec, tvec, inliers = cv2.solvePnPRansac(
        step.points_m,
        step.xy_px,
        rig.left.matrix,
        np.zeros(5),
        flags=cv2.SOLVEPNP_AP3P,  # of the smallest samples, so that many of them have no outlier
        iterationsCount=_N_TRIALS,
        reprojectionError=_MAX_ERROR_PX,
    )
    if not is_solved or inliers is None or len(inliers) < _MIN_INLIERS:
        return None
    motion = _Motion(np.asarray(cv2.Rodrigues(rvec)[0], np.float64), np.asarray(tvec, np.float64).reshape(3))
    return _refined(step, rig, motion, (_MAX_ERROR_PX,)) or motion, len(inliers) / len(step.points_m)


def _refined(
    step: _Step, rig: StereoRig, start: _Motion, max_errors_px: Sequence[float] = _REFINING_ERRORS_PX
) -> _Motion | None:
    """The motion of the points that agree with `start`; None if they are too few."""
    motion = start
    for max_error_px in max_errors_px:
        moved_px = rig.left.project(step.points_m @ motion.rotation.T + motion.translation_m)
        with np.errstate(invalid="ignore"):
            agrees = np.linalg.norm(moved_px - step.xy_px, axis=1) < max_error_px
        if agrees.sum() < _MIN_INLIERS:
            return None
        rvec, tvec = cv2.solvePnPRefineLM(
            step.points_m[agrees],
            step.xy_px[agrees],
            rig.left.matrix,
            np.zeros(5),
            cv2.Rodrigues(motion.rotation)[0],
            motion.translation_m.reshape(3, 1).copy(),
        )
        motion = _Motion(np.asarray(cv2.Rodrigues(rvec)[0], np.float64), np.asarray(tvec, np.float64).reshape(3))
    return motion
