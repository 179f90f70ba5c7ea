from __future__ import annotations

from pathlib import Path

import motmetrics
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.detection.formats.video_labels.mot import read_mot
from track_range.tracking.evaluation.scores import TrackingCounts, evaluate_tracks
from track_range.tracking.evaluation.tracked_boxes import IgnoreRegions, TrackedBoxes

WHEEL_DATA = Path(motmetrics.__file__).parent / "data"


def boxes_of(rows: list[tuple[int, int, float]], *, class_id: int = 2) -> TrackedBoxes:
    """Boxes of 10 x 10 px from (frame, id, left edge)."""
    frame, track_id, x = np.array(rows, np.float64).reshape(-1, 3).T
    y = np.zeros_like(x)
    return TrackedBoxes(
        frame.astype(np.int64),
        track_id.astype(np.int64),
        np.stack([x, y, x + 10, y + 10], axis=1),
        np.full(len(x), class_id),
    )


def golden(name: str, file: str) -> TrackedBoxes:
    rows = read_mot(WHEEL_DATA / name / file)
    return TrackedBoxes(rows.frame, rows.track_id, rows.xyxy_px, np.zeros(len(rows), np.int64))


# Scores that motmetrics publishes for the sequences in its wheel.
@pytest.mark.parametrize(
    ("name", "mota", "idf1", "idsw", "fp", "fn", "n"),
    [
        ("TUD-Campus", 52.65, 55.77, 7, 13, 150, 359),
        ("TUD-Stadtmitte", 56.40, 64.46, 7, 45, 452, 1156),
    ],
)
def test_golden_sequences(
    name: str, mota: float, idf1: float, idsw: int, fp: int, fn: int, n: int
) -> None:
    scores = evaluate_tracks(golden(name, "gt.txt"), golden(name, "test.txt"))
    assert scores.mota == pytest.approx(mota, abs=0.005)
    assert scores.idf1 == pytest.approx(idf1, abs=0.005)
    assert (scores.idsw, scores.fp, scores.fn, scores.n) == (idsw, fp, fn, n)


# Scores of TrackEval 1.3.0 for the same boxes.
TRACKEVAL = {
    "TUD-Campus": {
        "hota": 39.1397, "deta": 41.8047, "assa": 36.9121, "loca": 77.0052, "mota": 52.6462, "motp": 72.2799,
        "idf1": 55.7659, "idp": 72.973, "idr": 45.1253, "idsw": 7, "frag": 7, "mt": 1, "pt": 6, "ml": 1,
        "fp": 13, "fn": 150,
    },
    "TUD-Stadtmitte": {
        "hota": 39.7849, "deta": 39.2268, "assa": 40.8841, "loca": 73.7521, "mota": 56.4014, "motp": 65.4096,
        "idf1": 64.4619, "idp": 81.976, "idr": 53.1142, "idsw": 7, "frag": 6, "mt": 5, "pt": 4, "ml": 1,
        "fp": 45, "fn": 452,
    },
    "together": {
        "hota": 39.9957, "deta": 39.7683, "assa": 41.245, "loca": 73.248, "mota": 55.5116, "motp": 66.9823,
        "idf1": 62.4296, "idp": 79.9176, "idr": 51.2211, "idsw": 14, "frag": 13, "mt": 6, "pt": 10, "ml": 2,
        "fp": 58, "fn": 602,
    },
}  # fmt: skip


def test_scores_equal_trackeval() -> None:
    names = ("TUD-Campus", "TUD-Stadtmitte")
    counts = {
        name: TrackingCounts.of(golden(name, "gt.txt"), golden(name, "test.txt")) for name in names
    }
    counts["together"] = TrackingCounts.sum_of(list(counts.values()))
    for name, expected in TRACKEVAL.items():
        scores = counts[name].scores()
        assert {key: getattr(scores, key) for key in expected} == pytest.approx(
            expected, abs=1e-3
        ), name


def test_truth_against_itself_is_perfect() -> None:
    truth = golden("TUD-Campus", "gt.txt")
    scores = evaluate_tracks(truth, truth)
    ratios = (scores.mota, scores.motp, scores.idf1, scores.idp, scores.idr)
    assert ratios == (100.0, 100.0, 100.0, 100.0, 100.0)
    assert (scores.idsw, scores.fp, scores.fn, scores.frag, scores.mt, scores.ml, scores.n) == (
        0,
        0,
        0,
        0,
        8,
        0,
        359,
    )


@given(seed=st.integers(0, 1000))
@settings(max_examples=5, deadline=None)
def test_names_of_ids_and_order_of_rows_do_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth, results = golden("TUD-Campus", "gt.txt"), golden("TUD-Campus", "test.txt")
    names = rng.permutation(1000)
    renamed = TrackedBoxes(
        results.frame, names[results.track_id], results.xyxy_px, results.class_id
    )
    assert evaluate_tracks(truth, renamed.select(rng.permutation(len(renamed)))) == evaluate_tracks(
        truth, results
    )


