from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.foundation.arrays import Image
from track_range.tracking.appearance.embeddings import ColourLayout
from track_range.tracking.association import Classes
from track_range.tracking.confidence_threshold import ConfidenceThresholdSettings
from track_range.tracking.deepsort import AppearanceSettings, DeepSortSettings, DeepSortTracker
from track_range.tracking.history import PredictionGates
from track_range.tracking.registry import create_tracker
from track_range.tracking.tracks import Tracks

CAR, TRUCK, PERSON, BICYCLE, SIGN = (
    ROAD_CLASSES.index(name) for name in ("car", "truck", "person", "bicycle", "traffic sign")
)
IMAGE = np.zeros((375, 1242, 3), np.uint8)
SEEDS = range(15)  # of random frames
NO_PREDICTION = DeepSortSettings(prediction=PredictionGates(max_missing_s=0.0))
EARLY_PREDICTION = DeepSortSettings(prediction=PredictionGates(min_hit_streak_visible=5))


def car_at(x_px: float, *, score: float = 0.9, class_id: int = CAR) -> Detections:
    return Detections.of([[x_px, 100.0, x_px + 60.0, 140.0]], [score], [class_id])


def both(*parts: Detections) -> Detections:
    return Detections.of(
        np.concatenate([p.xyxy_px for p in parts]),
        np.concatenate([p.score for p in parts]),
        np.concatenate([p.class_id for p in parts]),
    )


def drive(
    tracker: DeepSortTracker, frames: Iterable[Detections], *, start_s: float = 0.0
) -> list[Tracks]:
    return [
        tracker.update(detections, start_s + 0.1 * i, IMAGE) for i, detections in enumerate(frames)
    ]


def test_first_frame_is_confirmed_with_ids_from_1() -> None:
    tracks = DeepSortTracker().update(both(car_at(100), car_at(500)), 0.0, IMAGE)
    assert tracks.track_id.tolist() == [1, 2]
    assert tracks.observed.all()


def test_ids_belong_to_the_instance() -> None:
    DeepSortTracker().update(car_at(100), 0.0, IMAGE)
    assert DeepSortTracker().update(car_at(100), 0.0, IMAGE).track_id.tolist() == [1]


def test_output_is_the_detected_box() -> None:
    frames = [car_at(100), car_at(104), car_at(115), car_at(113)]
    for tracks, detections in zip(drive(DeepSortTracker(), frames), frames, strict=True):
        np.testing.assert_array_equal(tracks.xyxy_px, detections.xyxy_px)
        assert tracks.track_id.tolist() == [1]
        assert tracks.score.tolist() == [0.9]


def test_smoothed_boxes_lie_between_detection_and_filter() -> None:
    frames = [car_at(100), car_at(104), car_at(115), car_at(113)]
    tracker = DeepSortTracker(DeepSortSettings(is_smoothed=True))
    *_, before, last = drive(tracker, frames)
    assert before.xyxy_px[0, 0] < 115.0  # the filter lags behind the jump ...
    assert 113.0 < last.xyxy_px[0, 0] < 115.0  # ... and expects more of it
    np.testing.assert_allclose(last.xyxy_px[:, 2:] - last.xyxy_px[:, :2], [[60.0, 40.0]])
    assert tracker.tentative.xyxy_px.shape == (0, 4)


def test_later_tracks_are_tentative_first() -> None:
    out = drive(DeepSortTracker(), [Detections.empty(), car_at(100), car_at(102), car_at(104)])
    assert [len(tracks) for tracks in out] == [0, 0, 1, 1]


def test_low_scores_delay_confirmation() -> None:
    out = drive(DeepSortTracker(), [Detections.empty(), *[car_at(100, score=0.45)] * 5])
    assert [len(tracks) for tracks in out] == [0, 0, 0, 0, 1, 1]  # 4 * 0.45 >= 1.5


def test_missed_tentative_track_is_deleted() -> None:
    other = car_at(900)
    frames = [
        other,
        both(other, car_at(100)),
        other,
        both(other, car_at(100)),
        both(other, car_at(100)),
    ]
    out = drive(DeepSortTracker(), frames)
    assert [tracks.track_id.tolist() for tracks in out] == [[1], [1], [1], [1], [1, 3]]


