"""Frame numbers that are off by one: found in moving boxes, and not in noise, lag or few boxes."""

import numpy as np
import pytest

from track_range.tracking.evaluation.frame_shift import frame_shift, frame_shift_note


def moving(n_frames=60, n_tracks=3, speed_px=3.0):
    frame = np.repeat(np.arange(n_frames), n_tracks)
    left = 100.0 * np.tile(np.arange(n_tracks), n_frames) + speed_px * frame
    return frame, np.stack([left, 0 * left + 20, left + 40, 0 * left + 60], axis=1)


@pytest.mark.parametrize("shift", [-1, 0, 1])
def test_shift_of_moving_boxes(shift):
    frame, boxes = moving()
    assert frame_shift(frame, boxes, frame - shift, boxes) == shift


def test_words_of_the_note():
    frame, boxes = moving()
    assert frame_shift_note("a", frame, boxes, frame, boxes) == ()
    assert "increased by 1" in frame_shift_note("a", frame, boxes, frame - 1, boxes)[0]
    assert "decreased by 1" in frame_shift_note("a", frame, boxes, frame + 1, boxes)[0]


def test_noise_and_lag_are_no_shift():
    frame, boxes = moving()
    noisy = boxes + np.random.default_rng(0).normal(0, 2, boxes.shape)
    assert frame_shift(frame, boxes, frame, noisy) == 0
    assert frame_shift(frame, boxes, frame, boxes - np.array([1.4, 0, 1.4, 0])) == 0, (
        "boxes late by less than half a frame"
    )
    assert frame_shift(frame, boxes, frame - 1, boxes + np.array([0, 12, 0, 12])) == 0, (
        "boxes of another detector"
    )


def test_static_or_few_boxes_are_no_shift():
    frame, boxes = moving(speed_px=0.0)
    assert frame_shift(frame, boxes, frame + 1, boxes) == 0
    frame, boxes = moving(n_frames=4)
    assert frame_shift(frame, boxes, frame + 1, boxes) == 0
    assert frame_shift(frame[:0], boxes[:0], frame, boxes) == 0
