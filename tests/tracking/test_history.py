from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.foundation.arrays import FloatArray
from track_range.tracking.history import (
    BoxHistory,
    Form,
    PredictionGates,
    initiate,
    median_prediction,
    predict_missing,
    smoothed,
)

BORDER_XYXY_PX = np.array([0.0, 0.0, 1241.0, 374.0])
AT_ONCE = PredictionGates(min_hit_streak_visible=5)
"""Gates that predict a visible box as early as an occluded one."""


def history_of(boxes: list[list[float]], times_s: list[float], *, n_kept: int = 6) -> BoxHistory:
    """History of one track with these boxes in successive frames."""
    history = initiate(np.array([boxes[0]]), times_s[0], n_kept=n_kept)
    for box, time_s in zip(boxes[1:], times_s[1:], strict=True):
        history.append(np.array([0]), np.array([box]), time_s, is_streak=np.array([True]))
    return history


def steady(n: int, *, step_px: float = 5.0, x_px: float = 100.0, dt_s: float = 0.1) -> BoxHistory:
    boxes = [[x_px + step_px * i, 50.0, x_px + 60.0 + step_px * i, 90.0] for i in range(n)]
    return history_of(boxes, [dt_s * i for i in range(n)])


def test_prediction_from_two_boxes_by_hand() -> None:
    # l(t) = l(t-1) + (l(t-1) - l(t-2))
    box, _ = median_prediction(history_of([[10, 10, 30, 50], [14, 11, 36, 53]], [0.0, 0.1]), 0.2)
    np.testing.assert_allclose(box, [[18, 12, 42, 56]])


def test_prediction_is_robust_to_one_bad_box() -> None:
    x1 = [10, 14, 18, 40, 26, 30]  # the fourth is wrong; steps 4, 4, 22, -14, 4
    box, deviation = median_prediction(
        history_of([[x, 0, x + 20, 40] for x in x1], [0.1 * i for i in range(6)]), 0.6
    )
    np.testing.assert_allclose(box, [[34, 0, 54, 40]])
    # deviations of the steps from 4: 0, 0, 18, 18, 0: their median is 0
    assert deviation[0] == pytest.approx(0.0, abs=1e-12)


def test_deviation_by_hand() -> None:
    x1 = [10, 14, 20, 22]  # steps 4, 6, 2: median 4, deviations 0, 2, 2: median 2 px in 0.1 s
    _, deviation = median_prediction(
        history_of([[x, 0, x + 20, 40] for x in x1], [0.0, 0.1, 0.2, 0.3]), 0.5
    )
    assert deviation[0] == pytest.approx(2 * 2 / 40)


def test_step_of_medians_by_hand() -> None:
    # k = 3 of left edges 10, 14, 40, 22, 26: l(t-1) = median(40, 22, 26) = 26, l(t-2) = median(14,
    # 40, 22) = 22
    history = history_of(
        [[x, 0, x + 20, 40] for x in (10, 14, 40, 22, 26)], [0.0, 0.1, 0.2, 0.3, 0.4], n_kept=4
    )
    box, deviation = median_prediction(history, 0.5, form="step-of-medians")
    np.testing.assert_allclose(box, [[30, 0, 50, 40]])
    # the last steps are 26, -18, 4; deviations from the step of the medians, 4 px: 22, 22, 0,
    # median 22
    assert deviation[0] == pytest.approx(22 / 40)
    np.testing.assert_allclose(smoothed(history), [[26, 0, 46, 40]])


def test_both_forms_agree_for_two_boxes() -> None:
    history = history_of([[10, 10, 30, 50], [14, 11, 36, 53]], [0.0, 0.1], n_kept=2)
    for form in get_args(Form):
        np.testing.assert_allclose(
            median_prediction(history, 0.2, form=form)[0], [[18, 12, 42, 56]]
        )
    np.testing.assert_allclose(smoothed(history), [[14, 11, 36, 53]])


@given(n=st.integers(2, 9), step_px=st.floats(-20, 20), dt_s=st.floats(0.02, 0.5))
@settings(deadline=None)
def test_step_of_medians_lags_by_half_the_buffer(n: int, step_px: float, dt_s: float) -> None:
    history = steady(n, step_px=step_px, dt_s=dt_s)
    steps, medians = (median_prediction(history, n * dt_s, form=form)[0] for form in get_args(Form))
    # frames between the middle of the newest boxes, at most 5, and the last
    lag = (min(n, 5) - 1) / 2
    np.testing.assert_allclose(steps[0, 0] - medians[0, 0], lag * step_px, atol=1e-6)
    np.testing.assert_allclose(
        smoothed(history)[0, 0], history.last_xyxy_px[0, 0] - lag * step_px, atol=1e-6
    )