@pytest.mark.parametrize("step", [2, 3])
def test_skipped_frames_are_not_misses(step: int) -> None:
    cars = both(*(car_at(200 * k, score=0.95) for k in range(3)))
    out = drive(
        DeepSortTracker(NO_PREDICTION),
        [cars if i % step == 1 else Detections.empty() for i in range(30)],
    )
    assert [tracks.track_id.tolist() for tracks in out[1 + step :: step]] == [[1, 2, 3]] * len(
        out[1 + step :: step]
    )


def far_car_every(n: int, *, n_frames: int, score: float = 0.6) -> list[Detections]:
    """A near car in every frame, and from the second frame on a far one in every n-th, the only
    frames that can show it."""
    near, far = car_at(100), car_at(500, score=score)
    return [
        both(near, far) if k % n == 1 else replace(near, is_complete=False) for k in range(n_frames)
    ]


def test_objects_that_only_some_frames_can_show_are_tracked() -> None:
    # after three detections, with a sum of scores of at least 1.5
    *before, confirmed = drive(DeepSortTracker(), far_car_every(3, n_frames=8))
    assert [tracks.track_id.tolist() for tracks in before] == [[1]] * 7
    assert confirmed.track_id.tolist() == [1, 2]
    # without the mark, the frames between are misses
    frames = [replace(boxes, is_complete=True) for boxes in far_car_every(3, n_frames=30)]
    assert all(tracks.track_id.tolist() == [1] for tracks in drive(DeepSortTracker(), frames))


@pytest.mark.parametrize(("is_sought", "n_tracks"), [(False, 2), (True, 1)])
def test_tentative_tracks_end_with_the_next_frame_that_could_show_them(
    is_sought: bool, n_tracks: int
) -> None:
    frames = far_car_every(3, n_frames=8, score=0.9)
    frames[4] = replace(car_at(100), is_complete=is_sought)
    assert len(drive(DeepSortTracker(), frames)[-1]) == n_tracks


def test_boxes_between_two_frames_that_can_show_them_are_predicted() -> None:
    tracks = drive(DeepSortTracker(), far_car_every(3, n_frames=18))
    assert [t.observed.tolist() for t in tracks[-5:]] == [
        [True, True],
        [True, False],
        [True, False],
        [True, True],
        [True, False],
    ]


def test_threshold_without_overlap_between_frames() -> None:
    tracker = DeepSortTracker()
    for i in range(40):
        tracker.update(
            both(*(car_at(200 * k + 70 * (i % 3), score=0.8) for k in range(3))), 0.5 * i, None
        )
    assert tracker.track_activation_threshold(np.array([CAR]))[0] == pytest.approx(0.4)


def test_fast_tracks_persist() -> None:
    """People beside the road move by 0.8 of their width per frame, which does not make their scores
    unreliable."""
    tracker = DeepSortTracker()
    for i in range(40):
        x, y = np.repeat([16.0 * i, 500.0], [3, 5]), 100.0 * np.arange(8)
        boxes = np.stack([x, y, x + 20, y + 50], axis=1)
        tracker.update(Detections.of(boxes, [0.95] * 3 + [0.75] * 5, [PERSON] * 8), 0.1 * i, None)
    assert tracker.track_activation_threshold(np.array([PERSON]))[0] == pytest.approx(0.4, abs=0.05)


def test_tentative_track_matches_widened_box() -> None:
    out = drive(DeepSortTracker(), [Detections.empty(), car_at(100), car_at(170), car_at(240)])
    # widened boxes overlap too little: 0.21
    assert [tracks.track_id.tolist() for tracks in out] == [[], [], [], []]
    out = drive(DeepSortTracker(), [Detections.empty(), car_at(100), car_at(150), car_at(200)])
    assert out[-1].track_id.tolist() == [1]


def test_low_confidence_continues_but_does_not_start() -> None:
    out = drive(
        DeepSortTracker(),
        [both(car_at(100), car_at(500, score=0.3)), *[car_at(100, score=0.2)] * 3],
    )
    assert [tracks.track_id.tolist() for tracks in out] == [[1], [1], [1], [1]]
    assert out[-1].observed.all()
    assert out[-1].score.tolist() == [0.2]


