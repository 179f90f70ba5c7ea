"""Boxes as (N, 4) arrays: layouts, IoU, and non-maximum suppression without a loop over boxes' pairs."""

from __future__ import annotations

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray

_NMS_BLOCK = 128
"""Boxes compared with each other at once: larger wastes comparisons, smaller wastes calls."""


def xyxy_from_cxcywh(cxcywh: FloatArray) -> FloatArray:
    """(..., 4) centre x, centre y, width, height -> left, top, right, bottom."""
    half = cxcywh[..., 2:] / 2
    return np.concatenate([cxcywh[..., :2] - half, cxcywh[..., :2] + half], axis=-1)


def area_px2(xyxy_px: FloatArray) -> FloatArray:
    """(N,) areas; 0 for a box turned inside out."""
    size = np.maximum(xyxy_px[:, 2:] - xyxy_px[:, :2], 0.0)
    return np.asarray(size[:, 0] * size[:, 1])


def intersection_px2(a_xyxy_px: FloatArray, b_xyxy_px: FloatArray) -> FloatArray:
    """(N, M) areas that each box of `a` (N, 4) shares with each of `b` (M, 4)."""
    # edge by edge, on arrays without gaps, in place: a fifth of the time of one (N, M, 2) expression
    left, top, right, bottom = np.ascontiguousarray(a_xyxy_px.T)[:, :, None]
    other_left, other_top, other_right, other_bottom = np.ascontiguousarray(b_xyxy_px.T)
    width, height = np.minimum(right, other_right), np.minimum(bottom, other_bottom)
    width -= np.maximum(left, other_left)
    height -= np.maximum(top, other_top)
    np.maximum(width, 0.0, out=width)
    np.maximum(height, 0.0, out=height)
    width *= height
    return np.asarray(width)


def iou(a_xyxy_px: FloatArray, b_xyxy_px: FloatArray) -> FloatArray:
    """(N, M) intersection over union; 0 where both boxes are empty."""
    shared = intersection_px2(a_xyxy_px, b_xyxy_px)
    union = np.add(area_px2(a_xyxy_px)[:, None], area_px2(b_xyxy_px))
    union -= shared
    return np.divide(shared, union, out=np.zeros_like(shared), where=union > 0)


def share_inside(a_xyxy_px: FloatArray, b_xyxy_px: FloatArray) -> FloatArray:
    """(N, M) share of each box of `a` that lies inside each of `b`; 0 for an empty box."""
    shared = intersection_px2(a_xyxy_px, b_xyxy_px)
    area = area_px2(a_xyxy_px)[:, None]
    return np.divide(shared, area, out=np.zeros_like(shared), where=area > 0)


def are_valid_boxes(xyxy_px: FloatArray) -> BoolArray:
    """(N,) which boxes are finite and have a positive width and height."""
    finite = np.isfinite(xyxy_px).all(axis=1)
    return np.asarray(finite & (xyxy_px[:, 2] > xyxy_px[:, 0]) & (xyxy_px[:, 3] > xyxy_px[:, 1]))


def nms(
    xyxy_px: FloatArray, score: FloatArray, class_id: IntArray, *, max_iou: float, max_boxes: int | None = None
) -> IntArray:
    """Indices of the boxes kept, best score first: greedy suppression within each class, ended at `max_boxes`.

    Of equal scores the earlier comes first. Boxes go block by block in the order of their scores, so that with a limit
    only the best of thousands are ever looked at.
    """
    order = np.argsort(-score, kind="stable")
    columns = _columns_apart(xyxy_px, class_id)[:, order]
    limit = len(order) if max_boxes is None else max_boxes
    kept = np.zeros(0, np.int64)
    for start in range(0, len(order), _NMS_BLOCK):
        if len(kept) >= limit:
            break
        block = columns[:, start : start + _NMS_BLOCK]
        rest = np.flatnonzero(~_overlap(columns[:, kept], block, max_iou=max_iou).any(axis=0))
        block = block[:, rest]
        kept = np.concatenate([kept, start + rest[_survivors(_overlap(block, block, max_iou=max_iou))]])
    return np.asarray(order[kept[:limit]])


def _columns_apart(xyxy_px: FloatArray, class_id: IntArray) -> FloatArray:
    """(5, N) left, top, right, bottom and area, shifted sideways so that boxes of different classes cannot meet."""
    span_px = float(np.ptp(xyxy_px)) + 1.0 if len(xyxy_px) else 0.0
    left, top, right, bottom = xyxy_px.T
    shift_px = class_id * span_px
    return np.stack([left + shift_px, top, right + shift_px, bottom, area_px2(xyxy_px)])


def _overlap(a: FloatArray, b: FloatArray, *, max_iou: float) -> BoolArray:
    """(N, M) whether boxes of `a` (5, N) and `b` (5, M) have IoU > max_iou.

    IoU > t is shared > t / (1 + t) * (area a + area b): no division, and a third of `iou`'s time.
    """
    width = np.minimum(a[2][:, None], b[2])
    width -= np.maximum(a[0][:, None], b[0])
    height = np.minimum(a[3][:, None], b[3])
    height -= np.maximum(a[1][:, None], b[1])
    np.maximum(width, 0.0, out=width)
    width *= height  # where the height is negative, so is the product: below any area
    return np.asarray(width > max_iou / (1.0 + max_iou) * (a[4][:, None] + b[4]))


def _survivors(overlaps: BoolArray) -> BoolArray:
    """(N,) which of N boxes, best first, survive, given which pairs overlap too much.

    "Survives = no better survivor overlaps it" is iterated from "all survive": after k rounds the first k are final,
    and it ends as soon as nothing changes, in practice after a few.
    """
    better_overlaps = np.triu(overlaps, 1)
    survives: BoolArray = np.ones(len(overlaps), np.bool_)
    while True:
        now = np.logical_not(better_overlaps[survives].any(axis=0))
        if np.array_equal(now, survives):
            return survives
        survives = now
