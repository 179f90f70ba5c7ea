"""What is known of a class before its box is seen: how high, wide and long its objects are, and which way they face.

    log (height, width, length) ~ N(mean, covariance)       over objects of all drives
    turn from the direction of travel ~ a few angles with weights, the same to the left and right
    log distance ~ N(mean, sigma)                            wide: it only says that 500 m is unlikely

`ShapeTables` are the geometry of `cuboid.py` at nodes of turn, bearing and distance, with slopes between them: a frame
of boxes costs one look-up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.ranging.size_models.cuboid import CuboidBox, Floats, box_of_cuboid
from track_range.ranging.size_models.size_model import SIZE_CLASSES

TURN_DEG = np.array([0.0, 3.0, 7.0, 12.0, 20.0, 32.0, 48.0, 68.0, 90.0])
"""Angles from the direction of travel that a prior has weights for; denser where the width changes most."""

NODE_CAMERA_HEIGHT_M = 1.65
"""Height that the tables' boxes are seen from; a box's size hardly depends on it."""

_TURN_RAD = np.radians(np.concatenate([TURN_DEG, -TURN_DEG[1:-1]]))
_BEARING_STEP = 0.06
_BEARINGS = np.arange(21) * _BEARING_STEP  # to 50 degrees
_LOG_STEP = 0.1
_LOG_M = np.arange(np.log(4.0), np.log(250.0), _LOG_STEP)
NODE_RANGE = float(_LOG_M[0]), float(_LOG_M[-1])
"""Log distances that there are nodes for."""

N_NUMBERS = 11
"""Numbers kept per node."""

_SIZE_STEP = 0.02  # of the numerical derivatives by log size


@dataclass(frozen=True, slots=True, kw_only=True)
class SizePrior:
    """What is known of one class.

    Attributes:
        hwl_m: typical height, width and length.
        log_sigma: standard deviations of their logarithms.
        correlation: of log height and width, height and length, width and length.
        turn_weights: one per angle of `TURN_DEG`, summing to 1.
        log_distance: mean and standard deviation of log metres.
        offset: by how much the log height and log width of boxes exceed the cuboid's,
        scatter: and the standard deviations about that: rounded mirrors, swinging arms.
        stands: whether it stands on the road.
        n_boxes: labels it was taken from,
        n_tracks: and how many objects they show; 0 = from standard sizes alone.
        source: from what.
    """

    hwl_m: tuple[float, float, float]
    log_sigma: tuple[float, float, float]
    correlation: tuple[float, float, float]
    turn_weights: tuple[float, ...]
    log_distance: tuple[float, float]
    offset: tuple[float, float]
    scatter: tuple[float, float]
    stands: bool
    n_boxes: int
    n_tracks: int
    source: str

    @property
    def covariance(self) -> FloatArray:
        """(3, 3) of the logarithms of height, width, length."""
        hw, hl, wl = self.correlation
        correlation = np.array([[1.0, hw, hl], [hw, 1.0, wl], [hl, wl, 1.0]])
        return np.asarray(correlation * np.outer(self.log_sigma, self.log_sigma))

    def faults(self) -> str:
        """What is wrong with the numbers; empty = nothing."""
        if len(self.turn_weights) != len(TURN_DEG) or min(self.turn_weights) < 0 or sum(self.turn_weights) <= 0:
            return f"expected {len(TURN_DEG)} turn_weights, none of them negative, not all 0"
        if min(*self.hwl_m, *self.log_sigma, *self.scatter, self.log_distance[1]) <= 0:
            return "sizes and standard deviations must be positive"
        if not np.isfinite([*self.offset, self.log_distance[0]]).all():
            return "offsets and distances must be finite"
        if not np.linalg.eigvalsh(self.covariance).min() > 0:
            return "the correlation matrix must be positive definite"
        return ""


class ShapeTables:
    """Boxes of all classes by turn, bearing and log distance: nodes with values and slopes, one look-up for a frame.

    Attributes:
        typical: (3, classes) log height, and log distance's mean and 1 / variance.
    """

    def __init__(self, priors: Mapping[str, SizePrior]) -> None:
        """Work out the nodes of every class, some 15 ms each."""
        n = len(SIZE_CLASSES)
        n_cells = len(_BEARINGS) * len(_LOG_M)
        self._nodes = np.full((n * n_cells, N_NUMBERS * len(_TURN_RAD)), np.nan, np.float32)
        self.typical = np.ones((3, n))
        for name, prior in priors.items():
            k = SIZE_CLASSES.index(name)
            self._nodes[k * n_cells : (k + 1) * n_cells] = _nodes(prior).reshape(n_cells, -1)
            self.typical[:, k] = np.log(prior.hwl_m[0]), prior.log_distance[0], prior.log_distance[1] ** -2

    def at(
        self, size_class: IntArray, bearing: FloatArray, log_m: FloatArray
    ) -> tuple[FloatArray, FloatArray, npt.NDArray[np.float32]]:
        """The nodes nearest to |bearing| and log distance of boxes (N,), each perhaps of M classes.

        Args:
            size_class: (M, N).
            bearing: (N,) not negative.
            log_m: (M, N).

        Returns:
            Steps (N,) of bearing and (M, N) of log distance from the node to what was asked, and (11, K, M, N) of K
            turns: log height and width, their slopes by log distance, their slopes by bearing, their variances and
            their covariance (sizes and scatter), log(distance / nearest ground point), and the turn's log weight.
        """
        b = np.minimum((bearing / _BEARING_STEP + 0.5).astype(np.int64), len(_BEARINGS) - 1)
        d = ((log_m - _LOG_M[0]) / _LOG_STEP + 0.5).astype(np.int64)
        off = np.minimum(bearing - b * _BEARING_STEP, _BEARING_STEP)
        nodes = self._nodes.take((size_class * len(_BEARINGS) + b) * len(_LOG_M) + d, axis=0)
        nodes = np.ascontiguousarray(nodes.reshape(log_m.size, -1).T)
        return off, log_m - _LOG_M[d], nodes.reshape(N_NUMBERS, len(_TURN_RAD), *log_m.shape)


def _nodes(prior: SizePrior) -> Floats:
    """(bearings, distances, 11, turns) of one class."""
    bearing, log_m, turn = (axis.astype(np.float32) for axis in np.ix_(_BEARINGS, _LOG_M, _TURN_RAD))
    box_for = partial(
        box_of_cuboid,
        turn_rad=turn,
        bearing=bearing,
        distance_m=np.exp(log_m),
        camera_height_m=NODE_CAMERA_HEIGHT_M,
    )
    mean = np.log(prior.hwl_m).astype(np.float32)
    typical = box_for(mean)
    value = _log_size(typical)
    by_size = np.stack(
        [
            (_log_size(box_for(mean + step, near=typical)) - _log_size(box_for(mean - step, near=typical)))
            / (2 * _SIZE_STEP)
            for step in (_SIZE_STEP * np.eye(3)).astype(np.float32)
        ]
    )
    a, c, b = (
        np.einsum("i...,ij,j...", by_size[:, i], prior.covariance, by_size[:, j]) for i, j in ((0, 0), (1, 1), (0, 1))
    )
    a, c = a + prior.scatter[0] ** 2, c + prior.scatter[1] ** 2
    slopes = [np.gradient(value, step, axis=axis) for axis, step in ((2, _LOG_STEP), (1, _BEARING_STEP))]
    value += np.array(prior.offset, np.float32)[:, None, None, None]
    weight = np.broadcast_to(_log_weights(np.array(prior.turn_weights)), a.shape)
    rest = np.stack([a, c, b, typical.log_nearness + log_m, weight])
    return np.concatenate([value, *slopes, rest]).transpose(1, 2, 0, 3)


def _log_size(box: CuboidBox) -> Floats:
    return np.stack([box.log_height, box.log_width])


def _log_weights(weights: FloatArray) -> FloatArray:
    """(K,) log weight of every turn to the left and right, from one per angle."""
    half = weights / weights.sum()
    half[1:-1] /= 2
    return np.asarray(np.log(np.maximum(np.concatenate([half, half[1:-1]]), 1e-9)))