@pytest.mark.parametrize(("x_px", "track_id"), [(110, [1]), (125, [])])
def test_low_confidence_recovers_only_with_high_iou(x_px: float, track_id: list[int]) -> None:
    frames = [*[car_at(100)] * 3, Detections.empty(), car_at(x_px, score=0.3)]  # IoU 0.71 and 0.41
    assert drive(DeepSortTracker(NO_PREDICTION), frames)[-1].track_id.tolist() == track_id


def test_high_confidence_is_matched_first() -> None:
    # The low-confidence box overlaps the track more, but the high-confidence one is matched.
    near, far = car_at(101, score=0.3), car_at(108, score=0.8)
    tracks = drive(DeepSortTracker(), [car_at(100), both(near, far)])[-1]
    np.testing.assert_array_equal(tracks.xyxy_px, far.xyxy_px)


@pytest.mark.parametrize(("n_missing", "track_id"), [(5, 1), (13, 1), (30, 2)])
def test_lost_track_is_recovered_until_max_age(n_missing: int, track_id: int) -> None:
    frames = [*[car_at(100)] * 5, *[Detections.empty()] * n_missing, car_at(100), car_at(100)]
    out = drive(DeepSortTracker(NO_PREDICTION), frames)
    assert [len(tracks) for tracks in out[5 : 5 + n_missing]] == [0] * n_missing
    assert out[-1].track_id.tolist() == [track_id]


def test_moving_track_is_recovered_at_its_prediction() -> None:
    frames = [
        *[car_at(100 + 20 * i) for i in range(8)],
        *[Detections.empty()] * 4,
        car_at(100 + 20 * 12),
    ]
    assert drive(DeepSortTracker(NO_PREDICTION), frames)[-1].track_id.tolist() == [1]


def test_a_gap_of_ten_seconds_ends_all_tracks() -> None:
    tracker = DeepSortTracker()
    drive(tracker, [car_at(100)] * 5)
    assert len(tracker.update(car_at(100), 10.4, IMAGE)) == 0
    assert tracker.update(car_at(100), 10.5, IMAGE).track_id.tolist() == [2]


def test_missing_box_is_predicted() -> None:
    out = drive(
        DeepSortTracker(EARLY_PREDICTION),
        [*[car_at(100 + 5 * i) for i in range(6)], Detections.empty(), car_at(135)],
    )
    missing = out[6]
    assert missing.track_id.tolist() == [1]
    assert missing.observed.tolist() == [False]
    np.testing.assert_allclose(missing.xyxy_px, [[130.0, 100.0, 190.0, 140.0]])
    assert missing.score[0] == pytest.approx(0.9 * 0.5**0.5)  # 0.1 s of a half-life of 0.2 s
    assert out[7].observed.tolist() == [True]
    assert out[7].track_id.tolist() == [1]


def test_prediction_ends_after_a_while() -> None:
    out = drive(DeepSortTracker(EARLY_PREDICTION), [*[car_at(100)] * 6, *[Detections.empty()] * 4])
    assert [len(tracks) for tracks in out[6:]] == [1, 1, 0, 0]  # 0.25 s


@pytest.mark.parametrize(("pause_s", "is_predicted"), [(0.9, True), (1.1, False), (3.0, False)])
def test_long_pause_ends_a_hit_streak(pause_s: float, is_predicted: bool) -> None:
    tracker = DeepSortTracker()
    drive(tracker, [car_at(100)] * 20)
    again_s = 1.9 + pause_s
    assert tracker.update(car_at(100), again_s, IMAGE).track_id.tolist() == [1]
    missing = tracker.update(Detections.empty(), again_s + 0.1, IMAGE)
    assert missing.track_id.tolist() == ([1] if is_predicted else [])


def test_a_box_that_leaves_the_image_is_not_predicted() -> None:
    # The border is at 1241, the margin of a box 40 px high is 2 px; the right edge is predicted at
    # 1235 and at 1240.
    for start_px, n_predicted in ((1145, 1), (1150, 0)):
        leaving = [*[car_at(start_px + 5 * i) for i in range(6)], Detections.empty()]
        assert len(drive(DeepSortTracker(EARLY_PREDICTION), leaving)[-1]) == n_predicted


