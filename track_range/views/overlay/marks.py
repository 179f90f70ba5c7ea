"""Drawing of boxes, inner windows, leader lines from labels to boxes, and the lines of the ego lane."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from track_range.detection.lanes.lines import LaneLines, points
from track_range.foundation.arrays import FloatArray, Image
from track_range.pipeline.colours import BLACK, LANE_COLOUR, Bgr
from track_range.stereo.matching.patches import inner_halves

_DASH = 7  # distance between the starts of dashes, in line widths
_MIN_WINDOW_PX = 8  # smallest side in pixels of an inner window that is drawn

_CORNERS = np.array([(0, 1), (0, 3), (2, 1), (2, 3)])
"""(4, 2) indices into (left, top, right, bottom) of the x and y of each corner of a window."""

_ARMS = np.array([[(x, 0), (0, 0), (0, y)] for x in (1, -1) for y in (1, -1)], np.int32)
"""(4, 3, 2) polyline at each corner, in arm lengths inwards: one end, the corner, the other end."""

_LANE_POINTS = 8  # points of the polyline of a lane line
_CORNER_FRACTION = 0.2  # arm length of a corner as a fraction of the shorter side of the inner window


def draw_box(canvas: Image, box: FloatArray, *, bgr: Bgr, line_px: int, dashed: bool) -> None:
    """Draw the outline of a box with a dark border, dashed for a predicted box."""
    x1, y1, x2, y2 = np.rint(box).astype(int).tolist()
    if not dashed:
        cv2.rectangle(canvas, (x1, y1), (x2, y2), BLACK, line_px + 2)
        cv2.rectangle(canvas, (x1, y1), (x2, y2), bgr, line_px)
        return
    step = _DASH * line_px
    across = [((x, y), (min(x + step // 2, x2), y)) for y in (y1, y2) for x in range(x1, x2, step)]
    down = [((x, y), (x, min(y + step // 2, y2))) for x in (x1, x2) for y in range(y1, y2, step)]
    strokes = np.array(across + down, np.int32).reshape(-1, 2, 2)
    cv2.polylines(canvas, list(strokes), False, BLACK, line_px + 2)
    cv2.polylines(canvas, list(strokes), False, bgr, line_px)


def draw_outline(canvas: Image, outline: FloatArray, *, bgr: Bgr, line_px: int, dashed: bool) -> None:
    """Draw a closed curve (N, 2) with a dark border, dashed for a predicted box; parts with NaN are omitted."""
    size_px = np.array(canvas.shape[1::-1], np.float64)
    segments = np.stack([outline, np.roll(outline, -1, axis=0)], axis=1)
    segments = segments[np.isfinite(segments).all(axis=(1, 2))][:: 2 if dashed else 1]
    strokes = list(np.rint(np.clip(segments, -size_px, 2 * size_px)).astype(np.int32))
    cv2.polylines(canvas, strokes, False, BLACK, line_px + 2)
    cv2.polylines(canvas, strokes, False, bgr, line_px)


def draw_inner_windows(canvas: Image, boxes: FloatArray, colours: Sequence[Bgr]) -> None:
    """Draw the corners of the inner half of each box, which the patch matcher uses; small boxes are skipped."""
    halves = inner_halves(boxes, canvas.shape[:2], margin_px=0, min_side_px=_MIN_WINDOW_PX)
    patches = [(patch, bgr) for patch, bgr in zip(halves, colours, strict=True) if patch is not None]
    edges = np.array([patch for patch, _ in patches], np.int32).reshape(-1, 4)
    spans = edges[:, 2:] - edges[:, :2] + 1
    arm = np.maximum(2, np.rint(_CORNER_FRACTION * spans.min(axis=1))).astype(np.int32) if len(edges) else spans[:, 0]
    corners = edges[:, _CORNERS]
    strokes = np.repeat(corners[:, :, None], 3, axis=2) + arm[:, None, None, None] * _ARMS
    cv2.polylines(canvas, list(strokes.reshape(-1, 3, 2)), False, BLACK, 3)
    for corner_strokes, (_, bgr) in zip(strokes, patches, strict=True):
        cv2.polylines(canvas, list(corner_strokes), False, bgr, 1)


def draw_leader(canvas: Image, place: FloatArray, box: FloatArray, *, bgr: Bgr, line_px: int) -> None:
    """Draw a thin line from a label to its box if there is a gap between them."""
    (left, top, right, bottom), (x1, y1, x2, y2) = place.tolist(), box.tolist()
    (start_x, end_x, gap_x), (start_y, end_y, gap_y) = _nearest(left, right, x1, x2), _nearest(top, bottom, y1, y2)
    if max(gap_x, gap_y) > 2:
        thin_px = max(1, line_px - 1)
        cv2.line(canvas, (start_x, start_y), (end_x, end_y), BLACK, thin_px + 2)
        cv2.line(canvas, (start_x, start_y), (end_x, end_y), bgr, thin_px)


def _nearest(low: float, high: float, other_low: float, other_high: float) -> tuple[int, int, float]:
    """Nearest points of two intervals of an axis, and the gap between them (negative = overlap).

    Overlapping intervals share the point, so that a leader is the shortest line.
    """
    shared_low, shared_high = max(low, other_low), min(high, other_high)
    if shared_low <= shared_high:
        return round(shared_low), round(shared_low), shared_low - shared_high
    start, end = (high, other_low) if other_low > high else (low, other_high)
    return round(start), round(end), shared_low - shared_high


def draw_lanes(
    canvas: Image,
    lanes: LaneLines,
    *,
    line_px: int,
    moved: Callable[[FloatArray], FloatArray] | None = None,
) -> None:
    """Draw the lines of the ego lane over the range in which they were detected; `moved` maps points to the canvas."""
    size_px = np.array(canvas.shape[1::-1], np.float64)
    for line in (lanes.left, lanes.right):
        if line is None:
            continue
        drawn = points(line, n=_LANE_POINTS)
        along = np.clip(np.nan_to_num(drawn if moved is None else moved(drawn)), -size_px, 2 * size_px)
        stroke = [np.rint(along).astype(np.int32)]
        cv2.polylines(canvas, stroke, False, BLACK, line_px + 2)
        cv2.polylines(canvas, stroke, False, LANE_COLOUR, line_px, cv2.LINE_AA)
