"""The overlay: a frame with the box, identity and distances of each track drawn on it.

Boxes are solid if detected, dashed if predicted; corners inside a box mark the window of the patch matcher. Labels
(`labels.py`) are placed near their boxes, inside the image and without overlap (`label_layout.py`). A bird's-eye view
(`birds_eye.py`) is at the lower left; the lines of the ego lane are drawn on the road. Labels of near tracks are placed
first; without room for a full label only its first line is drawn, and without room for that none.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import FloatArray, Image
from track_range.pipeline.colours import Bgr, track_colour
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.registry import methods
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.recorded_view import RecordedView
from track_range.views.overlay.birds_eye import BirdsEye
from track_range.views.overlay.label_layout import LabelPlacer
from track_range.views.overlay.labels import BOLD, TextRenderer, corner_lines, label_lines, text_sizes_px
from track_range.views.overlay.marks import draw_box, draw_inner_windows, draw_lanes, draw_leader, draw_outline

Status = Callable[[], Sequence[str]]  # returns short texts on the state of the run, such as the frame rate
MOST_LABELS = 100  # maximum number of labels per frame; in a crowd only the nearest tracks are labelled


class Overlay:
    """Draws the results of one video in their order; not thread-safe.

    Args:
        class_names: names by class ID.
        camera: camera of the images, for the bird's-eye view.
        status: texts for the upper left corner, after frame number and time.
        warning: text in amber after these.
        recorded: the recorded image of a wide lens to draw on, in which boxes are curved; None = the left image.
    """

    def __init__(
        self,
        class_names: Sequence[str] = ROAD_CLASSES,
        *,
        camera: PinholeCamera | None = None,
        status: Status = tuple,
        warning: str = "",
        recorded: RecordedView | None = None,
    ) -> None:
        self.class_names = tuple(class_names)
        self._recorded = recorded
        self._status, self._warning = status, warning
        self._text = TextRenderer()
        self._inset = BirdsEye(camera)
        self._placer = LabelPlacer()

    def draw(self, result: FrameResult) -> Image:
        """A new (H, W, 3) uint8 BGR image: the left frame, or the recorded one, with its tracks drawn on it.

        Boxes may extend beyond the image; boxes with NaN are skipped; a NaN distance is shown as "-".
        """
        view = self._recorded
        canvas = (result.frame.left if view is None or result.frame.recorded is None else result.frame.recorded).copy()
        line_px = text_sizes_px((canvas.shape[1], canvas.shape[0]))[2]
        boxes = result.tracks.xyxy_px if view is None else view.boxes(result.tracks.xyxy_px)
        valid = np.flatnonzero(np.isfinite(boxes).all(axis=1))
        colours = [track_colour(track_id) for track_id in result.tracks.track_id.tolist()]
        nearest_first = valid[np.argsort(-boxes[valid, 3])].tolist()
        # Edges far outside the image are clipped: drawing takes 32-bit pixels, and time for each dash.
        size_px = np.array(canvas.shape[1::-1], np.float64)
        boxes = np.clip(boxes, -8.0 * line_px, np.tile(size_px, 2) + 8.0 * line_px)
        if result.lanes is not None:
            draw_lanes(canvas, result.lanes, line_px=line_px, moved=None if view is None else view.points)
        shapes = list(boxes) if view is None else view.outlines(result.tracks.xyxy_px)
        draw_shape = draw_box if view is None else draw_outline
        observed = result.tracks.observed.tolist()
        for row in nearest_first[::-1]:
            draw_shape(canvas, shapes[row], bgr=colours[row], line_px=line_px, dashed=not observed[row])
        if view is None and any("right_image" in one.needs and one.name in result.ranges for one in methods()):
            matched = [row for row in nearest_first[::-1] if observed[row]]
            draw_inner_windows(canvas, boxes[matched], [colours[row] for row in matched])
        self._inset.draw(canvas, result)
        self._draw_labels(canvas, result, boxes, nearest_first[:MOST_LABELS], colours)
        return canvas

    def _draw_labels(
        self, canvas: Image, result: FrameResult, boxes: FloatArray, rows: Sequence[int], colours: Sequence[Bgr]
    ) -> None:
        """Draw the texts in the corners, then the label of each track in the order of `rows`."""
        image_px = (canvas.shape[1], canvas.shape[0])
        *sizes_px, line_px = text_sizes_px(image_px)
        occupied = self._draw_corners(canvas, result, sizes_px[1])
        full, short, urgent = [], [], []
        for row in rows:
            lines = label_lines(result, row, class_names=self.class_names, sizes_px=(sizes_px[0], sizes_px[1]))
            full.append(lines)
            short.append(lines[:1])
            urgent.append(lines[-1][0].weight == BOLD and lines[-1][0].fill is not None)
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
        """Draw frame number and time at the upper left and the legend at the upper right, if there is room.

        Returns:
            (1 to 3, 4) rectangles of these and of the inset, in pixels.
        """
        corners = corner_lines(result, size_px, status=self._status(), warning=self._warning)
        (w, h), (legend_w, legend_h) = self._text.sizes_px(corners).tolist()
        height, width = canvas.shape[:2]
        places = np.array([[0, 0, w, h], [width - legend_w, 0, width, legend_h]])
        places = places[: 0 if w > width else 1 if w + legend_w > width else 2]
        for lines, place in zip(corners, places, strict=False):
            self._text.write(canvas, lines, place)
        return np.vstack([places, self._inset.place((width, height))])
