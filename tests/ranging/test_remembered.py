import numpy as np

from track_range.ranging.remembered import TrackMemory


def test_known_tracks_are_recalled_in_the_new_order_and_absent_ones_kept_while_recent():
    memory = TrackMemory(np.array([0.0, -1.0]))
    memory.remember(np.array([5, 2, 9]), np.array([[50.0, 20.0, 90.0], [5.5, 2.5, 9.5]]), is_recent=np.zeros(0, bool))
    found = memory.recall(np.array([9, 1, 5]))
    assert found.tolist() == [[90.0, 0.0, 50.0], [9.5, -1.0, 5.5]]
    assert memory.known[0].tolist() == [50.0, 20.0, 90.0]
    memory.remember(np.array([9, 1, 5]), found + 1, is_recent=np.array([False, True, True]))
    assert memory.recall(np.array([5, 2, 9, 1, 3]))[0].tolist() == [51.0, 20.0, 91.0, 1.0, 0.0]
    memory.remember(np.array([7]), np.array([[70.0], [7.5]]), is_recent=np.zeros(4, bool))
    assert memory.recall(np.array([9, 7]))[0].tolist() == [0.0, 70.0]
    assert memory.known.shape == (2, 1)


def test_what_is_recalled_is_a_copy_that_may_be_written_to():
    memory = TrackMemory(np.zeros(()))
    memory.remember(np.array([1]), np.array([10.0]), is_recent=np.zeros(0, bool))
    memory.recall(np.array([1, 2]))[:] = 99.0
    assert memory.recall(np.array([1, 2])).tolist() == [10.0, 0.0]


def test_nobody_is_a_frame_too():
    memory = TrackMemory(np.zeros((2, 3)))
    nobody = np.zeros(0, np.int64)
    memory.remember(nobody, memory.recall(nobody), is_recent=np.zeros(0, bool))
    assert memory.known.shape == (2, 3, 0)
    assert memory.recall(np.array([4])).shape == (2, 3, 1)