def test_a_box_that_leaves_at_the_bottom_is_not_predicted() -> None:
    for start_px, n_predicted in (
        (300, 1),
        (309, 0),
    ):  # the lower edge is predicted at 370 and at 379, the border is 374.5
        boxes = [[100.0, start_px + 5.0 * i, 160.0, start_px + 40.0 + 5 * i] for i in range(6)]
        leaving = [*[Detections.of([box], [0.9], [CAR]) for box in boxes], Detections.empty()]
        assert len(drive(DeepSortTracker(EARLY_PREDICTION), leaving)[-1]) == n_predicted


def test_class_is_voted() -> None:
    labels = [CAR, CAR, TRUCK, CAR, TRUCK, CAR, CAR]
    out = drive(DeepSortTracker(), [car_at(100, class_id=c) for c in labels])
    assert [tracks.class_id.tolist() for tracks in out] == [[CAR]] * 7
    assert [tracks.track_id.tolist() for tracks in out] == [[1]] * 7


def test_wrong_first_class_is_outvoted() -> None:
    out = drive(DeepSortTracker(), [car_at(100, class_id=TRUCK, score=0.5), *[car_at(100)] * 6])
    assert [tracks.class_id.tolist() for tracks in out] == [[TRUCK]] * 4 + [[CAR]] * 3


def test_votes_for_another_class_are_a_doubt_that_shrinks() -> None:
    boxes = [car_at(100, class_id=TRUCK), *[car_at(100)] * 9]
    out = drive(DeepSortTracker(), boxes)
    assert [tracks.other_probability.tolist() for tracks in out[:2]] == [[0.0], [0.5]]
    assert out[0].other_class_id.tolist() == [TRUCK]  # no doubt after the first box
    # the votes lead by n - 1 of n + 1 boxes: Phi((n - 1) / sqrt(n + 1) sqrt(0.9))
    leads = [0.5, 0.709, 0.829, 0.898]
    of_car = [
        tracks.other_probability[0]
        if tracks.class_id[0] == TRUCK
        else 1 - tracks.other_probability[0]
        for tracks in out[1:]
    ]
    assert of_car[:4] == pytest.approx(leads, abs=1e-3)
    assert of_car == sorted(of_car)
    assert of_car[-1] == pytest.approx(0.992, abs=1e-3)
    assert out[-1].other_class_id.tolist() == [TRUCK]


def test_classes_that_flicker_change_rarely() -> None:
    rng, n_changes = np.random.default_rng(3), []
    for _ in range(10):
        labels = rng.choice([CAR, TRUCK], 100)
        out = drive(
            DeepSortTracker(), [car_at(100, class_id=c, score=rng.uniform(0.5, 1)) for c in labels]
        )
        n_changes.append(int((np.diff([tracks.class_id[0] for tracks in out]) != 0).sum()))
    assert max(n_changes) <= 1


@pytest.mark.parametrize(("fps", "step_px"), [(2.0, 90.0), (1.0, 90.0), (0.5, 100.0)])
def test_objects_that_move_by_more_than_their_width_per_frame(fps: float, step_px: float) -> None:
    tracker, ids = DeepSortTracker(), []
    for frame in range(8):
        far = Detections.of([[2000.0 - 8 * frame, 90.0, 2030.0 - 8 * frame, 110.0]], [0.9], [CAR])
        tracks = tracker.update(both(car_at(100 + step_px * frame), far), 100 + frame / fps, None)
        ids.append(tracks.track_id.tolist())
    assert ids == [[1, 2]] * 8


def test_a_person_does_not_become_a_car() -> None:
    out = drive(
        DeepSortTracker(NO_PREDICTION),
        [car_at(100), car_at(100, class_id=PERSON), car_at(100, class_id=PERSON)],
    )
    assert [tracks.track_id.tolist() for tracks in out] == [[1], [], [2]]


