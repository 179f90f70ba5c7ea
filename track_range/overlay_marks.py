"""Marks on the picture itself: boxes, inner windows, leaders from labels to boxes, and the own lane's lines."""

from __future__ import annotations

import cv2
import numpy as np

from detection.detections import FloatArray, Image
from detection.lanes import LaneLines, points
from stereo.patches import inner_halves
from track_range.overlay_colours import BLACK, LANE_COLOUR, Bgr

_DASH = 7  # line widths from dash to dash
_MIN_WINDOW_PX = 8
_CORNER_SHARE = 0.2  # of an inner window's shorter side


def draw_box(canvas: Image, box: FloatArray, *, bgr: Bgr, line_px: int, dashed: bool) -> None:
    """Outline one box on a dark seam, dashed for a predicted one; parts outside the image are not drawn."""
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


def draw_inner_window(canvas: Image, box: FloatArray, *, bgr: Bgr) -> None:
    """The four corners of the inner half of a box, where stereo looks; none on a box too small to see them."""
    height, width = canvas.shape[:2]
    patch = next(inner_halves(box[None], (height, width), margin_px=0, min_side_px=_MIN_WINDOW_PX))
    if patch is None:
        return
    arm = max(2, round(_CORNER_SHARE * min(patch.width_px, patch.height_px)))
    strokes = [
        np.array([(x + arm * inward_x, y), (x, y), (x, y + arm * inward_y)], np.int32)
        for x, inward_x in ((patch.left, 1), (patch.right, -1))
        for y, inward_y in ((patch.top, 1), (patch.bottom, -1))
    ]
    cv2.polylines(canvas, strokes, False, BLACK, 3)
    cv2.polylines(canvas, strokes, False, bgr, 1)


def draw_leader(canvas: Image, place: FloatArray, box: FloatArray, *, bgr: Bgr) -> None:
    """A thin line from a label to its box, where a gap lies between them."""
    low, high = np.maximum(place[:2], box[:2]), np.minimum(place[2:], box[2:])
    if (low > high + 2).any():
        # Between overlapping spans of an axis both ends take the same coordinate: the line is the shortest one.
        start = np.where(low > high, np.clip(box[:2], place[:2], place[2:]), low)
        end = np.clip(start, box[:2], box[2:])
        ends = np.rint([start, end]).astype(int).tolist()
        cv2.line(canvas, ends[0], ends[1], BLACK, 3)
        cv2.line(canvas, ends[0], ends[1], bgr, 1)


def draw_lanes(canvas: Image, lanes: LaneLines, *, line_px: int) -> None:
    """The own lane's lines, as far as they were seen."""
    size_px = np.array(canvas.shape[1::-1], np.float64)
    for line in (lanes.left, lanes.right):
        if line is None:
            continue
        along = np.clip(np.nan_to_num(points(line)), -size_px, 2 * size_px)
        stroke = [np.rint(along).astype(np.int32)]
        cv2.polylines(canvas, stroke, False, BLACK, line_px + 2, cv2.LINE_AA)
        cv2.polylines(canvas, stroke, False, LANE_COLOUR, line_px, cv2.LINE_AA)
