"""Levenberg and Marquardt's method for parameters of which one part is common and another belongs to one view.

    minimise  sum over views v of |r_v(c, p_v)|^2

    [ U + lambda diag U   W                 ] [ dc ]   [ g_c ]     U = sum J_c^T J_c,  W_v = J_c^T J_p
    [ W^T                 V + lambda diag V ] [ dp ] = [ g_p ]     V_v = J_p^T J_p,    g = -J^T r

V is block diagonal, so the views are eliminated first (Schur complement). Derivatives are forward differences; those by
the parameters of all views are taken at once. (Triggs et al. 1999: Bundle Adjustment - A Modern Synthesis.)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray

Residuals = Callable[[FloatArray, FloatArray], FloatArray]
"""(R,) residuals of common parameters (C,) and of the views' parameters (V, P), ordered by view."""

_STEP = 1e-6  # relative step of the differences, at least as large as for a parameter of 1e-3
_FIRST_DAMPING = 1e-3
_LARGEST_DAMPING = 1e8  # above it, the minimum is reached
_MAX_ITERATIONS = 100
_TOLERANCE = 1e-9  # relative reduction of the sum of squares below which the minimum is reached


@dataclass(frozen=True, slots=True)
class BlockSolution:
    """Minimum of a block least-squares problem."""

    common: FloatArray  # (C,) common parameters
    of_views: FloatArray  # (V, P) parameters of the views
    residuals: FloatArray  # (R,) residuals
    # (C, C) covariance of the common parameters for independent residuals of equal variance, which is estimated from
    # them
    covariance: FloatArray


def solve_blocks(
    residuals_of: Residuals, n_residuals: IntArray, common: FloatArray, of_views: FloatArray
) -> BlockSolution:
    """The local minimum that is reached from the given parameters.

    Args:
        residuals_of: the residuals; not finite where the parameters are not possible.
        n_residuals: (V,) number of residuals of each view.
        common: (C,) initial common parameters.
        of_views: (V, P) initial parameters of the views.

    Raises:
        numpy.linalg.LinAlgError: the residuals do not determine the parameters, or are not finite at the start.
    """
    starts = np.concatenate([[0], np.cumsum(n_residuals)[:-1]])
    residuals = residuals_of(common, of_views)
    if not np.isfinite(residuals).all():
        raise np.linalg.LinAlgError("residuals: expected finite initial values")
    damping = _FIRST_DAMPING
    for _ in range(_MAX_ITERATIONS):
        normal = _NormalEquations.of(residuals_of, residuals, starts, common, of_views)
        cost = float(residuals @ residuals)
        while damping <= _LARGEST_DAMPING:
            step, steps_of_views = normal.step(damping)
            moved = common + step, of_views + steps_of_views
            candidate = residuals_of(*moved)
            candidate_cost = float(candidate @ candidate) if np.isfinite(candidate).all() else np.inf
            if candidate_cost <= cost:
                break
            damping *= 10.0
        else:
            break
        common, of_views, residuals = *moved, candidate
        damping = max(damping / 10.0, 1e-12)
        if cost - candidate_cost <= _TOLERANCE * cost:
            break
    normal = _NormalEquations.of(residuals_of, residuals, starts, common, of_views)
    n_free = max(len(residuals) - common.size - of_views.size, 1)
    return BlockSolution(
        common, of_views, residuals, normal.common_covariance() * float(residuals @ residuals) / n_free
    )


@dataclass(frozen=True, slots=True)
class _NormalEquations:
    """Blocks of J^T J and -J^T r: u (C, C), v (V, P, P), w (V, C, P), g_common (C,), g_views (V, P)."""

    u: FloatArray
    v: FloatArray
    w: FloatArray
    g_common: FloatArray
    g_views: FloatArray

    @classmethod
    def of(
        cls, residuals_of: Residuals, residuals: FloatArray, starts: IntArray, common: FloatArray, of_views: FloatArray
    ) -> _NormalEquations:
        """The equations at a point with these residuals; `starts` (V,) is the first residual of each view."""
        j_c = np.stack(
            [
                (residuals_of(common + step, of_views) - residuals) / step.sum()
                for step in np.diag(_STEP * np.maximum(np.abs(common), 1e-3))
            ],
            axis=1,
        )
        steps = _STEP * np.maximum(np.abs(of_views).max(axis=0), 1e-3)
        j_p = np.stack(
            [(residuals_of(common, of_views + step) - residuals) / step.sum() for step in np.diag(steps)], axis=1
        )
        return cls(
            j_c.T @ j_c,
            np.add.reduceat(j_p[:, :, None] * j_p[:, None, :], starts),
            np.add.reduceat(j_c[:, :, None] * j_p[:, None, :], starts),
            -j_c.T @ residuals,
            -np.add.reduceat(j_p * residuals[:, None], starts),
        )

    def step(self, damping: float) -> tuple[FloatArray, FloatArray]:
        """Steps (C,) and (V, P) of the parameters."""
        diagonal = np.einsum("vii->vi", self.v)
        v = self.v + damping * diagonal[:, :, None] * np.eye(self.v.shape[1])
        u = self.u + damping * np.diag(np.diag(self.u))
        w_over_v = np.linalg.solve(v, self.w.transpose(0, 2, 1)).transpose(0, 2, 1)  # W V^-1
        schur = u - (w_over_v @ self.w.transpose(0, 2, 1)).sum(axis=0)
        common = np.linalg.solve(schur, self.g_common - (w_over_v @ self.g_views[:, :, None]).sum(axis=0)[:, 0])
        right = self.g_views - np.einsum("vcp,c->vp", self.w, common)
        return common, np.linalg.solve(v, right[:, :, None])[:, :, 0]

    def common_covariance(self) -> FloatArray:
        """(C, C) inverse of the Schur complement."""
        w_over_v = np.linalg.solve(self.v, self.w.transpose(0, 2, 1)).transpose(0, 2, 1)
        return np.asarray(np.linalg.inv(self.u - (w_over_v @ self.w.transpose(0, 2, 1)).sum(axis=0)))
