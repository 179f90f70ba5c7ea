"""lens_covariance: covariance of an estimated lens whose tracked points have errors in common.

Tracks drift along their whole length, and the points of a facade, a hedge or a shadow drift alike.
So the scores of the observations (derivatives of the log likelihood by the parameters of the lens,
with poses and points eliminated) are not independent; their sums over the parts of the image and
the scenes are:

    covariance = A^-1 (sum_g s_g s_g^T + prior information) A^-1,   A = information with the prior

(The sandwich of Huber 1967, "The behavior of maximum likelihood estimates under nonstandard
conditions", with groups of observations as in Liang and Zeger 1986.)
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.stereo.geometry.bundle_equations import Linear, PointBlocks
from track_range.stereo.self_calibration.radial_lens import RadialLens
from track_range.stereo.self_calibration.scene_bundle import (
    LensPrior,
    SceneBundle,
    shared_equations,
)

N_STRIPS = 8  # vertical strips of the image, whose points are a group


# Error in px of the tracked image that the far points of a scene may have in common, as a pattern
# that looks like another focal length; with it straight simulated drives (seeds 700 to 703) say
# that they do not know.
_PATTERN_PX = 0.05
# focal length in image widths below which a fit without turns may end: the turns are then too large
_USUAL_FOCAL = 0.8


def pattern_sigma(scenes: Sequence[SceneBundle], lens: RadialLens) -> float:
    """Relative standard deviation of the focal length from errors that a whole scene has in common.

    A turn by alpha moves a point at the angle u from the axis by f alpha (1 + u^2): only the part
    with u^2 tells f from alpha. So an error of e px of this pattern is one of e / (2 f alpha u^2)
    of f. It limits what a drive with small turns can show, however many points it has.
    """
    width_px = 2 * lens.centre_px[0] + 1
    information = 0.0
    for scene in scenes:
        turns = np.stack([cv2.Rodrigues(rotation)[0][:2, 0] for rotation in scene.rotation])
        turn_rad = turns.std(axis=0)[::-1]  # about y moves x, about x moves y
        u2 = (((scene.observed.xy_px - lens.centre_px) / lens.focal_px) ** 2).mean(axis=0)
        moved_px = 2 * lens.focal_px * turn_rad * u2
        information += float((moved_px**2).sum()) / _PATTERN_PX**2
    unusual = max(1.0, _USUAL_FOCAL * width_px / lens.focal_px)
    return float(unusual**2 / math.sqrt(max(information, 1e-9)))


class LensCovariance(NamedTuple):
    """Covariances of the parameters of a lens."""

    independent: FloatArray  # (6, 6) with independent errors of the observations
    common: FloatArray  # (6, 6) with common errors of each group of points


def lens_covariance(
    scenes: Sequence[SceneBundle], lens: RadialLens, prior: LensPrior, cauchy_sigmas: float
) -> LensCovariance:
    """The covariances at a fit; those of parameters that are kept are 0."""
    free = np.ix_(prior.is_free, prior.is_free)
    information, scores = np.diag(prior.information), np.diag(prior.information)
    for scene in scenes:
        part, of_groups = _scores(scene, lens, cauchy_sigmas)
        information = information + part
        scores = scores + of_groups.T @ of_groups
    inverse = np.zeros_like(information)
    inverse[free] = np.linalg.inv(information[free])
    return LensCovariance(inverse, inverse @ scores @ inverse)


def _scores(
    scene: SceneBundle, lens: RadialLens, cauchy_sigmas: float
) -> tuple[FloatArray, FloatArray]:
    """(6, 6) information of a scene, and (G, 6) the scores of its groups."""
    linear = scene.linearize(lens)
    shared, blocks, weight = shared_equations(scene, linear, cauchy_sigmas, damping=0.0)
    by_point = _by_point(scene, linear, blocks, weight)
    n_poses = len(shared.poses)
    reduced = by_point[:, n_poses:] - by_point[:, :n_poses] @ shared.by_shared
    strip = _strips(scene, lens)
    groups = np.stack([np.bincount(strip, column, N_STRIPS) for column in reduced.T], axis=1)
    return shared.information, np.asarray(groups, np.float64)


def _by_point(
    scene: SceneBundle, linear: Linear, blocks: PointBlocks, weight: FloatArray
) -> FloatArray:
    """(P, C) the part of each point in b_x - W^T V^-1 b_y."""
    frame, point, *_ = scene.observed
    n_points, n_frames = len(scene.ray), len(scene.rotation)
    weighted = (linear.residual * weight[:, None])[:, None, :]
    by_pose = np.zeros((n_points, n_frames, 6))
    by_pose[point, frame] = (weighted @ linear.by_pose)[:, 0]
    by_lens = np.zeros((n_points, linear.by_shared.shape[2]))
    np.add.at(by_lens, point, (weighted @ linear.by_shared)[:, 0])
    direct = np.concatenate([by_pose.reshape(n_points, -1)[:, 6:], by_lens], axis=1)
    eliminated = np.einsum("pkc,pk->pc", blocks.whitened, blocks.right_side)
    return np.asarray(direct - eliminated)


def _strips(scene: SceneBundle, lens: RadialLens) -> IntArray:
    """(P,) number of the strip of each point, by its mean column."""
    point, x_px = scene.observed.point, scene.observed.xy_px[:, 0]
    mean_px = np.bincount(point, x_px) / np.bincount(point)
    width_px = 2 * lens.centre_px[0] + 1
    strip = np.clip((mean_px * N_STRIPS / width_px).astype(np.int64), 0, N_STRIPS - 1)
    return np.asarray(strip, np.int64)
