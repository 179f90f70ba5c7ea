from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from detection.classes import ROAD_CLASSES
from detection.detections import Detections
from tracking.history import FillGates
from tracking.sort import SortTracker, TrackerSettings
from tracking.tracks import Tracks

CAR, TRUCK, PERSON = (ROAD_CLASSES.index(name) for name in ("car", "truck", "person"))
IMAGE = np.zeros((375, 1242, 3), np.uint8)
NO_FILL = TrackerSettings(fill=FillGates(max_missing_s=0.0))


def car_at(x_px: float, *, score: float = 0.9, class_id: int = CAR) -> Detections:
    return Detections.of([[x_px, 100.0, x_px + 60.0, 140.0]], [score], [class_id])


def both(*parts: Detections) -> Detections:
    return Detections.of(
        np.concatenate([p.xyxy_px for p in parts]),
        np.concatenate([p.score for p in parts]),
        np.concatenate([p.class_id for p in parts]),
    )


def drive(tracker: SortTracker, frames: Iterable[Detections], *, start_s: float = 0.0) -> list[Tracks]:
    return [tracker.update(found, start_s + 0.1 * i, IMAGE) for i, found in enumerate(frames)]


def test_first_frame_is_confirmed_at_once_and_ids_count_from_1() -> None:
    tracks = SortTracker().update(both(car_at(100), car_at(500)), 0.0, IMAGE)
    assert tracks.track_id.tolist() == [1, 2]
    assert tracks.observed.all()


def test_ids_belong_to_the_instance() -> None:
    SortTracker().update(car_at(100), 0.0, IMAGE)
    assert SortTracker().update(car_at(100), 0.0, IMAGE).track_id.tolist() == [1]


def test_the_detected_box_is_reported_not_the_filters() -> None:
    frames = [car_at(100), car_at(104), car_at(115), car_at(113)]
    for tracks, found in zip(drive(SortTracker(), frames), frames, strict=True):
        np.testing.assert_array_equal(tracks.xyxy_px, found.xyxy_px)
        assert tracks.track_id.tolist() == [1]
        assert tracks.score.tolist() == [0.9]


def test_later_tracks_are_tentative_first() -> None:
    out = drive(SortTracker(), [Detections.empty(), car_at(100), car_at(102), car_at(104)])
    assert [len(tracks) for tracks in out] == [0, 0, 1, 1]


def test_weak_starts_wait_until_their_scores_add_up() -> None:
    out = drive(SortTracker(), [Detections.empty(), *[car_at(100, score=0.45)] * 5])
    assert [len(tracks) for tracks in out] == [0, 0, 0, 0, 1, 1]  # 4 * 0.45 >= 1.5


def test_a_tentative_track_that_is_not_seen_again_at_once_is_dropped() -> None:
    frames = [Detections.empty(), car_at(100), Detections.empty(), car_at(100), car_at(100)]
    out = drive(SortTracker(), frames)
    assert [len(tracks) for tracks in out] == [0, 0, 0, 0, 1]
    assert out[-1].track_id.tolist() == [2]


def test_a_new_track_is_found_again_though_it_moved_by_more_than_its_width() -> None:
    out = drive(SortTracker(), [Detections.empty(), car_at(100), car_at(170), car_at(240)])
    assert [tracks.track_id.tolist() for tracks in out] == [[], [], [], []]  # widened boxes overlap too little: 0.21
    out = drive(SortTracker(), [Detections.empty(), car_at(100), car_at(150), car_at(200)])
    assert out[-1].track_id.tolist() == [1]


def test_a_weak_box_keeps_a_track_but_does_not_start_one() -> None:
    out = drive(SortTracker(), [both(car_at(100), car_at(500, score=0.3)), *[car_at(100, score=0.2)] * 3])
    assert [tracks.track_id.tolist() for tracks in out] == [[1], [1], [1], [1]]
    assert out[-1].observed.all()
    assert out[-1].score.tolist() == [0.2]


def test_a_weak_box_does_not_wake_a_lost_track() -> None:
    frames = [*[car_at(100)] * 3, Detections.empty(), car_at(100, score=0.3)]
    assert len(drive(SortTracker(NO_FILL), frames)[-1]) == 0