@pytest.mark.parametrize("name", ["road", "deepsort", "sort"])
@pytest.mark.parametrize("fps", [2, 10, 30])
@pytest.mark.parametrize("image", [IMAGE, None])
@pytest.mark.parametrize("other", [PERSON, BICYCLE, SIGN])
def test_no_tracker_of_ours_continues_a_car_as_something_else(
    name: str, fps: int, image: Image | None, other: int
) -> None:
    """Neither by overlap nor by distance or appearance, in either order; a truck may be the car."""
    before, after = [car_at(100)] * 4, [car_at(100, class_id=other)] * 4
    for frames in (before + after, after + before):
        tracker = create_tracker(name)
        ids = [
            set(tracker.update(boxes, k / fps, image).track_id.tolist())
            for k, boxes in enumerate(frames)
        ]
        assert ids[0] == {1}
        assert ids[-1] == {2}
    tracker, trucks = create_tracker(name), [car_at(100, class_id=TRUCK)] * 4
    assert {
        identity
        for k, boxes in enumerate(before + trucks)
        for identity in tracker.update(boxes, k / fps, image).track_id.tolist()
    } == {1}


def test_a_known_rider_is_matched_by_either_name_like_any_other_track() -> None:
    """After an IoU of 0.5 has shown that a person rides, a smaller one continues the bicycle."""
    jump = [car_at(126, class_id=BICYCLE)] * 2  # an IoU of 0.4
    walker = [car_at(100, class_id=PERSON)] * 6
    rider = [car_at(100, class_id=c) for c in (PERSON, BICYCLE, PERSON, PERSON, PERSON, PERSON)]
    ids = [drive(DeepSortTracker(NO_PREDICTION), frames + jump)[-1] for frames in (walker, rider)]
    assert [tracks.track_id.tolist() for tracks in ids] == [[2], [1]]


def test_a_rider_is_one_object_by_either_name() -> None:
    """Also before the track is confirmed; the class is voted."""
    labels = [PERSON, BICYCLE, BICYCLE, PERSON, *[BICYCLE] * 8]
    boxes = [car_at(100 + 2 * k, class_id=c) for k, c in enumerate(labels)]
    out = drive(DeepSortTracker(NO_PREDICTION), boxes)
    assert [tracks.track_id.tolist() for tracks in out] == [[1]] * 12
    assert [out[0].class_id[0], out[-1].class_id[0]] == [PERSON, BICYCLE]
    later = drive(DeepSortTracker(NO_PREDICTION), [Detections.empty(), *boxes])
    assert [tracks.track_id.tolist() for tracks in later] == [[], [], *[[1]] * 11]


def test_a_person_beside_a_bicycle_is_another_object() -> None:
    """Each box continues its own name; a bicycle with an IoU of 0.4 does not continue a person."""
    pair = both(car_at(100, class_id=PERSON), car_at(108, class_id=BICYCLE))
    swapped = both(car_at(108, class_id=PERSON), car_at(100, class_id=BICYCLE))
    out = drive(DeepSortTracker(NO_PREDICTION), [pair, pair, swapped, swapped])
    assert [tracks.class_id[tracks.track_id == 1].tolist() for tracks in out] == [[PERSON]] * 4
    beside = [car_at(100, class_id=PERSON)] * 3 + [car_at(126, class_id=BICYCLE)] * 3
    ids = [tracks.track_id.tolist() for tracks in drive(DeepSortTracker(NO_PREDICTION), beside)]
    assert ids == [[1]] * 3 + [[]] + [[2]] * 2


def test_two_cars_that_pass_each_other_keep_their_ids() -> None:
    near = [
        Detections.of([[600.0 - 30 * i, 100, 760 - 30 * i, 220]], [0.9], [CAR]) for i in range(20)
    ]
    far = [Detections.of([[300.0 + 4 * i, 110, 340 + 4 * i, 140]], [0.9], [CAR]) for i in range(20)]
    out = drive(DeepSortTracker(), [both(a, b) for a, b in zip(near, far, strict=True)])
    for i, tracks in enumerate(out):
        assert tracks.track_id.tolist() == [1, 2]
        np.testing.assert_array_equal(tracks.xyxy_px, both(near[i], far[i]).xyxy_px)


