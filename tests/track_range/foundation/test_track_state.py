import numpy as np

from track_range.foundation.track_state import TrackState


def test_put_and_get():
    state = TrackState(np.array([0.0, -1.0]))
    state.put(
        np.array([5, 2, 9]),
        np.array([[50.0, 20.0, 90.0], [5.5, 2.5, 9.5]]),
        keep_known=np.zeros(0, bool),
    )
    columns = state.get(np.array([9, 1, 5]))
    assert columns.tolist() == [[90.0, 0.0, 50.0], [9.5, -1.0, 5.5]]
    assert state.known[0].tolist() == [50.0, 20.0, 90.0]
    state.put(np.array([9, 1, 5]), columns + 1, keep_known=np.array([False, True, True]))
    assert state.get(np.array([5, 2, 9, 1, 3]))[0].tolist() == [51.0, 20.0, 91.0, 1.0, 0.0]
    state.put(np.array([7]), np.array([[70.0], [7.5]]), keep_known=np.zeros(4, bool))
    assert state.get(np.array([9, 7]))[0].tolist() == [0.0, 70.0]
    assert state.known.shape == (2, 1)


def test_same_tracks_again():
    state = TrackState(np.zeros(1))
    state.put(np.array([3, 1, 2]), np.array([[30.0, 10.0, 20.0]]), keep_known=np.zeros(0, bool))
    assert state.is_absent(np.array([3, 1])).tolist() == [False, False, True]
    first = state.get(np.array([3, 1]))
    state.put(np.array([3, 1]), first + 1, keep_known=np.ones(3, bool))
    assert first.tolist() == [[30.0, 10.0]]
    assert state.get(np.array([1, 2, 3, 4])).tolist() == [[11.0, 20.0, 31.0, 0.0]]
    state.put(np.array([3, 1]), first, keep_known=np.array([True, True, False]))
    assert state.known.tolist() == [[30.0, 10.0]]


def test_get_returns_a_copy():
    state = TrackState(np.zeros(()))
    state.put(np.array([1]), np.array([10.0]), keep_known=np.zeros(0, bool))
    state.get(np.array([1, 2]))[:] = 99.0
    assert state.get(np.array([1, 2])).tolist() == [10.0, 0.0]


def test_no_tracks():
    state = TrackState(np.zeros((2, 3)))
    no_ids = np.zeros(0, np.int64)
    state.put(no_ids, state.get(no_ids), keep_known=np.zeros(0, bool))
    assert state.known.shape == (2, 3, 0)
    assert state.get(np.array([4])).shape == (2, 3, 1)
