from dataclasses import dataclass

import numpy as np

from detection.detections import FloatArray
from ranging.remembered import TrackRows


@dataclass(slots=True)
class Rows(TrackRows):
    value: FloatArray


def test_known_tracks_are_recalled_in_the_new_order_and_absent_ones_kept_while_recent():
    known = Rows(np.array([5, 2, 9]), np.array([50.0, 20.0, 90.0]))
    now = Rows(np.array([9, 1, 5]), np.zeros(3)).recalling(known)
    assert now.value.tolist() == [90.0, 0.0, 50.0]
    assert known.value.tolist() == [50.0, 20.0, 90.0]
    kept = now.with_absent(known, is_recent=np.array([False, True, True]))
    assert kept.track_id.tolist() == [9, 1, 5, 2]
    assert kept.value.tolist() == [90.0, 0.0, 50.0, 20.0]
    assert now.with_absent(known, is_recent=np.zeros(3, bool)).track_id.tolist() == [9, 1, 5]
