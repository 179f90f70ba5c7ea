"""Steps of the bank of filters, by hand: prediction with the ego speed, gate, corrections, states
that come and go."""

from dataclasses import replace

import numpy as np
import pytest

from track_range.ranging.filtering.cut_boxes import CutBoxes
from track_range.ranging.filtering.filter_bank import FilterBank, FilterSettings
from track_range.ranging.filtering.motion_models import InteractingModels
from track_range.ranging.filtering.noise_scale import MeasuredDistances
from track_range.ranging.filtering.observation import EgoStep, FilterStep, Observation
from track_range.ranging.measurement.growth import Growth
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
    return FilterBank.new(models, settings)


def copy_of(bank):
    """Filters with a state of their own."""
    return bank.of_tracks(bank.rows.copy())


def running(d, v, *, P=(4.0, 0.0, 1.0), settings=SETTINGS):
    """Filters with a distance and a rate at 0 s, measured then; both models are as probable."""
    bank = new_bank(settings)
    states = bank.states
    states.d[...], states.v[...] = d, v
    states.P[0, 0], states.P[0, 1], states.P[1, 0], states.P[1, 1] = P[0], P[1], P[1], P[2]
    bank.weight[...], bank.last.time_s[...] = 0.5, 0.0
    history = bank.history
    history.systematic[...] = 0.01
    history.measured_s[...] = history.steady_since_s[...] = 0.0
    return bank


def step_to(time_s, z, bank, *, ego=UNKNOWN, sigma=0.1, **observed):
    """The step of a frame with the distance z, whose noise is `sigma` and all independent."""
    measured = MeasuredDistances.of(
        {"a": Ranges(np.array([7]), np.array([z]), np.array([sigma * z]))},
        {"a": 1.0},
        np.ones((1, 1)),
    )
    dt = np.fmax(time_s - bank.last.time_s, 0.0)
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


def predicted(bank, step):
    """The filters after the prediction."""
    bank = copy_of(bank)
    bank.predict(step)
    return bank


def corrected(bank, gate):
    """The states after the distances."""
    bank = copy_of(bank)
    bank.correct_by_distance(gate)
    return bank.states


def cut_box(is_cut):
    return CutBoxes(np.array([is_cut]), *np.array([[0.5], [0.01], [4.0], [0.6]]))


def test_prediction_with_an_input():
    """F x + B dV by matrices: the camera brakes from 10 to 8 m/s within 0.5 s."""
    bank = running(40.0, -6.0)
    bank.ego_mps[...] = 10.0
    states = predicted(bank, step_to(0.5, 37.0, bank, ego=EgoMotion(8.0, 0.3))).states
    F, B, dV = np.array([[1, 0.5], [0, 1]]), np.array([-0.25, -1.0]), -2.0
    x = F @ [40.0, -6.0] + B * dV
    Q = 0.25 * np.array([[0.5**3 / 3, 0.5**2 / 2], [0.5**2 / 2, 0.5]])
    variance = 2 * 0.3**2 * (1 - np.exp(-0.5))
    P = F @ np.diag([4.0, 1.0]) @ F.T + Q + variance * np.outer(B, B)
    assert states.x[:2, 0, 1, 0] == pytest.approx(x)
    assert states.P[:2, :2, 0, 1, 0] == pytest.approx(P)


def test_systematic_error_drifts_with_the_distance():
    """kappa (k d)^2 |v| dt / d = 0.2 * 0.08^2 * 40 * 6 * 0.5: of 10 %, 8 % drift."""
    drifts = []
    for learns_noise in (True, False):
        bank = running(40.0, -6.0, settings=FilterSettings(learns_noise=learns_noise))
        drifts.append(predicted(bank, step_to(0.5, 37.0, bank)).states.P_dd[0, 1, 0])
    assert drifts[0] - drifts[1] == pytest.approx(0.2 * 0.0064 * 240 * 0.5)


@pytest.mark.parametrize("class_id", [CAR, TRUCK])
def test_systematic_error_drifts_in_turns(class_id):
    """kappa_w (k d)^2 |w| dt = 2 * 0.08^2 * 40^2 * 0.1 * 0.5, to either side."""
    bank = running(40.0, -6.0, settings=FilterSettings())
    step = replace(step_to(0.5, 37.0, bank), class_id=np.array([class_id]))
    straight, turning = (
        predicted(bank, replace(step, turn_rad_s=rate)).states.P_dd[0, 1, 0] for rate in (0.0, 0.1)
    )
    assert turning - straight == pytest.approx(2 * 0.0064 * 1600 * 0.1 * 0.5)
    # a camera that moves across its axis sees another side, too: 4 m/s at 40 m are 0.1 rad/s
    across = predicted(bank, replace(step, across_mps=4.0)).states.P_dd[0, 1, 0]
    assert across == pytest.approx(turning)


@pytest.mark.parametrize(("d", "time_s"), [(40.0, 1.1), (0.7, 0.1)])
def test_filters_expire(d, time_s):
    """After a gap of more than 1 s, and where the object has passed the camera."""
    bank = running(d, -6.0)
    step = step_to(time_s, 40.0, bank)
    bank.predict(step)
    assert np.isnan(bank.states.d).all()
    gate = bank.gate(step)
    assert gate.starts.all()
    assert not gate.known.any()
    bank.restart(step, gate)
    states = bank.states
    assert states.d == pytest.approx(of(40.0))
    assert states.P_dd == pytest.approx(of(16.0))
    assert states.v == pytest.approx(of(0.0))
    assert states.P[1, 1] == pytest.approx(of(144.0))


