"""Where labels stand: beside their boxes, inside the image, and never on one another.

Each label tries its places in order, near ones first; near boxes choose first, and what is taken stays taken. A place
costs the area of boxes that it covers and its number in the list; the place a label had in the frame before costs
less, so that labels do not jump.
"""

from __future__ import annotations

import numpy as np

from detection.detections import FloatArray

BESIDE = ((0, 0, 0, -1), (1, 0, -1, -1), (0, 1, 0, 0), (1, 1, -1, 0), (1, 0, 0, 0), (0, 0, -1, 0), (0, 0, 0, 0))
AWAY = tuple((0, 0, across, -1 - up) for up in (0, 1, 2, 3, 4, -1, -2) for across in (0, 0.5, -0.5, 1, -1, 1.5, -1.5))
PLACES = np.array(BESIDE + AWAY, np.float64).reshape(-1, 2, 2)
"""(K, 2, 2) where a label may stand, best first: its upper left corner minus the box's, in box widths and heights,
then label widths and heights: above the box, below, beside it, inside it, then away from it in growing steps."""

_STEP_COST = 0.01
"""Of the label's own area: what one step down the list costs, beside the area of boxes covered."""

_HABIT = 0.1
"""Of the label's own area: how much better another place must be than the one of the frame before."""


def label_places(boxes: FloatArray, size_px: FloatArray, image_px: tuple[int, int]) -> FloatArray:
    """(N, K, 4) places for labels of (N, 2) widths and heights at (N, 4) boxes, best first, in an image (W, H)."""
    spans = np.stack([boxes[:, 2:] - boxes[:, :2], size_px], axis=1)
    corner = boxes[:, None, :2] + np.einsum("kij,nij->nkj", PLACES, spans)
    corner = np.clip(corner, 0.0, np.maximum(np.array(image_px) - size_px, 0.0)[:, None]).round()
    return np.concatenate([corner, corner + size_px[:, None]], axis=2)


def shared_areas(places: FloatArray, others: FloatArray) -> FloatArray:
    """(..., K) area in px that each of (..., K, 4) boxes shares with (M, 4) others, summed over these."""
    corners = places[..., None]
    width = np.minimum(corners[..., 2, :], others[:, 2]) - np.maximum(corners[..., 0, :], others[:, 0])
    height = np.minimum(corners[..., 3, :], others[:, 3]) - np.maximum(corners[..., 1, :], others[:, 1])
    return np.asarray(np.einsum("...m,...m->...", np.maximum(width, 0.0), np.maximum(height, 0.0)), np.float64)


def place_costs(places: FloatArray, boxes: FloatArray, habits: list[int | None] | None = None) -> FloatArray:
    """(N, K) what each of (N, K, 4) places costs; `habits`: the place that each label had before, None = it is new."""
    w, h = (places[:, 0, 2:] - places[:, 0, :2]).T
    costs = shared_areas(places, boxes) + np.outer(_STEP_COST * w * h, np.arange(places.shape[1]))
    for row, habit in enumerate(habits or ()):
        if habit is not None:
            costs[row, habit] -= _HABIT * w[row] * h[row]
    return costs


def free_place(places: FloatArray, costs: FloatArray, taken: FloatArray) -> int | None:
    """Which of (K, 4) places is the cheapest that covers none of the labels in `taken`; None if every place does."""
    free = shared_areas(places, taken) == 0
    return int(np.argmin(np.where(free, costs, np.inf))) if free.any() else None
