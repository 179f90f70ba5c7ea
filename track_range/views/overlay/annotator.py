"""The overlay: a frame with the drawn box, identity and distances of each track.

Boxes, or the edges of cuboids, are solid if detected, dashed if predicted; corners inside a box mark
the window of the patch matcher. Labels (`labels.py`) are placed near their boxes, inside the image and without overlap
(`LabelPlacer`). A bird's-eye view (`birds_eye.py`) is in a corner; the lines of the ego lane are
drawn on the road. Labels of near tracks are placed first and do not cover nearer road users;
without room for a full label only its first line is drawn, and without room for that none.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np
import numpy.typing as npt

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.lanes.lines import LaneLines, points
from track_range.foundation.arrays import FloatArray, Image
from track_range.pipeline.colours import BLACK, GREY, LANE_COLOUR, WHITE, Bgr, track_colour
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.registry import methods
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rectification import Rectifier, Undistorter
from track_range.stereo.matching.sgbm import disparity_picture, inner_halves
from track_range.views.overlay import labels
from track_range.views.overlay.birds_eye import BirdsEye
from track_range.views.overlay.counted_places import CountedPlaces
from track_range.views.overlay.cuboid_strokes import cuboid_strokes

# returns short texts on the state of the run, such as the frame rate
Status = Callable[[], Sequence[str]]
# maximum number of labels per frame; in a crowd only the nearest tracks are labelled
MOST_LABELS = 100
_DASH = 7  # distance between the starts of dashes, in line widths
_MIN_WINDOW_PX = 8  # smallest side in pixels of an inner window that is drawn
# (4, 2) x and y of each corner in left, top, right, bottom
_CORNERS = np.array([(0, 1), (0, 3), (2, 1), (2, 3)])
_ARMS = np.array([[(x, 0), (0, 0), (0, y)] for x in (1, -1) for y in (1, -1)], np.int32)
"""(4, 3, 2) polyline at each corner, in arm lengths inwards: one end, the corner, the other end."""

_LANE_POINTS = 8  # points of the polyline of a lane line
# arm length of a corner as a fraction of the shorter side of the inner window
_CORNER_FRACTION = 0.2


class Overlay:
    """Draws the results of one video in their order; not thread-safe.

    The bird's-eye view needs the camera of the images. The texts of `status` follow frame number
    and time in the upper left corner, `warning` follows them in amber. `recorded` is the
    undistorter of the images of a wide lens: boxes are drawn, as curves, on the images before this
    step; None = on the left images. `counted` are the places of a camera that stands still, whose
    labels begin with the speed; None = of a camera that moves. With `has_cuboids`, the edges of the
    cuboids are drawn in place of the boxes of the tracks that have one.
    """

    def __init__(
        self,
        class_names: Sequence[str] = ROAD_CLASSES,
        *,
        camera: PinholeCamera | None = None,
        status: Status = tuple,
        warning: str = "",
        recorded: Rectifier | Undistorter | None = None,
        counted: CountedPlaces | None = None,
        has_cuboids: bool = False,
    ) -> None:
        self._counted, self._camera = counted, camera if has_cuboids else None
        self.class_names = tuple(class_names)
        self._recorded = recorded
        self._status, self._warning = status, warning
        self._text = labels.TextRenderer()
        self._inset = BirdsEye(camera)
        self._placer = labels.LabelPlacer()

    def draw(self, result: FrameResult) -> Image:
        """A new (H, W, 3) uint8 BGR image: the left or the recorded frame with its tracks drawn.

        Boxes may extend beyond the image; boxes with NaN are skipped; a NaN distance is shown as
        "-".
        """
        view = self._recorded
        canvas = (
            result.frame.left
            if view is None or result.frame.recorded is None
            else result.frame.recorded
        ).copy()
        line_px = labels.text_sizes_px((canvas.shape[1], canvas.shape[0]))[2]
        boxes = (
            result.tracks.xyxy_px if view is None else view.recorded_boxes(result.tracks.xyxy_px)
        )
        valid = np.flatnonzero(np.isfinite(boxes).all(axis=1))
        colours = [track_colour(track_id) for track_id in result.tracks.track_id.tolist()]
        nearest_first = valid[np.argsort(-boxes[valid, 3])].tolist()
        # Edges far outside the image are clipped: drawing takes 32-bit pixels, and time for each
        # dash.
        size_px = np.array(canvas.shape[1::-1], np.float64)
        boxes = np.clip(boxes, -8.0 * line_px, np.tile(size_px, 2) + 8.0 * line_px)
        draw_lanes(
            canvas,
            result.lanes,
            line_px=line_px,
            moved=None if view is None else view.recorded_points,
        )
        shapes = list(boxes) if view is None else view.recorded_outlines(result.tracks.xyxy_px)
        draw_shape = draw_box if view is None else draw_outline
        observed = result.tracks.observed.tolist()
        strokes = self._cuboid_strokes(result)
        for row in nearest_first[::-1]:
            bgr, is_dashed = colours[row], not observed[row]
            if row in strokes:
                draw_cuboid(canvas, strokes[row], bgr=bgr, line_px=line_px, dashed=is_dashed)
            else:
                draw_shape(canvas, shapes[row], bgr=bgr, line_px=line_px, dashed=is_dashed)
        if view is None and any(
            "right_image" in one.needs and one.name in result.ranges for one in methods()
        ):
            matched = [row for row in nearest_first[::-1] if observed[row]]
            draw_inner_windows(canvas, boxes[matched], [colours[row] for row in matched])
        if self._counted is not None:
            self._counted.draw(canvas, result)
        self._inset.draw(canvas, result, boxes)
        self._draw_labels(canvas, result, boxes, nearest_first[:MOST_LABELS], colours)
        return canvas

    def _cuboid_strokes(self, result: FrameResult) -> dict[int, FloatArray]:
        """(13, 9, 2) lines of the cuboids by track; empty if they are not shown."""
        if self._camera is None or not len(result.tracks):
            return {}
        strokes = cuboid_strokes(result.cuboids, self._camera)
        if self._recorded is not None:
            moved = self._recorded.recorded_points(strokes.reshape(-1, 2))
            strokes = moved.reshape(strokes.shape)
        known = np.isfinite(strokes).all(axis=(2, 3)).sum(axis=1)
        return {row: strokes[row] for row in np.flatnonzero(known).tolist()}

    def _draw_labels(
        self,
        canvas: Image,
        result: FrameResult,
        boxes: FloatArray,
        rows: Sequence[int],
        colours: Sequence[Bgr],
    ) -> None:
        image_px = (canvas.shape[1], canvas.shape[0])
        *sizes_px, line_px = labels.text_sizes_px(image_px)
        occupied = self._draw_corners(canvas, result, sizes_px[1])
        full, short, urgent = [], [], []
        for row in rows:
            lines = labels.label_lines(
                result, row, class_names=self.class_names, sizes_px=(sizes_px[0], sizes_px[1])
            )
            if self._counted is not None:
                lines = labels.with_speed(result, row, lines)
            full.append(lines)
            short.append(lines[:1])
            urgent.append(lines[-1][0].weight == labels.BOLD and lines[-1][0].fill is not None)
        placements = self._placer.place(
            result.tracks.track_id[rows].tolist(),
            boxes[rows],
            np.stack([self._text.sizes_px(full), self._text.sizes_px(short)]),
            occupied=occupied,
            image_px=image_px,
            urgent=urgent,
        )
        for row, placement in zip(rows, placements, strict=True):
            if placement:
                draw_leader(canvas, placement[1], boxes[row], bgr=colours[row], line_px=line_px)
        for i, placement in enumerate(placements):
            if placement:
                lines = short[i] if placement[0] else full[i]
                self._text.write(canvas, lines, placement[1], stripe=colours[rows[i]])

    def _draw_corners(self, canvas: Image, result: FrameResult, size_px: int) -> FloatArray:
        """Draw the texts of the corners that have room; (1 to 3, 4) rectangles of texts and inset,
        in pixels.
        """
        large = "fused" if self._counted is None else "speed over ground, else fused"
        corners = labels.corner_lines(
            result, size_px, status=self._status(), warning=self._warning, large=large
        )
        (w, h), (legend_w, legend_h) = self._text.sizes_px(corners).tolist()
        height, width = canvas.shape[:2]
        places = np.array([[0, 0, w, h], [width - legend_w, 0, width, legend_h]])
        places = places[: 0 if w > width else 1 if w + legend_w > width else 2]
        for lines, place in zip(corners, places, strict=False):
            self._text.write(canvas, lines, place)
        return np.vstack([places, self._inset.place((width, height))])


def draw_box(canvas: Image, box: FloatArray, *, bgr: Bgr, line_px: int, dashed: bool) -> None:
    """Draw the outline of a box with a dark border, dashed for a predicted box."""
    x1, y1, x2, y2 = map(round, box.tolist())
    if not dashed:
        cv2.rectangle(canvas, (x1, y1), (x2, y2), BLACK, line_px + 2)
        cv2.rectangle(canvas, (x1, y1), (x2, y2), bgr, line_px)
        return
    step = _DASH * line_px
    across = [((x, y), (min(x + step // 2, x2), y)) for y in (y1, y2) for x in range(x1, x2, step)]
    down = [((x, y), (x, min(y + step // 2, y2))) for x in (x1, x2) for y in range(y1, y2, step)]
    _draw_strokes(canvas, np.array(across + down, np.int32).reshape(-1, 2, 2), bgr, line_px)


def draw_outline(
    canvas: Image, outline: FloatArray, *, bgr: Bgr, line_px: int, dashed: bool
) -> None:
    """Draw a closed curve (N, 2) with a dark border, dashed for a predicted box; parts with NaN are
    omitted.
    """
    size_px = np.array(canvas.shape[1::-1], np.float64)
    segments = np.stack([outline, np.roll(outline, -1, axis=0)], axis=1)
    segments = segments[np.isfinite(segments).all(axis=(1, 2))][:: 2 if dashed else 1]
    _draw_strokes(
        canvas, np.rint(np.clip(segments, -size_px, 2 * size_px)).astype(np.int32), bgr, line_px
    )


def draw_cuboid(
    canvas: Image, strokes: FloatArray, *, bgr: Bgr, line_px: int, dashed: bool
) -> None:
    """Draw the lines (13, K, 2) of a cuboid with a dark border, dashed for a predicted box."""
    size_px = np.array(canvas.shape[1::-1], np.float64)
    if dashed:
        parts = np.stack([strokes[:, :-1], strokes[:, 1:]], axis=2)[:, ::2]
        strokes = parts.reshape(-1, 2, 2)
    shown = strokes[np.isfinite(strokes).all(axis=(1, 2))]
    pixels = np.rint(np.clip(shown, -9 * size_px, 9 * size_px)).astype(np.int32)
    _draw_strokes(canvas, pixels, bgr, line_px)


def _draw_strokes(canvas: Image, strokes: npt.NDArray[np.int32], bgr: Bgr, line_px: int) -> None:
    cv2.polylines(canvas, list(strokes), False, BLACK, line_px + 2)
    cv2.polylines(canvas, list(strokes), False, bgr, line_px)


def draw_inner_windows(canvas: Image, boxes: FloatArray, colours: Sequence[Bgr]) -> None:
    """Draw the corners of the inner half of each box, which the patch matcher uses; small boxes are
    skipped.
    """
    halves = inner_halves(boxes, canvas.shape[:2], margin_px=0, min_side_px=_MIN_WINDOW_PX)
    patches = [
        (patch, bgr) for patch, bgr in zip(halves, colours, strict=True) if patch is not None
    ]
    edges = np.array([patch for patch, _ in patches], np.int32).reshape(-1, 4)
    spans = edges[:, 2:] - edges[:, :2] + 1
    arm = (
        np.maximum(2, np.rint(_CORNER_FRACTION * spans.min(axis=1))).astype(np.int32)
        if len(edges)
        else spans[:, 0]
    )
    corners = edges[:, _CORNERS]
    strokes = np.repeat(corners[:, :, None], 3, axis=2) + arm[:, None, None, None] * _ARMS
    cv2.polylines(canvas, list(strokes.reshape(-1, 3, 2)), False, BLACK, 3)
    for corner_strokes, (_, bgr) in zip(strokes, patches, strict=True):
        cv2.polylines(canvas, list(corner_strokes), False, bgr, 1)


def draw_leader(
    canvas: Image, place: FloatArray, box: FloatArray, *, bgr: Bgr, line_px: int
) -> None:
    """Draw a thin line from a label to its box if there is a gap between them."""
    (left, top, right, bottom), (x1, y1, x2, y2) = place.tolist(), box.tolist()
    (start_x, end_x, gap_x), (start_y, end_y, gap_y) = (
        _nearest(left, right, x1, x2),
        _nearest(top, bottom, y1, y2),
    )
    if max(gap_x, gap_y) > 2:
        thin_px = max(1, line_px - 1)
        cv2.line(canvas, (start_x, start_y), (end_x, end_y), BLACK, thin_px + 2)
        cv2.line(canvas, (start_x, start_y), (end_x, end_y), bgr, thin_px)


def _nearest(
    low: float, high: float, other_low: float, other_high: float
) -> tuple[int, int, float]:
    """Nearest points of two intervals, one common point if they overlap, and the gap (negative =
    overlap).
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
    """Draw the lines of the ego lane over the range in which they were detected; `moved` maps
    points to the canvas.
    """
    size_px = np.array(canvas.shape[1::-1], np.float64)
    for line in (lanes.left, lanes.right):
        if line is None:
            continue
        along = points(line, n=_LANE_POINTS)
        if moved is not None:
            along = np.nan_to_num(moved(along))
        along = np.clip(along, -size_px, 2 * size_px)
        stroke = [np.rint(along).astype(np.int32)]
        cv2.polylines(canvas, stroke, False, BLACK, line_px + 2)
        cv2.polylines(canvas, stroke, False, LANE_COLOUR, line_px, cv2.LINE_AA)