def test_strong_boxes_choose_first() -> None:
    # the weak box lies better on the track, but the strong one is taken
    near, far = car_at(101, score=0.3), car_at(108, score=0.8)
    tracks = drive(SortTracker(), [car_at(100), both(near, far)])[-1]
    np.testing.assert_array_equal(tracks.xyxy_px, far.xyxy_px)


@pytest.mark.parametrize(("n_missing", "track_id"), [(5, 1), (10, 1), (13, 2)])
def test_a_lost_track_is_recovered_until_its_time_is_up(n_missing: int, track_id: int) -> None:
    frames = [*[car_at(100)] * 5, *[Detections.empty()] * n_missing, car_at(100), car_at(100)]
    out = drive(SortTracker(NO_FILL), frames)
    assert [len(tracks) for tracks in out[5 : 5 + n_missing]] == [0] * n_missing
    assert out[-1].track_id.tolist() == [track_id]


def test_a_moving_track_is_recovered_where_it_would_be_by_then() -> None:
    frames = [*[car_at(100 + 20 * i) for i in range(8)], *[Detections.empty()] * 4, car_at(100 + 20 * 12)]
    assert drive(SortTracker(NO_FILL), frames)[-1].track_id.tolist() == [1]


def test_a_gap_of_ten_seconds_ends_all_tracks() -> None:
    tracker = SortTracker()
    drive(tracker, [car_at(100)] * 5)
    assert len(tracker.update(car_at(100), 10.4, IMAGE)) == 0
    assert tracker.update(car_at(100), 10.5, IMAGE).track_id.tolist() == [2]


def test_a_missing_box_is_predicted_from_the_last_steps() -> None:
    out = drive(SortTracker(), [*[car_at(100 + 5 * i) for i in range(6)], Detections.empty(), car_at(135)])
    missing = out[6]
    assert missing.track_id.tolist() == [1]
    assert missing.observed.tolist() == [False]
    np.testing.assert_allclose(missing.xyxy_px, [[130.0, 100.0, 190.0, 140.0]])
    assert missing.score[0] == pytest.approx(0.9 * 0.5**0.5)  # 0.1 s of a half-life of 0.2 s
    assert out[7].observed.tolist() == [True]
    assert out[7].track_id.tolist() == [1]


def test_prediction_ends_after_a_while() -> None:
    out = drive(SortTracker(), [*[car_at(100)] * 6, *[Detections.empty()] * 4])
    assert [len(tracks) for tracks in out[6:]] == [1, 1, 0, 0]  # 0.25 s


def test_a_box_that_leaves_the_image_is_not_predicted() -> None:
    leaving = [*[car_at(1150 + 5 * i) for i in range(6)], Detections.empty()]  # right edge 1240 next, border 1241.5
    assert len(drive(SortTracker(), leaving)[-1]) == 1
    leaving = [*[car_at(1152 + 5 * i) for i in range(6)], Detections.empty()]
    assert len(drive(SortTracker(), leaving)[-1]) == 0


def test_the_label_is_voted_on_and_does_not_flicker() -> None:
    labels = [CAR, CAR, TRUCK, CAR, TRUCK, CAR, CAR]
    out = drive(SortTracker(), [car_at(100, class_id=c) for c in labels])
    assert [tracks.class_id.tolist() for tracks in out] == [[CAR]] * 7
    assert [tracks.track_id.tolist() for tracks in out] == [[1]] * 7


def test_a_first_label_that_was_wrong_is_outvoted() -> None:
    out = drive(SortTracker(), [car_at(100, class_id=TRUCK, score=0.5), *[car_at(100)] * 3])
    assert [tracks.class_id.tolist() for tracks in out] == [[TRUCK], [CAR], [CAR], [CAR]]


def test_a_person_does_not_become_a_car() -> None:
    out = drive(SortTracker(NO_FILL), [car_at(100), car_at(100, class_id=PERSON), car_at(100, class_id=PERSON)])
    assert [tracks.track_id.tolist() for tracks in out] == [[1], [], [2]]


def test_two_cars_that_pass_each_other_keep_their_ids() -> None:
    near = [Detections.of([[600.0 - 30 * i, 100, 760 - 30 * i, 220]], [0.9], [CAR]) for i in range(20)]
    far = [Detections.of([[300.0 + 4 * i, 110, 340 + 4 * i, 140]], [0.9], [CAR]) for i in range(20)]
    out = drive(SortTracker(), [both(a, b) for a, b in zip(near, far, strict=True)])
    for i, tracks in enumerate(out):
        assert tracks.track_id.tolist() == [1, 2]
        np.testing.assert_array_equal(tracks.xyxy_px, both(near[i], far[i]).xyxy_px)


