import numpy as np
import pytest

from track_range.detection.training.networks.registry import (
    as_text,
    by_head,
    kmeans_anchors,
    mean_best_iou,
    shape_iou,
)


def test_iou_of_shapes_by_hand():
    assert shape_iou(
        np.array([[4.0, 2.0]]), np.array([[2.0, 2.0], [2.0, 4.0], [8.0, 2.0]])
    ) == pytest.approx(np.array([[0.5, 4 / 12, 0.5]]))


def test_clusters_of_boxes_are_found():
    rng = np.random.default_rng(1)
    centres = np.array([[10.0, 20.0], [60.0, 30.0], [200.0, 150.0]])
    sizes = np.concatenate([centre * rng.uniform(0.95, 1.05, (50, 2)) for centre in centres])
    anchors = kmeans_anchors(sizes, 3, np.random.default_rng(0))
    assert anchors == pytest.approx(centres, rel=0.03)
    assert mean_best_iou(sizes, anchors) > 0.93


def test_more_anchors_fit_better():
    rng = np.random.default_rng(2)
    sizes = np.exp(rng.normal(3.5, 0.8, (500, 2)))
    fits = [
        mean_best_iou(sizes, kmeans_anchors(sizes, k, np.random.default_rng(0))) for k in (2, 4, 9)
    ]
    assert fits == sorted(fits)
    again = kmeans_anchors(sizes, 9, np.random.default_rng(0))
    assert np.array_equal(again, kmeans_anchors(sizes, 9, np.random.default_rng(0)))


def test_fewer_boxes_than_anchors():
    with pytest.raises(ValueError, match="9 anchors"):
        kmeans_anchors(np.ones((40, 2)), 9, np.random.default_rng(0))


def test_anchor_groups_and_their_text():
    anchors = by_head(np.array([[1.0, 2], [3, 4], [5, 6], [7.5, 8]]), 2)
    assert anchors == (((1.0, 2.0), (3.0, 4.0)), ((5.0, 6.0), (7.5, 8.0)))
    assert as_text(anchors) == "1,2 3,4 / 5,6 7.5,8"
