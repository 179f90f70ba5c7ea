import numpy as np
from hypothesis import given, settings, strategies as st

from track_range.detection.boxes import (
    are_valid_boxes,
    area_px2,
    fraction_inside,
    iou,
    nms,
    xyxy_from_cxcywh,
)

MAX_IOU = 0.4987  # not a ratio that hypothesis draws, so that float32 and float64 agree
EDGE = st.floats(-50, 50, allow_nan=False)
BOXES = st.lists(
    st.tuples(EDGE, EDGE, st.floats(0.5, 40), st.floats(0.5, 40)), min_size=1, max_size=12
).map(lambda rows: np.array([[x, y, x + w, y + h] for x, y, w, h in rows]))


def test_iou_by_hand():
    a = np.array([[0.0, 0.0, 2.0, 2.0]])
    b = np.array([[1.0, 1.0, 3.0, 3.0], [0.0, 0.0, 2.0, 2.0], [5.0, 5.0, 6.0, 6.0]])
    np.testing.assert_allclose(iou(a, b), [[1 / 7, 1.0, 0.0]])
    np.testing.assert_allclose(fraction_inside(a, b), [[0.25, 1.0, 0.0]])
    assert iou(np.zeros((1, 4)), np.zeros((1, 4))) == 0.0


@settings(deadline=None)
@given(BOXES, BOXES)
def test_iou_is_symmetric_and_at_most_one(a, b):
    overlap = iou(a, b)
    np.testing.assert_allclose(overlap, iou(b, a).T)
    assert ((overlap >= 0) & (overlap <= 1 + 1e-12)).all()


@settings(deadline=None)
@given(BOXES, st.integers(0, 5))
def test_nms_is_idempotent_and_equals_the_greedy_rule(boxes, seed):
    score = np.random.default_rng(seed).permutation(len(boxes)) / len(boxes)
    class_id = np.arange(len(boxes)) % 2
    kept = nms(boxes, score, class_id, max_iou=MAX_IOU)
    again = nms(boxes[kept], score[kept], class_id[kept], max_iou=MAX_IOU)
    assert again.tolist() == list(range(len(kept)))
    assert kept.tolist() == greedy(boxes, score, class_id)


def test_nms_keeps_classes_apart_left_of_the_image():
    box = [-20.0, -20.0, -10.0, -10.0]
    kept = nms(np.array([box, box]), np.array([0.9, 0.8]), np.array([0, 1]), max_iou=0.5)
    assert kept.tolist() == [0, 1]


def greedy(boxes, score, class_id):
    kept: list[int] = []
    for i in np.argsort(-score, kind="stable"):
        competitors = [j for j in kept if class_id[j] == class_id[i]]
        if not competitors or iou(boxes[[i]], boxes[competitors]).max() <= MAX_IOU:
            kept.append(int(i))
    return kept


def test_layout_and_validity():
    np.testing.assert_allclose(xyxy_from_cxcywh(np.array([[5.0, 6.0, 4.0, 2.0]])), [[3, 5, 7, 7]])
    boxes = np.array(
        [[0, 0, 1, 1], [0, 0, 0, 1], [3, 3, 1, 5], [0, np.nan, 1, 1], [0, 0, np.inf, 1]]
    )
    assert are_valid_boxes(boxes).tolist() == [True, False, False, False, False]
    assert area_px2(boxes[:3]).tolist() == [1.0, 0.0, 0.0]


def test_corners_from_centres_for_any_leading_shape():
    cxcywh = np.array([[[10.0, 20.0, 4.0, 6.0]], [[0.0, 1.0, 2.0, 8.0]]])
    np.testing.assert_array_equal(
        xyxy_from_cxcywh(cxcywh), [[[8.0, 17.0, 12.0, 23.0]], [[-1.0, -3.0, 1.0, 5.0]]]
    )
