r"""Probability that a track touches the ego vehicle within a horizon.

      |  ^ x           The gap g in front of the ego vehicle changes with the rate v = u - V, the acceleration u' of the
    [obj] ---> o'      object and that of the ego vehicle V', which decay with the time constant tau (Singer, 1970) and
      |                end when the object or the ego vehicle stops, after t_u or t_V. The lateral offset o from the
      | g              ego path changes with the rate o'. With the horizon H and half the sum of both widths W:
    [ego]                  P = int_0^H f(t) P(-W - c_1 <= o(t) <= W + c_2) dt

        f = dF / dt,  F(t) = P(g(t) <= 0) = Phi(-m / s)
        m = g + u r + u' h(r) - V r_V - V' h(r_V)       r = min(t, t_u),  r_V = min(t, t_V)
        h(t) = tau^2 (exp(-t / tau) - 1 + t / tau)
        s^2 = P_gg + 2 t P_gv + t^2 P_vv + h^2 P_aa

        o(t) ~ N(o + o' t, P_oo + 2 t P_oo' + t^2 P_o'o' + (A t^2 / 2)^2)

F is made monotonic in t, since the first contact counts. c_1 and c_2 extend the overlap on the side
from which the object comes by the distance it travels while the ego vehicle passes: it may run into
the side. A is the standard deviation of the lateral acceleration of the object. Arrival time and
lateral offset are independent given the means: their common error, a factor of the scale, does not
move an object that is ahead out of the path.

Most vehicles that come towards the path from the side give way, or are in the next lane: they stop
their lateral motion before the path, as long as they need no more than an ordinary deceleration for
it, b = o'^2 / 2 (|o| - W). People seldom do once they walk.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import expit, ndtr

from track_range.foundation.arrays import FloatArray
from track_range.foundation.constant_velocity import ConstantVelocity

_N_STEPS = 12  # of the integral; with 256, 99 % of simulated probabilities differ by at most 0.004
_MIN_SIGMA = 1e-3  # smallest standard deviation in m, against a division by zero
_MIN_BRAKING_MPS = 1e-6  # smallest deceleration, against a division by zero
# fraction of the vehicles beside the path that give way if they can; deceleration that half of
# these would choose, and its scale, m/s^2
_YIELDING, _YIELDING_MPS2, _YIELDING_SPREAD_MPS2 = 0.95, 3.0, 0.5
_MIN_ROOM_M = 0.1  # smallest distance from the path, against a division by zero


@dataclass(frozen=True, slots=True)
class Encounter:
    """Motion of N objects relative to the ego vehicle, (N,) each; NaN = unknown."""

    # distance g from the front of the ego vehicle and its rate v, negative = closing
    gap: ConstantVelocity
    object_mps: FloatArray  # speed u, and acceleration u', of the object along the road
    object_mps2: FloatArray
    object_stop_s: FloatArray  # t_u, time at which it stops; inf = not, or its speed is unknown
    # standard deviation of the relative acceleration, sqrt(P_aa)
    acceleration_sigma_mps2: FloatArray
    ego_mps: float  # V, V' and t_V of the ego vehicle
    ego_mps2: float
    ego_stop_s: float
    # lateral offset o of the object's centre from the ego path and its rate
    offset: ConstantVelocity
    half_width_m: FloatArray  # W, half the sum of the widths of object and ego vehicle
    lateral_acceleration_mps2: FloatArray  # A


def contact_probability(
    encounter: Encounter, *, horizon_s: float, manoeuvre_s: float, ego_length_m: float
) -> FloatArray:
    """(N,) probability P of a contact within the horizon H, 0..1; NaN where gap or offset is
    unknown.

    `manoeuvre_s` is tau, the time constant with which accelerations end; `ego_length_m` sets the
    time of passing.
    """
    gap, offset = encounter.gap, encounter.offset
    t, h, middle_s = _times(horizon_s, manoeuvre_s)
    moving_s, ego_s = np.minimum(t, encounter.object_stop_s), np.minimum(t, encounter.ego_stop_s)
    of_ego_m = encounter.ego_mps * (t - ego_s) - encounter.ego_mps2 * manoeuvre(ego_s, manoeuvre_s)
    m = gap.x + t * gap.v
    m += encounter.object_mps2 * manoeuvre(moving_s, manoeuvre_s)
    m -= encounter.object_mps * (t - moving_s)
    m += of_ego_m
    variance = gap.P_xx + t * (2 * gap.P_xv + t * gap.P_vv)
    variance += (h * encounter.acceleration_sigma_mps2) ** 2
    F = ndtr(-m / np.sqrt(np.maximum(variance, _MIN_SIGMA**2)))
    F = np.maximum.accumulate(F, axis=0)

    passing_s = ego_length_m / np.maximum(-gap.v, ego_length_m)  # at most 1 s
    overlap = overlap_probability(
        offset,
        encounter.half_width_m,
        encounter.lateral_acceleration_mps2,
        middle_s,
        side_m=offset.v * passing_s,
    )
    probability = (F[1:] - F[:-1]) * overlap
    return np.asarray(probability.sum(axis=0) + F[0] * overlap[0])


@cache
def _times(horizon_s: float, manoeuvre_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times t (K + 1, 1) of the integral, h(t), and the middles (K, 1) of its steps."""
    t: FloatArray = horizon_s / _N_STEPS * np.arange(_N_STEPS + 1, dtype=np.float64)[:, None]
    return t, manoeuvre(t, manoeuvre_s), (t[1:] + t[:-1]) / 2


