"""Where labels stand: beside their boxes, inside the image, and never on one another.

Each label tries its places in order, near ones first; near boxes choose first, and what is taken stays taken. A place
costs the area of boxes that it covers and its number in the list; the place a label had in the frame before costs
less, so that labels do not jump. A label that finds no room, or would hide much of what lies behind, is cut short; one
that finds none even so is left out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray

BESIDE = ((0, 0, 0, -1), (1, 0, -1, -1), (0, 1, 0, 0), (1, 1, -1, 0), (1, 0, 0, 0), (0, 0, -1, 0), (0, 0, 0, 0))
AWAY = tuple((0, 0, across, -1 - up) for up in (0, 1, 2, 3, 4, -1, -2) for across in (0, 0.5, -0.5, 1, -1, 1.5, -1.5))
PLACES = np.array(BESIDE + AWAY, np.float64).reshape(-1, 2, 2)
"""(K, 2, 2) where a label may stand, best first: its upper left corner minus the box's, in box widths and heights,
then label widths and heights: above the box, below, beside it, inside it, then away from it in growing steps."""

_STEP_COST = 0.01
"""Of the label's own area: what one step down the list costs, beside the area of boxes covered."""

_HABIT = 0.1
"""Of the label's own area: how much better another place must be than the one of the frame before."""


_HIDES = 0.3
"""Of the label's own area: a full label that costs more is cut short if that helps."""


class LabelPlacer:
    """Finds room for the labels of one video, frame by frame."""

    def __init__(self) -> None:
        """Begin a video."""
        self._habits: dict[tuple[int, int], int] = {}

    def place(
        self,
        ids: Sequence[int],
        boxes: FloatArray,
        sizes_px: FloatArray,
        *,
        taken: FloatArray,
        image_px: tuple[int, int],
        urgent: Sequence[bool],
    ) -> list[tuple[int, FloatArray] | None]:
        """Which size each label takes, and where (4,) it stands; None = nowhere.

        Args:
            ids: whose label it is; what comes first chooses first.
            boxes: (N, 4) boxes, no NaN.
            sizes_px: (2, N, 2) width and height of full labels, and of short ones.
            taken: (M, 4) what is not free.
            image_px: (W, H).
            urgent: labels that are cut short only where they find no room.
        """
        habits, self._habits = self._habits, {}
        found: list[tuple[int, FloatArray] | None] = []
        full = _candidates(boxes, sizes_px[0], image_px, [habits.get((0, track_id)) for track_id in ids])
        for i, track_id in enumerate(ids):
            tried = full[0][i], full[1][i]
            size, number = 0, free_place(*tried, taken)
            if number is None or (not urgent[i] and tried[1][number] > _HIDES * sizes_px[0, i].prod()):
                habit = [habits.get((1, track_id))]
                short = [part[0] for part in _candidates(boxes, sizes_px[1, i : i + 1], image_px, habit, row=i)]
                other = free_place(short[0], short[1], taken)
                if other is not None and (number is None or short[1][other] < tried[1][number]):
                    size, number, tried = 1, other, (short[0], short[1])
            if number is not None:
                self._habits[size, track_id] = number
                taken = np.vstack([taken, tried[0][number]])
            found.append(None if number is None else (size, tried[0][number]))
        return found


def _candidates(
    boxes: FloatArray,
    size_px: FloatArray,
    image_px: tuple[int, int],
    habits: list[int | None],
    *,
    row: int | None = None,
) -> tuple[FloatArray, FloatArray]:
    """(N, K, 4) places and their (N, K) costs, of all boxes or of that in `row`; inf for what the image cannot hold."""
    places = label_places(boxes if row is None else boxes[row : row + 1], size_px, image_px)
    costs = place_costs(places, boxes, habits)
    costs[(size_px > image_px).any(axis=1)] = np.inf
    return places, costs


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
    """Which of (K, 4) places is the cheapest that covers no label in `taken`; None if all do, or cost inf."""
    costs = np.where(covered(places, taken), np.inf, costs)
    number = int(np.argmin(costs))
    return number if np.isfinite(costs[number]) else None


def covered(places: FloatArray, taken: FloatArray) -> BoolArray:
    """(K,) whether each of (K, 4) places shares any pixel with one of (M, 4) others."""
    shares = (places[:, None, :2] < taken[:, 2:]) & (places[:, None, 2:] > taken[:, :2])
    return np.asarray((shares[..., 0] & shares[..., 1]).any(axis=1))
