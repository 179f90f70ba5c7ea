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

import numpy as np

from detection.detections import FloatArray, IntArray
from ranging.cuboid import box_of_cuboid
from ranging.measured_boxes import SIZE_CLASSES

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

N_NUMBERS = 10
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
            return f"{len(TURN_DEG)} turn_weights wanted, not negative, not all zero"
        if min(*self.hwl_m, *self.log_sigma, *self.scatter, self.log_distance[1]) <= 0:
            return "sizes and standard deviations must be positive"
        if not np.isfinite([*self.offset, self.log_distance[0]]).all():
            return "offsets and distances must be finite"
        if not np.linalg.eigvalsh(self.covariance).min() > 0:
            return "the correlations contradict each other"
        return ""


class ShapeTables:
    """Boxes of all classes by turn, bearing and log distance: nodes with values and slopes, one look-up for a frame."""

    def __init__(self, priors: Mapping[str, SizePrior]) -> None:
        """Make room for every class; the nodes of one are worked out when it is first seen (some 50 ms)."""
        self._priors = {SIZE_CLASSES.index(name): prior for name, prior in priors.items()}
        n = len(SIZE_CLASSES)
        self._nodes = np.full((n, len(_BEARINGS), len(_LOG_M), len(_TURN_RAD), N_NUMBERS), np.nan)
        self.log_turn_weight = np.zeros((n, len(_TURN_RAD)))
        self.log_height, self.log_distance = np.zeros(n), np.ones((n, 2))
        self._worked_out = np.zeros(n, np.bool_)
        for k, prior in self._priors.items():
            self.log_height[k], self.log_distance[k] = np.log(prior.hwl_m[0]), prior.log_distance
            self.log_turn_weight[k] = _log_weights(np.array(prior.turn_weights))

    def at(
        self, size_class: IntArray, bearing: FloatArray, log_m: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The nodes nearest to (N,) |bearing| and (N,) log distance.

        Returns:
            (N,) steps of bearing and of log distance from the node to what was asked, and (10, N, K) of K turns:
            log height, log width, their slopes by log distance, their slopes by bearing, the three numbers of their
            covariance (sizes and scatter), and log(distance / nearest ground point).
        """
        if not self._worked_out[size_class].all():
            for k in np.unique(size_class[~self._worked_out[size_class]]).tolist():
                self._nodes[k] = _nodes(self._priors[k])
                self._worked_out[k] = True
        b = np.minimum(np.rint(bearing / _BEARING_STEP).astype(np.int64), len(_BEARINGS) - 1)
        d = np.rint((log_m - _LOG_M[0]) / _LOG_STEP).astype(np.int64).clip(0, len(_LOG_M) - 1)
        off = np.minimum(bearing - b * _BEARING_STEP, _BEARING_STEP)
        return off, log_m - _LOG_M[d], np.moveaxis(self._nodes[size_class, b, d], -1, 0)


def _nodes(prior: SizePrior) -> FloatArray:
    """(bearings, distances, turns, 10) of one class."""
    bearing, log_m, turn = np.meshgrid(_BEARINGS, _LOG_M, _TURN_RAD, indexing="ij")

    def sizes(log_hwl: FloatArray) -> tuple[FloatArray, FloatArray]:
        box = box_of_cuboid(
            log_hwl,
            turn_rad=turn,
            bearing=bearing,
            distance_m=np.exp(log_m),
            camera_height_m=NODE_CAMERA_HEIGHT_M,
        )
        return np.stack([box.log_height, box.log_width], axis=-1), box.log_nearness + log_m

    mean = np.log(prior.hwl_m)
    value, nearer = sizes(mean)
    by_size = np.stack(
        [(sizes(mean + step)[0] - sizes(mean - step)[0]) / (2 * _SIZE_STEP) for step in _SIZE_STEP * np.eye(3)], -1
    )
    spread = by_size @ prior.covariance @ np.swapaxes(by_size, -1, -2) + np.diag(np.square(prior.scatter))
    slopes = [np.gradient(value, step, axis=axis) for axis, step in ((1, _LOG_STEP), (0, _BEARING_STEP))]
    upper = np.stack([spread[..., 0, 0], spread[..., 0, 1], spread[..., 1, 1]], axis=-1)
    return np.concatenate([value + np.array(prior.offset), *slopes, upper, nearer[..., None]], axis=-1)


def _log_weights(weights: FloatArray) -> FloatArray:
    """(K,) log weight of every turn to the left and right, from one per angle."""
    half = weights / weights.sum()
    half[1:-1] /= 2
    return np.asarray(np.log(np.maximum(np.concatenate([half, half[1:-1]]), 1e-9)))