def yielding_probability(encounter: Encounter) -> FloatArray:
    """(N,) probability that an object beside the path, if it is a vehicle, stops before it."""
    offset = encounter.offset
    room_m = np.abs(offset.x) - encounter.half_width_m
    needed_mps2 = offset.v**2 / (2 * np.maximum(room_m, _MIN_ROOM_M))
    can_stop = expit((_YIELDING_MPS2 - needed_mps2) / _YIELDING_SPREAD_MPS2)
    return np.asarray(np.where(room_m > 0, _YIELDING * can_stop, 0.0))


def needed_deceleration(encounter: Encounter, reaction_s: float) -> FloatArray:
    """(N,) constant deceleration in m/s^2, from the reaction time on, that avoids a contact.

    Until then the ego vehicle goes on as before. With the gap g, the closing speed c, the object's
    speed u and its deceleration b at that time, the speeds become equal before the object stops, or
    the object stops first:
        b + c^2 / 2 g              if 2 g / c < u / b
        V^2 / 2 (g + u^2 / 2 b)    otherwise (ISO 15623)
    """
    t, gap = reaction_s, encounter.gap
    b = np.maximum(-encounter.object_mps2, 0.0)
    moving_s, ego_s = np.minimum(t, encounter.object_stop_s), min(t, encounter.ego_stop_s)
    travelled_m = encounter.object_mps * moving_s + encounter.object_mps2 * moving_s**2 / 2
    ego_m = encounter.ego_mps * ego_s + encounter.ego_mps2 * ego_s**2 / 2
    left_m = np.maximum(gap.x + travelled_m - ego_m, 0.1)
    u = encounter.object_mps + encounter.object_mps2 * moving_s
    V = encounter.ego_mps + encounter.ego_mps2 * ego_s
    c = np.maximum(V - u, 0.0)
    u = np.maximum(u, 0.0)
    is_stopped = (2 * left_m * b > c * u) & (encounter.ego_mps > 0)
    stopped = V * V / (2 * (left_m + u * u / (2 * np.maximum(b, _MIN_BRAKING_MPS))))
    return np.asarray(np.where(is_stopped, stopped, b + c * c / (2 * left_m)) * (c > 0))


def stop_s(speed_mps: FloatArray, acceleration_mps2: FloatArray, manoeuvre_s: float) -> FloatArray:
    """Time at which an object that brakes stops, t = -tau log(1 + u / (u' tau)); 0 if u <= 0, inf
    if it does not.
    """
    speed = np.maximum(speed_mps, 0.0)
    braking = np.maximum(-acceleration_mps2 * manoeuvre_s, _MIN_BRAKING_MPS)
    time_s = -manoeuvre_s * np.log1p(-np.minimum(speed / braking, 1.0 - 1e-9))
    return np.asarray(np.where(braking > speed, time_s, np.inf))


def manoeuvre(t: FloatArray | float, tau: float) -> FloatArray:
    """h(t): distance travelled per acceleration that decays with the time constant tau."""
    return np.asarray(tau * tau * np.expm1(-t / tau) + tau * t)


def overlap_probability(
    offset: ConstantVelocity,
    half_width_m: FloatArray,
    lateral_acceleration_mps2: FloatArray,
    t: FloatArray | float,
    *,
    side_m: FloatArray | float = 0.0,
) -> FloatArray:
    """Probability P(-W - c_1 <= o(t) <= W + c_2) that N objects overlap the ego path after t
    seconds.

    W is `half_width_m`, A `lateral_acceleration_mps2`, (N,) each, and t broadcast with them.
    `side_m` is the lateral distance travelled by the objects while the ego vehicle passes; it
    extends the side that they come from.
    """
    o = offset.x + t * offset.v
    growth = (lateral_acceleration_mps2 * t * t / 2) ** 2
    variance = offset.P_xx + t * (2 * offset.P_xv + t * offset.P_vv) + growth
    sigma = np.sqrt(np.maximum(variance, _MIN_SIGMA**2))
    low = -half_width_m - np.maximum(side_m, 0.0)
    high = half_width_m + np.maximum(-side_m, 0.0)
    return np.asarray(ndtr((high - o) / sigma) - ndtr((low - o) / sigma))
