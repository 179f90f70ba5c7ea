"""Levenberg and Marquardt's method for parameters of which one part is common and another belongs to one view.

    minimise  sum over views v of |r_v(c, p_v)|^2

    [ U + lambda diag U   W                 ] [ dc ]   [ g_c ]     U = sum J_c^T J_c,  W_v = J_c^T J_p
    [ W^T                 V + lambda diag V ] [ dp ] = [ g_p ]     V_v = J_p^T J_p,    g = -J^T r

V is block diagonal, so the views are eliminated first (Schur complement). Derivatives are forward differences; those by
the parameters of all views are taken at once. (Triggs et al. 1999: Bundle Adjustment - A Modern Synthesis.)
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray

Residuals = Callable[[FloatArray, FloatArray], FloatArray]
"""(R,) residuals of common parameters (C,) and of the views' parameters (V, P), ordered by view."""

_STEP = 1e-6  # relative step of the differences, at least as large as for a parameter of 1e-3
_FIRST_DAMPING = 1e-3
_LARGEST_DAMPING = 1e8  # above it, the minimum is reached
_MAX_ITERATIONS = 100
_TOLERANCE = 1e-9  # relative reduction of the sum of squares below which the minimum is reached


class BlockSolution(NamedTuple):
    """Minimum of a block least-squares problem."""

    common: FloatArray  # (C,) common parameters
    view_parameters: FloatArray  # (V, P)
    residuals: FloatArray  # (R,)
    covariance: FloatArray  # (C, C) of the common parameters, for independent residuals of equal, estimated variance


def solve_blocks(
    residuals_of: Residuals, n_residuals: IntArray, common: FloatArray, view_parameters: FloatArray
) -> BlockSolution:
    """The local minimum that is reached from the parameters (C,) and (V, P), with `n_residuals` (V,) per view.

    Raises LinAlgError if the residuals do not determine the parameters, or are not finite at the start.
    """
    starts = np.concatenate([[0], np.cumsum(n_residuals)[:-1]])
    residuals = residuals_of(common, view_parameters)
    if not np.isfinite(residuals).all():
        raise np.linalg.LinAlgError("residuals: expected finite initial values")
    damping = _FIRST_DAMPING
    for _ in range(_MAX_ITERATIONS):
        normal = _normal_equations(residuals_of, residuals, starts, common, view_parameters)
        cost = float(residuals @ residuals)
        while damping <= _LARGEST_DAMPING:
            step, view_steps, _ = normal.steps(damping)
            moved = common + step, view_parameters + view_steps
            candidate = residuals_of(*moved)
            candidate_cost = float(candidate @ candidate) if np.isfinite(candidate).all() else np.inf
            if candidate_cost <= cost:
                break
            damping *= 10.0
        else:
            break
        common, view_parameters, residuals = *moved, candidate
        damping = max(damping / 10.0, 1e-12)
        if cost - candidate_cost <= _TOLERANCE * cost:
            break
    normal = _normal_equations(residuals_of, residuals, starts, common, view_parameters)
    n_free = max(len(residuals) - common.size - view_parameters.size, 1)
    covariance = np.asarray(np.linalg.inv(normal.steps(0.0)[2]))
    return BlockSolution(common, view_parameters, residuals, covariance * float(residuals @ residuals) / n_free)


class _NormalEquations(NamedTuple):
    """Blocks of J^T J and -J^T r."""

    u: FloatArray  # (C, C)
    v: FloatArray  # (V, P, P)
    w: FloatArray  # (V, C, P)
    g_common: FloatArray  # (C,)
    g_views: FloatArray  # (V, P)

    def steps(self, damping: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Steps (C,) and (V, P) of the parameters, and the Schur complement (C, C) of the views."""
        u = self.u + damping * np.diag(np.diag(self.u))
        v = self.v + damping * np.einsum("vii->vi", self.v)[:, :, None] * np.eye(self.v.shape[1])
        w_over_v = np.linalg.solve(v, self.w.transpose(0, 2, 1)).transpose(0, 2, 1)
        schur = np.asarray(u - (w_over_v @ self.w.transpose(0, 2, 1)).sum(axis=0))
        common = np.linalg.solve(schur, self.g_common - (w_over_v @ self.g_views[:, :, None]).sum(axis=0)[:, 0])
        right = self.g_views - np.einsum("vcp,c->vp", self.w, common)
        return common, np.linalg.solve(v, right[:, :, None])[:, :, 0], schur


def _normal_equations(
    residuals_of: Residuals, residuals: FloatArray, starts: IntArray, common: FloatArray, view_parameters: FloatArray
) -> _NormalEquations:
    """The equations at a point with these residuals; `starts` (V,) is the first residual of each view."""
    common_steps = np.diag(_STEP * np.maximum(np.abs(common), 1e-3))
    view_steps = np.diag(_STEP * np.maximum(np.abs(view_parameters).max(axis=0), 1e-3))
    by_common = [(residuals_of(common + step, view_parameters) - residuals) / step.sum() for step in common_steps]
    by_views = [(residuals_of(common, view_parameters + step) - residuals) / step.sum() for step in view_steps]
    j_c, j_p = np.stack(by_common, axis=1), np.stack(by_views, axis=1)
    return _NormalEquations(
        j_c.T @ j_c,
        np.add.reduceat(j_p[:, :, None] * j_p[:, None, :], starts),
        np.add.reduceat(j_c[:, :, None] * j_p[:, None, :], starts),
        -j_c.T @ residuals,
        -np.add.reduceat(j_p * residuals[:, None], starts),
    )
