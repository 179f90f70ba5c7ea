"""Steps of the bank of filters, by hand: prediction with the ego speed, gate, corrections, states
that come and go."""

from dataclasses import replace

import numpy as np
import pytest

from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.ranging.filtering.cut_boxes import CutBoxes
from track_range.ranging.filtering.filter_bank import FilterBank, FilterSettings
from track_range.ranging.filtering.key_distance import Growth, KeyDistance
from track_range.ranging.filtering.motion_models import InteractingModels
from track_range.ranging.filtering.noise_scale import MeasuredDistances
from track_range.ranging.filtering.observation import EgoStep, FilterStep, Observation
from track_range.ranging.measurement.ranges import Ranges
from track_range.stereo.odometry.ego_motion import EgoMotion

CAR, TRUCK, NAN, UNKNOWN = 2, 5, np.array(np.nan), EgoMotion()
SETTINGS = FilterSettings(learns_noise=False)


def of(value):
    """An array of one method, two models and one track."""
    return np.full((1, 2, 1), float(value))


def new_bank(settings=SETTINGS):
    """A new track in the filters of one method, with a static and a moving model with q = 0.5^2."""
    models = InteractingModels(
        noises=np.full(8, 0.5),
        accelerations_mps2=np.zeros((1, 8)),
        has_static=settings.learns_noise,
    )
    return FilterBank.new(models, settings, 1)


def running(d, v, *, P=(4.0, 0.0, 1.0), settings=SETTINGS):
    """Filters with a distance and a rate at 0 s, measured then; both models are as probable."""
    bank = new_bank(settings)
    one = np.zeros((1, 1, 1))
    return bank._replace(
        motion=ConstantVelocity(of(d), of(v), *(of(part) for part in P)),
        weight=of(0.5),
        history=bank.history._replace(
            systematic=one + 0.01, time_s=one, measured_s=one, steady_since_s=one
        ),
    )


def step_to(time_s, z, bank, *, ego=UNKNOWN, sigma=0.1, **observed):
    """The step of a frame with the distance z, whose noise is `sigma` and all independent."""
    measured = MeasuredDistances.of(
        {"a": Ranges(np.array([7]), np.array([z]), np.array([sigma * z]))},
        {"a": 1.0},
        np.ones((1, 1)),
    )
    dt = np.fmax(time_s - bank.history.time_s, 0.0)
    observation = Observation(**observed)
    return FilterStep(
        time_s=time_s,
        dt=dt,
        measured=measured,
        ego=EgoStep.of(ego, np.array(ego.speed_mps), bank.ego_mps, dt),
        turn_rad_s=0.0,
        across_mps=0.0,
        observation=observation,
        class_id=np.array([CAR]),
        condition=np.full((1, 1, 1), 0.0),
        is_hidden=np.array(False),
        prior=of(0.5),
        slides=bank.slides(observation.cut),
    )


def cut_box(is_cut):
    return CutBoxes(np.array([is_cut]), *np.array([[0.5], [0.01], [4.0], [0.6]]))


def test_prediction_with_an_input():
    """F x + B dV by matrices: the camera brakes from 10 to 8 m/s within 0.5 s."""
    bank = running(40.0, -6.0)._replace(ego_mps=of(10.0))
    predicted = bank.predict(step_to(0.5, 37.0, bank, ego=EgoMotion(8.0, 0.3))).motion
    F, B, dV = np.array([[1, 0.5], [0, 1]]), np.array([-0.25, -1.0]), -2.0
    x = F @ [40.0, -6.0] + B * dV
    Q = 0.25 * np.array([[0.5**3 / 3, 0.5**2 / 2], [0.5**2 / 2, 0.5]])
    variance = 2 * 0.3**2 * (1 - np.exp(-0.5))
    P = F @ np.diag([4.0, 1.0]) @ F.T + Q + variance * np.outer(B, B)
    assert [predicted.x[0, 1, 0], predicted.v[0, 1, 0]] == pytest.approx(x)
    assert [predicted.P_xx[0, 1, 0], predicted.P_xv[0, 1, 0], predicted.P_vv[0, 1, 0]] == (
        pytest.approx(P[np.triu_indices(2)])
    )


