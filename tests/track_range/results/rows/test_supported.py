"""Supported values: what frames have to agree on."""

import numpy as np
import pytest

from track_range.results.rows.rows import Rows
from track_range.results.rows.supported import supported_values

NAN = np.nan
STEP_S = 0.1


def supported(name, **columns):
    """Supported values of one track in successive frames."""
    n = len(next(iter(columns.values())))
    usual = {
        "time_s": STEP_S * np.arange(n),
        "track_id": np.ones(n),
        "observed": np.ones(n),
        "distance_m": np.full(n, 20.0),
        "sigma_m": np.full(n, 1.0),
    }
    rows = Rows({**usual, **{key: np.array(values, float) for key, values in columns.items()}})
    return supported_values(rows, rows["distance_m"], rows["sigma_m"])[name]


@pytest.mark.parametrize("frame_s", [0.02, 1 / 30, 0.1, 0.5])
def test_a_time_to_collision_that_falls_steadily_is_supported_without_delay(frame_s: float) -> None:
    times_s = frame_s * np.arange(20)
    ttc_s = supported("ttc_front_s", time_s=times_s, ttc_front_s=12.0 - times_s)
    n_before = max(round(0.2 / frame_s), 2)
    assert np.isnan(ttc_s[:n_before]).all()
    np.testing.assert_allclose(ttc_s[n_before:], 12.0 - times_s[n_before:])


@pytest.mark.parametrize("n_frames", [1, 2])
def test_one_or_two_frames_support_nothing(n_frames: int) -> None:
    ttc_s = [NAN] * 5 + [0.9] * n_frames + [NAN] * 5
    assert np.isnan(supported("ttc_front_s", ttc_front_s=ttc_s)).all()


def test_a_single_short_time_is_not_the_minimum() -> None:
    ttc_s = [5.0, 4.9, 4.8, 1.0, 4.6, 4.5]
    assert np.nanmin(supported("ttc_front_s", ttc_front_s=ttc_s)) == pytest.approx(4.5)


@pytest.mark.parametrize("changes", [{"observed": 0}, {"is_cut": 1}])
def test_predicted_and_cut_boxes_do_not_count(changes: dict[str, int]) -> None:
    """Nor do they interrupt what the others agree on."""
    ttc_s = np.array([3.0, 2.9, 2.8, 0.1, 0.1, 0.1, 2.4])
    flags = {name: [1 - value] * 3 + [value] * 3 + [1 - value] for name, value in changes.items()}
    found = supported("ttc_front_s", ttc_front_s=ttc_s, **flags)
    assert np.isnan(found[3:6]).all()
    assert np.nanmin(found) == pytest.approx(2.4)


def test_after_an_interruption_frames_have_to_agree_again() -> None:
    times_s = [0.0, 0.1, 0.2, 1.3, 1.4, 1.5]
    found = supported("ttc_front_s", time_s=times_s, ttc_front_s=[9.0] * 6)
    assert np.isfinite(found).tolist() == [False, False, True, False, False, True]


@pytest.mark.parametrize(
    ("name", "sigma"), [("distance_m", "sigma_m"), ("closing_mps", "closing_sigma_mps")]
)
def test_uncertain_values_are_unknown(name: str, sigma: str) -> None:
    def found(relative: float) -> float:
        values = {name: [8.0] * 3, sigma: [8.0 * relative] * 3}
        return float(supported(name, **values)[-1])

    assert (found(0.5), found(NAN)) == (8.0, 8.0)
    assert np.isnan(found(0.51))


def test_uncertain_times_to_collision_are_unknown() -> None:
    """By the time to the camera, of which the sigma is: that to the front is shorter."""
    values = {"ttc_front_s": [3.0, 2.9, 2.8], "ttc_s": [4.0, 3.9, 3.8]}
    found = supported("ttc_front_s", ttc_sigma_s=[1.9] * 3, **values)
    assert found[-1] == pytest.approx(2.8)
    assert np.isnan(supported("ttc_front_s", ttc_sigma_s=[2.1] * 3, **values)[-1])


def test_distances_and_decelerations_are_carried_by_the_closing_speed() -> None:
    """A steady approach at 10 m/s has the values of its own frame; one frame does not shorten
    them."""
    gap_m = 20.0 - 10.0 * STEP_S * np.arange(6)
    columns = {
        "distance_m": gap_m + 1.5,
        "gap_m": gap_m,
        "headway_s": gap_m / 15.0,
        "closing_mps": np.full(6, 10.0),
        "closing_sigma_mps": np.full(6, 1.0),
        "drac_mps2": 100.0 / (2 * gap_m),
    }
    for name in ("distance_m", "gap_m", "headway_s", "drac_mps2"):
        np.testing.assert_allclose(supported(name, **columns)[2:], columns[name][2:], err_msg=name)
    columns["drac_mps2"] = np.array([2.5, 2.6, 2.7, 14.0, 2.9, 3.0])
    assert np.nanmax(supported("drac_mps2", **columns)) < 4.0
    columns["closing_mps"] = np.array([10.0, 10.0, 10.0, 60.0, 10.0, 10.0])
    assert np.nanmax(supported("closing_mps", **columns)) == 10.0


def test_tracks_in_any_order_do_not_count_for_one_another() -> None:
    order = np.random.default_rng(0).permutation(6)
    times_s, ttc_s = np.tile([0.0, 0.1, 0.2], 2), np.array([4.0, 3.9, 3.8, 9.0, NAN, 8.8])
    track_id = np.repeat([1.0, 2.0], 3)
    found = supported(
        "ttc_front_s", time_s=times_s[order], track_id=track_id[order], ttc_front_s=ttc_s[order]
    )
    assert np.isfinite(found).sum() == 1
    assert found[order == 2] == pytest.approx(3.8)


def test_no_rows() -> None:
    assert len(supported("gap_m", gap_m=[])) == 0