def test_gate_and_correction():
    """nu = d log(z / d) with S = P + R; the sigma of a distance at twice the limit is doubled."""
    bank = running(40.0, -6.0)
    step = step_to(0.0, 44.0, bank)
    gate = bank.gate(step)
    assert gate.nu == pytest.approx(of(40 * np.log(1.1)))
    np.testing.assert_allclose(gate.R, of(16.0))
    assert gate.excess.item() == pytest.approx(40 * np.log(1.1) / (3 * np.sqrt(20)))
    states = corrected(bank, gate)
    assert states.d == pytest.approx(of(40 + 4 / 20 * 40 * np.log(1.1)))
    assert states.P_dd == pytest.approx(of(4 - 4 * 4 / 20))
    twice = gate._replace(excess=np.full((1, 1, 1), 2.0))
    assert corrected(bank, twice).P_dd == pytest.approx(of(4 - 4 * 4 / 68))
    unmeasured = gate._replace(known=np.zeros((1, 1, 1), np.bool_))
    assert corrected(bank, unmeasured).d == pytest.approx(of(40.0))


def test_third_outlier_is_lost():
    bank = running(40.0, -6.0)
    bank.history.n_outliers[...] = 1.0
    for n, is_lost in ((2, False), (3, True)):
        step = step_to(0.0, 400.0, bank)
        gate = bank.gate(step)
        assert gate.n_outliers.item() == n
        assert gate.starts.item() == is_lost
        bank.remember(step, gate)
    assert bank.history.n_outliers.item() == 0


def test_step_of_a_condition_adds_both_systematic_variances():
    """10 % before, and 6 % now: 40^2 (0.01 + 0.0036); the key distance steps with it."""
    bank = running(40.0, -6.0)
    bank.states.r[...], bank.states.P[3, 3] = 50.0, 1.0
    step = step_to(0.1, 40.0, bank)
    measured = replace(step.measured, systematic=np.full((1, 1, 1), 0.0036))
    for code, variance in ((0, 0.0), (1, 1600 * 0.0136)):
        changed = replace(step, measured=measured, condition=np.full((1, 1, 1), float(code)))
        after = copy_of(bank)
        after.step_of_condition(changed)
        P = after.states.P
        assert P[0, 0] == pytest.approx(of(4.0 + variance))
        assert P[0, 3] == pytest.approx(of(50 / 40 * variance))
        assert P[3, 0] == pytest.approx(of(50 / 40 * variance))
        assert P[3, 3] == pytest.approx(of(1.0 + (50 / 40) ** 2 * variance))
        assert after.history.steady_since_s.item() == (0.1 if code else 0.0)


def test_a_cut_box_has_a_side_and_no_key_frame():
    bank = running(40.0, -6.0)
    bank.states.r[...] = 50.0
    for is_cut, time_s in ((False, 0.1), (True, 0.2), (False, 0.3)):
        step = step_to(time_s, 40.0, bank, cut=cut_box(is_cut))
        was_cut = bool(bank.last.was_cut.item())
        bank.predict(step)
        assert (bank.side.P_kk > 0).all() == is_cut
        assert np.isnan(bank.states.r).all() == (is_cut or was_cut)
        bank.remember(step, bank.gate(step))
    assert not bank.slides(cut_box(False)).any()


def test_key_frames_and_restarts():
    """A new key frame has the covariances of d; a filter that restarts knows nothing of a and r."""
    bank = running(40.0, -6.0, P=(4.0, 0.5, 1.0))
    bank.states.a[...], bank.states.P[2, 2] = 0.5, 0.3
    growth = Growth(*np.array([[np.nan], [0.01]]), np.array([True]))
    bank.start_key_frames(step_to(0.1, 40.0, bank, growth=growth))
    states = bank.states
    assert states.r == pytest.approx(of(40.0))
    assert states.P[3, :, 0, 0, 0] == pytest.approx([4.0, 0.5, 0.0, 4.0])
    assert states.P[:, 3, 0, 0, 0] == pytest.approx([4.0, 0.5, 0.0, 4.0])
    step = step_to(0.1, 30.0, bank)
    bank.restart(step, bank.gate(step)._replace(starts=np.ones((1, 1, 1), np.bool_)))
    assert states.x[:3, 0, 0, 0] == pytest.approx([30.0, 0.0, 0.0])
    assert np.isnan(states.r).all()
    assert states.P[:, :, 0, 0, 0] == pytest.approx(np.diag([9.0, 144.0, 0.0, 0.0]))


def test_an_error_that_is_new_in_each_frame_is_one_of_both_speeds_of_a_change():
    """0.5 m/s: 0.4 m/s are new in each frame, 0.3 m/s last."""
    dt, last_mps = np.array([0.5]), np.full((1, 1, 1), 9.0)
    step = EgoStep.of(EgoMotion(8.0, 0.5, noise_mps=0.4), np.array(8.0), last_mps, dt)
    assert step.change_variance == pytest.approx(2 * (0.16 + 0.09 * (1 - np.exp(-0.5))))


@pytest.mark.parametrize(("sigma_mps", "variance"), [(0.3, 0.18 * (1 - np.exp(-0.5))), (NAN, 0.0)])
def test_change_of_the_ego_speed(sigma_mps, variance):
    """A change has a variance only if the speed has one, and none where the speed was unknown."""
    dt, last_mps = np.full(3, 0.5), np.array([[[10.0, 8.0, np.nan]]])
    step = EgoStep.of(EgoMotion(8.0, float(sigma_mps)), np.array(8.0), last_mps, dt)
    assert step.change_mps[0, 0] == pytest.approx([-2.0, 0.0, 0.0])
    expected = np.broadcast_to(step.change_variance, (1, 1, 3))[0, 0]
    assert expected == pytest.approx([variance, 0.0, 0.0])
    assert not EgoStep.of(EgoMotion(), NAN, last_mps, dt).is_known
