"""Given speeds that are right, late, scaled or at rest, beside the speed that images show."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from track_range.stereo.odometry.ego_motion import EgoMotion
from track_range.stereo.speed.ego_speed import EgoSpeed
from track_range.stereo.speed.given_speed import GivenSpeed, p_mistake
from track_range.stereo.speed.speed_relation import LAGS_S, SpeedRelation

FPS, SECONDS = 10.0, 20.0
TIMES_S = np.arange(0, SECONDS, 1 / FPS)
FLAT = np.ones(len(LAGS_S))
Speed = Callable[[float], float]


def driven(time_s: float) -> float:
    """A town drive between 6 and 14 m/s, with up to 2.5 m/s^2."""
    return 10.0 + 4.0 * math.sin(2 * math.pi * time_s / 10.0)


def by_images(time_s: float, rng: np.random.Generator) -> EgoMotion:
    return EgoMotion(driven(time_s) + 0.05 * rng.normal(), 0.07)


def relation(given: Speed, seconds: float = SECONDS, measured: Speed = driven) -> SpeedRelation:
    rng, samples = np.random.default_rng(1), SpeedRelation()
    for time_s in np.arange(0, seconds, 1 / FPS):
        by_receiver = EgoMotion(given(time_s) + 0.1 * rng.normal(), 0.2)
        samples.add(time_s, by_receiver, EgoMotion(measured(time_s) + 0.05 * rng.normal(), 0.07))
    return samples


def weighed(
    given: Speed, *, has_table: bool = True, scale_sigma: float = 0.025
) -> tuple[GivenSpeed, list[EgoMotion]]:
    """The speeds of all frames, with the given one as a table or frame by frame."""
    rng, both = np.random.default_rng(2), GivenSpeed()
    table = EgoSpeed(TIMES_S, np.array([given(t) for t in TIMES_S]), "a file")
    motions = [
        both.update(
            t,
            EgoMotion(given(t), 0.2),
            by_images(t, rng),
            (0.0, scale_sigma),
            table=table if has_table else None,
        )
        for t in TIMES_S.tolist()
    ]
    return both, motions


def errors(motions: list[EgoMotion], since_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Errors and standard deviations of the speeds since a time."""
    used = since_s <= TIMES_S
    error = np.array([m.speed_mps for m in motions]) - [driven(t) for t in TIMES_S]
    return error[used], np.array([m.speed_sigma_mps for m in motions])[used]


# -- ratio and delay


@pytest.mark.parametrize("late_s", [-0.5, 0.0, 1.0, 2.0])
@pytest.mark.parametrize("factor", [1.0, 1.15, 0.6])
def test_ratio_and_delay_of_a_drive_that_changes_its_speed(late_s: float, factor: float) -> None:
    fit = relation(lambda t: factor * driven(t - late_s)).fit()
    assert fit is not None
    mean, covariance = fit.moments(fit.weights(FLAT))
    sigmas = np.sqrt(np.diag(covariance))
    assert abs(mean[0] - math.log(factor)) < 3 * sigmas[0] + 0.005
    assert abs(mean[1] - late_s) < 3 * sigmas[1]
    assert 0.03 < sigmas[1] < 0.2
    assert 0.001 < sigmas[0] < 0.03


def test_constant_speed_shows_its_ratio_and_no_delay():
    fit = relation(lambda t: 11.0, measured=lambda t: 10.0).fit()
    assert fit is not None
    mean, covariance = fit.moments(fit.weights(FLAT))
    assert mean[0] == pytest.approx(math.log(1.1), abs=0.01)
    assert math.sqrt(covariance[1, 1]) > 0.5 * np.std(LAGS_S)


def test_short_drive_and_speeds_near_rest_show_nothing():
    assert relation(driven, seconds=0.7).fit() is None
    assert relation(lambda t: 0.0).fit() is None
    assert relation(driven, measured=lambda t: math.nan).fit() is None


def test_single_failures_hardly_change_the_ratio():
    fit = relation(lambda t: 30.0 if 4 < t < 5 else driven(t)).fit()
    assert fit is not None
    mean, _ = fit.moments(fit.weights(FLAT))
    assert mean[0] == pytest.approx(0.0, abs=0.03)
    assert mean[1] == pytest.approx(0.0, abs=0.2)


# -- the speed of a moment


def test_right_speed_is_kept_and_made_more_precise():
    _, motions = weighed(driven)
    error, sigma = errors(motions, 5.0)
    assert (np.abs(error) < 0.15).all()
    assert (sigma < 0.2).all()
    assert (sigma > 0.05).all()


@pytest.mark.parametrize("late_s", [1.0, 2.0])
def test_late_table_is_read_at_its_delay(late_s: float) -> None:
    both, motions = weighed(lambda t: driven(t - late_s))
    error, sigma = errors(motions, 8.0)
    assert (np.abs(error) < 2 * sigma).mean() > 0.9
    assert np.median(np.abs(error)) < 0.2
    lag_s, sigma_s = both.lag_s
    assert abs(lag_s - late_s) < 3 * sigma_s
    assert both.notes[0].startswith(f"The given speed is {lag_s:.1f} ± {sigma_s:.1f} s late")
    assert weighed(driven)[0].notes == ()