def test_smoothed_box_of_short_and_long_histories() -> None:
    assert smoothed(steady(1))[0].tolist() == [100, 50, 160, 90]
    assert smoothed(steady(3))[0].tolist() == [105, 50, 165, 90]
    assert smoothed(steady(9))[0].tolist() == [130, 50, 190, 90]  # of the last 5 of 9 the third


@given(
    times_s=st.lists(st.floats(0.01, 0.5), min_size=2, max_size=8), missing_s=st.floats(0.0, 1.0)
)
@settings(deadline=None)
def test_prediction_is_exact_for_a_steady_box(times_s: list[float], missing_s: float) -> None:
    t = np.cumsum(times_s)
    motion = np.array([40.0, -3.0, 44.0, 5.0])
    start = np.array([100.0, 50.0, 140.0, 130.0])
    history = history_of([(start + motion * s).tolist() for s in t], t.tolist())
    box, deviation = median_prediction(history, float(t[-1] + missing_s))
    np.testing.assert_allclose(box[0], start + motion * (t[-1] + missing_s), rtol=1e-6)
    assert deviation[0] < 1e-6


@pytest.mark.parametrize("form", ["median-of-steps", "step-of-medians"])
def test_single_box_gives_nan(form: Form) -> None:
    box, deviation = median_prediction(history_of([[10, 10, 30, 50]], [0.0]), 0.1, form=form)
    assert np.isnan(box).all()
    assert np.isnan(deviation).all()


def test_append_drops_oldest_and_restarts_streak() -> None:
    history = steady(8)
    assert history.hit_streak.tolist() == [8]
    np.testing.assert_allclose(history.time_s[0], [0.2, 0.3, 0.4, 0.5, 0.6, 0.7])
    history.append(np.array([0]), history.last_xyxy_px, 1.0, is_streak=np.array([False]))
    assert history.hit_streak.tolist() == [1]
    assert history.last_s.tolist() == [1.0]


def test_append_changes_only_its_rows() -> None:
    both = steady(6).concatenate(steady(3))
    other = both.select(np.array([1]))
    both.append(np.array([0]), np.array([[1.0, 2.0, 3.0, 4.0]]), 0.9, is_streak=np.array([True]))
    assert both.last_xyxy_px[0].tolist() == [1, 2, 3, 4]
    assert both.hit_streak.tolist() == [7, 3]
    np.testing.assert_array_equal(both.xyxy_px[1:], other.xyxy_px)
    np.testing.assert_array_equal(both.time_s[1:], other.time_s)


def test_a_steady_track_is_predicted() -> None:
    rows, boxes = predict_missing(steady(6), 0.6, gates=AT_ONCE, border_xyxy_px=BORDER_XYXY_PX)
    assert rows.tolist() == [0]
    np.testing.assert_allclose(boxes, [[130.0, 50.0, 190.0, 90.0]])


@pytest.mark.parametrize(
    ("history", "time_s", "gates"),
    [
        # 0.3 s missing
        (steady(6), 0.8, PredictionGates(max_missing_s=0.25, min_hit_streak_visible=5)),
        (steady(4), 0.4, PredictionGates(min_hit_streak=5, min_hit_streak_visible=2)),
        (steady(14), 1.4, PredictionGates()),
        # no step is known
        (steady(1), 0.1, PredictionGates(min_hit_streak=2, min_hit_streak_visible=1)),
        (
            history_of(
                [[x, 0, x + 20, 40] for x in (10, 30, 20, 50, 30, 70)], [0.1 * i for i in range(6)]
            ),
            0.6,
            AT_ONCE,
        ),
        (steady(6, x_px=1154.0), 0.6, AT_ONCE),  # right edge would be at 1244
        (steady(6, x_px=1150.0), 0.6, AT_ONCE),  # right edge at 1240: nearer than 0.05 of 40 px
        (steady(6, x_px=22.0, step_px=-4.0), 0.6, AT_ONCE),  # left edge would be at -2
    ],
    ids="too long,too new,too new and visible,single box,unsteady,leaves right,too near,leaves "
    "left".split(","),
)
def test_gates_prevent_prediction(
    history: BoxHistory, time_s: float, gates: PredictionGates
) -> None:
    assert (
        predict_missing(history, time_s, gates=gates, border_xyxy_px=BORDER_XYXY_PX)[0].tolist()
        == []
    )