@pytest.mark.parametrize("hz", [10, 30])
def test_the_frame_rate_does_not_matter(hz: int) -> None:
    tracker = DeepSortTracker(NO_PREDICTION)
    ids = set()
    for i in range(4 * hz):
        t = i / hz
        is_occluded = 1.5 < t < 2.3
        tracks = tracker.update(
            Detections.empty() if is_occluded else car_at(50 + 250 * t), t, IMAGE
        )
        ids |= set(tracks.track_id.tolist())
    assert ids == {1}


@pytest.mark.parametrize("time_s", [0.3, 0.5, float("nan"), float("inf")])
def test_time_must_increase(time_s: float) -> None:
    tracker = DeepSortTracker()
    tracker.update(car_at(100), 0.5, IMAGE)
    with pytest.raises(ValueError, match="time_s"):
        tracker.update(car_at(100), time_s, IMAGE)


def test_boxes_without_area_or_score_are_ignored() -> None:
    bad = Detections.of(
        [[5, 5, 5, 9], [9, 8, 12, 8], [300, 10, 320, 40]], [0.9, 0.9, 0.0], [CAR] * 3
    )
    assert DeepSortTracker().update(both(bad, car_at(100)), 0.0, None).track_id.tolist() == [1]


def test_frames_without_boxes() -> None:
    assert [len(tracks) for tracks in drive(DeepSortTracker(), [Detections.empty()] * 3)] == [
        0,
        0,
        0,
    ]


def random_frames(seed: int, *, n_frames: int = 25) -> list[Detections]:
    """Ten boxes in random motion, some missing, of all scores and several classes."""
    rng = np.random.default_rng(seed)
    corner, size = rng.uniform(0, [1100, 250], (10, 2)), rng.uniform(10, 120, (10, 2))
    speed = rng.normal(0, 8, (10, 2))
    frames = []
    for i in range(n_frames):
        at = corner + speed * i + rng.normal(0, 1, (10, 2))
        boxes = np.concatenate([at, at + size], axis=1)
        detections = Detections.of(
            boxes, rng.uniform(0, 1, 10), rng.choice([CAR, TRUCK, PERSON], 10)
        )
        frames.append(detections.select(rng.random(10) < 0.8))
    return frames


@cache
def tracked(seed: int) -> list[Tracks]:
    """The tracks of `random_frames`."""
    return drive(DeepSortTracker(), random_frames(seed))


@pytest.mark.parametrize("seed", SEEDS)
def test_invariants_of_tracks(seed: int) -> None:
    frames, out = random_frames(seed), tracked(seed)
    for detections, tracks in zip(frames, out, strict=True):
        assert (np.diff(tracks.track_id) > 0).all()
        assert (tracks.track_id >= 1).all()
        assert ((tracks.score >= 0) & (tracks.score <= 1)).all()
        detected = {tuple(box) for box in detections.xyxy_px.tolist()}
        observed = [tuple(box) for box in tracks.xyxy_px[tracks.observed].tolist()]
        assert set(observed) <= detected
        assert len(set(observed)) == len(observed)
    assert sum(len(tracks) for tracks in out) > 0


@pytest.mark.parametrize("seed", SEEDS)
def test_the_same_input_gives_the_same_output(seed: int) -> None:
    for a, b in zip(tracked(seed), drive(DeepSortTracker(), random_frames(seed)), strict=True):
        np.testing.assert_array_equal(a.track_id, b.track_id)
        np.testing.assert_array_equal(a.xyxy_px, b.xyxy_px)


@pytest.mark.parametrize("seed", SEEDS)
def test_order_of_boxes_changes_only_ids(seed: int) -> None:
    reordered = [
        detections.select(np.arange(len(detections))[::-1]) for detections in random_frames(seed)
    ]
    for a, b in zip(tracked(seed), drive(DeepSortTracker(), reordered), strict=True):
        assert sorted(a.xyxy_px.tolist()) == sorted(b.xyxy_px.tolist())


def with_embeddings(detections: Detections, *numbers: int) -> Detections:
    """The detections with embeddings from eight orthogonal ones, by number."""
    embedding = np.eye(8, dtype=np.float32)[list(numbers)]
    return Detections(detections.xyxy_px, detections.score, detections.class_id, embedding)


