from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tracking.history import BoxHistory, FillGates, begun, filled, median_prediction

IMAGE_HW = (375, 1242)


def seen(boxes: list[list[float]], times_s: list[float], *, n_kept: int = 6) -> BoxHistory:
    """One track seen as these boxes in frames without a break."""
    history = begun(np.array([boxes[0]]), times_s[0], n_kept=n_kept)
    for box, before_s, time_s in zip(boxes[1:], times_s, times_s[1:], strict=False):
        history = history.appended(np.array([box]), time_s, previous_s=before_s)
    return history


def steady(n: int, *, step_px: float = 5.0, x_px: float = 100.0, dt_s: float = 0.1) -> BoxHistory:
    boxes = [[x_px + step_px * i, 50.0, x_px + 60.0 + step_px * i, 90.0] for i in range(n)]
    return seen(boxes, [dt_s * i for i in range(n)])


def test_two_boxes_give_the_papers_prediction() -> None:
    # l(t) = l(t-1) + (l(t-1) - l(t-2))
    box, _ = median_prediction(seen([[10, 10, 30, 50], [14, 11, 36, 53]], [0.0, 0.1]), 0.2)
    np.testing.assert_allclose(box, [[18, 12, 42, 56]])


def test_one_bad_box_does_not_bend_the_prediction() -> None:
    x1 = [10, 14, 18, 40, 26, 30]  # the fourth is wrong; steps 4, 4, 22, -14, 4
    box, spread = median_prediction(seen([[x, 0, x + 20, 40] for x in x1], [0.1 * i for i in range(6)]), 0.6)
    np.testing.assert_allclose(box, [[34, 0, 54, 40]])
    # deviations of the steps from 4: 0, 0, 18, 18, 0: their median is 0
    assert spread[0] == pytest.approx(0.0, abs=1e-12)


def test_spread_by_hand() -> None:
    x1 = [10, 14, 20, 22]  # steps 4, 6, 2: median 4, deviations 0, 2, 2: median 2 px in 0.1 s
    _, spread = median_prediction(seen([[x, 0, x + 20, 40] for x in x1], [0.0, 0.1, 0.2, 0.3]), 0.5)
    assert spread[0] == pytest.approx(2 * 2 / 40)


@given(times_s=st.lists(st.floats(0.01, 0.5), min_size=2, max_size=8), missing_s=st.floats(0.0, 1.0))
@settings(deadline=None)
def test_a_steady_box_is_predicted_exactly_at_any_times(times_s: list[float], missing_s: float) -> None:
    t = np.cumsum(times_s)
    motion = np.array([40.0, -3.0, 44.0, 5.0])
    start = np.array([100.0, 50.0, 140.0, 130.0])
    history = seen([(start + motion * s).tolist() for s in t], t.tolist())
    box, spread = median_prediction(history, float(t[-1] + missing_s))
    np.testing.assert_allclose(box[0], start + motion * (t[-1] + missing_s), rtol=1e-6)
    assert spread[0] < 1e-6


def test_seen_once_nothing_is_known() -> None:
    box, spread = median_prediction(seen([[10, 10, 30, 50]], [0.0]), 0.1)
    assert np.isnan(box).all()
    assert np.isnan(spread).all()


def test_old_boxes_are_forgotten_and_a_break_restarts_the_run() -> None:
    history = steady(8)
    assert history.n_running.tolist() == [8]
    np.testing.assert_allclose(history.time_s[0], [0.2, 0.3, 0.4, 0.5, 0.6, 0.7])
    late = history.appended(history.last_xyxy_px, 1.0, previous_s=0.9)
    assert late.n_running.tolist() == [1]
    assert late.last_s.tolist() == [1.0]


def test_a_steady_track_is_filled() -> None:
    rows, boxes = filled(steady(6), 0.6, gates=FillGates(), image_hw=IMAGE_HW)
    assert rows.tolist() == [0]
    np.testing.assert_allclose(boxes, [[130.0, 50.0, 190.0, 90.0]])


@pytest.mark.parametrize(
    ("history", "time_s", "gates"),
    [
        (steady(6), 0.8, FillGates(max_missing_s=0.25)),  # 0.3 s missing
        (steady(4), 0.4, FillGates(min_running=5)),
        (steady(1), 0.1, FillGates(min_running=2)),  # no step is known
        (seen([[x, 0, x + 20, 40] for x in (10, 30, 20, 50, 30, 70)], [0.1 * i for i in range(6)]), 0.6, FillGates()),
        (steady(6, x_px=1154.0), 0.6, FillGates()),  # right edge would be at 1244
        (steady(6, x_px=22.0, step_px=-4.0), 0.6, FillGates()),  # left edge would be at -2
    ],
    ids=["too long", "too new", "seen once", "restless", "leaves right", "leaves left"],
)
def test_gates_close(history: BoxHistory, time_s: float, gates: FillGates) -> None:
    assert filled(history, time_s, gates=gates, image_hw=IMAGE_HW)[0].tolist() == []


def test_a_box_predicted_inside_out_is_not_filled() -> None:
    history = seen([[10, 0, 110 - 20 * i, 40] for i in range(6)], [0.1 * i for i in range(6)])  # width 0 at 0.5 s
    shrinking = BoxHistory(history.xyxy_px[:, :-1], history.time_s[:, :-1], history.n_running)
    assert filled(shrinking, 0.6, gates=FillGates(), image_hw=None)[0].tolist() == []


def test_without_an_image_the_border_is_not_known() -> None:
    assert filled(steady(6, x_px=1154.0), 0.6, gates=FillGates(), image_hw=None)[0].tolist() == [0]


def test_tracks_do_not_mix() -> None:
    both = steady(6).joined(steady(2, step_px=-3.0))
    alone, _ = median_prediction(steady(2, step_px=-3.0), 0.6)
    np.testing.assert_array_equal(median_prediction(both, 0.6)[0][1:], alone)
    rows, boxes = filled(both.select(np.array([1, 0])), 0.6, gates=FillGates(), image_hw=IMAGE_HW)
    assert rows.tolist() == [1]
    np.testing.assert_array_equal(boxes, median_prediction(both, 0.6)[0][:1])
    assert len(both.select(np.array([False, True]))) == 1


def test_no_tracks() -> None:
    rows, boxes = filled(begun(np.zeros((0, 4)), 0.0, n_kept=6), 0.1, gates=FillGates(), image_hw=IMAGE_HW)
    assert rows.shape == (0,)
    assert boxes.shape == (0, 4)


@pytest.mark.parametrize("wrong", [{"min_running": 1}, {"n_kept": 1}])
def test_gates_that_cannot_work_are_refused(wrong: dict[str, int]) -> None:
    with pytest.raises(ValueError, match="min_running and n_kept: at least 2 wanted"):
        FillGates(**wrong)
