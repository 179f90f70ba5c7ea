"""initial_bundle: initial poses and points of a bundle adjustment, by PnP (perspective-n-point)
from frame to frame.

The points of a frame are triangulated with their measured disparities. In some steps, several
motions are found in turn: first the motion with the most inliers (RANSAC), then a motion of the
remaining points. Behind a vehicle, most points may be on it; so the static scene's motion is the
fastest motion that has points all over the image in most steps, and the points that do not follow
it are omitted. Rays and inverse depths start from the first observation of a point.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.stereo.alignment.bundle_adjustment import (
    N_ERRORS,
    Bundle,
    Observations,
    error_columns,
)
from track_range.stereo.geometry.alignment import column_from_axis
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig

# minimum number of observations of a point; points with fewer carry little information
MIN_OBSERVATIONS = 4
MIN_POINTS = 60  # minimum number of points of a bundle
_MIN_INLIERS = 12  # minimum number of inliers of a pose
_MAX_ERROR_PX = 2.0  # largest reprojection error of an inlier
_N_TRIALS = 200  # iterations of RANSAC
_MIN_DISPARITY_PX = 0.5  # initial disparity of farther points; the bundle adjustment moves them
# largest distance of points used for PnP; farther ones carry no information on the translation
_FAR_M = 200.0
# number of steps in which motions are searched, and of the motions of one step
_N_KEY_STEPS, _N_MOTIONS = 5, 3
# rows and columns of the cells by which the spread of a motion's points over the image is counted
_GRID = (8, 16)
# Minimum support of the static scene's motion, relative to the motion with the most: on eight
# windows of simulated queues and highways (seeds 602 to 611), its support was 0.55 or more, that of
# fast spurious motions below 0.3.
_MIN_SUPPORT = 0.4
# Largest difference of one motion between two steps, relative and in m: a vehicle that brakes with
# 6 m/s^2 from 8 m/s changes its speed by half of that within 1.6 s.
_MAX_CHANGE, _MAX_CHANGE_M = 0.25, 0.1
_MAX_STATIC_ERROR_PX = 4.0  # largest reprojection error of a static point
_MIN_STATIC_STEPS = 0.5  # minimum fraction of the steps in which it is smaller
# largest reprojection errors of the inliers of a predicted motion, by round
_REFINING_ERRORS_PX = (8.0, 3.0, 2.0)
# minimum ratio of a point's depths in frame 0 and when first seen; smaller in sharp turns
_MIN_DEPTH_FRACTION = 0.3


class InitialBundle(NamedTuple):
    """Usable observations (renumbered), their initial bundle, and the support of its motion (see
    `_support`).
    """

    observed: Observations
    bundle: Bundle
    support: float


class _Step(NamedTuple):
    """Points of one frame in metres (N, 3), their pixels in the next frame (N, 2), and their image
    cells (N,).
    """

    points_m: FloatArray
    xy_px: FloatArray
    cell: IntArray

    def only(self, is_used: BoolArray) -> _Step:
        """The points in the mask (N,)."""
        return _Step(self.points_m[is_used], self.xy_px[is_used], self.cell[is_used])


class _Motion(NamedTuple):
    """Frame from the previous one: (3, 3) rotation and (3,) translation."""

    rotation: FloatArray
    translation_m: FloatArray


def initial_bundle(
    observed: Observations, rig: StereoRig, *, error_px: FloatArray | None = None
) -> InitialBundle | None:
    """The initial bundle, None with too few points or without a pose; `error_px` (3,) is the
    assumed error, default 0.

    The error contains offset, curvature and slope, see `stereo.alignment.bundle_adjustment`.
    """
    error_px, camera = np.zeros(N_ERRORS) if error_px is None else error_px, rig.left
    points, index, count = np.unique(observed.point, return_inverse=True, return_counts=True)
    if not len(points):
        return None
    observed = only_points(observed._replace(point=index), count >= MIN_OBSERVATIONS)
    if not len(observed.point) or observed.point.max() + 1 < MIN_POINTS:
        return None
    x_px = observed.xyx_px[:, 0]
    corrections_px = error_columns(column_from_axis(x_px, camera)) @ error_px
    disparity_px = np.maximum(x_px - observed.xyx_px[:, 2] + corrections_px, _MIN_DISPARITY_PX)
    points_m = camera.rays(observed.xyx_px[:, :2]) * rig.distance_m(disparity_px)[:, None]
    steps, pairs = _steps(observed, points_m, camera)
    static = _static_motions(steps, camera)
    if static is None:
        return None
    motions, support = static
    is_static = _static_mask(observed, points_m, pairs, motions, camera)
    if is_static.sum() >= MIN_POINTS:
        points_m = points_m[is_static[observed.point]]
        observed = only_points(observed, is_static)
    n_points = int(observed.point.max()) + 1
    world_m, depth_m = np.full((n_points, 3), np.nan), np.full(n_points, np.nan)
    rotation, translation_m = np.eye(3), np.zeros(3)
    rotations, translations = [], []
    for frame, motion in enumerate([_Motion(np.eye(3), np.zeros(3)), *motions]):
        rows = np.flatnonzero(observed.frame == frame)
        rotation, translation_m = (
            motion.rotation @ rotation,
            motion.rotation @ translation_m + motion.translation_m,
        )
        new = rows[np.isnan(depth_m[observed.point[rows]])]
        world_m[observed.point[new]] = (points_m[new] - translation_m) @ rotation
        depth_m[observed.point[new]] = points_m[new, 2]
        rotations.append(rotation)
        translations.append(translation_m)
    is_ahead = world_m[:, 2] > _MIN_DEPTH_FRACTION * depth_m
    if is_ahead.sum() < MIN_POINTS:
        return None
    rays = (
        np.column_stack([world_m[is_ahead, :2], np.ones(int(is_ahead.sum()))])
        / world_m[is_ahead, 2:]
    )
    bundle = Bundle(np.stack(rotations), np.stack(translations), rays, error_px)
    return InitialBundle(only_points(observed, is_ahead), bundle, support)


def only_points(observed: Observations, is_used: BoolArray) -> Observations:
    """The observations of the points in the mask (P,), with points renumbered."""
    rows, number = is_used[observed.point], np.cumsum(is_used) - 1
    return Observations(observed.frame[rows], number[observed.point[rows]], observed.xyx_px[rows])


def _steps(
    observed: Observations, points_m: FloatArray, camera: PinholeCamera
) -> tuple[list[_Step], list[tuple[IntArray, IntArray]]]:
    """The steps between consecutive frames, without far points, and for each the rows of all points
    in both frames.
    """
    frame_rows = [
        np.flatnonzero(observed.frame == frame) for frame in range(int(observed.frame.max()) + 1)
    ]
    steps, pairs = [], []
    for before, now in pairwise(frame_rows):
        _, first, second = np.intersect1d(
            observed.point[before], observed.point[now], return_indices=True
        )
        first, second = before[first], now[second]
        pairs.append((first, second))
        near = points_m[first, 2] < _FAR_M
        xy_px = observed.xyx_px[first[near], :2]
        size_px = np.array([camera.width_px, camera.height_px])
        column, row = (
            np.clip(xy_px / size_px * _GRID[::-1], 0, np.array(_GRID[::-1]) - 1).astype(np.int64).T
        )
        steps.append(
            _Step(points_m[first[near]], observed.xyx_px[second[near], :2], row * _GRID[1] + column)
        )
    return steps, pairs


class _Candidate(NamedTuple):
    """A motion found in one of the steps, and its support there."""

    step: int
    motion: _Motion
    support: float


def _static_motions(
    steps: Sequence[_Step], camera: PinholeCamera
) -> tuple[list[_Motion], float] | None:
    """The motion of the static scene in each step, and its support; None if no motion has enough
    inliers.
    """
    key_steps = np.linspace(0, len(steps) - 1, _N_KEY_STEPS).round().astype(int).tolist()
    candidates = [
        candidate
        for number in sorted(set(key_steps))
        for candidate in _candidates(number, steps[number], camera)
    ]
    if not candidates:
        return None
    static, support = _static_group(candidates)
    motions = []
    for number, step in enumerate(steps):
        steps_away = [abs(candidate.step - number) for candidate in static]
        nearest = static[steps_away.index(min(steps_away))].motion
        motions.append(_refined(step, camera, nearest) or nearest)
    return motions, support


def _candidates(number: int, step: _Step, camera: PinholeCamera) -> list[_Candidate]:
    """The motion of a step with the most inliers, then those of the remaining points."""
    candidates, rest = list[_Candidate](), step
    for _ in range(_N_MOTIONS):
        motion = _motion(rest, camera)
        if motion is None:
            break
        candidates.append(_Candidate(number, motion, _support(step, motion, camera)))
        is_outlier = ~_agrees(rest.points_m, rest.xy_px, motion, camera, _MAX_ERROR_PX)
        rest = rest.only(is_outlier)
    return candidates


def _static_group(candidates: Sequence[_Candidate]) -> tuple[list[_Candidate], float]:
    """The motions of the static scene, at most one in each step, and their support."""
    translation_m = np.array([candidate.motion.translation_m for candidate in candidates])
    length_m = np.linalg.norm(translation_m, axis=1)
    difference_m = np.linalg.norm(translation_m[:, None] - translation_m, axis=2)
    is_alike = difference_m <= _MAX_CHANGE * np.maximum(length_m[:, None], length_m) + _MAX_CHANGE_M
    groups = [
        _best_of_steps([candidates[i] for i in np.flatnonzero(alike).tolist()])
        for alike in is_alike
    ]
    supports = np.array([sum(one.support for one in group) for group in groups])
    is_usual = supports >= _MIN_SUPPORT * supports.max()
    fastest = int(np.where(is_usual, length_m, -1.0).argmax())
    best = int(np.where(is_usual & is_alike[fastest], supports, -1.0).argmax())
    return groups[best], float(supports[best])


def _best_of_steps(alike: Sequence[_Candidate]) -> list[_Candidate]:
    """The motion with the most support in each step."""
    best = dict[int, _Candidate]()
    for candidate in alike:
        if candidate.step not in best or candidate.support > best[candidate.step].support:
            best[candidate.step] = candidate
    return list(best.values())


def _support(step: _Step, motion: _Motion, camera: PinholeCamera) -> float:
    """Sum over the cells of the image of the fraction of points that agree with the motion."""
    agrees = _agrees(step.points_m, step.xy_px, motion, camera, _MAX_ERROR_PX)
    n_points = np.bincount(step.cell, minlength=_GRID[0] * _GRID[1])
    return float((np.bincount(step.cell, agrees, len(n_points)) / np.maximum(n_points, 1)).sum())


def _agrees(
    points_m: FloatArray,
    xy_px: FloatArray,
    motion: _Motion,
    camera: PinholeCamera,
    max_error_px: float,
) -> BoolArray:
    """(N,) whether points (N, 3) move to pixels (N, 2) of the next frame."""
    moved_px = camera.project(points_m @ motion.rotation.T + motion.translation_m)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.linalg.norm(moved_px - xy_px, axis=1) < max_error_px)


def _static_mask(
    observed: Observations,
    points_m: FloatArray,
    pairs: Sequence[tuple[IntArray, IntArray]],
    motions: Sequence[_Motion],
    camera: PinholeCamera,
) -> BoolArray:
    """(P,) whether the points follow the motions in at least half of their steps."""
    n_points = int(observed.point.max()) + 1
    n_steps, n_agreeing = np.zeros(n_points), np.zeros(n_points)
    for (first, second), motion in zip(pairs, motions, strict=True):
        agrees = _agrees(
            points_m[first], observed.xyx_px[second, :2], motion, camera, _MAX_STATIC_ERROR_PX
        )
        n_steps[observed.point[first]] += 1
        n_agreeing[observed.point[first]] += agrees
    return np.asarray((n_agreeing >= _MIN_STATIC_STEPS * n_steps) & (n_steps > 0))


def _motion(step: _Step, camera: PinholeCamera) -> _Motion | None:
    """The motion with the most inliers; None with too few."""
    if len(step.points_m) < _MIN_INLIERS:
        return None
    is_solved, rvec, tvec, inliers = cv2.solvePnPRansac(
        step.points_m,
        step.xy_px,
        camera.matrix,
        np.zeros(5),
        flags=cv2.SOLVEPNP_AP3P,  # of the smallest samples, so that many of them have no outlier
        iterationsCount=_N_TRIALS,
        reprojectionError=_MAX_ERROR_PX,
    )
    if not is_solved or inliers is None or len(inliers) < _MIN_INLIERS:
        return None
    if refined := _refined(step, camera, _pose(rvec, tvec), (_MAX_ERROR_PX,)):
        return refined
    # OpenCV's last step, EPnP on all inliers, may end far from the pose that has them.
    rows = inliers.ravel()
    is_solved, rvec, tvec = cv2.solvePnP(
        step.points_m[rows], step.xy_px[rows], camera.matrix, np.zeros(5), flags=cv2.SOLVEPNP_SQPNP
    )
    return _refined(step, camera, _pose(rvec, tvec), (_MAX_ERROR_PX,)) if is_solved else None


def _refined(
    step: _Step,
    camera: PinholeCamera,
    motion: _Motion,
    max_errors_px: Sequence[float] = _REFINING_ERRORS_PX,
) -> _Motion | None:
    """The motion of the points that agree with `motion`; None if there are too few."""
    for max_error_px in max_errors_px:
        agrees = _agrees(step.points_m, step.xy_px, motion, camera, max_error_px)
        if agrees.sum() < _MIN_INLIERS:
            return None
        start = cv2.Rodrigues(motion.rotation)[0], motion.translation_m.reshape(3, 1).copy()
        motion = _pose(
            *cv2.solvePnPRefineLM(
                step.points_m[agrees], step.xy_px[agrees], camera.matrix, np.zeros(5), *start
            )
        )
    return motion


def _pose(rvec: npt.ArrayLike, tvec: npt.ArrayLike) -> _Motion:
    rotation = cv2.Rodrigues(np.asarray(rvec, np.float64))[0]
    return _Motion(np.asarray(rotation, np.float64), np.asarray(tvec, np.float64).reshape(3))
