import numpy as np
import pytest

from track_range.detection.detections import Detections


def test_shapes_are_checked():
    with pytest.raises(ValueError, match=r"xyxy_px: expected shape \(2, 4\), got \(3, 4\)"):
        Detections(np.zeros((3, 4)), np.zeros(2), np.zeros(2, np.int64), np.zeros((2, 0), np.float32))


def test_select_takes_rows_in_order():
    detections = Detections.of([[0, 0, 1, 1], [2, 2, 3, 3], [4, 4, 5, 5]], [0.1, 0.2, 0.3], [0, 1, 2])
    chosen = detections.select(np.array([2, 0]))
    assert chosen.score.tolist() == [0.3, 0.1]
    assert chosen.class_id.tolist() == [2, 0]
    assert len(detections.select(np.zeros(3, bool))) == len(Detections.empty()) == 0
