import numpy as np
import pytest

from track_range.ranging.fusion.track_biases import TrackBiases, blank_track


def of_two_tracks(m):
    columns = np.repeat(blank_track(m)[:, None], 2, axis=1)
    return columns, TrackBiases.in_columns(columns, m)


def test_a_blank_track_has_unknown_biases_and_has_never_been_seen():
    columns, biases = of_two_tracks(3)
    assert columns.shape == (3 + 9 + 6, 2)
    assert biases.mean.tolist() == [[0.0, 0.0]] * 3
    assert (biases.covariance == np.eye(3)[..., None]).all()
    assert (biases.own_variance == 1.0).all()
    assert np.isnan([biases.log_m, biases.variance, biases.time_s, biases.stereo_s]).all()
    assert (biases.trust == 0).all()
    assert (biases.n_upsets == 0).all()


def test_what_is_written_is_in_the_columns():
    columns, biases = of_two_tracks(2)
    biases.covariance[1, 0, 1] = 0.25
    biases.own_variance[1, 0] = 0.5
    biases.stereo_s[1] = 7.0
    again = TrackBiases.in_columns(columns, 2)
    assert again.covariance[..., 0].tolist() == [[1.0, 0.0], [0.0, 0.5]]
    assert again.covariance[..., 1].tolist() == [[1.0, 0.0], [0.25, 1.0]]
    assert columns[-1].tolist() == pytest.approx([np.nan, 7.0], nan_ok=True)


def test_forgetting_goes_back_to_knowing_nothing():
    _, biases = of_two_tracks(2)
    biases.mean[:] = 1.0
    biases.covariance[:] = np.array([[0.2, 0.1], [0.1, 0.4]])[..., None]
    biases.forget(np.array([0.5, 0.0]))
    assert biases.mean.tolist() == [[0.5, 0.0], [0.5, 0.0]]
    assert biases.covariance[..., 0] == pytest.approx(np.array([[0.8, 0.025], [0.025, 0.85]]))
    assert biases.covariance[..., 1].tolist() == [[1.0, 0.0], [0.0, 1.0]]