@pytest.mark.parametrize("hz", [10, 30])
def test_the_frame_rate_does_not_matter(hz: int) -> None:
    tracker = SortTracker(NO_FILL)
    ids = set()
    for i in range(4 * hz):
        t = i / hz
        hidden = 1.5 < t < 2.3
        tracks = tracker.update(Detections.empty() if hidden else car_at(50 + 250 * t), t, IMAGE)
        ids |= set(tracks.track_id.tolist())
    assert ids == {1}


@pytest.mark.parametrize("time_s", [0.3, 0.5, float("nan"), float("inf")])
def test_time_must_go_forward(time_s: float) -> None:
    tracker = SortTracker()
    tracker.update(car_at(100), 0.5, IMAGE)
    with pytest.raises(ValueError, match=r"time must go forward: .* s after 0\.5 s"):
        tracker.update(car_at(100), time_s, IMAGE)


def test_unsound_boxes_are_ignored() -> None:
    bad = Detections.of(
        [[np.nan, 0, 10, 10], [5, 5, 5, 9], [9, 0, 3, 9], [0, 0, np.inf, 9], [300, 10, 320, 40]],
        [0.9, 0.9, 0.9, 0.9, np.nan],
        [CAR] * 5,
    )
    assert SortTracker().update(both(bad, car_at(100)), 0.0, None).track_id.tolist() == [1]


def test_frames_without_boxes() -> None:
    assert [len(tracks) for tracks in drive(SortTracker(), [Detections.empty()] * 3)] == [0, 0, 0]


def random_frames(seed: int, *, n_frames: int = 25) -> list[Detections]:
    """Ten boxes that wander, some left out, some false, all scores."""
    rng = np.random.default_rng(seed)
    corner, size = rng.uniform(0, [1100, 250], (10, 2)), rng.uniform(10, 120, (10, 2))
    speed = rng.normal(0, 8, (10, 2))
    frames = []
    for i in range(n_frames):
        at = corner + speed * i + rng.normal(0, 1, (10, 2))
        boxes = np.concatenate([at, at + size], axis=1)
        found = Detections.of(boxes, rng.uniform(0, 1, 10), rng.choice([CAR, TRUCK, PERSON], 10))
        frames.append(found.select(rng.random(10) < 0.8))
    return frames


@given(seed=st.integers(0, 10**6))
@settings(max_examples=15, deadline=None)
def test_what_is_always_true_of_the_tracks(seed: int) -> None:
    frames = random_frames(seed)
    out = drive(SortTracker(), frames)
    for found, tracks in zip(frames, out, strict=True):
        assert (np.diff(tracks.track_id) > 0).all()
        assert (tracks.track_id >= 1).all()
        assert ((tracks.score >= 0) & (tracks.score <= 1)).all()
        known = {tuple(box) for box in found.xyxy_px.tolist()}
        reported = [tuple(box) for box in tracks.xyxy_px[tracks.observed].tolist()]
        assert set(reported) <= known
        assert len(set(reported)) == len(reported)
    assert sum(len(tracks) for tracks in out) > 0


@given(seed=st.integers(0, 10**6))
@settings(max_examples=10, deadline=None)
def test_the_same_input_gives_the_same_output(seed: int) -> None:
    frames = random_frames(seed)
    for a, b in zip(drive(SortTracker(), frames), drive(SortTracker(), frames), strict=True):
        np.testing.assert_array_equal(a.track_id, b.track_id)
        np.testing.assert_array_equal(a.xyxy_px, b.xyxy_px)


@given(seed=st.integers(0, 10**6))
@settings(max_examples=10, deadline=None)
def test_the_order_of_the_boxes_changes_names_only(seed: int) -> None:
    frames = random_frames(seed)
    turned = [found.select(np.arange(len(found))[::-1]) for found in frames]
    for a, b in zip(drive(SortTracker(), frames), drive(SortTracker(), turned), strict=True):
        assert sorted(a.xyxy_px.tolist()) == sorted(b.xyxy_px.tolist())