def crossing(*, has_embeddings: bool) -> list[Detections]:
    """Two people of equal size who walk towards each other, are occluded for a while, and turn
    back."""
    frames = []
    for i in range(30):
        a, b = (
            (200 + 10 * i, 400 - 10 * i) if i <= 8 else (300 - 10 * (i - 12), 300 + 10 * (i - 12))
        )
        people = both(*(Detections.of([[x, 100, x + 40, 200]], [0.9], [PERSON]) for x in (a, b)))
        frames.append(with_embeddings(people, 0, 1) if has_embeddings else people)
        if 8 < i < 16:
            frames[-1] = frames[-1].select(np.zeros(0, np.int64))
    return frames


def test_appearance_resolves_crossing() -> None:
    by_appearance, by_motion = (
        drive(DeepSortTracker(NO_PREDICTION), crossing(has_embeddings=value))[-1]
        for value in (True, False)
    )
    left_is_first = by_appearance.xyxy_px[0, 0] < by_appearance.xyxy_px[1, 0]
    assert (by_appearance.track_id.tolist(), bool(left_is_first)) == ([1, 2], True)
    # motion alone predicts that they passed each other
    assert by_motion.xyxy_px[0, 0] > by_motion.xyxy_px[1, 0]


def test_appearance_is_gated_by_motion() -> None:
    near, far = with_embeddings(car_at(100), 3), with_embeddings(car_at(900), 3)
    frames = [*[near] * 5, far, far]
    assert drive(DeepSortTracker(NO_PREDICTION), frames)[-1].track_id.tolist() == [2]


def test_overlap_outweighs_other_appearance() -> None:
    out = drive(DeepSortTracker(), [with_embeddings(car_at(100 + i), i % 8) for i in range(6)])
    assert [tracks.track_id.tolist() for tracks in out] == [[1]] * 6


def test_embeddings_from_images() -> None:
    """A red and a blue car change places during a missing frame: the built-in appearance model
    follows the colours."""
    red, blue = (20, 20, 220), (220, 20, 20)
    settings = DeepSortSettings(
        appearance=AppearanceSettings(gating_threshold=1e9),
        is_camera_motion_compensated=False,
        prediction=PredictionGates(max_missing_s=0.0),
    )

    def last(tracker: DeepSortTracker) -> Tracks:
        for i in range(12):
            image = np.full((375, 1242, 3), 128, np.uint8)
            left, right = (red, blue) if i < 6 else (blue, red)
            image[100:141, 300:361], image[100:141, 380:441] = left, right
            detections = Detections.empty() if i == 6 else both(car_at(300), car_at(380))
            tracks = tracker.update(detections, 0.1 * i, image)
        return tracks

    assert last(DeepSortTracker(settings)).xyxy_px[:, 0].tolist() == [300.0, 380.0]
    assert last(DeepSortTracker(settings, appearance_model=ColourLayout())).xyxy_px[
        :, 0
    ].tolist() == [380.0, 300.0]


def test_predictions_move_with_the_camera() -> None:
    """A shaking camera: 60 px back and forth between frames, 1.5 times the width of a static
    person."""
    rng = np.random.default_rng(0)
    world = np.kron(rng.integers(0, 255, (75, 260)), np.ones((8, 8))).astype(np.uint8)
    frames = []
    for i in range(14):
        shift = 60 * (i % 2)
        image = np.ascontiguousarray(np.repeat(world[:375, shift : shift + 1242, None], 3, axis=2))
        frames.append(
            (Detections.of([[600 - shift, 150, 640 - shift, 250]], [0.9], [PERSON]), image)
        )
    ids = {}
    for is_compensated in (True, False):
        tracker = DeepSortTracker(DeepSortSettings(is_camera_motion_compensated=is_compensated))
        ids[is_compensated] = [
            tracker.update(detections, 0.1 * i, image).track_id.tolist()
            for i, (detections, image) in enumerate(frames)
        ]
    assert ids[True] == [[1]] * 14
    assert ids[False] != [[1]] * 14


