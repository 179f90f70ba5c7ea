"""The sequential test of the collision warning, by hand."""

import math

import numpy as np
import pytest

from track_range.ranging.warning.sequential_test import (
    CORRELATION_S,
    HARD_MPS2,
    PRIOR_LOG_ODDS,
    is_due,
    posterior,
    soundness,
    threshold,
)

STEP_S = 0.1


def log_odds(probabilities: list[float], step_s: float = STEP_S) -> list[float]:
    """Log odds of one track after each frame with these predictions."""
    last, results = np.array([math.nan]), []
    for probability in probabilities:
        last = posterior(last, np.array([probability]), step_s)
        results.append(float(last[0]))
    return results


def test_log_odds_start_at_those_of_any_road_user() -> None:
    assert log_odds([0.999]) == [PRIOR_LOG_ODDS]


def test_log_odds_follow_the_evidence_within_the_correlation_time() -> None:
    """After the time T, 1 / e of the way from the prior to the evidence is left."""
    n_steps = 100
    last = log_odds([0.5] * (n_steps + 1), CORRELATION_S / n_steps)[-1]
    assert last == pytest.approx(PRIOR_LOG_ODDS / math.e)


def test_steps_do_not_depend_on_the_frame_rate() -> None:
    assert log_odds([0.9] * 11, 0.1)[-1] == pytest.approx(log_odds([0.9] * 41, 0.025)[-1])


def test_certain_evidence_is_believed_sooner() -> None:
    """Times until a contact is as probable as not: 0.3 s and 0.6 s at 10 frames per second."""
    certain, uncertain = log_odds([0.99] * 20), log_odds([0.75] * 20)
    starts = [next(i for i, value in enumerate(part) if value > 0) for part in (certain, uncertain)]
    assert starts == [3, 6]


def test_one_frame_is_never_enough() -> None:
    """A track on another object for one frame, in a harmless drive."""
    values = log_odds([0.001] * 5 + [1.0] + [0.001] * 5)
    assert max(values) < -2.0


def test_unknown_predictions_lead_back_to_the_prior() -> None:
    values = log_odds([0.99] * 20 + [math.nan] * 20)
    assert values[19] > 4.0
    assert values[-1] == pytest.approx(PRIOR_LOG_ODDS, abs=0.05)


def test_new_tracks_are_believed_less() -> None:
    """A tenth at first, and two thirds after the time in which false tracks end."""
    first, later = soundness(np.array([0.0, 0.3]))
    assert first == pytest.approx(0.1)
    assert later == pytest.approx(1 - 0.9 / math.e)


def test_threshold_falls_as_hard_braking_comes_near() -> None:
    """At half of the hard deceleration, the odds are four times those at the hard one."""
    at_half, at_hard, beyond = threshold(0.2, HARD_MPS2 * np.array([0.5, 1.0, 3.0]))
    assert math.exp(at_half) == pytest.approx(4 * 0.25)
    assert math.exp(at_hard) == pytest.approx(0.25)
    assert beyond == at_hard


def test_no_alarm_below_normal_braking() -> None:
    needed = np.array([0.0, 2.4, 2.6, 6.0])
    due = is_due(np.full(4, 9.0), np.full(4, 0.5), needed, 2.5)
    assert due.tolist() == [False, False, True, True]
