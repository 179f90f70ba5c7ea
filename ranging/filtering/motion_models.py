"""InteractingModels: how an object may move, with a filter and a probability for each model.

    static         own speed 0: v = -V, but by sizes that are wrong by s, v = -(1 + s) V
    moving         the own speed v + V changes by accelerations that last (`TargetStates`), calm
                   or agile: with a small or a large standard deviation sigma_a

The four steps of Blom and Bar-Shalom (The interacting multiple model algorithm, 1988), for the
models g of a track with the probabilities w_g:

    1. interaction       w_g' = (T w)_g                                 T: switching towards the prior of the class
    2. filtering         x_g, P_g, nu_g, S_g: one Kalman filter per model, with the density q_g (`FilterBank`)
    3. probabilities     w_g'' ~ w_g' N(nu_g; 0, S_g)
    4. combination       x = sum w_g'' x_g     P = sum w_g'' (P_g + (x_g - x) (x_g - x)')

Only the probabilities interact. In their algorithm, step 1 also mixes the states, so that each
filter starts from a mean over the models; ours keep their own states (as in Magill, Optimal
adaptive estimation, 1965), so that v = -V of the static model is not mixed with other rates.

The prior belongs to the class in the drive: the time that its tracks have spent in each model,
beside 10 s of the first prior. So a queue has another prior than a motorway. Without ego speed
there is no static model. Constants without a source were chosen on 13 of KITTI's tracking
sequences.
"""

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray

# of the own speed of moving objects beside their acceleration, m/s per square root of a second; of
# all but people, the smallest with 92 % of closing speeds within two sigma for objects at 2 to
# 6 m/s on KITTI
_MOVING_NOISES = np.array([{"person": 0.2}.get(name, 0.35) for name in ROAD_CLASSES])
"""(road classes,)"""
# sigma_a of calm and agile road users, m/s^2; as are the changes of the speeds of moving objects on
# 13 of KITTI's sequences, for vehicles those from 0.5 to 4 s
_ACCELERATIONS_MPS2 = np.array(
    [{"person": (0.1, 0.3), "bicycle": (0.25, 0.6)}.get(name, (0.4, 1.5)) for name in ROAD_CLASSES]
).T
"""(2, road classes)"""
# of a camera whose speed is unknown: the rates of all objects change with its own speed, m/s^2
_EGO_ACCELERATION_MPS2 = 0.5
# of the own speed of static objects, whose relative size error changes, as `_MOVING_NOISES`
_STATIC_NOISE = 0.02
STATIC_SIGMA_MPS = 0.1  # of the own speed of static objects at the start
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

_MAX_CHI2 = 25.0  # of innovations; larger ones are outliers in every model


class InteractingModels:
    """Probabilities w of G models for M methods and N tracks, in arrays (M, G, N); counts the time
    of each by class.
    """

    def __init__(
        self,
        n_methods: int = 1,
        *,
        noises: FloatArray = _MOVING_NOISES,
        accelerations_mps2: FloatArray = _ACCELERATIONS_MPS2,
        has_static: bool = True,
    ) -> None:
        """Start with the priors; `noises` (road classes,) and sigma_a (moving models, road classes)
        are for moving objects, and without `has_static` all objects move.
        """
        n_moving = len(accelerations_mps2)
        self.n_methods, self.n_models = n_methods, 1 + n_moving
        # (G, 1)
        self.is_static: BoolArray = np.arange(1 + n_moving)[:, None] == 0
        self._is_moving = ~self.is_static
        # (G, road classes) density of the noise of v, m^2/s^3
        self.q: FloatArray = np.where(self.is_static, _STATIC_NOISE, noises) ** 2
        # (G, road classes) sigma_a
        self._acceleration_mps2 = np.pad(accelerations_mps2, ((1, 0), (0, 0)))
        static = _STATIC_PRIOR * has_static
        # (G, road classes)
        self._first_prior = np.where(self.is_static, static, (1 - static) / n_moving)
        self._seen_s = np.zeros((n_methods, 1 + n_moving, len(ROAD_CLASSES)))

    def prior(self, class_id: IntArray, may_be_static: BoolArray | bool) -> FloatArray:
        """(M, G, N) probabilities of the models of tracks of these classes."""
        time_s = (_PRIOR_S * self._first_prior + self._seen_s)[..., class_id]
        prior = time_s * (may_be_static | self._is_moving)
        return np.asarray(prior / np.add.reduce(prior, axis=1, keepdims=True))

    def start_sigma_mps(
        self, class_id: IntArray, moving_mps: float, scale_mps: FloatArray
    ) -> FloatArray:
        """Standard deviations of v of new tracks, by the own speed (`moving_mps`) and by the size
        (`scale_mps`).
        """
        moving = np.minimum(_SPEED_SIGMA_MPS[class_id], moving_mps)
        return np.hypot(np.where(self.is_static, STATIC_SIGMA_MPS, moving), scale_mps)

    def acceleration_sigma(self, class_id: IntArray, *, is_ego_known: bool) -> FloatArray:
        """(G, N) sigma_a of the tracks, in m/s^2; 0 for static models."""
        sigma = self._acceleration_mps2[:, class_id]
        if is_ego_known:
            return sigma
        return np.where(sigma > 0, np.hypot(sigma, _EGO_ACCELERATION_MPS2), 0.0)

    def interact(self, weight: FloatArray, prior: FloatArray, dt: FloatArray) -> FloatArray:
        """Step 1: probabilities after the time dt, in which objects may have changed their model.

        The moving models mix among each other over 4 s, all models over 100 s.
        """
        possible, before = prior[:, 1:], weight[:, 1:]
        is_moving = np.add.reduce(before, axis=1, keepdims=True)
        total = np.maximum(np.add.reduce(possible, axis=1, keepdims=True), 1e-9)
        weight = weight.copy()
        weight[:, 1:] -= np.expm1(-dt / _SWITCH_S) * (possible * (is_moving / total) - before)
        weight -= np.expm1(-dt / _STATIC_SWITCH_S) * (prior - weight)
        return np.asarray(weight * (prior > 0))

    def update_probabilities(
        self, weight: FloatArray, nu: FloatArray, S: FloatArray, *, valid: BoolArray
    ) -> FloatArray:
        """Step 3: probabilities after the innovations nu of variance S, where valid."""
        likelihood = np.exp(-0.5 * (np.minimum(nu * nu / S, _MAX_CHI2) + np.log(S)))
        weight = np.where(valid, weight * likelihood, weight)
        total = np.add.reduce(weight, axis=1, keepdims=True)
        return np.asarray(weight / np.maximum(total, 1e-300))

    def count(self, class_id: IntArray, weight: FloatArray, dt: FloatArray) -> None:
        """Add the time dt of tracks with the probabilities (M, G, N)."""
        self._seen_s += (weight * dt) @ (class_id[:, None] == np.arange(len(ROAD_CLASSES)))


def mean_of(x: FloatArray, weight: FloatArray) -> FloatArray:
    """(..., M, N) mean over the models (..., M, G, N)."""
    return np.asarray(np.add.reduce(weight * x, axis=-2))
