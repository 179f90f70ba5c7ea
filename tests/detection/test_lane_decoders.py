"""Decoders of lane networks on tensors made from known lines, by the rules of the networks'
labels."""

import numpy as np
import pytest

from track_range.detection.lanes.nets import (
    ROW_ANCHORS,
    curve_points,
    is_row_anchor_shape,
    mask_points,
    row_anchor_points,
)

LINES = (
    lambda y: 700 - 1.5 * y,
    lambda y: 500 - 0.6 * y,
    lambda y: 330 + 0.5 * y,
    lambda y: 300 + 1.5 * y,
)


def row_anchor_tensor(n_cells, anchors, lines=LINES, *, width=800):
    """One-hot cells int(x / cell width) as in the published labels; the last cell if a line is
    outside."""
    scores = np.zeros((n_cells + 1, len(anchors), 4), np.float32)
    cell_px = (width - 1) / (n_cells - 1)
    for line, x_of in enumerate(lines):
        for row, y in enumerate(anchors):
            x = x_of(y)
            scores[int(x // cell_px) if 0 <= x < width else n_cells, row, line] = 50.0
    return scores


@pytest.mark.parametrize(("n_cells", "n_rows"), [(200, 18), (100, 56)], ids=["CULane", "TuSimple"])
def test_row_anchors_reproduce_their_lines(n_cells, n_rows):
    xy, line = row_anchor_points(row_anchor_tensor(n_cells, ROW_ANCHORS[n_rows]), (288, 800))
    half_cell_px = 799 / (n_cells - 1) / 2
    for number, x_of in enumerate(LINES):
        y = ROW_ANCHORS[n_rows]
        inside = (x_of(y) >= 0) & (x_of(y) < 800)
        x_px, y_px = xy[line == number].T
        assert y_px == pytest.approx(y[inside])
        assert np.abs(x_px - x_of(y[inside])).max() <= half_cell_px + 1e-6
        assert abs((x_px - x_of(y[inside])).mean()) < half_cell_px / 2  # no shift of half a cell


def test_row_anchor_between_two_cells():
    scores = np.full((201, 18, 4), -50.0, np.float32)
    scores[200] = 50.0
    scores[[100, 101], 3, 1] = 60.0  # equally likely: x is the border between them, 101 cell widths
    xy, line = row_anchor_points(scores, (288, 800))
    assert line.tolist() == [1]
    assert xy[0] == pytest.approx([101 * 799 / 199, 150.0])


def test_row_anchors_in_another_input_size():
    xy, _ = row_anchor_points(row_anchor_tensor(200, ROW_ANCHORS[18], width=1640), (590, 1640))
    assert xy[:, 1].max() == pytest.approx(287 / 288 * 590)


def test_row_anchor_shapes():
    assert is_row_anchor_shape((1, 201, 18, 4))
    assert is_row_anchor_shape((1, 101, 56, 4))
    assert not is_row_anchor_shape((1, 2, 360, 640))
    assert not is_row_anchor_shape((1, 201, 18, 2))
    assert not is_row_anchor_shape((201, 18, 4))


def test_middles_of_the_runs_of_a_mask():
    scores = np.zeros((2, 64, 128), np.float32)
    scores[1, 10, 20:25] = 1.0  # columns 20..24: 22
    scores[1, 10, 60] = 1.0
    scores[1, 10, 126:] = 1.0  # at the edge of the image: 126.5
    scores[1, 12, 30:60] = 1.0  # too wide for a line
    xy, line = mask_points(scores)
    assert xy.tolist() == [[22.0, 10.0], [60.0, 10.0], [126.5, 10.0]]
    assert line.tolist() == [-1, -1, -1]


@pytest.mark.parametrize(
    ("road", "paint"), [(0.1, 0.9), (-4.0, 3.0)], ids=["probabilities", "logits"]
)
def test_mask_with_one_channel(road, paint):
    scores = np.full((1, 64, 128), road, np.float32)
    scores[0, 8, 40:43] = paint
    assert mask_points(scores)[0].tolist() == [[41.0, 8.0]]


def test_curves_by_hand():
    logits = np.array([[0.0, 4.0], [4.0, 0.0], [0.0, 3.0]], np.float32)
    curves = np.zeros((3, 8), np.float32)
    curves[0] = [0.4, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.25]  # x = y - 0.25
    curves[2] = [0.4, 1.0, 0.0, 0.1, 0.2, 0.5, 0.0, 0.0]  # x = 0.2 / (y - 0.1) + 0.5
    xy, line = curve_points(logits, curves, (100, 200))
    assert set(line.tolist()) == {0, 2}  # the second one is not a line
    u, v = ((xy + 0.5) / [200, 100]).T
    assert u[line == 0] == pytest.approx(v[line == 0] - 0.25, abs=1e-6)
    assert u[line == 2] == pytest.approx(0.2 / (v[line == 2] - 0.1) + 0.5, abs=1e-6)
    assert v.max() == pytest.approx(1.0)
    assert v.min() > 0.4


def test_curve_points_outside_are_dropped():
    curves = np.array(
        [[0.2, 1.0, 0.0, 0.4, 0.1, 0.5, 0.0, 0.0], [0.2, 1.0, 0, 0, 0, 5.0, 0, 0]], np.float32
    )
    xy, line = curve_points(np.array([[0, 9], [0, 9]], np.float32), curves, (100, 100))
    assert set(line.tolist()) == {0}
    assert xy[:, 1].min() > 39.5  # nothing above the pole at 0.4
    assert np.isfinite(xy).all()


def test_no_markings():
    assert mask_points(np.zeros((2, 64, 64), np.float32))[0].shape == (0, 2)
    assert curve_points(np.array([[9.0, 0.0]], np.float32), np.zeros((1, 8), np.float32), (9, 9))[
        0
    ].shape == (0, 2)
    no_lines = np.zeros((101, 56, 4), np.float32)
    no_lines[-1] = 9.0
    assert row_anchor_points(no_lines, (288, 800))[0].shape == (0, 2)
