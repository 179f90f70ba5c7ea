"""Layout of labels: near their boxes, inside the image, and without overlap.

Labels are placed greedily in the given order. Each gets the free candidate position of the lowest cost: the area of
boxes it covers, plus a term that grows along the list of candidates (near ones first), minus a bonus for the position
in the previous frame, so that labels do not jump. A label without a free position, or at a high cost, is shortened; if
that does not help either, it is omitted.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from track_range.foundation.arrays import FloatArray

BESIDE = ((0, 0, 0, -1), (1, 0, -1, -1), (0, 1, 0, 0), (1, 1, -1, 0), (1, 0, 0, 0), (0, 0, -1, 0), (0, 0, 0, 0))
AWAY = tuple((0, 0, across, -1 - up) for up in (0, 1, 2, 3, 4, -1, -2) for across in (0, 0.5, -0.5, 1, -1, 1.5, -1.5))
PLACES = np.array(BESIDE + AWAY, np.float64).reshape(-1, 2, 2)
"""(K, 2, 2) candidate positions of a label, best first: offset of its upper left corner from that of the box, as a
multiple of the box size plus a multiple of the label size. First at the box and inside it, then farther away."""

_STEP_COST = 0.01  # cost of each step along the list of candidates, as a fraction of the label's area
_PREVIOUS_BONUS = 0.1  # bonus for the position in the previous frame, as a fraction of the label's area

_MAX_COST = 0.3
"""Cost above which a full label is shortened if that reduces the cost, as a fraction of the label's area."""


class LabelPlacer:
    """Places the labels of one video, frame by frame."""

    def __init__(self) -> None:
        self._previous: dict[tuple[int, int], int] = {}

    def place(
        self,
        ids: Sequence[int],
        boxes: FloatArray,
        sizes_px: FloatArray,
        *,
        occupied: FloatArray,
        image_px: tuple[int, int],
        urgent: Sequence[bool],
    ) -> list[tuple[int, FloatArray] | None]:
        """Size (0 = full, 1 = short) and rectangle (4,) of each label; None = no free position.

        Args:
            ids: track IDs of the labels, in the order of placement.
            boxes: (N, 4) boxes of the tracks, without NaN.
            sizes_px: (2, N, 2) width and height of the full and the short labels.
            occupied: (M, 4) rectangles that labels must not cover.
            image_px: (W, H).
            urgent: (N,) whether a label is shortened only if the full one has no free position.
        """
        previous, self._previous = self._previous, {}
        placements: list[tuple[int, FloatArray] | None] = []
        full = _candidates(boxes, sizes_px[0], image_px, [previous.get((0, track_id)) for track_id in ids])
        for i, track_id in enumerate(ids):
            places, costs = full[0][i], full[1][i]
            size, number = 0, free_place(places, costs, occupied)
            if number is None or (not urgent[i] and costs[number] > _MAX_COST * sizes_px[0, i].prod()):
                last = [previous.get((1, track_id))]
                short = [part[0] for part in _candidates(boxes, sizes_px[1, i : i + 1], image_px, last, row=i)]
                short_number = free_place(short[0], short[1], occupied)
                if short_number is not None and (number is None or short[1][short_number] < costs[number]):
                    size, number, places = 1, short_number, short[0]
            if number is not None:
                self._previous[size, track_id] = number
                occupied = np.vstack([occupied, places[number]])
            placements.append(None if number is None else (size, places[number]))
        return placements


def _candidates(
    boxes: FloatArray,
    size_px: FloatArray,
    image_px: tuple[int, int],
    previous: list[int | None],
    *,
    row: int | None = None,
) -> tuple[FloatArray, FloatArray]:
    """(N, K, 4) candidate rectangles and (N, K) costs, for all boxes or that in `row`; inf if larger than the image."""
    places = label_places(boxes if row is None else boxes[row : row + 1], size_px, image_px)
    costs = place_costs(places, boxes, previous)
    costs[(size_px > image_px).any(axis=1)] = np.inf
    return places, costs


def label_places(boxes: FloatArray, size_px: FloatArray, image_px: tuple[int, int]) -> FloatArray:
    """(N, K, 4) candidate rectangles of labels of size (N, 2) at (N, 4) boxes in an image (W, H), best first."""
    spans = np.stack([boxes[:, 2:] - boxes[:, :2], size_px], axis=1)
    corner = boxes[:, None, :2] + np.einsum("kij,nij->nkj", PLACES, spans)
    corner = np.clip(corner, 0.0, np.maximum(np.array(image_px) - size_px, 0.0)[:, None]).round()
    return np.concatenate([corner, corner + size_px[:, None]], axis=2)


def shared_areas(places: FloatArray, others: FloatArray) -> FloatArray:
    """(..., K) area in px^2 that each of (..., K, 4) rectangles shares with (M, 4) others, summed over these."""
    corners = places[..., None]
    width = np.minimum(corners[..., 2, :], others[:, 2]) - np.maximum(corners[..., 0, :], others[:, 0])
    height = np.minimum(corners[..., 3, :], others[:, 3]) - np.maximum(corners[..., 1, :], others[:, 1])
    return np.asarray(np.einsum("...m,...m->...", np.maximum(width, 0.0), np.maximum(height, 0.0)), np.float64)


def place_costs(places: FloatArray, boxes: FloatArray, previous: list[int | None] | None = None) -> FloatArray:
    """(N, K) costs in px^2 of (N, K, 4) candidates; `previous`: candidate of each label in the last frame, or None."""
    w, h = (places[:, 0, 2:] - places[:, 0, :2]).T
    costs = shared_areas(places, boxes) + np.outer(_STEP_COST * w * h, np.arange(places.shape[1]))
    for row, number in enumerate(previous or ()):
        if number is not None:
            costs[row, number] -= _PREVIOUS_BONUS * w[row] * h[row]
    return costs


def free_place(places: FloatArray, costs: FloatArray, occupied: FloatArray) -> int | None:
    """Index of the cheapest of (K, 4) candidates that is free and has a finite cost; None if there is none."""
    fractions = (places[:, None, :2] < occupied[:, 2:]) & (places[:, None, 2:] > occupied[:, :2])
    costs = np.where((fractions[..., 0] & fractions[..., 1]).any(axis=1), np.inf, costs)
    number = int(np.argmin(costs))
    return number if np.isfinite(costs[number]) else None