def test_late_speed_that_is_known_frame_by_frame_is_corrected_by_the_images():
    _, motions = weighed(lambda t: driven(t - 1.0), has_table=False)
    error, sigma = errors(motions, 2.0)
    assert (np.abs(error) < 2 * sigma).mean() > 0.9
    late = np.array([driven(t - 1.0) - driven(t) for t in TIMES_S[20:]])
    assert np.sqrt((error**2).mean()) < 0.4 * np.sqrt((late**2).mean())


def test_speed_of_zeros_is_replaced_and_named():
    both, motions = weighed(lambda t: 0.0)
    error, sigma = errors(motions, 2.0)
    assert (np.abs(error) < 2 * sigma).mean() > 0.9
    (note,) = both.notes
    assert "below 1 m/s during 19.9 of the 19.9 s" in note


def test_loss_of_a_receiver_is_bridged():
    both, motions = weighed(lambda t: 0.0 if 10 < t < 13 else driven(t))
    error, sigma = errors(motions, 5.0)
    assert (np.abs(error) < 3 * sigma).mean() > 0.9
    assert "below 1 m/s during 2.9 of" in both.notes[0]


def test_scale_that_contradicts_the_images_widens_the_speed_only():
    _, motions = weighed(lambda t: 1.3 * driven(t))
    error, sigma = errors(motions, 5.0)
    true_mps = np.array([driven(t) for t in TIMES_S[50:]])
    assert error == pytest.approx(0.3 * true_mps, abs=0.3)  # as given
    assert (np.abs(error) < 2 * sigma).all()
    assert (sigma < 0.5 * true_mps).all()


def test_unknown_scale_of_the_images_does_not_widen_the_speed():
    _, motions = weighed(lambda t: 1.3 * driven(t), scale_sigma=1.0)
    _, sigma = errors(motions, 5.0)
    assert (sigma < 0.25).all()


def test_probability_of_a_mistake_by_hand():
    # densities 0.9 N(0; 0, 1) and 0.1 N(0; 0, 10): 0.9 / 1 and 0.1 / sqrt(10)
    odds = 0.1 / math.sqrt(10) / 0.9
    assert p_mistake(0.0, 1.0, 3.0) == pytest.approx(odds / (1 + odds))
    assert p_mistake(10.0, 1.0, 3.0) > 0.999
    assert p_mistake(0.0, 0.0, 3.0) < 1e-6


def test_rest_that_no_car_reaches_is_not_given():
    """20 m/s, and zero for ten seconds in a tunnel; a stop by 5 m/s^2 stays."""
    time_s = np.arange(0.0, 40.0)
    stop_mps = np.interp(time_s, [0, 30, 34, 40], [20, 20, 0, 0])
    tunnel = (time_s >= 15) & (time_s < 25)
    table = EgoSpeed(
        time_s,
        np.where(tunnel, 0.0, stop_mps),
        "a file",
        positions_deg=np.stack([time_s, time_s], axis=1),
    )
    kept, lost_s = table.without_lost_fixes()
    assert lost_s.tolist() == time_s[tunnel].tolist()
    assert math.isnan(kept.at(20.0))
    assert (kept.at(14.0), kept.at(26.0), kept.at(39.0)) == (20.0, 20.0, 0.0)
    assert kept.positions_deg is not None
    assert kept.positions_deg[:, 0].tolist() == kept.time_s.tolist()
    parked = EgoSpeed(time_s, np.zeros(40), "a file")
    assert parked.without_lost_fixes()[0] is parked
    spike = EgoSpeed(time_s, np.where(time_s == 5, 40.0, 20.0), "a file")  # which one is wrong?
    assert spike.without_lost_fixes()[0] is spike


def test_gap_of_the_given_speed_is_filled_by_the_images_in_its_scale():
    """The images show 10 % less: the ratio is known before the gap."""
    both, rng = GivenSpeed(), np.random.default_rng(3)
    for k in range(100):
        shown = by_images(0.1 * k, rng)
        given = EgoMotion(1.1 * driven(0.1 * k), 0.2)
        both.update(0.1 * k, given, shown, (0.0, 0.3))
    motion = both.update(10.0, EgoMotion(), EgoMotion(10.0, 0.1), (0.0, 0.3))
    assert motion.speed_mps == pytest.approx(11.0, rel=0.02)
    assert 0.1 < motion.speed_sigma_mps < 0.6
    assert math.isnan(GivenSpeed().update(0.0, EgoMotion(), EgoMotion(10.0), (0.0, 0.3)).speed_mps)


def test_speeds_near_times_are_those_beside_a_gap():
    speed = EgoSpeed(np.array([0.0, 1.0, 16.0]), np.array([5.0, 6.0, 20.0]), "log")
    near_mps = speed.near(np.array([-1.0, 0.5, 5.0, 12.0, 20.0]))
    assert near_mps.tolist() == [5.0, 5.5, 6.0, 20.0, 20.0]
