"""Trackers by name, by `module:Class` and by entry point; `tests/toys/toy_tracker.py` is another
package's tracker."""

import pickle

import numpy as np
import pytest

from tests.toys.toy_tracker import GreedyIouTracker
from track_range.detection.detections import Detections
from track_range.tracking.registry import (
    TRACKERS,
    RefinableTracker,
    TrackerError,
    TrackerOptions,
    checked_tracks,
    create_tracker,
    find_tracker,
    register_tracker,
    tracker_class,
)
from track_range.tracking.tracks import Tracks

BOX = Detections.of([[10, 10, 50, 50]], [0.9], [2])


@pytest.fixture
def _restored():
    with TRACKERS.restored():
        yield


@pytest.mark.parametrize("name", ["road", "deepsort", "sort"])
def test_built_in_trackers(name):
    assert name in TRACKERS.names
    tracker = create_tracker(name)
    assert tracker.update(BOX, 0.0, None).track_id.tolist() == [1]
    assert isinstance(tracker, RefinableTracker)
    assert find_tracker(name).uses_reid == (name != "sort")


def test_reid_is_handed_to_trackers_with_appearance():
    class Counting:
        max_cosine_distance, notes, n_calls = 0.1, (), 0

        def embed(self, image, xyxy_px):
            self.n_calls += 1
            return np.tile(np.eye(4, dtype=np.float32)[:1], (len(xyxy_px), 1))

    for name, n_calls in (("road", 1), ("deepsort", 1), ("sort", 0)):
        reid = Counting()
        create_tracker(name, TrackerOptions(reid=reid)).update(
            BOX, 0.0, np.zeros((60, 60, 3), np.uint8)
        )
        assert reid.n_calls == n_calls


@pytest.mark.usefixtures("_restored")
def test_registered_class():
    register_tracker("greedy", GreedyIouTracker)
    assert TRACKERS.names[-1] == "greedy"
    tracker = create_tracker("greedy")
    assert tracker.update(BOX, 0.0, None).track_id.tolist() == [101]
    assert not isinstance(tracker, RefinableTracker)


@pytest.mark.usefixtures("_restored")
@pytest.mark.parametrize("name", ["deepsort", "greedy"])
def test_names_in_use(name):
    if name == "greedy":
        register_tracker(name, GreedyIouTracker)
    with pytest.raises(TrackerError, match=f"{name}.*in use"):
        register_tracker(name, GreedyIouTracker)


def test_class_by_module_path():
    tracker = create_tracker("tests.toys.toy_tracker:GreedyIouTracker")
    assert tracker.update(BOX, 0.0, None).track_id.tolist() == [101]


def test_entry_point(install):
    install("track_range.trackers", other="tests.toys.toy_tracker:GreedyIouTracker")
    assert "other" in TRACKERS.names
    assert create_tracker("other").update(BOX, 0.0, None).track_id.tolist() == [101]


@pytest.mark.parametrize(
    ("name", "key_word"),
    [
        ("bytetrack", "road, deepsort, sort"),
        ("no_such_module:Tracker", "no_such_module"),
        ("tests.toys.toy_tracker:Missing", "Missing"),
        ("tests.toys.toy_tracker:", "tests.toys.toy_tracker"),
        (":Tracker", ":Tracker"),
        ("tests.toys.toy_tracker:NOT_CALLABLE", "class"),
        ("tests.toys.toy_tracker:TakesNothing", "TrackerOptions"),
        ("tests.toys.toy_tracker:NotATracker", "update"),
        ("os:system", "TrackerOptions"),
        ("builtins:int", "TrackerOptions"),
    ],
)
def test_wrong_names_and_classes(name, key_word):
    with pytest.raises(TrackerError, match=key_word):
        create_tracker(name)


@pytest.mark.parametrize("name", ["", "a:b"])
def test_names_that_cannot_be_registered(name):
    with pytest.raises(ValueError, match="colon"):
        register_tracker(name, GreedyIouTracker)


@pytest.mark.parametrize(
    ("ids", "x2_px", "key_word"),
    [
        ([1, 1], 50.0, r"each once per frame, got \[1, 1\]"),
        ([-1, 2], 50.0, "track_id >= 0"),
        ([0, 2], np.nan, "xyxy_px"),
    ],
)
def test_wrong_tracks_of_another_package(ids, x2_px, key_word):
    tracks = Tracks(
        np.array(ids),
        np.array([[10, 10, x2_px, 50]] * 2),
        np.array([2, 2]),
        np.ones(2),
        np.ones(2, bool),
    )
    with pytest.raises(TrackerError, match=key_word):
        checked_tracks(GreedyIouTracker(TrackerOptions()), tracks)
    right = Tracks(
        np.array([0, 7]),
        np.array([[10.0, 10, 50, 50]] * 2),
        *(getattr(tracks, n) for n in ("class_id", "score", "observed")),
    )
    assert checked_tracks(GreedyIouTracker(TrackerOptions()), right) is right


class ScoresSeen:
    """A tracker of another package that records the scores that it gets."""

    min_score = 0.5

    def __init__(self, options):
        self.scores: list[float] = []
        self.tentative = Tracks.empty()

    def update(self, detections, time_s, image):
        self.scores += detections.score.tolist()
        n = len(detections)
        observed = np.ones(n, np.bool_)
        boxes = detections.xyxy_px, detections.class_id, detections.score
        return Tracks(np.arange(n) + 1, *boxes, observed)


def scored(*scores: float) -> Detections:
    boxes_px = np.array([[10.0 * i, 0.0, 10.0 * i + 8.0, 8.0] for i in range(len(scores))])
    return Detections.of(boxes_px, scores, [2] * len(scores))


@pytest.mark.parametrize(
    ("min_score", "seen"), [(None, [0.5, 0.9]), (0.0, [0.1, 0.5, 0.9]), (0.8, [0.9])]
)
def test_a_tracker_gets_the_scores_that_it_expects(min_score, seen):
    tracker = create_tracker(f"{__name__}:ScoresSeen", TrackerOptions(min_score=min_score))
    detections = scored(0.1, 0.5, 0.9)
    assert len(tracker.update(detections, 0.0, None)) == len(seen)
    assert tracker.scores == seen
    assert isinstance(tracker.tentative, Tracks)
    assert tracker_class(tracker) is ScoresSeen
    with pytest.raises(TrackerError, match="ScoresSeen"):
        checked_tracks(tracker, None)


def test_a_tracker_with_a_min_score_is_stored_with_the_state_of_a_pipeline():
    tracker = create_tracker("sort", TrackerOptions(min_score=0.5))
    again = pickle.loads(pickle.dumps(tracker))  # noqa: S301 - bytes of this test
    assert (tracker_class(again), again.min_score) == (tracker_class(tracker), 0.5)


@pytest.mark.usefixtures("_restored")
def test_a_registered_tracker_has_a_min_score():
    register_tracker("confident", ScoresSeen, min_score=0.6)
    tracker = create_tracker("confident")
    tracker.update(scored(0.5, 0.7), 0.0, None)
    assert tracker.scores == [0.7]