def test_an_occlusion_of_a_second_is_bridged() -> None:
    """A pedestrian behind a parked van: 8 px per frame, occluded for 10 frames."""
    van = Detections.of([[400, 80, 560, 220]], [0.9], [TRUCK])
    walker = [
        Detections.of([[200 + 8 * i, 100, 240 + 8 * i, 200]], [0.9], [PERSON]) for i in range(60)
    ]
    frames = [both(van, walker[i]) if not 24 <= i < 34 else van for i in range(60)]
    out = drive(DeepSortTracker(), frames)
    assert out[-1].track_id.tolist() == [1, 2]


def test_leaving_target_is_not_predicted() -> None:
    frames = [*[car_at(1000 + 20 * i) for i in range(9)], *[Detections.empty()] * 20]
    assert [len(tracks) for tracks in drive(DeepSortTracker(), frames)[9:]] == [0] * 20


@pytest.mark.parametrize(("classes", "n_tracks"), [("similar", 1), ("same", 2), ("any", 1)])
def test_which_classes_may_be_one_object(classes: Classes, n_tracks: int) -> None:
    settings = DeepSortSettings(classes=classes, prediction=PredictionGates(max_missing_s=0.0))
    out = drive(DeepSortTracker(settings), [*[car_at(100)] * 4, *[car_at(100, class_id=TRUCK)] * 4])
    assert len({i for tracks in out for i in tracks.track_id.tolist()}) == n_tracks
    people = drive(
        DeepSortTracker(settings), [*[car_at(100)] * 4, *[car_at(100, class_id=PERSON)] * 4]
    )
    assert len({i for tracks in people for i in tracks.track_id.tolist()}) == (
        1 if classes == "any" else 2
    )


def test_duplicate_boxes_are_two_tracks() -> None:
    out = drive(DeepSortTracker(), [both(car_at(100), car_at(100))] * 5)
    assert [tracks.track_id.tolist() for tracks in out] == [[1, 2]] * 5


@pytest.mark.slow
def test_ten_thousand_boxes() -> None:
    rng = np.random.default_rng(5)
    at = rng.uniform(0, 50_000, (10_000, 2))
    detections = Detections.of(
        np.concatenate([at, at + 20], axis=1), np.full(10_000, 0.9), np.full(10_000, CAR)
    )
    tracker = DeepSortTracker()
    assert len(tracker.update(detections, 0.0, None)) == 10_000
    assert tracker.update(detections, 0.1, None).track_id.tolist() == list(range(1, 10_001))


@pytest.mark.parametrize(("min_fraction", "least", "most"), [(0.85, 0, 0), (0.0, 60, 200)])
def test_activation_threshold_adapts_to_detector(
    min_fraction: float, least: int, most: int
) -> None:
    """False alarms with a score of 0.55 at random positions, persistent cars with 0.85: false
    alarms start no track."""
    rng = np.random.default_rng(6)
    tracker = DeepSortTracker(
        DeepSortSettings(
            track_activation_threshold=ConfidenceThresholdSettings(min_fraction=min_fraction)
        )
    )
    n_new = []
    for i in range(50):
        false = [car_at(x, score=0.55) for x in rng.uniform(300, 1100, 4)]
        tracker.update(both(*[car_at(60 * k, score=0.85) for k in range(3)], *false), 0.1 * i, None)
        n_new.append(len(tracker.tentative))
    assert least <= sum(n_new[5:]) <= most
    assert (tracker.track_activation_threshold(np.array([CAR]))[0] > 0.55) == (min_fraction > 0)


@pytest.mark.parametrize(
    ("name", "jump_px", "continues"),
    [
        ("road", 50, True),  # the boxes hardly overlap, and the appearance is equal
        ("sort", 50, False),
        ("deepsort", 90, True),  # as far as another car of the same colour may be
        ("road", 90, False),
    ],
)
def test_appearance_decides_near_the_prediction(name: str, jump_px: int, continues: bool) -> None:
    other = car_at(800)
    frames = [both(car_at(100), other)] * 10 + [other] * 8
    tracks = drive(create_tracker(name), frames + [both(car_at(100 + jump_px), other)] * 2)[-1]
    assert tracks.track_id.tolist() == ([1, 2] if continues else [2, 3])
