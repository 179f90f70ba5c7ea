from __future__ import annotations

import numpy as np
import pytest

from track_range.detection.classes import ROAD_CLASSES
from track_range.tracking.offline_refinement import OfflineRefinement, RefinementSettings
from track_range.tracking.tracks import Tracks

CAR, TRUCK = ROAD_CLASSES.index("car"), ROAD_CLASSES.index("truck")
NONE = Tracks.empty()
EVERYTHING = RefinementSettings(min_boxes=1, min_score_fraction=0.0)


def track(
    track_id: int, x_px: float, *, score: float = 0.9, class_id: int = CAR, observed: bool = True
) -> Tracks:
    box = np.array([[x_px, 10.0, x_px + 40.0, 50.0]])
    return Tracks(
        np.array([track_id]), box, np.array([class_id]), np.array([score]), np.array([observed])
    )


def half(class_id: np.ndarray) -> np.ndarray:
    return np.full(len(class_id), 0.5)


def refined(frames, settings=EVERYTHING, *, times=None, threshold=half):
    refinement = OfflineRefinement()
    for i, (confirmed, tentative) in enumerate(frames):
        refinement.add(0.1 * i if times is None else times[i], confirmed, tentative)
    return refinement.refine(threshold, settings)


def test_a_gap_is_interpolated_in_time() -> None:
    frames = [(track(1, 100), NONE), (NONE, NONE), (NONE, NONE), (track(1, 160, score=0.5), NONE)]
    out = refined(frames, times=[0.0, 0.1, 0.5, 0.6])
    assert [tracks.observed.tolist() for tracks in out] == [[True], [False], [False], [True]]
    assert [tracks.xyxy_px[0, 0] for tracks in out] == pytest.approx([100.0, 110.0, 150.0, 160.0])
    assert [tracks.score[0] for tracks in out] == pytest.approx(
        [0.9, 0.9 - 0.4 / 6, 0.9 - 2.0 / 6, 0.5]
    )


def test_max_gap() -> None:
    frames = [(track(1, 100), NONE), *[(NONE, NONE)] * 12, (track(1, 160), NONE)]
    assert sum(len(tracks) for tracks in refined(frames)) == 2
    assert (
        sum(len(tracks) for tracks in refined(frames, RefinementSettings(max_gap_s=2, min_boxes=1)))
        == 14
    )


def test_tentative_boxes_of_a_confirmed_track() -> None:
    frames = [
        (NONE, track(1, 100)),
        (NONE, track(1, 105)),
        (track(1, 110), track(2, 500)),
        (track(1, 115), NONE),
    ]
    out = refined(frames)
    assert [tracks.track_id.tolist() for tracks in out] == [[1], [1], [1], [1]]  # 2 never was
    np.testing.assert_array_equal(out[0].xyxy_px, [[100.0, 10.0, 140.0, 50.0]])


def test_predicted_boxes_are_replaced() -> None:
    frames = [(track(1, 100), NONE), (track(1, 300, observed=False), NONE), (track(1, 120), NONE)]
    out = refined(frames)
    assert out[1].xyxy_px[0, 0] == 110.0
    # and nothing came after
    frames = [(track(1, 100), NONE), (track(1, 105, observed=False), NONE)]
    assert [len(tracks) for tracks in refined(frames)] == [1, 0]


def test_unreliable_tracks_are_dropped() -> None:
    long, short, weak = (
        [(track(i, x, score=s), NONE)] * n
        for i, x, s, n in ((1, 0, 0.9, 5), (2, 9, 0.9, 2), (3, 9, 0.4, 5))
    )
    out = refined([*long, *short, *weak], RefinementSettings())
    assert {i for tracks in out for i in tracks.track_id.tolist()} == {1}
    no_threshold = refined([*long, *short, *weak], RefinementSettings(), threshold=None)
    assert {i for tracks in no_threshold for i in tracks.track_id.tolist()} == {1, 3}
    lenient = refined(
        [*long, *short, *weak], RefinementSettings(min_boxes=2, min_score_fraction=0.8)
    )
    assert {i for tracks in lenient for i in tracks.track_id.tolist()} == {1, 2, 3}


def test_last_label_counts() -> None:
    frames = [(track(1, 100, class_id=TRUCK), NONE), (track(1, 100), NONE), (track(1, 100), NONE)]
    assert [tracks.class_id.tolist() for tracks in refined(frames)] == [[CAR]] * 3


def test_order_within_a_frame() -> None:
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
    out = refined(frames)
    assert [tracks.track_id.tolist() for tracks in out] == [[2, 7], [2, 7], [2, 7], [2]]
    assert [tracks.xyxy_px[0, 0] for tracks in out] == [300.0, 301.0, 302.0, 303.0]


def test_empty_recordings() -> None:
    assert refined([]) == []
    assert [len(tracks) for tracks in refined([(NONE, NONE)] * 3)] == [0, 0, 0]
    assert [len(tracks) for tracks in refined([(NONE, track(1, 100))])] == [0]
