r"""SequentialTest: the posterior probability of a contact, and whether to warn now or to wait.

In each frame k, the motion of a track predicts a contact with the probability p_k. Errors of this
prediction are errors of filtered motions, which last for about the correlation time T: two frames
within T tell little more than one. So the log odds of a contact start at those of any road user,
l_0, and follow the evidence over T:

    L_0 = l_0        L_k = L_(k-1) + (1 - exp(-dt / T)) (logit p_k - L_(k-1))

A certain prediction is believed within T, an uncertain one after several T, and a single frame
never. While an object comes nearer, the evidence of a contact grows, and L is behind it; so the
posterior probability, which is reported, is

    P = 1 / (1 + exp(-(alpha + beta L)))

A track that is new, or has jumped, may be no object, or another one, with the probability
a exp(-age / T_a): such tracks end soon. So p_k is the predicted probability times
1 - a exp(-age / T_a).

To warn now costs C_f, with the probability 1 - P that there is no contact. To wait for dt costs the
rise dC of the loss of a late warning, with the probability P. What a step can bring is new
evidence, a fraction dt / T of what would be independent of the past; at best, it saves C_f. A
further step is worth its wait while

    P dC/dt < (1 - P) C_f / T        <=>        P / (1 - P) < C_f / (T dC/dt)

The loss of a late warning grows with the deceleration b that the driver needs after the reaction
time (`needed_deceleration`), which before a standing object at the gap g is b = V^2 / 2 g, with
db/dt = b V / g = 2 b^2 / V. With C ~ b up to hard braking B, dC/dt is proportional to b^2, and the
threshold of the log odds of P falls as the time that is left runs out,

    theta(b) = logit P_on + 2 log max(B / b, 1)

while beyond B all is lost that can be. No alarm starts while b is that of normal driving. P_on, the
threshold where hard braking is needed, stands for C_f, and is a setting; it is lower for people.
"""

import numpy as np
from scipy.special import expit, logit

from track_range.foundation.arrays import BoolArray, FloatArray

# correlation time T of the errors of the evidence, s: the largest likelihood of the contacts and
# harmless tracks of drives without images (seeds 0 to 4), one camera and two, is between 0.2 and
# 0.3 s
CORRELATION_S = 0.3
# log odds l_0 of a contact of a road user of which nothing is known
PRIOR_LOG_ODDS = -5.0
_PRIOR = float(expit(PRIOR_LOG_ODDS))
# largest log odds of one frame: motions that no model describes have at least this probability
_MOST_LOG_ODDS = 6.0
# alpha and beta, of the largest likelihood on drives without images (seeds 0 to 6 and 200 to 206),
# one camera and two: 0.63 and 1.20; of either alone 0.40 and 1.10, 0.93 and 1.32
_OFFSET, _SLOPE = 0.6, 1.2
HARD_MPS2 = 5.0  # B, of hard braking
# fraction a of tracks with a predicted contact that are false in their first frame, and the time
# T_a after which 1 / e of them are left, s
_FALSE_FRACTION, _FALSE_S = 0.9, 0.3


def posterior(last: FloatArray, probability: FloatArray, dt: FloatArray) -> FloatArray:
    """Log odds L after a frame of the predicted probabilities p, 0..1, in arrays of one shape.

    `last` are the log odds before, NaN = a new track; `dt` is the time since then. Where p is NaN,
    nothing was predicted, and the log odds return to those of any road user.
    """
    evidence = logit(np.where(np.isnan(probability), _PRIOR, probability))
    evidence = np.minimum(np.maximum(evidence, -_MOST_LOG_ODDS), _MOST_LOG_ODDS)
    is_new = np.isnan(last)
    before = np.where(is_new, PRIOR_LOG_ODDS, last)
    weight = -np.expm1(-np.where(is_new, 0.0, dt) / CORRELATION_S)
    return np.asarray(before + weight * (evidence - before))


def calibrated(log_odds: FloatArray) -> FloatArray:
    """Log odds of the reported probability P, by L."""
    return np.asarray(_OFFSET + _SLOPE * log_odds)


def soundness(age_s: FloatArray) -> FloatArray:
    """Probability that a track of this age is of the object that it seems to be."""
    return np.asarray(1.0 - _FALSE_FRACTION * np.exp(-age_s / _FALSE_S))


def threshold(on_probability: FloatArray | float, needed_mps2: FloatArray) -> FloatArray:
    """Log odds theta(b) from which an alarm starts, by the deceleration b that is needed, >= 0."""
    reserve = np.maximum(HARD_MPS2 / np.maximum(needed_mps2, 1e-3), 1.0)
    return np.asarray(logit(on_probability) + 2.0 * np.log(reserve))


def is_due(
    log_odds: FloatArray, on_probability: FloatArray, needed_mps2: FloatArray, least_mps2: float
) -> BoolArray:
    """(N,) whether waiting costs more than an alarm, by the log odds of P.

    It never does below `least_mps2`, normal driving.
    """
    is_needed = needed_mps2 >= least_mps2
    return np.asarray(is_needed & (log_odds >= threshold(on_probability, needed_mps2)))
