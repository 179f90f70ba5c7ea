import json
from dataclasses import replace

import numpy as np
import pytest

from track_range.foundation.files.output_files import write_json
from track_range.ranging.truth.truth import Truth
from track_range.results.rows.columns import column_names
from track_range.results.rows.rows import Rows
from track_range.results.summary import (
    frame_spans,
    matched_truth,
    range_scores,
    stage_times_ms,
    track_scores,
)

BOX = np.array([10.0, 10.0, 40.0, 40.0])


def columns_of(n=10, *, fused=20.0, name="car"):
    """One track over n frames; mono only every other frame."""
    columns = {key: np.full(n, np.nan) for key in column_names()}
    columns |= {
        "frame": np.arange(n, dtype=float),
        "track_id": np.ones(n),
        "class": np.full(n, name),
    }
    columns |= {
        f"{edge}_px": np.full(n, value)
        for edge, value in zip(("x1", "y1", "x2", "y2"), BOX, strict=True)
    }
    columns |= {
        "fused_m": np.full(n, fused),
        "fused_sigma_m": np.ones(n),
        "mono_sigma_m": np.ones(n),
    }
    return Rows(columns | {"mono_m": np.where(np.arange(n) % 2, np.nan, 22.0)})


def truth_of(n=10, *, kitti_type="Car", class_id=2, distance_m=20.0, closing_mps=np.nan):
    metres, speeds = np.full(n, distance_m), np.full(n, closing_mps)
    ones = np.ones(n, np.int64)
    return Truth(
        np.arange(n),
        ones,
        np.full(n, kitti_type),
        class_id * ones,
        np.tile(BOX, (n, 1)),
        metres,
        speeds,
    )


def test_methods_and_common_coverage():
    columns = columns_of(fused=21.0)
    scores = range_scores(columns, matched_truth(columns, truth_of()), ("mono", "fused"))
    mono, fused = scores["methods"]["mono"], scores["methods"]["fused"]
    assert (mono["n"], mono["coverage"]) == (5, 0.5)
    assert mono["mean_relative_error_pct"] == pytest.approx(10.0)
    assert fused["bias_pct"] == pytest.approx(5.0)
    assert scores["common"]["fused"]["n"] == 5
    assert set(scores["methods"]) == {"mono", "fused"}


def test_closing_speed_against_truth():
    speeds = {"closing_mps": np.full(10, 3.0), "closing_sigma_mps": np.full(10, 0.4)}
    columns = columns_of().with_columns(speeds)
    columns["closing_mps"][:5] = np.nan
    closing = range_scores(columns, matched_truth(columns, truth_of(closing_mps=2.5)), ("fused",))[
        "closing"
    ]
    assert (closing["coverage"], closing["n"]) == (0.5, 5)
    assert (closing["median_error_mps"], closing["bias_mps"]) == (0.5, 0.5)
    assert (closing["within_1_sigma"], closing["within_2_sigma"]) == (0.0, 1.0)


@pytest.mark.parametrize(
    "truth",
    [
        truth_of(),  # without speeds
        truth_of(closing_mps=2.5, class_id=-1),  # of no road class
        # too near for distances to be scored, so for speeds too
        truth_of(closing_mps=2.5, distance_m=4.0),
        truth_of(closing_mps=2.5, distance_m=np.nan),
    ],
)
def test_no_closing_speed_where_nothing_is_scored(truth):
    assert "closing" not in range_scores(
        columns_of(), matched_truth(columns_of(), truth), ("fused",)
    )


def test_coverage_without_truth():
    scores = range_scores(columns_of(), None, ("mono", "fused"))
    assert scores["methods"]["mono"]["coverage"] == 0.5
    assert scores["methods"]["mono"]["bias_pct"] is None
    assert scores["common"] == {}


def test_mot_metrics_and_ignored_classes():
    frames = np.arange(10)
    perfect = track_scores(columns_of(), truth_of(), frames)
    assert (perfect["n"], perfect["mota"], perfect["idf1"], perfect["idsw"]) == (1, 100.0, 100.0, 0)
    van = track_scores(columns_of(), truth_of(kitti_type="Van", class_id=-1), frames)
    assert van["fp"] == 0  # vans are ignored
    assert track_scores(columns_of(), None, frames)["mota"] is None


def test_objects_below_25_px_do_not_count():
    low = replace(truth_of(), xyxy_px=np.array([[10.0, 10.0, 40.0, 34.9]] * 5 + [BOX] * 5))
    tracked = track_scores(columns_of(), low, np.arange(10))
    assert (tracked["n_truth_boxes"], tracked["fn"], tracked["fp"]) == (5, 0, 0)
    left, right = np.full(10, 100.0), np.full(10, 120.0)
    for bottom, n_false in ((34.9, 0), (35.1, 10)):
        edges = {"x1_px": left, "x2_px": right, "y2_px": np.full(10, bottom)}
        stray = columns_of().with_columns(edges)
        assert track_scores(stray, truth_of(), np.arange(10))["fp"] == n_false


def test_truth_of_other_frames_does_not_count():
    columns = columns_of().select(slice(4))
    assert track_scores(columns, truth_of(), np.arange(4))["mota"] == 100.0
    assert track_scores(columns, truth_of(), np.arange(10))["fn"] == 6


def test_unlabelled_classes_are_no_false_positives():
    lights = columns_of(name="traffic light")
    assert track_scores(lights, truth_of(), np.arange(10))["fp"] == 0


def test_times_and_the_file(tmp_path):
    assert stage_times_ms({"read": 1.0}, 500) == {"read": 2.0}
    assert stage_times_ms({"read": 0.0}, 0) == {"read": 0.0}
    write_json(tmp_path / "summary.json", {"a": None})
    assert json.loads((tmp_path / "summary.json").read_text()) == {"a": None}
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "summary.json", {"a": float("nan")})


def test_truth_without_rows():
    truth = truth_of(0)
    columns = columns_of()
    scores = range_scores(columns, matched_truth(columns, truth), ("mono", "fused"))
    assert scores["methods"]["fused"]["n"] == 0
    assert "closing" not in scores
    assert track_scores(columns, truth, np.arange(10))["n_truth_boxes"] == 0


@pytest.mark.parametrize(
    ("frames", "every", "spans"),
    [
        ([], 1, None),
        ([7, 8, 9], 1, None),
        ([0, 2, 4], 2, None),
        ([7, 8, 11, 12, 13, 15], 1, [[7, 8], [11, 13], [15, 15]]),
        ([0, 2, 6], 2, [[0, 2], [6, 6]]),
    ],
)
def test_spans_of_processed_frames(frames, every, spans):
    assert frame_spans(np.array(frames, np.int64), every) == (
        {} if spans is None else {"processed_frames": spans}
    )
