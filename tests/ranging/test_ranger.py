"""Rangers that are asked by several others."""

import numpy as np

from track_range.ranging.ranger import OncePerFrame
from track_range.ranging.ranges import Ranges
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

IMAGE = np.zeros((80, 100, 3), np.uint8)


class Counting:
    """Says how often it was asked."""

    def __init__(self):
        self.n_asked = 0

    def measure(self, tracks, frame):
        self.n_asked += 1
        return Ranges(tracks.track_id, np.full(len(tracks), float(self.n_asked)), np.ones(len(tracks)))


def one_track():
    return Tracks(np.array([1]), np.array([[9.0, 9.0, 29.0, 29.0]]), np.array([2]), np.ones(1), np.ones(1, np.bool_))


def test_the_same_tracks_of_the_same_frame_are_measured_once_and_others_anew():
    ranger, tracks = OncePerFrame(Counting()), one_track()
    frames = [Frame(index, 0.1 * index, IMAGE, None) for index in (0, 1)]
    assert ranger.measure(tracks, frames[0]).distance_m == [1.0]
    assert ranger.measure(tracks, frames[0]).distance_m == [1.0]
    assert ranger.measure(tracks, frames[1]).distance_m == [2.0]  # tracks that stand still are measured again
    assert ranger.measure(one_track(), frames[1]).distance_m == [3.0]
