from __future__ import annotations

import numpy as np
import pytest

from track_range.detection.classes import ROAD_CLASSES
from track_range.tracking.offline_refinement import LookaheadSettings, Recording
from track_range.tracking.tracks import Tracks

CAR, TRUCK = ROAD_CLASSES.index("car"), ROAD_CLASSES.index("truck")
NONE = Tracks.empty()
EVERYTHING = LookaheadSettings(min_boxes=1, min_score_share=0.0)


def track(track_id: int, x_px: float, *, score: float = 0.9, class_id: int = CAR, observed: bool = True) -> Tracks:
    box = np.array([[x_px, 10.0, x_px + 40.0, 50.0]])
    return Tracks(np.array([track_id]), box, np.array([class_id]), np.array([score]), np.array([observed]))


def strong(class_id: np.ndarray) -> np.ndarray:
    return np.full(len(class_id), 0.5)


def completed(frames, settings=EVERYTHING, *, times=None):
    recording = Recording()
    for i, (confirmed, tentative) in enumerate(frames):
        recording.add(0.1 * i if times is None else times[i], confirmed, tentative)
    return recording.completed(strong, settings)


def test_a_gap_is_filled_on_the_straight_line_in_real_time() -> None:
    frames = [(track(1, 100), NONE), (NONE, NONE), (NONE, NONE), (track(1, 160, score=0.5), NONE)]
    out = completed(frames, times=[0.0, 0.1, 0.5, 0.6])
    assert [tracks.observed.tolist() for tracks in out] == [[True], [False], [False], [True]]
    assert [tracks.xyxy_px[0, 0] for tracks in out] == pytest.approx([100.0, 110.0, 150.0, 160.0])
    assert [tracks.score[0] for tracks in out] == pytest.approx([0.9, 0.9 - 0.4 / 6, 0.9 - 2.0 / 6, 0.5])


def test_a_longer_gap_stays_open() -> None:
    frames = [(track(1, 100), NONE), *[(NONE, NONE)] * 12, (track(1, 160), NONE)]
    assert sum(len(tracks) for tracks in completed(frames)) == 2
    assert sum(len(tracks) for tracks in completed(frames, LookaheadSettings(max_gap_s=2, min_boxes=1))) == 14


def test_first_boxes_belong_to_a_track_that_was_confirmed_later() -> None:
    frames = [(NONE, track(1, 100)), (NONE, track(1, 105)), (track(1, 110), track(2, 500)), (track(1, 115), NONE)]
    out = completed(frames)
    assert [tracks.track_id.tolist() for tracks in out] == [[1], [1], [1], [1]]  # 2 never was
    np.testing.assert_array_equal(out[0].xyxy_px, [[100.0, 10.0, 140.0, 50.0]])


def test_predictions_of_the_live_stream_give_way() -> None:
    frames = [(track(1, 100), NONE), (track(1, 300, observed=False), NONE), (track(1, 120), NONE)]
    out = completed(frames)
    assert out[1].xyxy_px[0, 0] == 110.0
    frames = [(track(1, 100), NONE), (track(1, 105, observed=False), NONE)]  # and nothing came after
    assert [len(tracks) for tracks in completed(frames)] == [1, 0]


def test_tracks_of_few_or_of_weak_boxes_were_false_alarms() -> None:
    long, short, weak = (
        [(track(i, x, score=s), NONE)] * n for i, x, s, n in ((1, 0, 0.9, 5), (2, 9, 0.9, 2), (3, 9, 0.4, 5))
    )
    out = completed([*long, *short, *weak], LookaheadSettings())
    assert {i for tracks in out for i in tracks.track_id.tolist()} == {1}
    lenient = completed([*long, *short, *weak], LookaheadSettings(min_boxes=2, min_score_share=0.8))
    assert {i for tracks in lenient for i in tracks.track_id.tolist()} == {1, 2, 3}


def test_the_last_label_is_the_tracks() -> None:
    frames = [(track(1, 100, class_id=TRUCK), NONE), (track(1, 100), NONE), (track(1, 100), NONE)]
    assert [tracks.class_id.tolist() for tracks in completed(frames)] == [[CAR]] * 3


def test_tracks_of_a_frame_come_by_id_and_do_not_mix() -> None:
    two = [
        Tracks(
            *(
                np.concatenate(pair)
                for pair in zip(
                    *[
                        (t.track_id, t.xyxy_px, t.class_id, t.score, t.observed)
                        for t in (track(2, 300 + i), track(7, 100 + i))
                    ],
                    strict=True,
                )
            )
        )
        for i in range(4)
    ]
    frames = [(two[0], NONE), (track(7, 101), NONE), (two[2], NONE), (track(2, 303), NONE)]
    out = completed(frames)
    assert [tracks.track_id.tolist() for tracks in out] == [[2, 7], [2, 7], [2, 7], [2]]
    assert [tracks.xyxy_px[0, 0] for tracks in out] == [300.0, 301.0, 302.0, 303.0]


def test_nothing_at_all() -> None:
    assert completed([]) == []
    assert [len(tracks) for tracks in completed([(NONE, NONE)] * 3)] == [0, 0, 0]
    assert [len(tracks) for tracks in completed([(NONE, track(1, 100))])] == [0]
