"""Boxes as (N, 4) arrays: layouts, IoU, and non-maximum suppression without a loop over boxes' pairs."""

from __future__ import annotations

import cv2
import numpy as np

from detection.detections import BoolArray, FloatArray, IntArray


def xyxy_from_cxcywh(cxcywh: FloatArray) -> FloatArray:
    """(N, 4) centre x, centre y, width, height -> left, top, right, bottom."""
    half = cxcywh[:, 2:] / 2
    return np.concatenate([cxcywh[:, :2] - half, cxcywh[:, :2] + half], axis=1)


def area_px2(xyxy_px: FloatArray) -> FloatArray:
    """(N,) areas; 0 for a box turned inside out."""
    size = np.maximum(xyxy_px[:, 2:] - xyxy_px[:, :2], 0.0)
    return np.asarray(size[:, 0] * size[:, 1])


def intersection_px2(a_xyxy_px: FloatArray, b_xyxy_px: FloatArray) -> FloatArray:
    """(N, M) areas that each box of `a` (N, 4) shares with each of `b` (M, 4)."""
    top_left = np.maximum(a_xyxy_px[:, None, :2], b_xyxy_px[None, :, :2])
    bottom_right = np.minimum(a_xyxy_px[:, None, 2:], b_xyxy_px[None, :, 2:])
    size = np.maximum(bottom_right - top_left, 0.0)
    return np.asarray(size[..., 0] * size[..., 1])


def iou(a_xyxy_px: FloatArray, b_xyxy_px: FloatArray) -> FloatArray:
    """(N, M) intersection over union; 0 where both boxes are empty."""
    shared = intersection_px2(a_xyxy_px, b_xyxy_px)
    union = area_px2(a_xyxy_px)[:, None] + area_px2(b_xyxy_px)[None, :] - shared
    return np.divide(shared, union, out=np.zeros_like(shared), where=union > 0)


def share_inside(a_xyxy_px: FloatArray, b_xyxy_px: FloatArray) -> FloatArray:
    """(N, M) share of each box of `a` that lies inside each of `b`; 0 for an empty box."""
    shared = intersection_px2(a_xyxy_px, b_xyxy_px)
    area = area_px2(a_xyxy_px)[:, None]
    return np.divide(shared, area, out=np.zeros_like(shared), where=area > 0)


def are_sound(xyxy_px: FloatArray) -> BoolArray:
    """(N,) which boxes are finite and have a positive width and height."""
    finite = np.isfinite(xyxy_px).all(axis=1)
    return np.asarray(finite & (xyxy_px[:, 2] > xyxy_px[:, 0]) & (xyxy_px[:, 3] > xyxy_px[:, 1]))


def nms(xyxy_px: FloatArray, score: FloatArray, class_id: IntArray, *, max_iou: float) -> IntArray:
    """Indices of the boxes kept, best score first: greedy suppression within each class.

    OpenCV's batched NMS does the work. It keeps classes apart by shifting each by a multiple of the largest coordinate,
    which does so only while none is negative.
    """
    if len(score) == 0:
        return np.zeros(0, np.int64)
    xywh = np.concatenate([xyxy_px[:, :2] - xyxy_px.min() + 1.0, xyxy_px[:, 2:] - xyxy_px[:, :2]], axis=1)
    kept = cv2.dnn.NMSBoxesBatched(xywh.tolist(), score.tolist(), class_id.tolist(), -1.0, max_iou)
    return np.asarray(kept, np.int64).reshape(-1)