def test_a_switch_by_hand() -> None:
    truth = boxes_of([(0, 1, 0), (1, 1, 0), (2, 1, 0), (3, 1, 0)])
    results = boxes_of([(0, 7, 0), (1, 7, 0), (2, 8, 0), (3, 8, 0)])
    scores = evaluate_tracks(truth, results)
    assert (scores.idsw, scores.fp, scores.fn, scores.mt) == (1, 0, 0, 1)
    assert scores.mota == pytest.approx(75.0)  # 1 - 1 / 4
    assert scores.idf1 == pytest.approx(50.0)  # one of the two ids explains 2 of 4 boxes


def test_motp_is_the_mean_iou_of_the_matches() -> None:
    # shifted by 2 of 10 px: intersection 80, union 120; the second box is exact
    scores = evaluate_tracks(boxes_of([(0, 1, 0), (0, 2, 50)]), boxes_of([(0, 1, 2), (0, 2, 50)]))
    assert scores.motp == pytest.approx(100 * (2 / 3 + 1) / 2)


def test_iou_below_half_is_no_match() -> None:
    scores = evaluate_tracks(boxes_of([(0, 1, 0)]), boxes_of([(0, 1, 4)]))  # 60 of 140
    assert (scores.fp, scores.fn, scores.mota) == (1, 1, -100.0)


def test_another_class_does_not_match() -> None:
    scores = evaluate_tracks(boxes_of([(0, 1, 0)], class_id=2), boxes_of([(0, 1, 0)], class_id=5))
    assert (scores.fp, scores.fn) == (1, 1)


def test_frames_with_only_truth_or_results() -> None:
    scores = evaluate_tracks(boxes_of([(0, 1, 0), (2, 1, 0)]), boxes_of([(0, 1, 0), (5, 1, 0)]))
    assert (scores.fp, scores.fn, scores.n) == (1, 1, 2)


def test_a_track_lost_and_found_is_fragmented() -> None:
    other = [(f, 2, 50) for f in range(5)]
    truth = boxes_of([*((f, 1, 0) for f in range(5)), *other])
    scores = evaluate_tracks(truth, boxes_of([*((f, 1, 0) for f in (0, 1, 3, 4)), *other]))
    # 80 % is not more than 80 %
    assert (scores.frag, scores.fn, scores.mt, scores.pt, scores.ml) == (1, 1, 1, 1, 0)


@pytest.mark.parametrize(
    ("region_frame", "region_x_px", "fp"),
    [(0, 94.0, 0), (0, 95.0, 0), (0, 96.0, 1), (1, 94.0, 1)],
    ids=["60 % inside", "half inside", "40 % inside", "other frame"],
)
def test_false_boxes_in_ignore_regions_are_dropped(
    region_frame: int, region_x_px: float, fp: int
) -> None:
    truth, results = boxes_of([(0, 1, 0), (1, 1, 0)]), boxes_of([(0, 1, 0), (1, 1, 0), (0, 2, 90)])
    ignore = IgnoreRegions(
        np.array([region_frame]), np.array([[region_x_px, -50.0, region_x_px + 100, 50.0]])
    )
    assert evaluate_tracks(truth, results, ignore=ignore).fp == fp


def test_matched_box_in_ignore_region_counts() -> None:
    everything = IgnoreRegions(np.array([0]), np.array([[-100.0, -100.0, 100.0, 100.0]]))
    truth = boxes_of([(0, 1, 0)])
    assert evaluate_tracks(truth, boxes_of([(0, 1, 0), (0, 2, 1)]), ignore=everything).mota == 100.0


@pytest.mark.parametrize(("x_px", "n_matches"), [(3.0, 1), (4.0, 0)], ids=["IoU 0.54", "IoU 0.43"])
def test_only_a_match_protects_a_box_in_an_ignore_region(x_px: float, n_matches: int) -> None:
    everything = IgnoreRegions(np.array([0]), np.array([[-100.0, -100.0, 100.0, 100.0]]))
    scores = evaluate_tracks(boxes_of([(0, 1, 0)]), boxes_of([(0, 1, x_px)]), ignore=everything)
    assert (scores.fp, scores.fn) == (0, 1 - n_matches)


def test_scores_without_boxes_are_nan() -> None:
    empty, one = boxes_of([]), boxes_of([(0, 1, 0)])
    no_results = evaluate_tracks(one, empty)
    assert (no_results.mota, no_results.idf1, no_results.fn, no_results.ml) == (0.0, 0.0, 1, 1)
    assert np.isnan([no_results.motp, no_results.idp]).all()
    no_truth = evaluate_tracks(empty, one)
    assert np.isnan([no_truth.mota, no_truth.motp, no_truth.idr]).all()
    assert no_truth.fp == 1
    nothing = evaluate_tracks(empty, empty)
    assert np.isnan([nothing.mota, nothing.motp, nothing.idf1, nothing.idp, nothing.idr]).all()


def test_duplicate_id_in_a_frame() -> None:
    with pytest.raises(ValueError, match=r"track_id.*duplicates"):
        boxes_of([(0, 1, 0), (0, 1, 30)])


def test_shapes_are_checked() -> None:
    ids = np.zeros(1, np.int64)
    with pytest.raises(ValueError, match=r"xyxy_px.*shape"):
        TrackedBoxes(ids, ids, np.zeros((1, 3)), ids)
    with pytest.raises(ValueError, match=r"xyxy_px.*shape"):
        IgnoreRegions(ids, np.zeros((2, 4)))