NEARER = np.array([[100.0, 60.0, 145.0, 120.0]])
"""Occludes (145 - 130) / 60 of the width and 30 / 40 of the height of the box predicted from
`steady(6)`."""


@pytest.mark.parametrize(
    ("others", "gates", "is_predicted"),
    [
        (NEARER, PredictionGates(min_occlusion=0.18), True),
        (NEARER, PredictionGates(min_occlusion=0.19), False),  # visible: 15 frames are required
        (
            NEARER - np.array([0, 40, 0, 40]),
            PredictionGates(min_occlusion=0.01),
            False,
        ),  # lower edge at 80 px, above 90: farther away
        # nearer, but without overlap
        (NEARER + np.array([0, 40, 0, 0]), PredictionGates(min_occlusion=0.01), False),
        # three that occlude the same part
        (np.repeat(NEARER, 3, axis=0), PredictionGates(min_occlusion=0.19), False),
        (np.array([[0.0, 0.0, 500.0, 300.0]]), PredictionGates(), True),  # fully occluded
        (None, PredictionGates(), False),
    ],
    ids="enough,too little,farther,no overlap,three equal,fully,single".split(","),
)
def test_an_occluded_box_is_predicted_sooner(
    others: FloatArray | None, gates: PredictionGates, is_predicted: bool
) -> None:
    rows, _ = predict_missing(steady(6), 0.6, gates=gates, others_xyxy_px=others)
    assert rows.tolist() == ([0] if is_predicted else [])


def test_visible_box_needs_a_longer_streak() -> None:
    assert predict_missing(steady(15), 1.5, gates=PredictionGates())[0].tolist() == [0]


def test_form_of_the_gates_is_used() -> None:
    by_form = [
        predict_missing(steady(15), 1.5, gates=PredictionGates(form=form))[1][0, 0]
        for form in get_args(Form)
    ]
    assert by_form == pytest.approx([175.0, 165.0])


def test_inverted_prediction_is_dropped() -> None:
    # width 0 at 0.5 s
    history = history_of([[10, 0, 110 - 20 * i, 40] for i in range(6)], [0.1 * i for i in range(6)])
    shrinking = BoxHistory(history.boxes[:, :-1], history.hit_streak)
    assert predict_missing(shrinking, 0.6, gates=AT_ONCE, border_xyxy_px=None)[0].tolist() == []


def test_unknown_border() -> None:
    assert predict_missing(steady(6, x_px=1154.0), 0.6, gates=AT_ONCE, border_xyxy_px=None)[
        0
    ].tolist() == [0]


def test_tracks_do_not_mix() -> None:
    both = steady(6).concatenate(steady(2, step_px=-3.0))
    alone, _ = median_prediction(steady(2, step_px=-3.0), 0.6)
    np.testing.assert_array_equal(median_prediction(both, 0.6)[0][1:], alone)
    rows, boxes = predict_missing(
        both.select(np.array([1, 0])), 0.6, gates=AT_ONCE, border_xyxy_px=BORDER_XYXY_PX
    )
    assert rows.tolist() == [1]
    np.testing.assert_array_equal(boxes, median_prediction(both, 0.6)[0][:1])
    assert len(both.select(np.array([False, True]))) == 1


def test_no_tracks() -> None:
    rows, boxes = predict_missing(
        initiate(np.zeros((0, 4)), 0.0, n_kept=6),
        0.1,
        gates=PredictionGates(),
        border_xyxy_px=BORDER_XYXY_PX,
    )
    assert rows.shape == (0,)
    assert boxes.shape == (0, 4)


@pytest.mark.parametrize("wrong", [{"min_hit_streak": 1}, {"n_kept": 1}])
def test_invalid_gates_are_refused(wrong: dict[str, int]) -> None:
    with pytest.raises(ValueError, match="at least 2"):
        PredictionGates(**wrong)


def test_unknown_form_is_refused() -> None:
    with pytest.raises(ValueError, match="form"):
        PredictionGates(form="mean")