def test_systematic_error_drifts_with_the_distance():
    """kappa (k d)^2 |v| dt / d = 0.2 * 0.08^2 * 40 * 6 * 0.5: of 10 %, 8 % drift."""
    drifts = []
    for learns_noise in (True, False):
        bank = running(40.0, -6.0, settings=FilterSettings(learns_noise=learns_noise))
        drifts.append(bank.predict(step_to(0.5, 37.0, bank)).motion.P_xx[0, 1, 0])
    assert drifts[0] - drifts[1] == pytest.approx(0.2 * 0.0064 * 240 * 0.5)


@pytest.mark.parametrize("class_id", [CAR, TRUCK])
def test_systematic_error_drifts_in_turns(class_id):
    """kappa_w (k d)^2 |w| dt = 2 * 0.08^2 * 40^2 * 0.1 * 0.5, to either side."""
    bank = running(40.0, -6.0, settings=FilterSettings())
    step = replace(step_to(0.5, 37.0, bank), class_id=np.array([class_id]))
    straight, turning = (
        bank.predict(replace(step, turn_rad_s=rate)).motion.P_xx[0, 1, 0] for rate in (0.0, 0.1)
    )
    assert turning - straight == pytest.approx(2 * 0.0064 * 1600 * 0.1 * 0.5)
    # a camera that moves across its axis sees another side, too: 4 m/s at 40 m are 0.1 rad/s
    across = bank.predict(replace(step, across_mps=4.0)).motion.P_xx[0, 1, 0]
    assert across == pytest.approx(turning)


@pytest.mark.parametrize(("d", "time_s"), [(40.0, 1.1), (0.7, 0.1)])
def test_filters_expire(d, time_s):
    """After a gap of more than 1 s, and where the object has passed the camera."""
    bank = running(d, -6.0)
    step = step_to(time_s, 40.0, bank)
    bank = bank.predict(step)
    assert np.isnan(bank.motion.x).all()
    gate = bank.gate(step)
    assert gate.starts.all()
    assert not gate.known.any()
    started = bank.restart(step, gate)
    assert started.motion.x == pytest.approx(of(40.0))
    assert started.motion.P_xx == pytest.approx(of(16.0))
    assert started.motion.v == pytest.approx(of(0.0))
    assert started.motion.P_vv == pytest.approx(of(144.0))


def test_gate_and_correction():
    """nu = d log(z / d) with S = P + R; the sigma of a distance at twice the limit is doubled."""
    bank = running(40.0, -6.0)
    step = step_to(0.0, 44.0, bank)
    gate = bank.gate(step)
    assert gate.nu == pytest.approx(of(40 * np.log(1.1)))
    np.testing.assert_allclose(gate.R, of(16.0))
    assert gate.excess.item() == pytest.approx(40 * np.log(1.1) / (3 * np.sqrt(20)))
    corrected = bank.correct_by_distance(gate).motion
    assert corrected.x == pytest.approx(of(40 + 4 / 20 * 40 * np.log(1.1)))
    assert corrected.P_xx == pytest.approx(of(4 - 4 * 4 / 20))
    twice = gate._replace(excess=np.full((1, 1, 1), 2.0))
    assert bank.correct_by_distance(twice).motion.P_xx == pytest.approx(of(4 - 4 * 4 / 68))
    unmeasured = gate._replace(known=np.zeros((1, 1, 1), np.bool_))
    assert bank.correct_by_distance(unmeasured).motion.x == pytest.approx(of(40.0))


def test_third_outlier_is_lost():
    bank = running(40.0, -6.0)
    bank = bank._replace(history=bank.history._replace(n_outliers=np.full((1, 1, 1), 1.0)))
    for n, is_lost in ((2, False), (3, True)):
        step = step_to(0.0, 400.0, bank)
        gate = bank.gate(step)
        assert gate.n_outliers.item() == n
        assert gate.starts.item() == is_lost
        bank = bank.remember(step, gate)
    assert bank.history.n_outliers.item() == 0


