"""motmetrics' scores for the sequences in its wheel, and where its rules differ from `clear`."""

from __future__ import annotations

import math
from pathlib import Path

import motmetrics
import numpy as np
import pytest

from track_range.detection.formats.video_labels.mot import read_mot
from track_range.tracking.evaluation.motmetrics_comparison import REASONS, motmetrics_figures
from track_range.tracking.evaluation.scores import TrackingCounts
from track_range.tracking.evaluation.tracked_boxes import Similarity, TrackedBoxes

WHEEL_DATA = Path(motmetrics.__file__).parent / "data"


def similarity_of(truth: list[tuple[int, int]], results: list[tuple[int, int]]) -> Similarity:
    """Boxes at one place from (frame, id)."""

    def boxes(rows: list[tuple[int, int]]) -> TrackedBoxes:
        frame, track_id = np.array(rows, np.int64).reshape(-1, 2).T
        n = len(frame)
        return TrackedBoxes(
            frame, track_id, np.tile([0.0, 0.0, 10.0, 10.0], (n, 1)), np.zeros(n, np.int64)
        )

    return Similarity.of(boxes(truth), boxes(results))


def track_range_figures(similarity: Similarity) -> dict[str, float]:
    scores = TrackingCounts.of_similarity(similarity).scores()
    return {name: getattr(scores, name) for name in REASONS}


def test_published_scores_of_wheel_sequences() -> None:
    sequences = {}
    for name in ("TUD-Campus", "TUD-Stadtmitte"):
        truth, results = (read_mot(WHEEL_DATA / name / file) for file in ("gt.txt", "test.txt"))
        sequences[name] = Similarity.of(
            *(
                TrackedBoxes(r.frame, r.track_id, r.xyxy_px, np.zeros(len(r), np.int64))
                for r in (truth, results)
            )
        )
    figures = motmetrics_figures(sequences)
    campus = figures.sequences["TUD-Campus"]
    assert (campus["idsw"], campus["fp"], campus["fn"]) == (7, 13, 150)
    assert (campus["mota"], campus["motp"], campus["idf1"]) == pytest.approx(
        (52.65, 72.28, 55.77), abs=0.005
    )
    assert figures.combined["mota"] == pytest.approx(55.51, abs=0.005)
    assert figures.combined["motp"] == pytest.approx(66.98, abs=0.005)
    assert {name: campus[name] for name in REASONS} == pytest.approx(
        track_range_figures(sequences["TUD-Campus"])
    )


def test_exactly_80_per_cent_tracked() -> None:
    similarity = similarity_of([(f, 1) for f in range(5)], [(f, 7) for f in range(4)])
    reference, figures = (
        motmetrics_figures({"a": similarity}).combined,
        track_range_figures(similarity),
    )
    assert (reference["mt"], reference["pt"]) == (1, 0)
    assert (figures["mt"], figures["pt"]) == (0, 1)


def test_fragments_of_an_interrupted_truth_track() -> None:
    other = [(f, 2) for f in range(6)]
    absent = similarity_of(
        [*((f, 1) for f in (0, 1, 4, 5)), *[(f, 3) for f in (2, 3)]], [(f, 7) for f in range(6)]
    )
    assert (
        motmetrics_figures({"a": absent}).combined["frag"],
        track_range_figures(absent)["frag"],
    ) == (0, 1)
    missed = similarity_of(other, [(f, 7) for f in (0, 1, 4, 5)])
    assert (
        motmetrics_figures({"a": missed}).combined["frag"],
        track_range_figures(missed)["frag"],
    ) == (1, 0)


def test_match_across_a_gap() -> None:
    """Track 1 is missed in a frame where 2 is matched, then both 7 and 8 overlap it: motmetrics
    repeats 7."""
    truth = TrackedBoxes(
        np.array([0, 1, 1, 2]),
        np.array([1, 1, 2, 1]),
        box_at([0, 0, 100, 0]),
        np.zeros(4, np.int64),
    )
    results = TrackedBoxes(
        np.array([0, 1, 2, 2]),
        np.array([7, 9, 7, 8]),
        box_at([0, 100, 2, 0]),
        np.zeros(4, np.int64),
    )
    similarity = Similarity.of(truth, results)
    assert (
        motmetrics_figures({"a": similarity}).combined["idsw"],
        track_range_figures(similarity)["idsw"],
    ) == (0, 1)


def box_at(x_px: list[float]) -> np.ndarray:
    x = np.array(x_px, np.float64)
    return np.stack([x, 0 * x, x + 10, 0 * x + 10], axis=1)


def test_sequence_without_matches() -> None:
    figures = motmetrics_figures(
        {
            "none": similarity_of([(0, 1)], []),
            "some": similarity_of([(0, 1), (1, 1)], [(0, 7), (1, 7)]),
        }
    )
    assert math.isnan(figures.sequences["none"]["motp"])
    assert figures.combined["motp"] == 100.0
    assert figures.combined["fn"] == 1
