"""MotionModels: how an object may move, with a filter and a probability for each model.

    static         own speed 0: v = -V, but by sizes that are wrong by s, v = -(1 + s) V
    moving         the own speed v + V is a random walk, calm or agile: with a small or a large density q_g

    w_g' ~ (T w)_g N(nu_g; 0, S_g)^a                            T: switching towards the prior of the class
    x = sum w_g x_g     P = sum w_g (P_g + (x_g - x) (x_g - x)')

(Magill, Optimal adaptive estimation, 1965; Blom and Bar-Shalom, 1988, without the mixing of states.) The prior is that
of the class in the drive: the time that its tracks have spent in each model, beside `prior_s` of the first prior. So a
queue has another one than a motorway. Without ego speed there is no static model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray

_IS_WALKER = np.array([name in ("person", "bicycle") for name in ROAD_CLASSES])
_SPEED_SIGMA_MPS = np.array([{"person": 1.5, "bicycle": 4.0}.get(name, np.inf) for name in ROAD_CLASSES])
"""(road classes,) standard deviation of the own speed of moving objects, m/s; inf = that of the settings."""

_EVIDENCE = 1.5
"""Exponent a of the likelihoods. Fitted on KITTI's labelled tracks: with 1, static cars have a probability of 0.7 where
98 % are static, since the size error of an object is the same in all frames and its noise is smaller than declared."""

_MAX_CHI2 = 25.0  # of innovations; larger ones are outliers in every model


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelSettings:
    """Settings of the models of motion; constants without a source were chosen on 13 of KITTI's tracking sequences."""

    acceleration_noises: tuple[float, ...] = (0.25, 1.25)  # of the own speed, m/s per square root of a second
    static_noise: float = 0.02  # the same of static objects, whose relative size error changes
    static_sigma_mps: float = 0.1  # of the own speed of static objects at the start
    static_rate_sigma_mps: float = 0.2  # of the closing speed of static objects beside that of the ego speed
    static_prior: float = 0.7  # probability that a new vehicle is static
    static_walker_prior: float = 0.2  # the same of people and cyclists
    prior_s: float = 10.0  # time of tracks that weighs as much as the prior
    switch_s: float = 4.0  # time after which a moving object has changed between calm and agile
    static_switch_s: float = 100.0  # time after which an object has started or stopped


class MotionModels:
    """Probabilities of G models for M methods and N tracks, in arrays (M, G, N); counts the time of each by class."""

    def __init__(self, settings: ModelSettings, n_methods: int = 1) -> None:
        """Start with the priors."""
        self._settings = settings
        noises = np.array([settings.static_noise, *settings.acceleration_noises])
        self.is_static: BoolArray = np.arange(len(noises))[:, None] == 0  # (G, 1)
        self.q: FloatArray = noises[:, None] ** 2  # (G, 1)
        self._seen_s = np.zeros((n_methods, len(noises), len(ROAD_CLASSES)))

    def prior(self, class_id: IntArray, may_be_static: BoolArray | bool) -> FloatArray:
        """(M, G, N) probabilities of the models of tracks of these classes."""
        settings, seen_s = self._settings, self._seen_s[..., class_id]
        static = np.where(_IS_WALKER[class_id], settings.static_walker_prior, settings.static_prior)
        before = np.where(self.is_static, static, (1 - static) / (len(self.q) - 1))
        prior = (settings.prior_s * before + seen_s) * (may_be_static | ~self.is_static)
        return np.asarray(prior / prior.sum(axis=1, keepdims=True))

    def start_sigma_mps(self, class_id: IntArray, moving_mps: float, scale_mps: FloatArray) -> FloatArray:
        """Standard deviations of v of new tracks, by the own speed (`moving_mps`) and by the size (`scale_mps`)."""
        moving = np.minimum(_SPEED_SIGMA_MPS[class_id], moving_mps)
        return np.hypot(np.where(self.is_static, self._settings.static_sigma_mps, moving), scale_mps)

    def predicted(self, weight: FloatArray, prior: FloatArray, dt: FloatArray) -> FloatArray:
        """Probabilities (M, G, N) after the steps dt."""
        settings, is_moving = self._settings, ~self.is_static
        moving = prior * is_moving
        moving *= (weight * is_moving).sum(axis=1, keepdims=True) / np.maximum(moving.sum(axis=1, keepdims=True), 1e-9)
        weight = weight - np.expm1(-dt / settings.switch_s) * np.where(is_moving, moving - weight, 0.0)
        return np.asarray((weight - np.expm1(-dt / settings.static_switch_s) * (prior - weight)) * (prior > 0))

    def updated(
        self, weight: FloatArray, nu: FloatArray, S: FloatArray, *, valid: BoolArray, evidence: float = _EVIDENCE
    ) -> FloatArray:
        """Probabilities after the innovations nu of variance S, where valid; `evidence` is the exponent a."""
        likelihood = np.exp(-0.5 * evidence * (np.minimum(nu * nu / S, _MAX_CHI2) + np.log(S)))
        weight = np.where(valid, weight * likelihood, weight)
        return np.asarray(weight / np.maximum(weight.sum(axis=1, keepdims=True), 1e-300))

    def count(self, class_id: IntArray, weight: FloatArray, dt: FloatArray) -> None:
        """Add the time dt of tracks with the probabilities (M, G, N)."""
        self._seen_s += (weight * dt) @ (class_id[:, None] == np.arange(len(ROAD_CLASSES)))


def mean_of(x: FloatArray, weight: FloatArray) -> FloatArray:
    """(M, N) mean over the models (M, G, N)."""
    return np.asarray((weight * x).sum(axis=1))


def covariance_of(x: FloatArray, y: FloatArray, P: FloatArray, weight: FloatArray) -> FloatArray:
    """(M, N) covariance over the models of x and y, whose covariance in each model is P."""
    return mean_of(P + (x - mean_of(x, weight)[:, None]) * (y - mean_of(y, weight)[:, None]), weight)