def test_step_of_a_condition_adds_both_systematic_variances():
    """10 % before, and 6 % now: 40^2 (0.01 + 0.0036); the key distance steps with it."""
    bank = running(40.0, -6.0)
    bank = bank._replace(key=KeyDistance(of(50.0), of(0.0), of(0.0), of(1.0)))
    step = step_to(0.1, 40.0, bank)
    measured = replace(step.measured, systematic=np.full((1, 1, 1), 0.0036))
    for code, variance in ((0, 0.0), (1, 1600 * 0.0136)):
        changed = replace(step, measured=measured, condition=np.full((1, 1, 1), float(code)))
        after = bank.step_of_condition(changed)
        assert after.motion.P_xx == pytest.approx(of(4.0 + variance))
        assert after.key.P_dr == pytest.approx(of(50 / 40 * variance))
        assert after.history.steady_since_s.item() == (0.1 if code else 0.0)


def test_side_and_key_states_exist_only_while_they_matter():
    bank = new_bank()
    stored = bank.with_rows(bank.rows())
    assert stored.side is not None
    assert stored.key is not None
    growth = Growth(*np.array([[0.1], [0.01]]), np.array([True]))
    for observed, has_side, has_key in (
        ({}, False, False),
        ({"cut": cut_box(False)}, False, False),
        ({"cut": cut_box(True)}, True, False),
        ({"growth": growth}, False, True),
    ):
        needed = stored.with_needed_states(step_to(0.0, 40.0, stored, **observed))
        assert (needed.side is not None) == has_side
        assert (needed.key is not None) == has_key
    was_cut = stored._replace(side=stored.side._replace(P_kk=of(0.04)))
    assert was_cut.with_needed_states(step_to(0.1, 40.0, was_cut)).side is not None
    had_key = stored._replace(key=stored.key._replace(r=of(50.0)))
    assert had_key.with_needed_states(step_to(0.1, 40.0, had_key)).key is not None


def test_rows_keep_the_state():
    bank = running(40.0, -6.0)._replace(
        ego_mps=np.array(9.0), key=KeyDistance(of(50.0), of(1.0), of(2.0), of(3.0))
    )
    again = bank.with_rows(bank.rows())
    for part, kept in zip(bank.motion.columns, again.motion.columns, strict=True):
        assert np.array_equal(part, kept)
    assert again.ego_mps == pytest.approx(of(9.0))
    assert np.array_equal(again.key, bank.key)
    assert not again.side.is_cut.any()
    assert np.array_equal(again.history, bank.history)


def test_an_error_that_is_new_in_each_frame_is_one_of_both_speeds_of_a_change():
    """0.5 m/s: 0.4 m/s are new in each frame, 0.3 m/s last."""
    dt, last_mps = np.full((1, 1, 1), 0.5), np.full((1, 1, 1), 9.0)
    step = EgoStep.of(EgoMotion(8.0, 0.5, noise_mps=0.4), np.array(8.0), last_mps, dt)
    assert step.change_variance == pytest.approx(2 * (0.16 + 0.09 * (1 - np.exp(-0.5))))


@pytest.mark.parametrize(("sigma_mps", "variance"), [(0.3, 0.18 * (1 - np.exp(-0.5))), (NAN, 0.0)])
def test_change_of_the_ego_speed(sigma_mps, variance):
    """A change has a variance only if the speed has one, and none where the speed was unknown."""
    dt, last_mps = np.full((1, 1, 3), 0.5), np.array([[[10.0, 8.0, np.nan]]])
    step = EgoStep.of(EgoMotion(8.0, float(sigma_mps)), np.array(8.0), last_mps, dt)
    assert step.change_mps[0, 0] == pytest.approx([-2.0, 0.0, 0.0])
    expected = np.broadcast_to(step.change_variance, (1, 1, 3))[0, 0]
    assert expected == pytest.approx([variance, 0.0, 0.0])
    assert not EgoStep.of(EgoMotion(), NAN, last_mps, dt).is_known
