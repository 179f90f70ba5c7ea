"""MotionModels: how an object may move, with a filter and a probability for each model.

    static         own speed 0: v = -V, but by sizes that are wrong by s, v = -(1 + s) V
    moving         the own speed v + V is a random walk, calm or agile: with a small or a large density q_g

    w_g' ~ (T w)_g N(nu_g; 0, S_g)^a                            T: switching towards the prior of the class
    x = sum w_g x_g     P = sum w_g (P_g + (x_g - x) (x_g - x)')

(Magill, Optimal adaptive estimation, 1965; Blom and Bar-Shalom, 1988, without the mixing of
states.) The prior belongs to the class in the drive: the time that its tracks have spent in each
model, beside 10 s of the first prior. So a queue has another prior than a motorway. Without ego
speed there is no static model. Constants without a source were chosen on 13 of KITTI's tracking
sequences.
"""

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray

# of the own speed of moving objects, m/s per square root of a second
ACCELERATION_NOISES = (0.25, 1.25)
_STATIC_NOISE = 0.02  # the same of static objects, whose relative size error changes
_STATIC_SIGMA_MPS = 0.1  # of the own speed of static objects at the start
STATIC_RATE_SIGMA_MPS = 0.2  # of the closing speed of static objects beside that of the ego speed
_STATIC_PRIOR = np.array([{"person": 0.2, "bicycle": 0.2}.get(name, 0.7) for name in ROAD_CLASSES])
"""(road classes,) probability that a new object is static."""

_PRIOR_S = 10.0  # time of tracks that weighs as much as the prior
_SWITCH_S = 4.0  # time after which a moving object has changed between calm and agile
_STATIC_SWITCH_S = 100.0  # time after which an object has started or stopped
_SPEED_SIGMA_MPS = np.array(
    [{"person": 1.5, "bicycle": 4.0}.get(name, np.inf) for name in ROAD_CLASSES]
)
"""(road classes,) largest standard deviation of the own speed of moving objects, m/s."""

_EVIDENCE = 1.5
"""Exponent a of the likelihoods. Fitted on KITTI's labelled tracks: with 1, static cars have a
probability of 0.7 where 98 % are static, since the size error of an object is the same in all
frames and its noise is smaller than declared."""

_MAX_CHI2 = 25.0  # of innovations; larger ones are outliers in every model


class MotionModels:
    """Probabilities of G models for M methods and N tracks, in arrays (M, G, N); counts the time of
    each by class.
    """

    def __init__(
        self,
        n_methods: int = 1,
        *,
        noises: tuple[float, ...] = ACCELERATION_NOISES,
        has_static: bool = True,
    ) -> None:
        """Start with the priors; `noises` are for moving objects, and without `has_static` all
        objects move.
        """
        self._static_prior = _STATIC_PRIOR * has_static
        noises = (_STATIC_NOISE, *noises)
        self.is_static: BoolArray = np.arange(len(noises))[:, None] == 0  # (G, 1)
        self.q: FloatArray = np.array(noises)[:, None] ** 2  # (G, 1)
        self._seen_s = np.zeros((n_methods, len(noises), len(ROAD_CLASSES)))

    def prior(self, class_id: IntArray, may_be_static: BoolArray | bool) -> FloatArray:
        """(M, G, N) probabilities of the models of tracks of these classes."""
        static = self._static_prior[class_id]
        before = np.where(self.is_static, static, (1 - static) / (len(self.q) - 1))
        prior = (_PRIOR_S * before + self._seen_s[..., class_id]) * (
            may_be_static | ~self.is_static
        )
        return np.asarray(prior / prior.sum(axis=1, keepdims=True))

    def start_sigma_mps(
        self, class_id: IntArray, moving_mps: float, scale_mps: FloatArray
    ) -> FloatArray:
        """Standard deviations of v of new tracks, by the own speed (`moving_mps`) and by the size
        (`scale_mps`).
        """
        moving = np.minimum(_SPEED_SIGMA_MPS[class_id], moving_mps)
        return np.hypot(np.where(self.is_static, _STATIC_SIGMA_MPS, moving), scale_mps)

    def predicted(self, weight: FloatArray, prior: FloatArray, dt: FloatArray) -> FloatArray:
        """Probabilities (M, G, N) after the steps dt."""
        is_moving = ~self.is_static
        moving = prior * is_moving
        moving *= (weight * is_moving).sum(axis=1, keepdims=True) / np.maximum(
            moving.sum(axis=1, keepdims=True), 1e-9
        )
        weight = weight - np.expm1(-dt / _SWITCH_S) * np.where(is_moving, moving - weight, 0.0)
        return np.asarray(
            (weight - np.expm1(-dt / _STATIC_SWITCH_S) * (prior - weight)) * (prior > 0)
        )

    def updated(
        self,
        weight: FloatArray,
        nu: FloatArray,
        S: FloatArray,
        *,
        valid: BoolArray,
        evidence: float = _EVIDENCE,
    ) -> FloatArray:
        """Probabilities after the innovations nu of variance S, where valid; `evidence` is the
        exponent a.
        """
        likelihood = np.exp(-0.5 * evidence * (np.minimum(nu * nu / S, _MAX_CHI2) + np.log(S)))
        weight = np.where(valid, weight * likelihood, weight)
        return np.asarray(weight / np.maximum(weight.sum(axis=1, keepdims=True), 1e-300))

    def count(self, class_id: IntArray, weight: FloatArray, dt: FloatArray) -> None:
        """Add the time dt of tracks with the probabilities (M, G, N)."""
        self._seen_s += (weight * dt) @ (class_id[:, None] == np.arange(len(ROAD_CLASSES)))


def mean_of(x: FloatArray, weight: FloatArray) -> FloatArray:
    """(M, N) mean over the models (M, G, N)."""
    return np.asarray((weight * x).sum(axis=1))