REDDEST_M = 5.0  # distance in metres shown in the reddest colour; nearer ones have the same colour
SCALE_M = (5, 7, 10, 15, 20, 30, 50)  # distances on the scale, in metres


class DensePicture:
    """Draws the depths of all pixels, of the first method that measures them: near is red, far is
    blue, unknown is black; not thread-safe.
    """

    def __init__(self) -> None:
        self._text = labels.TextRenderer()

    def draw(self, result: FrameResult) -> Image:
        """Colour-coded inverse depths, (H, W, 3) uint8 BGR; black if no method measures them."""
        dense = next((one for one in result.dense.values() if one.is_depth), None)
        if dense is None:
            return np.zeros_like(result.frame.left)
        return disparity_picture(REDDEST_M / dense.in_image(dense.depth_m()), largest_px=1.0)

    def draw_marked(self, result: FrameResult) -> Image:
        """Colour-coded depths with the boxes and inner windows of the tracks, and a scale at the
        lower edge.
        """
        canvas = self.draw(result)
        boxes = np.clip(result.tracks.xyxy_px, -20.0, np.tile(canvas.shape[1::-1], 2) + 20.0)
        valid = np.isfinite(boxes).all(axis=1)
        for row in np.flatnonzero(valid).tolist():
            bgr, is_observed = (
                track_colour(int(result.tracks.track_id[row])),
                bool(result.tracks.observed[row]),
            )
            draw_box(canvas, boxes[row], bgr=bgr, line_px=1, dashed=not is_observed)
        observed = boxes[valid & result.tracks.observed]
        draw_inner_windows(canvas, observed, [WHITE] * len(observed))
        names = [name for name, one in result.dense.items() if one.is_depth]
        self._draw_scale(canvas, names[0] if names else "dense stereo")
        return canvas

    def _draw_scale(self, canvas: Image, name: str) -> None:
        size_px = labels.text_sizes_px((canvas.shape[1], canvas.shape[0]))[1]
        level = np.rint(255 * REDDEST_M / np.array(SCALE_M)).astype(np.uint8)
        swatches = cv2.applyColorMap(level[:, None], cv2.COLORMAP_TURBO)[:, 0].tolist()
        line = [labels.Span(f"{name}, m", size_px, labels.BOLD, WHITE)]
        for metres, (blue, green, red) in zip(SCALE_M, swatches, strict=True):
            line += [
                labels.Span("■■", size_px, labels.BOLD, (blue, green, red)),
                labels.Span(str(metres), size_px, labels.REGULAR, GREY),
            ]
        width, height = self._text.sizes_px([[line]])[0]
        corner: FloatArray = np.array(canvas.shape[1::-1], np.float64)
        if width <= corner[0]:
            self._text.write(canvas, [line], np.concatenate([corner - (width, height), corner]))


class StackedPicture:
    """Draws the overlay with the depths of all pixels below it; not thread-safe."""

    def __init__(self, overlay: Overlay) -> None:
        self._overlay, self._dense = overlay, DensePicture()

    def draw(self, result: FrameResult) -> Image:
        """Overlay above depths, (2 * H, W, 3) uint8 BGR."""
        return np.vstack([self._overlay.draw(result), self._dense.draw_marked(result)])
